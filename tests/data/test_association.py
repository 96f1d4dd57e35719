"""Association against TUM's rule written plainly, and against what a person would pair by hand."""

from pathlib import Path

import numpy as np
import pytest

from stillroom.data.association import associate


def tum_rule(first_s, second_s, max_gap_s):
    """All pairs within the gap, smallest first, each time used once: associate.py in plain loops."""
    pairs = [(abs(a - b), i, j) for i, a in enumerate(first_s) for j, b in enumerate(second_s)]
    left_first, left_second, chosen = set(range(len(first_s))), set(range(len(second_s))), []
    for gap, i, j in sorted(pairs):
        if gap <= max_gap_s and i in left_first and j in left_second:
            left_first.remove(i)
            left_second.remove(j)
            chosen.append((i, j))
    return sorted(chosen, key=lambda pair: first_s[pair[0]])


@pytest.mark.parametrize("seed", range(20))
def test_agrees_with_the_plain_rule_on_jittered_streams(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = np.sort(1.3e9 + np.arange(60) / 30 + rng.normal(0, 0.004, 60))[rng.random(60) > 0.1]
    second = np.sort(1.3e9 + 0.007 + np.arange(60) / 30 + rng.normal(0, 0.004, 60))[rng.random(60) > 0.1]
    i, j = associate(first, second, 0.02)
    assert list(zip(i, j, strict=True)) == tum_rule(first, second, 0.02)
    assert len(i) > 30


def test_uses_no_entry_twice_where_the_nearest_would() -> None:
    # 0.004 is nearest to both times, and must serve only one.
    i, j = associate(np.array([0.0, 0.010]), np.array([0.004, 0.020]), 0.02)
    assert i.tolist() == [0, 1]
    assert j.tolist() == [0, 1]


def test_never_swaps_the_order_of_time() -> None:
    # Greedy alone would take 0.0167–0.0167 and then 0–0.033: a frame with the depth of two frames on.
    i, j = associate(np.array([0.0, 0.0167]), np.array([0.0167, 0.0334]), 0.08)
    assert i.tolist() == [1]
    assert j.tolist() == [0]


def test_unsorted_input_gives_indices_into_the_input() -> None:
    i, j = associate(np.array([2.0, 0.0, 1.0]), np.array([1.01, 2.01, 5.0, 0.01]), 0.02)
    assert i.tolist() == [1, 2, 0]
    assert j.tolist() == [3, 0, 1]


def test_the_gap_is_a_limit() -> None:
    assert len(associate(np.array([0.0]), np.array([0.0201]), 0.02)[0]) == 0
    assert len(associate(np.array([0.0]), np.array([0.02]), 0.02)[0]) == 1


@pytest.mark.parametrize(
    ("first", "second"), [([], [1.0]), ([1.0], []), ([], []), ([np.nan], [np.nan]), ([0.0], [np.inf])]
)
def test_nothing_to_pair(first: list[float], second: list[float]) -> None:
    i, j = associate(np.array(first), np.array(second))
    assert len(i) == len(j) == 0


def _column(path: Path) -> np.ndarray:
    return np.loadtxt(path, usecols=0)


def test_bonn_images_all_find_a_depth_image_and_559_a_pose(bonn: Path) -> None:
    rgb, depth, truth = (_column(bonn / f"{name}.txt") for name in ("rgb", "depth", "groundtruth"))
    i, j = associate(rgb, depth)
    assert len(i) == 560
    assert np.abs(rgb[i] - depth[j]).max() < 0.0175
    i, j = associate(rgb, truth)
    assert len(i) == 559
    assert 0 not in i
    assert np.all(np.diff(j) > 0)


def test_freiburg1_images_all_find_a_depth_image_and_a_pose(freiburg1: Path) -> None:
    rgb, depth, truth = (_column(freiburg1 / f"{name}.txt") for name in ("rgb", "depth", "groundtruth"))
    assert len(associate(rgb, depth)[0]) == len(rgb)
    assert len(associate(rgb, truth)[0]) == len(rgb)
