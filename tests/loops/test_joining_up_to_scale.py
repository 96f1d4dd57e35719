"""Two pieces of a room, each in a unit of its own: joined with the scale between them."""

from dataclasses import dataclass

import numpy as np
import pytest
from building import parts
from map_checks import check_links, check_same, contents
from ring_map import vocabulary_of
from small_world import CAMERA, SCALES, SmallMap, SmallWorld, pose

from stillroom.data.map import Map, submaps
from stillroom.data.sensor import Sensor
from stillroom.features.places.place_index import PlaceMemory
from stillroom.geometry import se3, sim3
from stillroom.loops.joining import JoiningConfig, SubmapJoiner

BEFORE = [pose(0.1 * k, turn=(0, 0.03 * k, 0)) for k in range(6)]
AFTER = [pose(0.1 * k + 0.05, 0.04, turn=(0, 0.03 * k, 0.02)) for k in range(6)]
UNITS = 0.5, 1.3
"""How long a metre is in either piece."""
S_PIECE_WORLD = submaps.origin(1) @ sim3.of(pose(0.4, -0.3, 0.2, turn=(0.1, 0.7, -0.2)), UNITS[1])
ROOM, OTHER_ROOM = SmallWorld.of(0, 900), SmallWorld.of(1, 900)
CULLED = 7
NEWEST = len(BEFORE) + len(AFTER) - 1


@dataclass
class Pieces:
    """A map in two pieces, and what remembers its places."""

    map: Map
    places: PlaceMemory

    def joiner(self) -> SubmapJoiner:
        return JoiningConfig().build(parts(CAMERA, self.map), self.places)

    def errors(self) -> tuple[float, float]:
        """Largest errors of the second piece's keyframes in the coordinates of the first [m, rad]."""
        T = np.array([self.map.keyframe_pose(k) for k in range(len(BEFORE), NEWEST + 1)])
        T[:, :3, 3] /= UNITS[0]
        off = se3.inverse(np.array(AFTER)) @ T
        return float(np.linalg.norm(off[:, :3, 3], axis=1).max()), float(se3.angle_rad(off).max())


def pieces(world: SmallWorld = ROOM) -> Pieces:
    """The first piece's world is that of the room, in its unit; the second one's is another's."""
    small = SmallMap(ROOM, Map(SCALES, Sensor.MONOCULAR))
    for T in BEFORE:
        small.add(T, noise_px=0.3, flips=6, depth_share=0.0)
    made = small.map
    made.keyframes.T_world_cam[:, :3, 3] *= UNITS[0]
    made.points.position_m[:] *= UNITS[0]
    made.refresh_geometry(np.arange(len(made.points)))
    ids = np.full(len(world.points_m), -1, np.int32)
    for i, T in enumerate(AFTER):
        k = len(made.keyframes)
        frame, seen = world.look(T, seed=k, index=k, noise_px=0.3, flips=6, depth_share=0.0)
        made.add_keyframe(frame, sim3.rigid(S_PIECE_WORLD @ T), ids[seen], frame.is_static, k - 1 if i else -1)
        new = np.flatnonzero(ids[seen] < 0)
        positions_m = world.points_m[seen[new]] @ S_PIECE_WORLD[:3, :3].T + S_PIECE_WORLD[:3, 3]
        ids[seen[new]] = made.add_points(positions_m, made.rows(k).start + new)
        made.refresh(ids[ids >= 0])
        made.connect(k)
    made.remove_keyframe(CULLED)
    places = PlaceMemory(vocabulary_of(ROOM), made)
    places.remember_all()
    return Pieces(made, places)


def test_the_second_piece_is_laid_upon_the_first_in_its_unit() -> None:
    made = pieces()
    joiner = made.joiner()
    assert joiner.join(NEWEST)
    assert submaps.unjoined(made.map).tolist() == [0]
    error_m, error_rad = made.errors()  # of the culled keyframe too
    assert error_m < 0.01
    assert error_rad < 0.01
    assert joiner.joined[0].scale == pytest.approx(UNITS[0] / UNITS[1], rel=0.01)
    expected = np.ones(NEWEST + 1)
    expected[len(BEFORE) :] = UNITS[0] / UNITS[1]
    np.testing.assert_allclose(made.map.keyframes.scale, expected, rtol=0.01)
    np.testing.assert_array_equal(made.map.keyframes.T_world_cam[0, :3, :3], np.eye(3))
    check_links(made.map)


def test_the_younger_piece_takes_the_unit_of_the_older_whichever_recognises_the_other() -> None:
    made = pieces()
    assert made.joiner().join(len(BEFORE) - 1)
    assert made.errors()[0] < 0.01
    np.testing.assert_array_equal(made.map.keyframes.scale[: len(BEFORE)], 1.0)


def test_points_of_both_lie_where_they_are() -> None:
    made = pieces()
    made.joiner().join(NEWEST)
    world = made.map
    own = world.points_of(NEWEST)
    seen = np.flatnonzero(own >= 0)
    px = CAMERA.project(
        se3.transform(se3.inverse(world.keyframes.T_world_cam[NEWEST]), world.points.position_m[own[seen]])
    )
    off_px = np.linalg.norm(px - world.keypoints.px[world.rows(NEWEST)][seen], axis=1)
    assert np.median(off_px) < 1.0
    far = np.linalg.norm(world.points.position_m[own[seen]] - world.keyframes.T_world_cam[NEWEST, :3, 3], axis=1)
    assert 1.5 * UNITS[0] < np.median(far) < 6.0 * UNITS[0]


def test_pieces_of_different_rooms_stay_apart() -> None:
    made = pieces(OTHER_ROOM)
    before = contents(made.map)
    joiner = made.joiner()
    assert not any(joiner.join(k) for k in range(NEWEST + 1) if k != CULLED)
    check_same(made.map, before)
