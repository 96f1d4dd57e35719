"""Painting out: on a wall whose colours are known, and against the same rendered room without figures."""

from dataclasses import replace

import numpy as np
import pytest
from flat_wall import wall_depth
from small_world import CAMERA, NO_DEPTH, SCALES, SmallWorld, pose

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.image import RgbdImage
from stillroom.data.map import Map
from stillroom.datasets.open import open_dataset
from stillroom.dense.inpainting import BackgroundPainter, InpaintingConfig, Painted
from stillroom.errors import ConfigError
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera

BENT = replace(CAMERA, distortion=(0.12, -0.2, 0.002, -0.003, 0.05))
FIGURE = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
FIGURE[100:400, 250:380] = True
NOBODY = np.zeros_like(FIGURE)
EXACT = InpaintingConfig(margin_px=0, close_px=0)


def painted_wall(camera: Camera, T_world_cam: np.ndarray, index: int = 0) -> RgbdImage:
    """The wall z = 3 m in colours that are smooth functions of the place on it."""
    depth_m = wall_depth(camera, T_world_cam)
    column, row = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    px = camera.undistort(np.stack((column.ravel(), row.ravel()), axis=1).astype(np.float32))
    places = se3.transform(T_world_cam, camera.back_project(px, depth_m.ravel()))
    x, y = places[:, 0].reshape(depth_m.shape), places[:, 1].reshape(depth_m.shape)
    rgb = np.stack((128 + 90 * np.sin(2 * x), 128 + 90 * np.cos(3 * y), 128 + 60 * np.sin(x + 2 * y)), axis=-1)
    return RgbdImage(index / 30.0, np.rint(rgb).astype(np.uint8), depth_m, index)


def somebody_before(image: RgbdImage, where: np.ndarray = FIGURE) -> RgbdImage:
    rgb, depth_m = image.rgb.copy(), image.depth_m.copy()
    rgb[where], depth_m[where] = (255, 0, 0), 1.2
    return replace(image, rgb=rgb, depth_m=depth_m)


def at(poses: list[np.ndarray]) -> Map:
    """A map whose keyframes stand at these poses."""
    world = Map(SCALES)
    frame, _ = SmallWorld.of(0, 50).look(pose())
    unseen = np.full(len(frame), -1, np.int32)
    for T_world_cam in poses:
        world.add_keyframe(frame, T_world_cam, unseen, np.ones(len(frame), np.bool_), parent=-1)
    return world


def error_db(painted: Painted, true: np.ndarray) -> float:
    """PSNR of the painted pixels [dB]."""
    difference = painted.rgb[painted.is_filled].astype(float) - true[painted.is_filled]
    return float(10 * np.log10(255.0**2 / max(np.mean(difference**2), 1e-9)))


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["straight", "bent"])
def test_a_wall_is_painted_as_it_is(camera: Camera) -> None:
    before, now = pose(0.25, 0.1, -0.1, turn=(0.03, -0.06, 0.05)), pose()
    painter = EXACT.build(camera)
    painter.remember(0, painted_wall(camera, before), NOBODY)
    true = painted_wall(camera, now)
    painted = painter.paint(somebody_before(true), now, FIGURE, at([before]))
    assert painted.is_filled[FIGURE].mean() > 0.995
    assert not painted.is_filled[~FIGURE].any()
    np.testing.assert_array_equal(painted.is_hole, FIGURE & ~painted.is_filled)
    np.testing.assert_array_equal(painted.rgb[~FIGURE], true.rgb[~FIGURE])
    np.testing.assert_array_equal(painted.depth_m[~FIGURE], true.depth_m[~FIGURE])
    assert error_db(painted, true.rgb) > 45
    assert np.abs(painted.depth_m - true.depth_m)[painted.is_filled].max() < 0.005


def test_what_nobody_saw_stays_a_hole() -> None:
    painter = replace(EXACT, hole_grey=7).build(CAMERA)
    image = painted_wall(CAMERA, pose())
    alone = painter.paint(somebody_before(image), pose(), FIGURE, Map(SCALES))
    np.testing.assert_array_equal(alone.is_hole, FIGURE)
    assert np.all(alone.rgb[FIGURE] == 7)
    assert np.all(alone.depth_m[FIGURE] == 0)
    # A keyframe in which the same pixels moved knows no better; nor does one that was nearer than 0.2 m.
    painter.remember(0, somebody_before(image), FIGURE)
    assert not painter.paint(somebody_before(image), pose(), FIGURE, at([pose()])).is_filled.any()
    near = replace(image, depth_m=np.full_like(NO_DEPTH, 0.15))
    painter.remember(1, near, NOBODY)
    assert not painter.paint(somebody_before(image), pose(), FIGURE, at([pose(), pose()])).is_filled.any()


def test_the_nearest_surface_hides_what_lies_behind() -> None:
    painter = EXACT.build(CAMERA)
    wall = painted_wall(CAMERA, pose())
    pillar = np.zeros_like(FIGURE)
    pillar[150:300, 300:330] = True
    with_pillar = somebody_before(wall, pillar)  # stays: the keyframe is not told that it moves
    painter.remember(0, with_pillar, NOBODY)
    painter.remember(1, wall, NOBODY)  # knows the wall there
    painted = painter.paint(somebody_before(wall), pose(), FIGURE, at([pose(), pose()]))
    assert np.all(painted.rgb[pillar] == (255, 0, 0))
    np.testing.assert_allclose(painted.depth_m[pillar], 1.2, atol=1e-5)


def test_keyframes_are_where_the_map_says_now() -> None:
    true = painted_wall(CAMERA, pose())
    painter = EXACT.build(CAMERA)
    there = pose(0.2, 0.1)
    painter.remember(0, painted_wall(CAMERA, there), NOBODY)
    world = at([pose(-0.3)])
    wrong = painter.paint(somebody_before(true), pose(), FIGURE, world)
    world.keyframes.T_world_cam[0] = there
    right = painter.paint(somebody_before(true), pose(), FIGURE, world)
    assert error_db(right, true.rgb) > error_db(wrong, true.rgb) + 15


def test_only_the_last_keyframes_are_kept() -> None:
    painter = replace(EXACT, keyframes=3).build(CAMERA)
    image = painted_wall(CAMERA, pose())
    for keyframe in range(5):
        painter.remember(keyframe, image, FIGURE if keyframe > 1 else NOBODY)
    assert len(painter) == 3
    assert not painter.paint(somebody_before(image), pose(), FIGURE, at([pose()] * 5)).is_filled.any()


def test_the_dense_map_fills_what_is_left() -> None:
    image = painted_wall(CAMERA, pose())
    x, y = np.meshgrid(np.arange(-1.5, 1.5, 0.02), np.arange(-1.5, 1.5, 0.02))
    places = np.stack((x.ravel(), y.ravel(), np.full(x.size, 3.0)), axis=1).astype(np.float32)
    positions = np.concatenate((places, places + np.float32([0, 0, 0.5])))
    colours = np.repeat(np.uint8([[90], [30]]), x.size, axis=0) * np.ones(3, np.uint8)
    cloud = DenseCloud(positions, np.zeros_like(positions), colours, np.ones(len(positions), np.float32), 0.02)
    painted = EXACT.build(CAMERA).paint(somebody_before(image), pose(), FIGURE, Map(SCALES), cloud)
    assert painted.is_filled[FIGURE].mean() > 0.99
    assert not painted.is_filled[~FIGURE].any()
    assert np.mean(painted.rgb[painted.is_filled] == 90) > 0.99  # the nearer of the two
    np.testing.assert_array_equal(painted.rgb[~FIGURE], image.rgb[~FIGURE])


def test_narrow_holes_take_the_colours_around_and_stay_marked() -> None:
    image = replace(painted_wall(CAMERA, pose()), rgb=np.full((480, 640, 3), 100, np.uint8))
    crack, gap = np.zeros_like(FIGURE), np.zeros_like(FIGURE)
    crack[200:260, 300:304] = True
    gap[100:160, 100:160] = True
    painted = InpaintingConfig(margin_px=0).build(CAMERA).paint(image, pose(), crack | gap, Map(SCALES))
    assert painted.is_hole[crack | gap].all()
    np.testing.assert_allclose(painted.rgb[crack], 100, atol=3)
    assert np.all(painted.rgb[120:140, 120:140] == 0)


def test_the_margin_goes_around() -> None:
    image = painted_wall(CAMERA, pose())
    painted = InpaintingConfig(margin_px=6).build(CAMERA).paint(image, pose(), FIGURE, Map(SCALES))
    assert painted.is_hole[94:406, 244:386].all()
    assert painted.is_hole.sum() == 312 * 142


@pytest.mark.parametrize(
    ("change", "said"), [({"keyframes": 0}, "keyframes' is 0"), ({"hole_grey": 256}, "from 0 to 255")]
)
def test_impossible_values_are_named(change: dict[str, int], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        replace(InpaintingConfig(), **change).build(CAMERA)


def test_the_room_without_figures_comes_out() -> None:
    """The same room, path and seed without figures is the truth; only noise and figures differ."""
    people, nobody = open_dataset("synthetic:walking"), open_dataset("synthetic:empty")
    assert people.groundtruth is not None
    assert nobody.groundtruth is not None
    np.testing.assert_array_equal(people.groundtruth.T_world_cam, nobody.groundtruth.T_world_cam)
    poses = people.groundtruth.T_world_cam
    keyframes = list(range(0, 120, 12))
    painter = InpaintingConfig().build(people.camera)
    world = at([poses[i] for i in keyframes])
    for keyframe, i in enumerate(keyframes):
        image = people.load(i)
        assert image.truth is not None
        painter.remember(keyframe, image, image.truth.movable)
    for i in (66, 90, 118):
        image, true = people.load(i), nobody.load(i)
        assert image.truth is not None
        painted = painter.paint(image, poses[i], image.truth.movable, world)
        still = ~image.truth.movable
        assert np.mean(np.all(image.rgb[still] == true.rgb[still], axis=-1)) > 0.97
        wanted = painted.is_filled | painted.is_hole
        assert painted.is_filled.sum() > 0.95 * wanted.sum()
        assert (wanted & image.truth.movable).sum() == image.truth.movable.sum()
        assert error_db(painted, true.rgb) > 27
        unpainted = Painted(image.rgb, image.depth_m, painted.is_filled, painted.is_hole)
        assert error_db(unpainted, true.rgb) < 18  # what a painter who does nothing gets
        known = painted.is_filled & (true.depth_m > 0)
        assert np.median(np.abs(painted.depth_m - true.depth_m)[known]) < 0.03


def test_it_is_repeatable() -> None:
    image = painted_wall(CAMERA, pose())

    def painted() -> Painted:
        painter = BackgroundPainter(InpaintingConfig(), CAMERA)
        painter.remember(0, painted_wall(CAMERA, pose(0.2)), NOBODY)
        painter.remember(1, painted_wall(CAMERA, pose(-0.2)), NOBODY)
        return painter.paint(somebody_before(image), pose(), FIGURE, at([pose(0.2), pose(-0.2)]))

    np.testing.assert_array_equal(painted().rgb, painted().rgb)
    np.testing.assert_array_equal(painted().depth_m, painted().depth_m)


def test_colours_follow_exposure_and_white_balance() -> None:
    dim = np.array([0.8, 0.7, 0.6])
    keyframe, true = painted_wall(CAMERA, pose(0.2)), painted_wall(CAMERA, pose())
    true = replace(true, rgb=np.rint(true.rgb * dim).astype(np.uint8))
    for matching, least_db, most_db in ((True, 40, 100), (False, 0, 22)):
        painter = replace(EXACT, match_brightness=matching).build(CAMERA)
        painter.remember(0, keyframe, NOBODY)
        painted = painter.paint(somebody_before(true), pose(), FIGURE, at([pose(0.2)]))
        assert least_db < error_db(painted, true.rgb) < most_db


def test_brightness_is_left_alone_where_it_cannot_be_compared() -> None:
    keyframe, true = painted_wall(CAMERA, pose()), painted_wall(CAMERA, pose())
    painter = EXACT.build(CAMERA)
    painter.remember(0, keyframe, NOBODY)
    dark = replace(true, rgb=np.zeros_like(true.rgb))
    np.testing.assert_array_equal(painter.paint(dark, pose(), FIGURE, at([pose()])).rgb[FIGURE], keyframe.rgb[FIGURE])
