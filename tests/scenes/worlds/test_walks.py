"""Where the camera goes: far enough, smoothly, through no wall, and back to where it was."""

import numpy as np
import pytest
from opened_worlds import scene_of, world

from stillroom.evaluation.ghost_truth import distances_to_patches_m
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom_scenes.room import SyntheticRoom

SPECS = ("corridor", "corridor,frames=600", "building", "building,rooms=3,frames=600", "rooms,rooms=3")


def cells_on_the_way(room: SyntheticRoom) -> list[str]:
    plan = scene_of(room).plan
    names = [plan.cells[plan.cell_at(x, y)].name for x, y in room.groundtruth.positions_m[:, :2]]
    return [name for k, name in enumerate(names) if k == 0 or names[k - 1] != name]


@pytest.mark.parametrize("spec", SPECS)
def test_a_walk_is_smooth_enough_to_be_tracked(spec: str) -> None:
    poses = world(spec).groundtruth.T_world_cam
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (len(poses), 1, 1)), atol=1e-12
    )
    steps = se3.inverse(poses[:-1]) @ poses[1:]
    moved_m, turned_deg = np.linalg.norm(steps[:, :3, 3], axis=1), np.degrees(se3.angle_rad(steps))
    assert moved_m.max() <= 0.1
    assert turned_deg.max() <= 4.0
    assert np.abs(np.diff(moved_m)).max() < 0.01
    assert np.abs(np.diff(turned_deg)).max() < 1.0
    assert moved_m.mean() > 0.04
    for index in (0, len(poses) // 3, len(poses) - 1):
        np.testing.assert_allclose(world(spec).pose(index), poses[index], atol=1e-12)


def test_the_ring_is_sixty_metres_long_and_known_again_at_its_end() -> None:
    for spec, least_m, least_known in (("corridor", 60.0, 250), ("corridor,frames=600", 25.0, 80)):
        truth = world(spec).groundtruth
        walked_m = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(truth.positions_m, axis=0), axis=1))))
        away_m = np.linalg.norm(truth.positions_m - truth.positions_m[0], axis=1)
        back = int(np.flatnonzero((away_m < 0.2) & (walked_m > 10.0))[0])
        assert walked_m[back] >= least_m
        # Nowhere does the way come near itself before it is once round.
        early = truth.positions_m[: back - 60 : 10]
        apart_m = np.linalg.norm(early[:, None] - early[None], axis=2)
        apart_along_m = np.abs(walked_m[: back - 60 : 10][:, None] - walked_m[: back - 60 : 10][None])
        assert apart_m[apart_along_m > 6.0].min() > 1.8
        # From then on every view is much like one that was there.
        known = truth.T_world_cam[back:]
        assert len(known) >= least_known
        offsets = se3.inverse(truth.T_world_cam[None, : back // 2 : 3]) @ known[::15, None]
        near_m = np.linalg.norm(offsets[..., :3, 3], axis=2)
        nearest = near_m.argmin(axis=1)
        assert near_m.min(axis=1).max() < 0.35
        angles = se3.angle_rad(offsets[np.arange(len(nearest)), nearest])
        assert np.degrees(angles).max() < 60
        assert np.degrees(np.median(angles)) < 35


def test_the_building_is_walked_through_room_by_room() -> None:
    for spec, rooms in (("building", 10), ("building,rooms=3,frames=600", 3)):
        way = [name for name in cells_on_the_way(world(spec)) if name.startswith("room")]
        assert way == [f"room {k}" for k in range(rooms)]


def test_ten_thousand_frames_lead_through_the_rooms_again_and_again() -> None:
    room = world("rooms,rooms=3")
    assert len(room) == 10_000
    way = [name for name in cells_on_the_way(room) if name.startswith("room")]
    assert way[:12] == [f"room {k % 3}" for k in range(12)]
    assert len(way) > 24
    # Each round goes where the last one did: there is nothing new to see after the first.
    positions_m = room.groundtruth.positions_m
    later, earlier = positions_m[5000:6000:50], positions_m[:4000]
    assert np.linalg.norm(later[:, None] - earlier[None], axis=2).min(axis=1).max() < 0.15


@pytest.mark.parametrize("spec", SPECS)
def test_the_camera_goes_through_no_wall_and_no_furniture(spec: str) -> None:
    room = world(spec)
    scene = scene_of(room)
    eyes = room.groundtruth.positions_m
    inside = [scene.plan.cells[scene.plan.cell_at(x, y)].distance_m(x, y) for x, y in eyes[::3, :2]]
    assert max(inside) == 0.0
    some = eyes[:: max(1, len(eyes) // 400)]
    away_m = distances_to_patches_m(some, scene.still.shape_m, scene.still.kind[:, 0] == 1)
    assert away_m.min() > 0.3
    # And between two frames lies no wall: where a step crosses a cell's border, there is an opening.
    cells = np.array([scene.plan.cell_at(x, y) for x, y in eyes[:, :2]])
    for k in np.flatnonzero(np.diff(cells)):
        doors = [o for o in scene.plan.openings if set(o.cells) == {cells[k], cells[k + 1]}]
        assert doors, (k, scene.plan.cells[cells[k]].name, scene.plan.cells[cells[k + 1]].name)
        assert doors[0].distance_m(*eyes[k, :2]) < 0.1


def body_points(places: F64) -> F64:
    """Return points (N, 3) round and in people that stand at places (N, 2)."""
    angles = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    ring = np.concatenate((np.zeros((1, 2)), 0.2 * np.stack((np.cos(angles), np.sin(angles)), axis=1)))
    heights = np.array([0.3, 0.9, 1.5])
    flat = (places[:, None] + ring[None]).reshape(-1, 2)
    return np.concatenate([np.column_stack((flat, np.full(len(flat), height))) for height in heights])


@pytest.mark.parametrize("spec", ["corridor", "corridor,frames=600", "rooms,rooms=3"])
def test_figures_walk_into_no_wall_no_furniture_no_camera_and_no_other(spec: str) -> None:
    room = world(spec)
    scene = scene_of(room)
    times_s = room.timestamps_s[:3000:3]
    ways = np.array([[(p.x_m, p.y_m) for p in map(figure.script.at, times_s)] for figure in scene.figures])
    assert len(ways) >= 2
    eyes = room.groundtruth.positions_m[:3000:3, :2]
    assert np.linalg.norm(ways - eyes[None], axis=2).min() > 0.5
    for a in range(len(ways)):
        for b in range(a):
            assert np.linalg.norm(ways[a] - ways[b], axis=1).min() > 0.5
        patches = scene.still.shape_m, scene.still.kind[:, 0] == 1
        assert distances_to_patches_m(body_points(ways[a, ::40]), *patches).min() > 0.04
        assert np.ptp(ways[a], axis=0).max() > 0.15
