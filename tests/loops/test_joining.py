"""Two pieces of one room, and pieces that only seem to be: joined where they are right, left alone where not."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from building import parts
from map_checks import check_links, check_same, contents
from ring_map import vocabulary_of
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.data.map import Map, submaps
from stillroom.features.places.place_index import PlaceMemory
from stillroom.geometry import se3
from stillroom.loops.joining import JoiningConfig, SubmapJoiner
from stillroom.loops.verification import Loop, VerificationConfig

BEFORE = [pose(0.1 * k, turn=(0, 0.03 * k, 0)) for k in range(5)]
AFTER = [pose(0.1 * k + 0.05, 0.04, turn=(0, 0.03 * k, 0.02)) for k in range(5)]
T_PIECE_WORLD = submaps.origin(1) @ pose(0.4, -0.3, 0.2, turn=(0.1, 0.7, -0.2))
"""How the second piece lies in coordinates of its own."""


@dataclass
class Pieces:
    """A map in two pieces; where the keyframes of the second (K, 4, 4) truly are in the first; what it remembers."""

    map: Map
    places: PlaceMemory
    numbers: np.ndarray
    followed: list[int]

    def joiner(self, **changes: Any) -> SubmapJoiner:
        return JoiningConfig(**changes).build(
            parts(CAMERA, self.map), self.places, after=(lambda: self.followed.append(1),)
        )

    def errors(self) -> tuple[float, float]:
        """Largest errors of the second piece's keyframes in the coordinates of the first [m, rad]."""
        off = se3.inverse(np.array(AFTER)) @ self.map.keyframes.T_world_cam[len(BEFORE) :]
        return float(np.linalg.norm(off[:, :3, 3], axis=1).max()), float(se3.angle_rad(off).max())


ROOM = SmallWorld.of(0, 900)
OTHER_ROOM = SmallWorld.of(1, 900)
REARRANGED = replace(OTHER_ROOM, descriptors=ROOM.descriptors, angle_rad=ROOM.angle_rad)
"""Another room with the same things in it."""


def pieces(world: SmallWorld = ROOM) -> Pieces:
    """The second piece is mapped by a camera that knows nothing of the first; in the same room or in another."""
    first = ROOM
    small = SmallMap.of(first, BEFORE, noise_px=0.3, flips=6)
    numbers = small.number_of().tolist()
    ids = np.full(len(world.points_m), -1, np.int32)
    for i, T in enumerate(AFTER):
        k = len(small.map.keyframes)
        frame, seen = world.look(T, seed=k, index=k, noise_px=0.3, flips=6)
        parent = k - 1 if i else -1
        small.map.add_keyframe(frame, T_PIECE_WORLD @ T, ids[seen], frame.is_static, parent)
        new = np.flatnonzero(ids[seen] < 0)
        positions_m = se3.transform(T_PIECE_WORLD, world.points_m[seen[new]])
        ids[seen[new]] = small.map.add_points(positions_m, small.map.rows(k).start + new)
        numbers += seen[new].tolist()
        small.map.refresh(ids[ids >= 0])
        small.map.connect(k)
    places = PlaceMemory(vocabulary_of(first), small.map)
    places.remember_all()
    return Pieces(small.map, places, np.array(numbers), [])


def test_two_pieces_of_a_room_become_one_where_the_room_is() -> None:
    made = pieces()
    joiner = made.joiner()
    newest = len(BEFORE) + len(AFTER) - 1
    assert joiner.join(newest)
    assert submaps.unjoined(made.map).tolist() == [0]
    error_m, error_rad = made.errors()
    assert error_m < 0.01
    assert error_rad < 0.01
    assert made.followed == [1]
    assert [place.keyframe for place in joiner.joined] == [newest]
    check_links(made.map)
    assert not joiner.join(newest)


def test_what_both_pieces_saw_is_one_point_afterwards() -> None:
    made = pieces()
    newest = len(BEFORE) + len(AFTER) - 1
    made.joiner().join(newest)
    world = made.map
    alive = np.flatnonzero(world.points.is_alive)
    seen_by = [set(made.numbers[world.points_of(k)[world.points_of(k) >= 0]].tolist()) for k in range(newest + 1)]
    shared = len(seen_by[newest] & seen_by[len(BEFORE) - 1])
    fused = np.intersect1d(world.points_of(newest), world.points_of(len(BEFORE) - 1))
    assert len(fused[fused >= 0]) > 0.85 * shared > 100
    assert min(world.covisibility.neighbours(newest)) < len(BEFORE)
    both = made.numbers[alive]
    assert len(both) < 1.3 * len(np.unique(both))


def test_the_younger_piece_moves_whichever_recognises_the_other() -> None:
    made = pieces()
    poses = made.map.keyframes.T_world_cam[: len(BEFORE)].copy()
    assert made.joiner().join(len(BEFORE) - 1)
    assert made.errors()[0] < 0.01
    np.testing.assert_array_equal(made.map.keyframes.T_world_cam[0], poses[0])
    assert made.map.keyframes.parent[len(BEFORE)] == len(BEFORE) - 1


@pytest.mark.parametrize("room", [OTHER_ROOM, REARRANGED], ids=["another", "the same things elsewhere"])
def test_pieces_of_different_rooms_stay_apart(room: SmallWorld) -> None:
    made = pieces(room)
    before = contents(made.map)
    joiner = made.joiner()
    assert not any(joiner.join(k) for k in range(len(BEFORE) + len(AFTER)))
    check_same(made.map, before)
    assert made.followed == []


def test_it_is_the_arrangement_that_tells_rooms_with_the_same_things_apart() -> None:
    """What the test above relies on: by their descriptors the things of the rearranged room match all the same."""
    newest, n_matches = len(BEFORE) + len(AFTER) - 1, []
    for room in (ROOM, REARRANGED, OTHER_ROOM):
        made = pieces(room)
        match = made.joiner()._verifier._by_descriptors
        n_matches.append(max(len(match(newest, k, made.places.index, made.map)) for k in range(len(BEFORE))))
    assert n_matches[1] > 0.5 * n_matches[0] > 100
    assert n_matches[2] < VerificationConfig().min_matches


def test_a_place_that_the_map_cannot_agree_with_is_taken_back() -> None:
    made = pieces()
    joiner = made.joiner()
    before = contents(made.map)
    newest = len(BEFORE) + len(AFTER) - 1
    right = joiner._verifier.verify(newest, len(BEFORE) - 1, made.places.index, made.map)
    assert right is not None
    rng = np.random.default_rng(0)
    confused = replace(right, point_ids=rng.permutation(right.point_ids))
    assert not joiner._join(confused)
    check_same(made.map, before)
    assert submaps.unjoined(made.map).tolist() == [0, 1]
    assert isinstance(right, Loop)
    assert joiner._join(right)


@pytest.mark.parametrize("off", [{"enabled": False}, {"n_places": 0}])
def test_it_can_be_switched_off(off: dict[str, Any]) -> None:
    made = pieces()
    before = contents(made.map)
    assert not made.joiner(**off).join(len(BEFORE) + len(AFTER) - 1)
    check_same(made.map, before)
