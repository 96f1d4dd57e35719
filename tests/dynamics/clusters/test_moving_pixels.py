"""From verdicts on clusters to pixels, against a plain reading of the rule."""

import numpy as np
import pytest
from staged_things import clusters_of

from stillroom.data.clusters import PLANE, UNKNOWN
from stillroom.dynamics.cluster_evidence import MovingPixels

MARGIN_PX = 3


def rough_labels(seed: int, shape: tuple[int, int] = (90, 120)) -> np.ndarray:
    tiles = np.random.default_rng(seed).integers(PLANE, 5, (shape[0] // 10, shape[1] // 10))
    return np.kron(tiles, np.ones((10, 10))).astype(np.int16)


def plainly(labels: np.ndarray, belief: np.ndarray, box: np.ndarray, in_boxes: np.ndarray) -> np.ndarray:
    moving = np.zeros(labels.shape, dtype=bool)
    for k in range(len(belief)):
        if belief[k] > 0 or box[k] >= 0:
            moving |= labels == k
        elif belief[k] == 0:
            moving |= (labels == k) & in_boxes
    beside = np.zeros_like(moving)
    for row, column in np.argwhere(labels == UNKNOWN):
        around = np.s_[
            max(0, row - MARGIN_PX) : row + MARGIN_PX + 1, max(0, column - MARGIN_PX) : column + MARGIN_PX + 1
        ]
        beside[row, column] = moving[around].any()
    return moving | beside


@pytest.mark.parametrize("seed", range(4))
def test_the_rule_is_kept_on_random_images(seed: int) -> None:
    rng, labels = np.random.default_rng(seed), rough_labels(seed)
    belief, box = np.array([1.5, 0.0, -2.0, 0.0, -1.0]), np.array([-1, -1, -1, 0, 1])
    belief, box = belief[order := rng.permutation(5)], box[order]
    in_boxes = np.zeros(labels.shape, dtype=bool)
    in_boxes[20:70, 15:80] = True
    expected = plainly(labels, belief, box, in_boxes)
    found = MovingPixels(MARGIN_PX).of(clusters_of(labels, box.tolist()), belief, in_boxes)
    assert found.dtype == np.bool_
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(found, expected)


def test_new_verdicts_boxes_or_clusters_are_marked_anew() -> None:
    pixels, nothing = MovingPixels(MARGIN_PX), np.zeros((90, 120), dtype=bool)
    first, second = (clusters_of(rough_labels(seed), [-1] * 5) for seed in (7, 8))
    still, goes = np.full(5, -1.0), np.array([-1.0, 2.0, -1.0, -1.0, -1.0])
    for clusters, belief in [(first, still), (first, goes), (second, goes), (first, goes), (first, still)]:
        expected = plainly(clusters.labels, belief, clusters.box, nothing)
        np.testing.assert_array_equal(pixels.of(clusters, belief, nothing), expected)


def test_where_nothing_moves_no_pixel_does() -> None:
    everywhere = np.ones((90, 120), dtype=bool)
    clusters = clusters_of(rough_labels(1), [-1] * 5)
    assert not MovingPixels(MARGIN_PX).of(clusters, np.full(5, -0.1), everywhere).any()
    planes = clusters_of(np.full((90, 120), PLANE, dtype=np.int16), [])
    assert not MovingPixels(MARGIN_PX).of(planes, np.zeros(0), everywhere).any()
