"""What is seen in buildings: nothing is lost by rendering only what is behind open doors, and it costs no more."""

import tracemalloc
from functools import partial

import numpy as np
import pytest
from counted_lines import n_lines
from opened_worlds import scene_of, world
from synthetic_raycaster import cast

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom_scenes.camera_path import looking
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.render import Scene, render
from stillroom_scenes.room import SyntheticRoom
from stillroom_scenes.worlds.rooms import places


@pytest.mark.parametrize(
    ("spec", "index"),
    [("corridor", 60), ("corridor", 700), ("corridor,frames=600", 20), ("building,rooms=3,frames=600", 240)],
)
def test_depth_and_instances_are_those_of_a_plain_ray_caster(spec: str, index: int) -> None:
    """The caster knows all patches of the whole building."""
    room = world(spec)
    truth = room.truth(index)
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, (640, 480), (250, 2))
    on_figures = np.argwhere(truth.instance > 0)[:, ::-1]
    if len(on_figures):
        pixels[:80] = on_figures[rng.integers(0, len(on_figures), 80)]
    patches = room.scene.patches(float(room.timestamps_s[index]))
    depths, owners, margins = cast(patches, room.camera, truth.T_world_cam, pixels)
    clear = margins > 1e-6
    assert clear.mean() > 0.98
    found = truth.depth_m[pixels[:, 1], pixels[:, 0]]
    np.testing.assert_array_equal(truth.instance[pixels[:, 1], pixels[:, 0]][clear], owners[clear])
    np.testing.assert_allclose(found[clear], depths[clear], rtol=2e-6)


def odd_poses(room: SyntheticRoom, count: int) -> F64:
    """Return poses at places of the walk that look anywhere, also steeply up and down."""
    rng = np.random.default_rng(7)
    positions = room.groundtruth.positions_m[rng.integers(0, len(room), count)]
    yaw, pitch, roll = rng.uniform(-np.pi, np.pi, count), rng.uniform(-1.4, 1.4, count), rng.uniform(-0.5, 0.5, count)
    pitch[: count // 2] *= 0.1
    return looking(positions, yaw, pitch, roll)


@pytest.mark.parametrize("spec", ["corridor,frames=600", "building,rooms=3,frames=600", "rooms,rooms=3"])
def test_what_is_not_rendered_would_not_have_been_seen(spec: str) -> None:
    room = world(spec)
    scene = scene_of(room)
    whole = Scene(scene.atlas, scene.still, scene.figures, scene.objects)
    poses = np.concatenate((odd_poses(room, 16), room.groundtruth.T_world_cam[:: len(room) // 8]))
    spared = []
    for k, pose in enumerate(poses):
        time_s = 0.7 * k
        part, full = render(scene, room.camera, pose, time_s), render(whole, room.camera, pose, time_s)
        np.testing.assert_array_equal(part.inverse_depth, full.inverse_depth)
        np.testing.assert_array_equal(part.instance, full.instance)
        assert (part.rgb != full.rgb).mean() < 1e-3  # where two patches meet, either may be taken
        assert (part.inverse_depth > 0).all(), "a hole in the building"
        spared.append(1.0 - len(scene.seen(room.camera, pose, time_s)) / len(whole.patches(time_s)))
    assert np.mean(spared) > 0.4


def differing(room: SyntheticRoom, homes: list[F64], other: int) -> float:
    """Return which part of what is seen of room 0 looks otherwise where the same view is taken of another."""
    scene, off, total = scene_of(room), 0, 0
    (cell,) = (cell for cell in scene.plan.cells if cell.name == "room 0")
    for pose in room.groundtruth.T_world_cam[60:200:20]:
        one = render(scene, room.camera, pose, 0.0)
        two = render(scene, room.camera, homes[other] @ se3.inverse(homes[0]) @ pose, 0.0)
        row, column = np.mgrid[:480, :640].reshape(2, -1)
        points = room.camera.back_project(
            np.stack((column, row), axis=1).astype(np.float64), 1.0 / one.inverse_depth[row, column]
        )
        x, y = se3.transform(pose, points)[:, :2].T
        inside = (x > cell.low_m[0] - 0.01) & (x < cell.high_m[0] + 0.01)
        inside &= (y > cell.low_m[1] - 0.01) & (y < cell.high_m[1] + 0.01)
        changed = np.abs(one.rgb.astype(int) - two.rgb).max(axis=2).ravel() > 6
        off, total = off + int(changed[inside].sum()), total + int(inside.sum())
    return off / total


def test_look_alike_rooms_differ_in_a_tenth_of_what_one_sees() -> None:
    room = world("building")
    scene = scene_of(room)
    rooms = [k for k, cell in enumerate(scene.plan.cells) if cell.name.startswith("room")]
    assert len(rooms) == 10
    first = scene.still_of[rooms[0]]
    homes = [place.T_world_room for place in places(10)]
    for k in range(1, 10):
        other = scene.still_of[rooms[k]]
        T_first_other = homes[0] @ se3.inverse(homes[k])
        corners = se3.transform(T_first_other, other.shape_m[:, :3])
        np.testing.assert_allclose(corners, first.shape_m[:, :3], atol=1e-9)
        np.testing.assert_array_equal(other.look, first.look)
        own = other.kind[:, 1] != first.kind[:, 1]
        assert 5 <= own.sum() <= 0.1 * len(first)
    assert 0.07 < np.mean([differing(room, homes, k) for k in (1, 4, 9)]) < 0.13
    different = scene_of(world("rooms,rooms=3"))
    rooms = [k for k, cell in enumerate(different.plan.cells) if cell.name.startswith("room")]
    one, two = (set(different.still_of[k].kind[:, 1].tolist()) for k in rooms[:2])
    assert len(one & two) <= 2, "rooms that need not be alike share floor and ceiling only"


def test_a_frame_costs_the_same_in_a_building_of_three_rooms_and_of_twenty() -> None:
    n_patches, lines = [], []
    for rooms in (3, 20):
        room = open_synthetic(f"synthetic:building,rooms={rooms},frames=600,cache=off,noise=off")
        room.load(0)
        indices = range(0, 600, 100)
        poses = [(room.pose(index), float(room.timestamps_s[index])) for index in indices]
        n_patches.append(np.median([len(room.scene.seen(room.camera, *pose)) for pose in poses]))
        lines.append(np.median([n_lines(partial(room.load, index)) for index in indices]))
    assert n_patches[1] < 1.4 * n_patches[0], n_patches
    assert lines[1] < 1.4 * lines[0], lines


def test_length_costs_no_memory() -> None:
    peaks = []
    for frames in (600, 60_000):
        open_synthetic(f"synthetic:building,rooms=3,frames={frames},cache=off")
        tracemalloc.start()
        room = open_synthetic(f"synthetic:building,rooms=3,frames={frames},cache=off")
        for index in np.linspace(0, frames - 1, 6).astype(int).tolist():
            room.load(index)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 1_000_000


def test_figures_are_in_truth_and_picture() -> None:
    room = world("corridor,frames=600")
    assert len(room.scene.figures) == 4
    boxes = [box for index in range(0, 600, 25) for box in (room.load(index).truth or pytest.fail("no truth")).boxes]
    assert len(boxes) >= 10
    assert {box.label for box in boxes} == {"person"}
