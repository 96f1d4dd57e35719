"""Recognising a place on a small world: who is matched, what pose comes out, and when it is refused."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from building import parts
from ring_map import vocabulary_of
from small_world import SmallMap, SmallWorld, pose

from stillroom.data.frame import Frame
from stillroom.data.map import submaps
from stillroom.data.matches import Matches
from stillroom.features.places.place_index import PlaceMemory
from stillroom.features.projection import Window
from stillroom.geometry import se3
from stillroom.tracking.relocalizer import (
    RecognitionConfig,
    RecognizedPose,
    around_projections,
    by_words,
    solve_pnp,
)

KEYFRAMES = [pose(0.1 * k, turn=(0, 0.03 * k, 0)) for k in range(4)]
TRUE = pose(0.25, -0.1, 0.15, turn=(0.05, 0.1, 0.3))


@pytest.fixture(scope="module")
def small() -> SmallMap:
    return SmallMap.of(SmallWorld.of(0, 900), KEYFRAMES, noise_px=0.3, flips=6)


@pytest.fixture(scope="module")
def places(small: SmallMap) -> PlaceMemory:
    memory = PlaceMemory(vocabulary_of(small.world), small.map)
    memory.remember_all()
    return memory


def look(small: SmallMap, flips: int = 6, world: SmallWorld | None = None) -> tuple[Frame, np.ndarray]:
    return (world or small.world).look(TRUE, seed=99, noise_px=0.3, flips=flips)


def recognised(
    small: SmallMap, places: PlaceMemory, frame: Frame, keyframe: int = 2, **config: float
) -> RecognizedPose | None:
    recognizer = replace(RecognitionConfig(), **config).build(parts())
    bag = places.bag_of_frame(frame)
    return recognizer.recognise(frame, bag, keyframe, places.index.nodes(keyframe), small.map)


def true_matches(small: SmallMap, n_wrong: int, seed: int = 0) -> tuple[Frame, Matches, np.ndarray]:
    """Matches of a frame, of which so many name another point than they should, and which are right."""
    frame, seen = look(small)
    rng = np.random.default_rng(seed)
    known = np.flatnonzero(small.id_of[seen] >= 0)[:150]
    ids = small.id_of[seen[known]].copy()
    wrong = rng.permutation(len(known))[:n_wrong]
    ids[wrong] = ids[np.roll(wrong, 1)]
    right = np.ones(len(known), bool)
    right[wrong] = False
    return frame, Matches(known.astype(np.int32), ids, np.full((len(known), 2), np.nan, np.float32)), right


@pytest.mark.parametrize("n_wrong", [0, 60, 90])
def test_pnp_finds_the_pose_and_who_is_wrong(small: SmallMap, n_wrong: int) -> None:
    frame, matches, right = true_matches(small, n_wrong)
    solved = solve_pnp(frame, matches, small.map, 4.0, 300, 10, seed=0)
    assert solved is not None
    T_cam_world, inlier = solved
    off = T_cam_world @ TRUE
    assert np.linalg.norm(off[:3, 3]) < 0.02
    assert se3.angle_rad(off) < 0.01
    assert np.mean(inlier == right) > 0.97
    # OpenCV's own refinement over those that are right says the same.
    rotation, translation = cv2.Rodrigues(T_cam_world[:3, :3])[0], T_cam_world[:3, 3].copy()
    points_m, px = small.map.points.position_m[matches.point_id[right]], frame.keypoints.px[matches.keypoint[right]]
    rotation, translation = cv2.solvePnPRefineLM(
        points_m, px.astype(np.float64), frame.camera.K, np.zeros(4), rotation, translation
    )
    assert np.linalg.norm(translation - T_cam_world[:3, 3]) < 0.02


def test_pnp_is_as_good_in_a_piece_far_away_and_repeats(small: SmallMap) -> None:
    frame, matches, _ = true_matches(small, 60)
    near = solve_pnp(frame, matches, small.map, 4.0, 300, 10, seed=3)
    again = solve_pnp(frame, matches, small.map, 4.0, 300, 10, seed=3)
    assert near is not None
    assert again is not None
    np.testing.assert_array_equal(near[0], again[0])
    T_far = submaps.origin(40)
    positions_m = small.map.points.position_m.copy()
    try:
        small.map.points.position_m[:] = se3.transform(T_far, positions_m)
        far = solve_pnp(frame, matches, small.map, 4.0, 300, 10, seed=3)
    finally:
        small.map.points.position_m[:] = positions_m
    assert far is not None
    np.testing.assert_allclose(far[0] @ T_far, near[0], atol=1e-6)


def test_pnp_of_nonsense_is_refused(small: SmallMap) -> None:
    frame, matches, _ = true_matches(small, 150)
    assert solve_pnp(frame, matches, small.map, 4.0, 300, 25, seed=0) is None


def test_words_match_what_is_the_same_and_only_static_keypoints(small: SmallMap, places: PlaceMemory) -> None:
    frame, seen = look(small)
    frame = frame.with_static(np.arange(len(frame)) % 4 != 0)
    matches = by_words(frame, places.bag_of_frame(frame), 2, places.index.nodes(2), small.map)
    right = small.id_of[seen[matches.keypoint]] == matches.point_id
    assert len(matches) > 60
    assert right.mean() > 0.97
    assert frame.is_static[matches.keypoint].all()


def test_the_guided_search_finds_what_is_near_and_free(small: SmallMap) -> None:
    frame, seen = look(small)
    ids = small.id_of[small.id_of >= 0]
    free = np.arange(len(frame)) % 3 != 0
    found = around_projections(frame, se3.inverse(TRUE), ids, free, Window(10.0, max_bits=100), small.map)
    assert free[found.keypoint].all()
    right = small.id_of[seen[found.keypoint]] == found.point_id
    assert right.mean() > 0.97
    assert right.sum() > 0.8 * np.count_nonzero(free & (small.id_of[seen] >= 0))


@pytest.mark.parametrize("flips", [6, 20])
def test_a_place_is_recognised_with_its_pose(small: SmallMap, places: PlaceMemory, flips: int) -> None:
    frame, seen = look(small, flips)
    found = recognised(small, places, frame)
    assert found is not None
    off = found.T_cam_world @ TRUE
    assert np.linalg.norm(off[:3, 3]) < 0.01
    assert se3.angle_rad(off) < 0.005
    has = found.point_ids >= 0
    assert found.n_inliers == has.sum() >= 50
    assert np.mean(small.id_of[seen[has]] == found.point_ids[has]) > 0.98


def test_guided_search_makes_many_of_few_matches(small: SmallMap, places: PlaceMemory) -> None:
    """With descriptors so changed that words lead to few matches, most points are found all the same."""
    frame, _ = look(small, flips=50)
    matches = by_words(frame, places.bag_of_frame(frame), 2, places.index.nodes(2), small.map)
    assert 15 <= len(matches) < 50
    found = recognised(small, places, frame)
    assert found is not None
    assert found.n_inliers > 2 * len(matches)


def test_another_room_is_refused_and_so_is_too_little(small: SmallMap, places: PlaceMemory) -> None:
    other, _ = look(small, world=SmallWorld.of(7, 900))
    assert all(recognised(small, places, other, k) is None for k in range(len(KEYFRAMES)))
    frame, _ = look(small)
    assert recognised(small, places, frame, min_inliers=len(frame) + 1) is None
