"""Keypoints in cells, level by level."""

import numpy as np
import pytest

from stillroom.features.matching import CELL_PX, build_grid, side_px


@pytest.mark.parametrize("n", [1, 2, 50, 1500])
def test_every_usable_keypoint_lies_in_its_cell_once(n: int) -> None:
    rng = np.random.default_rng(n)
    px = (rng.uniform(-30, 700, (n, 2)) * [1.0, 0.7]).astype(np.float32)
    octave, usable = rng.integers(0, 8, n).astype(np.int32), rng.random(n) < 0.7
    grid = build_grid(px, octave, usable)
    assert sorted(grid.order.tolist()) == np.flatnonzero(usable).tolist()
    assert grid.start[0] == 0
    assert grid.start[-1] == usable.sum()
    assert len(grid.start) == grid.shape.prod(axis=1).sum() + 1
    for level in range(octave.max() + 1):
        for row in range(grid.shape[level, 0]):
            for column in range(grid.shape[level, 1]):
                cell = grid.first[level] + row * grid.shape[level, 1] + column
                inside = grid.order[grid.start[cell] : grid.start[cell + 1]]
                assert np.all(octave[inside] == level)
                place = (px[inside] - grid.origin_px) // np.float32(side_px(level))
                np.testing.assert_array_equal(place, np.tile([column, row], (len(inside), 1)))


def test_cells_grow_with_the_levels() -> None:
    assert [side_px(level) / CELL_PX for level in range(8)] == [1, 1, 1, 2, 2, 2, 3, 3]


def test_no_keypoints_make_one_empty_cell() -> None:
    grid = build_grid(np.zeros((0, 2), np.float32), np.zeros(0, np.int32), np.zeros(0, np.bool_))
    assert grid.shape.tolist() == [[1, 1]]
    assert grid.start.tolist() == [0, 0]
    assert len(grid.order) == 0


def test_keypoints_on_one_spot_share_a_cell() -> None:
    grid = build_grid(np.full((5, 2), 77.25, np.float32), np.zeros(5, np.int32), np.ones(5, np.bool_))
    assert grid.shape.tolist() == [[1, 1]]
    assert grid.start.tolist() == [0, 5]
