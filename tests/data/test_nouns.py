"""Frames, matches, verdicts and semantics."""

import numpy as np
import pytest
from small_world import SmallWorld, pose

from stillroom.data.frame import ScaleLevels
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion
from stillroom.data.result import Tracked, TrackingState
from stillroom.data.semantics import UNNAMED, Box, Instance, Semantics, nothing


def test_scale_levels() -> None:
    scales = ScaleLevels(1.5, 4)
    np.testing.assert_allclose(scales.factors, [1, 1.5, 2.25, 3.375])
    np.testing.assert_allclose(scales.inverse_variances, [1, 1 / 2.25, 1 / 2.25**2, 1 / 3.375**2])


def test_a_frame_with_another_verdict_is_another_frame() -> None:
    frame, _ = SmallWorld.of(0, 40).look(pose(), index=7)
    verdict = np.arange(len(frame)) % 2
    other = frame.with_static(verdict)
    assert frame.is_static.all()
    assert other.is_static.dtype == np.bool_
    np.testing.assert_array_equal(other.is_static, verdict == 1)
    assert other.keypoints is frame.keypoints
    assert (len(frame), len(frame.keypoints)) == (len(frame.keypoints.px),) * 2
    assert frame.timestamp_s == frame.image.timestamp_s == pytest.approx(7 / 30)


def test_matches_of_a_frame_and_a_choice_of_them() -> None:
    matches = Matches.of(np.array([-1, 8, -1, 3, 5], np.int32))
    assert matches.keypoint.tolist() == [1, 3, 4]
    assert matches.point_id.tolist() == [8, 3, 5]
    assert np.isnan(matches.reference_px).all()
    assert matches.reference_px.shape == (3, 2)
    kept = matches.keep(np.array([True, False, True]))
    assert (len(kept), kept.keypoint.tolist(), kept.point_id.tolist()) == (2, [1, 4], [8, 5])
    assert len(Matches.of(np.full(4, -1, np.int32))) == 0


def test_the_verdict_that_nothing_moves() -> None:
    motion = Motion.none(5, 3, 4)
    assert motion.is_static.tolist() == [True] * 5
    assert motion.moving.shape == (3, 4)
    assert not motion.moving.any()


def test_a_tracked_frame_counts_its_points() -> None:
    frame, _ = SmallWorld.of(0, 40).look(pose())
    ids = np.full(len(frame), -1, np.int32)
    ids[[2, 5]] = 0, 9
    tracked = Tracked(frame, TrackingState.OK, np.eye(4), ids, Motion.none(len(frame), 480, 640))
    assert (tracked.n_inliers, tracked.lost) == (2, False)
    assert np.flatnonzero(tracked.is_matched).tolist() == [2, 5]
    assert Tracked(frame, TrackingState.LOST, None, ids, tracked.motion).lost
    assert not Tracked(frame, TrackingState.NOT_INITIALIZED, None, ids, tracked.motion).lost


def box(*xyxy_px: float) -> Box:
    return Box(*xyxy_px, "person", 0.9)


@pytest.mark.parametrize(
    "edges", [(3, 2, 6, 5), (2.4, 1.6, 6.2, 5.9), (-5, -5, 2, 1), (8, 4, 40, 40), (3, 3, 3, 3), (-9, -9, -1, -1)]
)
def test_a_box_covers_the_pixels_whose_middles_lie_in_it(edges: tuple[float, float, float, float]) -> None:
    semantics = Semantics(7, 11, (box(*edges),))
    x, y = np.meshgrid(np.arange(11), np.arange(7))
    inside = (x >= edges[0]) & (x <= edges[2]) & (y >= edges[1]) & (y <= edges[3])
    np.testing.assert_array_equal(semantics.movable, inside)


def test_boxes_add_up_and_a_mask_overrules_them() -> None:
    boxes = box(0, 0, 1, 1), box(3, 3, 4, 4), box(5, 5, 4, 4)
    assert Semantics(9, 9, boxes).movable.sum() == 8
    assert Semantics(9, 9, boxes).boxes_xyxy_px.tolist() == [[0, 0, 1, 1], [3, 3, 4, 4], [5, 5, 4, 4]]
    assert [b.area_px for b in boxes] == [1, 1, 0]
    mask = np.zeros((9, 9), bool)
    mask[8, 8] = True
    semantics = Semantics(9, 9, boxes, mask)
    np.testing.assert_array_equal(semantics.movable, mask)
    assert semantics.has_any
    assert not Semantics(9, 9, (), np.zeros((9, 9), bool)).has_any


def test_points_are_looked_up_at_the_nearest_pixel_of_the_image() -> None:
    semantics = Semantics(10, 20, (box(4, 3, 8, 6),))
    points = np.array([[4, 3], [3.6, 3], [3.4, 3], [8.4, 6.4], [8.6, 6], [8, 6.6], [-50, 4], [5, 400]])
    assert semantics.movable_at(points).tolist() == [True, True, False, True, False, False, False, False]
    to_the_edge = Semantics(10, 20, (box(15, 5, 19, 9),))
    assert to_the_edge.movable_at(np.array([[19.8, 9.9], [25, 12]])).tolist() == [True, True]
    assert semantics.movable_at(np.zeros((0, 2))).shape == (0,)


def test_nothing_covers_nothing() -> None:
    semantics = nothing(4, 6)
    assert not semantics.has_any
    assert semantics.movable.shape == (4, 6)
    assert not semantics.movable_at(np.array([[1.0, 1.0]])).any()
    assert semantics.boxes_xyxy_px.shape == (0, 4)


def two_who_touch() -> tuple[Instance, Instance]:
    left, right = np.zeros((2, 9, 12), bool)
    left[2:6, 1:4] = True
    left[1, 2] = True  # a head
    right[3:7, 4:7] = True
    return Instance.of(left, "person", 0.8, track_id=4), Instance.of(right, "dog", 0.5)


def test_an_instance_keeps_its_part_of_a_mask() -> None:
    mask = np.zeros((480, 640), bool)
    mask[100:300, 50:150] = True
    mask[120, 90] = False
    instance = Instance.of(mask, "person", 0.75, track_id=3)
    np.testing.assert_array_equal(instance.mask, mask)
    assert instance.box == Box(50, 100, 149, 299, "person", 0.75, track_id=3)
    assert instance.area_px == 200 * 100 - 1
    assert instance.pixels.nbytes == 200 * 100
    assert instance.pixels.base is None  # and does not hold on to the whole mask
    mask[:] = False
    assert instance.pixels.any()
    with pytest.raises(ValueError, match="'person' covers no pixel"):
        Instance.of(mask, "person")


def test_instances_add_up_unless_a_mask_overrules_them() -> None:
    left, right = two_who_touch()
    semantics = Semantics(9, 12, (box(0, 0, 11, 8),), instances=(left, right))
    assert semantics.has_any
    np.testing.assert_array_equal(semantics.movable, left.mask | right.mask)
    assert Semantics(9, 12, instances=(left,)).has_any
    assert Semantics(9, 12, instances=(left,)).movable_at(np.array([[2.0, 1.0], [1.0, 1.0]])).tolist() == [True, False]
    everything = np.ones((9, 12), bool)
    assert Semantics(9, 12, mask=everything, instances=(left,)).movable is everything


def test_objects_are_instances_or_else_what_hangs_together() -> None:
    left, right = two_who_touch()
    told_apart = Semantics(9, 12, instances=(left, right))
    assert told_apart.objects == (left, right)
    mask = left.mask | right.mask
    mask[0, 8] = mask[1, 9] = True  # touch by a corner
    (people, speck) = Semantics(9, 12, mask=mask).objects
    np.testing.assert_array_equal(people.mask | speck.mask, mask)
    assert (people.label, people.area_px, speck.area_px) == (UNNAMED, left.area_px + right.area_px, 2)
    assert speck.box.xyxy_px == (8, 0, 9, 1)
    (filled,) = Semantics(9, 12, (box(1, 2, 3, 4),)).objects
    assert filled.box.xyxy_px == (1, 2, 3, 4)
    assert Semantics(9, 12).objects == ()
