"""Keypoints in cells."""

import numpy as np
import pytest

from stillroom.features.matching import CELL_PX, build_grid


@pytest.mark.parametrize("n", [1, 2, 50, 1500])
def test_every_keypoint_lies_in_its_cell_once(n: int) -> None:
    rng = np.random.default_rng(n)
    px = (rng.uniform(-30, 700, (n, 2)) * [1.0, 0.7]).astype(np.float32)
    grid = build_grid(px)
    assert sorted(grid.order.tolist()) == list(range(n))
    assert grid.start[0] == 0
    assert grid.start[-1] == n
    assert len(grid.start) == grid.shape[0] * grid.shape[1] + 1
    for cell in range(len(grid.start) - 1):
        row, column = divmod(cell, int(grid.shape[1]))
        inside = px[grid.order[grid.start[cell] : grid.start[cell + 1]]] - grid.origin_px
        np.testing.assert_array_equal(inside // CELL_PX, np.tile([column, row], (len(inside), 1)))


def test_no_keypoints_make_one_empty_cell() -> None:
    grid = build_grid(np.zeros((0, 2), np.float32))
    assert grid.shape.tolist() == [1, 1]
    assert grid.start.tolist() == [0, 0]
    assert len(grid.order) == 0


def test_keypoints_on_one_spot_share_a_cell() -> None:
    grid = build_grid(np.full((5, 2), 77.25, np.float32))
    assert grid.shape.tolist() == [1, 1]
    assert grid.start.tolist() == [0, 5]
