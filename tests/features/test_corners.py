"""Detection on a pyramid, and the even spread."""

import cv2
import numpy as np
import pytest

from stillroom.features.corners import Corners, detect, spread
from stillroom.features.orb import BORDER_PX

SIZES = [(320, 240), (267, 200), (222, 167)]
QUOTAS = [120, 80, 50]
STRONG = 20.0


def random_corners(seed: int, n: int = 3000, crowd: float = 0.7) -> Corners:
    """Corners of which most lie crowded in a small part of each level, as texture in a real image does."""
    rng = np.random.default_rng(seed)
    level = np.sort(rng.integers(0, len(SIZES), n)).astype(np.int32)
    place = np.where(rng.random((n, 1)) < crowd, 0.3 * rng.random((n, 2)), rng.random((n, 2)))
    px = np.floor(place * np.array(SIZES)[level]).astype(np.float32)
    _, kept = np.unique(np.column_stack((level, px)), axis=0, return_index=True)
    kept = np.sort(kept)
    return Corners(px[kept], rng.integers(7, 60, n).astype(np.float32)[kept], level[kept])


def cells_of(corners: Corners) -> np.ndarray:
    """A label for each corner's cell: square cells, about as many as the level's quota."""
    side = np.array([np.sqrt(w * h / q) for (w, h), q in zip(SIZES, QUOTAS, strict=True)])[corners.level]
    return np.column_stack((corners.level, np.floor(corners.px / side[:, None]))).astype(int)


def chosen_by_hand(corners: Corners, quotas: list[int]) -> list[list[int]]:
    """The rule written plainly: turn after turn each cell gives its next best, strong ones only where there are any."""
    by_level: list[list[int]] = []
    labels = cells_of(corners)
    for level, quota in enumerate(quotas):
        queues = []
        for label in np.unique(labels[corners.level == level], axis=0):
            inside = np.flatnonzero((labels == label).all(axis=1))
            if corners.score[inside].max() >= STRONG:
                inside = inside[corners.score[inside] >= STRONG]
            queues.append(sorted(inside, key=lambda i: -corners.score[i]))
        turns: list[int] = []
        while any(queues) and len(turns) < quota:
            turns += sorted((queue.pop(0) for queue in queues if queue), key=lambda i: -corners.score[i])
        by_level.append(turns[:quota])
    return by_level


@pytest.mark.parametrize("seed", range(4))
def test_the_choice_is_the_plain_rule_where_scores_differ(seed: int) -> None:
    corners = random_corners(seed, n=900)
    distinct = np.random.default_rng(seed).permutation(len(corners.score)) * (200 / len(corners.score))
    # Whole scores only: the merit is cut to whole numbers. So each level is tested with what fits into 200.
    kept = np.sort(np.unique(np.column_stack((corners.level, distinct.astype(int))), axis=0, return_index=True)[1])
    corners = Corners(corners.px[kept], distinct.astype(int)[kept].astype(np.float32), corners.level[kept])
    chosen = spread(corners, SIZES, QUOTAS, STRONG, seed=0)
    expected = [i for turns in chosen_by_hand(corners, QUOTAS) for i in turns]
    np.testing.assert_array_equal(chosen, expected)


@pytest.mark.parametrize("seed", range(4))
def test_no_cell_goes_empty_while_another_has_two(seed: int) -> None:
    corners = random_corners(seed)
    chosen = spread(corners, SIZES, QUOTAS, STRONG, seed)
    assert len(np.unique(chosen)) == len(chosen)
    np.testing.assert_array_equal(np.diff(corners.level[chosen]) >= 0, True)
    labels = cells_of(corners)
    for level, quota in enumerate(QUOTAS):
        own = chosen[corners.level[chosen] == level]
        assert len(own) <= quota
        there = np.unique(labels[corners.level == level], axis=0)
        taken, counts = np.unique(labels[own], axis=0, return_counts=True)
        if counts.max() > 1:
            assert len(taken) == len(there)


def test_a_level_fills_its_quota_when_it_can() -> None:
    corners = random_corners(0)
    corners = Corners(corners.px, np.full_like(corners.score, 30.0), corners.level)
    chosen = spread(corners, SIZES, QUOTAS, STRONG, seed=0)
    np.testing.assert_array_equal(np.bincount(corners.level[chosen]), QUOTAS)


def test_weak_corners_serve_only_where_there_is_no_strong_one() -> None:
    px = np.array([[5, 5], [6, 6], [7, 7], [300, 200], [301, 201]], dtype=np.float32)
    corners = Corners(px, np.array([19, 20, 8, 19, 8], np.float32), np.zeros(5, np.int32))
    chosen = spread(corners, SIZES[:1], [100], STRONG, seed=0)
    assert set(chosen.tolist()) == {1, 3, 4}


def test_the_seed_changes_only_which_of_equals_are_taken() -> None:
    corners = random_corners(1)
    first, second = (spread(corners, SIZES, QUOTAS, STRONG, seed) for seed in (0, 1))
    np.testing.assert_array_equal(first, spread(corners, SIZES, QUOTAS, STRONG, 0))
    assert set(first.tolist()) != set(second.tolist())
    np.testing.assert_array_equal(corners.level[first], corners.level[second])
    np.testing.assert_array_equal(corners.score[first], corners.score[second])


def test_no_corners_and_empty_levels_are_fine() -> None:
    none = Corners(np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros(0, np.int32))
    assert len(spread(none, SIZES, QUOTAS, STRONG, 0)) == 0
    only_last = Corners(np.array([[50, 50]], np.float32), np.array([30], np.float32), np.array([2], np.int32))
    np.testing.assert_array_equal(spread(only_last, SIZES, QUOTAS, STRONG, 0), [0])


def test_detection_is_opencvs_on_each_level_but_not_near_the_edge() -> None:
    rng = np.random.default_rng(0)
    levels = [cv2.GaussianBlur(rng.integers(0, 256, (h, w), dtype=np.uint8), (0, 0), 1.2) for w, h in SIZES]
    corners = detect(levels, 15, BORDER_PX)
    for number, image in enumerate(levels):
        height, width = image.shape
        expected = set()
        for keypoint in cv2.FastFeatureDetector.create(15, nonmaxSuppression=True).detect(image):
            x, y = keypoint.pt
            if BORDER_PX <= x < width - BORDER_PX and BORDER_PX <= y < height - BORDER_PX:
                expected.add((x, y, keypoint.response))
        own = corners.level == number
        found = {(*px, score) for px, score in zip(corners.px[own].tolist(), corners.score[own].tolist(), strict=True)}
        assert len(expected) > 50
        # Suppression looks at neighbours beyond the edge too, so a corner on the very border may differ.
        assert len(found ^ expected) <= 0.1 * len(expected)
        inner = {
            c for c in found if BORDER_PX < c[0] < width - BORDER_PX - 1 and BORDER_PX < c[1] < height - BORDER_PX - 1
        }
        assert inner <= expected


@pytest.mark.parametrize("width", [10, 37, 38, 39, 70, 71])
def test_narrow_images_have_opencvs_corners(width: int) -> None:
    # Narrower than the vectors that are looked at together, just as wide, and wider by less than one more.
    image = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (300, width), dtype=np.uint8), (0, 0), 0.8)
    corners = detect([image], 20, 3)
    keypoints = cv2.FastFeatureDetector.create(20, nonmaxSuppression=True).detect(image)
    assert len(keypoints) > 10
    found = [(*px, score) for px, score in zip(corners.px.tolist(), corners.score.tolist(), strict=True)]
    assert found == [(*keypoint.pt, keypoint.response) for keypoint in keypoints]


@pytest.mark.parametrize("size", [(1, 1), (10, 60), (38, 38), (39, 39), (44, 44)])
def test_an_image_too_small_to_describe_anything_has_no_corners(size: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    corners = detect([image], 7, BORDER_PX)
    assert np.all((corners.px >= BORDER_PX) & (corners.px < np.array(size[::-1]) - BORDER_PX))
    assert len(corners.px) == len(corners.score) == len(corners.level)
