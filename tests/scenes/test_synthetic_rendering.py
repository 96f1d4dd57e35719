"""What is rendered, against a slow ray caster, against itself from elsewhere, and against textures known by hand."""

import numpy as np
import pytest
from synthetic_raycaster import cast

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, U8
from stillroom.geometry.camera import Camera
from stillroom_scenes.camera_path import PATHS
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.render import Scene, render
from stillroom_scenes.room import FrameTruth, SyntheticRoom
from stillroom_scenes.scene.atlas import AtlasBuilder
from stillroom_scenes.scene.patches import Patches


@pytest.mark.parametrize(
    ("spec", "index"),
    [
        ("synthetic:walking", 70),
        ("synthetic:standing,room=workshop,seed=3", 30),
        ("synthetic:carried,room=library", 150),
        ("synthetic:pushed,path=loop", 260),
        ("synthetic:loop", 333),
    ],
)
def test_depth_and_instances_are_those_of_a_plain_ray_caster(spec: str, index: int) -> None:
    room = open_synthetic(spec + ",cache=off")
    truth = room.truth(index)
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, (640, 480), (500, 2))
    on_figures = np.argwhere(truth.instance > 0)[:, ::-1]
    if len(on_figures):
        pixels[:200] = on_figures[rng.integers(0, len(on_figures), 200)]
    patches = room.scene.patches(float(room.timestamps_s[index]))
    depths, owners, margins = cast(patches, room.camera, truth.T_world_cam, pixels)
    found = truth.depth_m[pixels[:, 1], pixels[:, 0]]
    instance = truth.instance[pixels[:, 1], pixels[:, 0]]
    clear = margins > 1e-6
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(instance[clear], owners[clear])
    np.testing.assert_allclose(found[clear], depths[clear], rtol=2e-6)
    assert len(np.unique(instance)) > 1 or "loop" in spec


def seen_from(camera: Camera, source: FrameTruth, target: FrameTruth) -> tuple[F64, F64, F64]:
    """Move the source's pixels into the target: their pixels (N, 2) there, depth (N,) there, place in the source."""
    row, column = np.nonzero(~source.moving & (source.depth_m > 0))
    row, column = row[::7], column[::7]
    points = camera.back_project(np.stack((column, row), axis=1), source.depth_m[row, column])
    moved = se3.transform(se3.inverse(target.T_world_cam) @ source.T_world_cam, points)
    moved, kept = moved[moved[:, 2] > 0.1], moved[:, 2] > 0.1
    px = camera.project(moved)
    inside = (px[:, 0] > 1) & (px[:, 0] < 638) & (px[:, 1] > 1) & (px[:, 1] < 478)
    return px[inside], moved[inside, 2], np.stack((column, row), axis=1)[kept][inside]


@pytest.mark.parametrize("spec", ["synthetic:walking", "synthetic:standing,path=rpy", "synthetic:loop,room=library"])
@pytest.mark.parametrize("gap", [1, 25])
def test_what_is_still_is_where_the_exact_poses_say(spec: str, gap: int) -> None:
    room = open_synthetic(spec + ",noise=off,cache=off")
    source, target = room.truth(100), room.truth(100 + gap)
    px, depth_m, place = seen_from(room.camera, source, target)
    assert len(px) > 10000
    column, row = np.rint(px).astype(int).T
    there = target.depth_m[row, column].astype(np.float64)
    # The pixel centre that was hit lies beside the point: allow the surface's slope over that pixel.
    window = np.stack([target.depth_m[row + a, column + b] for a in (-1, 0, 1) for b in (-1, 0, 1)])
    slope = window.max(axis=0) - window.min(axis=0)
    smooth = (slope < 0.02 * there) & ~target.moving[row, column]
    agree = np.abs(there - depth_m) <= slope + 1e-4
    hidden = there < depth_m - slope - 1e-4
    assert smooth.mean() > 0.5
    assert (agree | hidden)[smooth].mean() > 0.999, "a surface lies behind where it was seen"
    assert agree[smooth].mean() > 0.93
    now, then = room.load(100 + gap).rgb, room.load(100).rgb
    flat = smooth & agree
    rows, columns = place[flat, 1], place[flat, 0]
    off = np.abs(sampled(now, px[flat]) - then[rows, columns]).mean(axis=1)
    shuffled = np.abs(sampled(now, px[flat][::-1]) - then[rows, columns]).mean(axis=1)
    assert np.median(off) < 5
    assert off.mean() < 0.25 * shuffled.mean()


def sampled(image: U8, px: F64) -> F64:
    """Return colours (N, 3) between pixels."""
    low = np.floor(px).astype(int)
    f = px - low
    column, row = low.T
    top = image[row, column] * (1 - f[:, :1]) + image[row, column + 1] * f[:, :1]
    bottom = image[row + 1, column] * (1 - f[:, :1]) + image[row + 1, column + 1] * f[:, :1]
    mixed: F64 = top * (1 - f[:, 1:]) + bottom * f[:, 1:]
    return mixed


def test_a_pixel_of_a_moving_figure_is_not_where_the_poses_say() -> None:
    room = open_synthetic("synthetic:walking,noise=off,cache=off")
    source, target = room.truth(60), room.truth(75)
    assert source.moving.mean() > 0.1
    row, column = np.nonzero(source.moving)
    points = room.camera.back_project(np.stack((column, row), axis=1), source.depth_m[row, column])
    moved = se3.transform(se3.inverse(target.T_world_cam) @ source.T_world_cam, points)
    px = np.rint(room.camera.project(moved)).astype(int)
    inside = (px[:, 0] >= 0) & (px[:, 0] < 640) & (px[:, 1] >= 0) & (px[:, 1] < 480)
    there = target.depth_m[px[inside, 1], px[inside, 0]]
    assert (np.abs(there - moved[inside, 2]) < 0.02).mean() < 0.35


def one_wall(picture: U8, width_m: float, height_m: float, distance_m: float, light: float) -> Scene:
    """A picture that stands across the optical axis of a camera at the origin, looking along +y of the world."""
    atlas = AtlasBuilder()
    texture = atlas.add(picture)
    corner = (-width_m / 2, distance_m, -height_m / 2)
    shape = np.array([[*corner, width_m, 0, 0, 0, 0, height_m]])
    look = np.array([[0, 1, light, 1, 0, 0, 0, -1, 0]], dtype=np.float64)
    return Scene(atlas.build(), Patches(shape, look, np.array([[0, texture, 0]], dtype=np.int32)), (), ())


FORWARD = se3.from_rotation_translation(np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]]), np.zeros(3))
CAMERA = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)


def test_a_picture_hung_across_the_axis_is_seen_upright_and_in_its_colours() -> None:
    rng = np.random.default_rng(3)
    picture = np.repeat(np.repeat(rng.integers(0, 255, (4, 5, 3), dtype=np.uint8), 64, axis=0), 64, axis=1)
    rendering = render(one_wall(picture, 1.28, 1.024, 1.0, 0.5), CAMERA, FORWARD, 0.0)
    for row in range(4):
        for column in range(5):
            x, y = 320 - 320 + 128 * column + 64, 240 - 256 + 128 * row + 64
            if 3 < y < 476:
                seen = rendering.rgb[y, min(x, 636)].astype(int)
                np.testing.assert_allclose(seen, picture[64 * row + 30, 64 * column + 30] * 0.5, atol=2)
    assert np.all(np.abs(1.0 / rendering.inverse_depth[:, 4:-4] - 1.0) < 1e-6)


def test_magnified_textures_are_interpolated_between_texel_centres() -> None:
    ramp = np.zeros((64, 64, 3), dtype=np.uint8)
    ramp[..., 0] = np.arange(64) * 4
    ramp[..., 1] = np.arange(64)[:, None] * 4
    rendering = render(one_wall(ramp, 1.0, 1.0, 2.0, 1.0), CAMERA, FORWARD, 0.0)
    columns, rows = np.arange(240, 400), np.arange(160, 320)
    expected_u = ((columns - 319.5) / 500.0 * 2.0 + 0.5) * 64 - 0.5
    expected_v = ((rows - 239.5) / 500.0 * 2.0 + 0.5) * 64 - 0.5
    seen = rendering.rgb[160:320, 240:400].astype(float)
    np.testing.assert_allclose(seen[80, :, 0], expected_u * 4, atol=2)
    np.testing.assert_allclose(seen[:, 80, 1], expected_v * 4, atol=2)


def test_a_fine_pattern_far_away_becomes_its_mean_not_a_moire() -> None:
    checker = np.zeros((512, 512, 3), dtype=np.uint8)
    checker[::2, ::2] = checker[1::2, 1::2] = 255
    rendering = render(one_wall(checker, 1.0, 1.0, 6.0, 1.0), CAMERA, FORWARD, 0.0)
    inside = rendering.rgb[215:265, 295:345, 0].astype(float)
    assert abs(inside.mean() - 127) < 3
    assert inside.std() < 6


def test_a_patch_is_seen_from_its_front_only_and_nothing_is_black() -> None:
    picture = np.full((8, 8, 3), 200, dtype=np.uint8)
    behind = FORWARD.copy()
    behind[:3, 3] = (0, 2.0, 0)
    behind[:3, :3] = np.array([[-1, 0, 0], [0, 0, -1], [0, -1, 0.0]])
    scene = one_wall(picture, 0.5, 0.5, 1.0, 1.0)
    assert render(scene, CAMERA, FORWARD, 0.0).rgb[240, 320, 0] >= 198
    rendering = render(scene, CAMERA, behind, 0.0)
    assert not rendering.rgb.any()
    assert not rendering.inverse_depth.any()


@pytest.mark.parametrize("path", sorted(PATHS))
def test_the_room_is_closed_from_everywhere(path: str) -> None:
    room: SyntheticRoom = open_synthetic(f"synthetic:empty,path={path},frames=240,noise=off,cache=off")
    for index in range(0, 240, 40):
        assert (room.truth(index).depth_m > 0.3).all()
