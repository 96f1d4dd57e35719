"""Rendered clouds: things stand where they should, in their colours, on a clean background."""

from base64 import b64decode
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from dense_clouds import CRATE, EMPTY, FLOOR, assemble, cube, select, sheet

from stillroom.data.dense_cloud import DenseCloud
from stillroom.errors import ConfigError, StillroomError
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.viz.cloud.render import GAP_PX, CloudRendererConfig, creases, draw_dense_pair, fill_gaps, write_panels
from stillroom.viz.cloud.splat import splat
from stillroom.viz.cloud.view import Viewpoint, default_view

CAMERA = Camera(240, 160, 200.0, 200.0, 119.5, 79.5)
RENDERER = CloudRendererConfig().build()


def hue(rgb: np.ndarray | tuple[int, int, int]) -> np.ndarray:
    """Colours without their brightness."""
    colors = np.asarray(rgb, float)
    return colors / np.maximum(np.linalg.norm(colors, axis=-1, keepdims=True), 1e-9)


def is_of(picture: np.ndarray, rgb: tuple[int, int, int]) -> np.ndarray:
    return np.linalg.norm(hue(picture) - hue(rgb), axis=2) < 0.08


def test_a_cubes_faces_land_where_they_project() -> None:
    """Seen from a corner, three faces show: the picture is the hull of the projected corners, and full."""
    center, edge_m = np.array([0.0, 0.0, 3.0]), 0.8
    T_view_cube = se3.exp(np.array([0, 0, 0, 0.5, 0.6, 0.0]))
    faces = [
        ((p - center) @ T_view_cube[:3, :3].T + center, n @ T_view_cube[:3, :3].T, c)
        for p, n, c in cube(center, edge_m, CRATE)
    ]
    picture = RENDERER.render(assemble(faces), Viewpoint(np.eye(4), CAMERA))
    corners_m = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * edge_m / 2
    px = CAMERA.project(corners_m @ T_view_cube[:3, :3].T + center)
    hull = cv2.convexHull(np.rint(px).astype(np.int32))
    expected = cv2.fillConvexPoly(np.zeros((160, 240), np.uint8), hull, 1).astype(bool)
    found = is_of(picture, CRATE)
    # A disc reaches beyond its point by 1.25 voxels: 4 px here.
    assert found[cv2.erode(expected.astype(np.uint8), np.ones((3, 3))).astype(bool)].all()
    assert not found[~cv2.dilate(expected.astype(np.uint8), np.ones((11, 11))).astype(bool)].any()


def test_a_face_seen_head_on_is_brighter_than_a_slanted_one() -> None:
    head_on = assemble([sheet((-2, -2, 3), (4, 0, 0), (0, 4, 0), (0, 0, -1), (150, 150, 150))])
    slanted = assemble([sheet((-1, -2, 2), (2, 0, 3), (0, 4, 0), (3, 0, -2) / np.sqrt(13), (150, 150, 150))])
    bright, dark = (RENDERER.render(cloud, Viewpoint(np.eye(4), CAMERA))[80, 120, 0] for cloud in (head_on, slanted))
    assert bright == pytest.approx(150 * 1.15, abs=3)
    assert dark < bright - 10


def test_an_empty_cloud_is_the_background() -> None:
    picture = RENDERER.render(EMPTY, Viewpoint(np.eye(4), CAMERA))
    config = CloudRendererConfig()
    assert picture.shape == (160, 240, 3)
    assert picture.dtype == np.uint8
    np.testing.assert_allclose(picture[0], [config.background_top] * 240, atol=1)
    np.testing.assert_allclose(picture[-1], [config.background_bottom] * 240, atol=1)
    assert np.all(np.diff(picture[:, 0].astype(int), axis=0) >= 0)


def test_the_same_cloud_gives_the_same_picture(room: DenseCloud, poses: np.ndarray) -> None:
    view = default_view(room, poses, 240, 160)
    first = RENDERER.render(room, view)
    np.testing.assert_array_equal(RENDERER.render(room, view), first)
    # In another order only sums round otherwise.
    order = np.random.default_rng(0).permutation(len(room))
    assert np.abs(RENDERER.render(select(room, order), view).astype(int) - first).max() <= 1


def test_edges_are_smooth_where_pixels_are_means() -> None:
    cloud = assemble(cube((0.0, 0.0, 3.0), 0.8, (0, 0, 0)))
    view = Viewpoint(np.eye(4), CAMERA)
    shades = [len(np.unique(CloudRendererConfig(supersampling=n).build().render(cloud, view)[80])) for n in (1, 4)]
    assert shades[1] > shades[0]


def test_narrow_gaps_are_filled_and_wide_ones_left() -> None:
    left = sheet((-1.0, -0.5, 2), (0.9, 0, 0), (0, 1, 0), (0, 0, -1), FLOOR)
    for gap_m, filled in ((0.2, True), (0.5, False)):
        right = sheet((-0.1 + gap_m, -0.5, 2), (0.9, 0, 0), (0, 1, 0), (0, 0, -1), FLOOR)
        splats = splat(assemble([left, right]), Viewpoint(np.eye(4), CAMERA), 0.06)
        column = round(119.5 + 200 * (-0.1 + gap_m / 2) / 2)
        assert splats.nearest[80, column] < 0
        whole, covered = fill_gaps(splats, 15)
        assert covered[80, column] == filled
        assert not filled or np.allclose(whole.rgb[80, column], FLOOR, atol=1)
        assert not filled or whole.depth_m[80, column] == pytest.approx(2.0, abs=0.01)


def test_planes_have_no_creases_however_slanted_and_corners_have() -> None:
    v, u = np.mgrid[0:80, 0:120]
    plane = (1.0 / (0.2 + 0.002 * u + 0.001 * v)).astype(np.float32)
    inside = (slice(20, -20), slice(20, -20))
    assert creases(plane, np.ones(plane.shape, bool), 6)[inside].max() < 0.02
    corner = (1.0 / (0.3 + 0.002 * np.abs(u - 60.0))).astype(np.float32)
    deep = creases(corner, np.ones(corner.shape, bool), 6)
    assert deep[40, 60] > 0.5
    assert deep[40, 30] < 0.02
    step = np.where(u < 60, 2.0, 3.0).astype(np.float32)
    halo = creases(step, np.ones(step.shape, bool), 6)
    assert halo[40, 62] > 0.2
    assert halo[40, 57] < halo[40, 62] / 2


def test_the_pair_shows_the_crate_only_where_it_is(room: DenseCloud, poses: np.ndarray, tmp_path: Path) -> None:
    crate = is_of(room.rgb[None], CRATE)[0]
    path = tmp_path / "new" / "pair.png"
    draw_dense_pair(path, room, select(room, ~crate), poses, size_px=(300, 220))
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    assert picture.shape == (220, 2 * 300 + GAP_PX, 3)
    left, right = picture[:, :300], picture[:, 300 + GAP_PX :]
    assert np.all(picture[:, 300 : 300 + GAP_PX] == 255)
    assert is_of(left, CRATE).sum() > 300
    assert not is_of(right, CRATE).any()
    elsewhere = ~cv2.dilate(is_of(left, CRATE).astype(np.uint8), np.ones((41, 41))).astype(bool)
    elsewhere[-40:] = False  # The captions differ.
    np.testing.assert_array_equal(left[elsewhere], right[elsewhere])
    dark = (picture.max(axis=2) < 90) & (np.arange(220) > 190)[:, None]
    assert dark[:, :150].any()
    assert dark[:, 312:462].any()


def test_the_pair_takes_a_view_and_names_a_place_it_cannot_write(room, poses, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    view = Viewpoint(np.eye(4), CAMERA)
    with pytest.raises(StillroomError, match=r"taken/.*cannot be written"):
        draw_dense_pair(tmp_path / "taken" / "pair.png", room, room, poses, view=view)
    draw_dense_pair(tmp_path / "pair.png", EMPTY, room, poses, view=view)
    assert cv2.imread(str(tmp_path / "pair.png")).shape == (160, 480 + GAP_PX, 3)


@pytest.mark.parametrize(("config", "word"), [({"supersampling": 0}, "supersampling"), ({"disc_voxels": 0.0}, "disc")])
def test_an_impossible_value_is_named(config: dict[str, float], word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        CloudRendererConfig(**config).build()


@pytest.mark.filterwarnings("error")
def test_panels_for_a_paper_lie_where_they_do_in_pixels(tmp_path: Path) -> None:
    """Each fills its half; a picture that took its pixels for points would reach beyond the page."""
    panels = [np.full((300, 400, 3), color, np.uint8) for color in ((200, 40, 30), (30, 160, 60))]
    write_panels(tmp_path / "pair.svg", panels, ("one", "two"), ["1", "2"])
    drawn = ElementTree.parse(tmp_path / "pair.svg").getroot()
    width, height = (float(side) for side in drawn.attrib["viewBox"].split()[2:])
    assert (width, height) == pytest.approx(((800 + GAP_PX) * 72 / 150, 300 * 72 / 150))
    images = list(drawn.iter("{http://www.w3.org/2000/svg}image"))
    assert len(images) == 2
    for image, panel, left in zip(images, panels, (0, 400 + GAP_PX), strict=True):
        assert (image.attrib["width"], image.attrib["height"]) == ("400", "300")
        moved = [float(number) for number in image.attrib["transform"].removeprefix("matrix(").rstrip(")").split()]
        assert moved == pytest.approx([72 / 150, 0, 0, 72 / 150, left * 72 / 150, 0], abs=0.01)
        png = b64decode(image.attrib["{http://www.w3.org/1999/xlink}href"].partition(",")[2])
        picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR_RGB)
        assert picture is not None
        assert np.abs(picture[50:250, 50:350].astype(int) - panel[0, 0]).max() <= 1
    write_panels(tmp_path / "pair.pdf", panels, ("one", "two"), ["1", "2"])
    assert (tmp_path / "pair.pdf").read_bytes().count(b"/Subtype /Image") == 2
