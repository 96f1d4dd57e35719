"""RANSAC on four pairs: against OpenCV's homography of the same four, and against trying all fours."""

from itertools import combinations

import cv2
import numpy as np
import pytest

from stillroom.geometry import homography
from stillroom.geometry.sampled_homography import of_four_pairs, through_four

TRUE = np.array([[1.02, 0.03, 12.0], [-0.02, 0.98, -7.0], [3e-5, -2e-5, 1.0]])


def pairs(seed: int, n: int, noise_px: float, outliers: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of a homography, and which of them are."""
    rng = np.random.default_rng(seed)
    first = rng.uniform((0, 0), (640, 480), (n, 2))
    second = homography.apply(TRUE, first) + rng.normal(0.0, noise_px, (n, 2))
    wrong = rng.random(n) < outliers
    second[wrong] = rng.uniform((0, 0), (640, 480), (np.count_nonzero(wrong), 2))
    return first, second, ~wrong


@pytest.mark.parametrize("seed", range(8))
def test_it_goes_through_four_of_the_pairs_and_is_theirs(seed: int) -> None:
    first, second, _ = pairs(seed, 200, 0.7, 0.3)
    fit = of_four_pairs(first, second, 3.0, seed)
    assert fit is not None
    off_px = homography.transfer_errors_px(fit.H_second_first, first, second)
    order = np.argsort(off_px)
    assert off_px[order[3]] < 1e-6
    assert off_px[order[4]] > 1e-3
    four = order[:4]
    by_opencv = cv2.getPerspectiveTransform(first[four].astype(np.float32), second[four].astype(np.float32))
    np.testing.assert_allclose(
        homography.apply(by_opencv, first), homography.apply(fit.H_second_first, first), atol=0.02
    )


@pytest.mark.parametrize("seed", range(4))
def test_with_many_outliers_it_still_finds_who_agrees(seed: int) -> None:
    first, second, true = pairs(seed, 300, 0.5, 0.5)
    fit = of_four_pairs(first, second, 3.0, seed)
    assert fit is not None
    assert np.mean(fit.is_inlier[true]) > 0.75
    assert np.mean(fit.is_inlier[~true]) < 0.02
    residual_px = homography.transfer_errors_px(fit.H_second_first, first, second)
    np.testing.assert_array_equal(fit.is_inlier, residual_px <= 3.0)
    assert fit.rms_px == pytest.approx(np.sqrt(np.mean(residual_px[fit.is_inlier] ** 2)))


def test_of_few_pairs_it_comes_near_the_best_four_there_are() -> None:
    first, second, _ = pairs(1, 10, 1.0, 0.3)
    most = 0
    for four in combinations(range(10), 4):
        H = np.zeros((3, 3))
        if through_four(first / 300, second / 300, np.array(four), H):
            off = homography.transfer_errors_px(H, first / 300, second / 300)
            most = max(most, int(np.count_nonzero(off <= 3.0 / 300)))
    found = [of_four_pairs(first, second, 3.0, seed) for seed in range(5)]
    assert max(fit.is_inlier.sum() if fit is not None else 0 for fit in found) == (most if most >= 8 else 0)


def test_the_same_seed_gives_the_same_bytes_and_another_another() -> None:
    first, second, _ = pairs(3, 200, 0.7, 0.3)
    one, same, other = (of_four_pairs(first, second, 3.0, seed) for seed in (1, 1, 2))
    assert one is not None
    assert same is not None
    assert other is not None
    assert one.H_second_first.tobytes() == same.H_second_first.tobytes()
    assert one.H_second_first.tobytes() != other.H_second_first.tobytes()
    assert np.linalg.norm(one.H_second_first) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "first",
    [
        np.zeros((0, 2)),
        np.full((50, 2), 7.0),
        np.column_stack((np.linspace(0, 600, 50), np.linspace(0, 300, 50))),
        np.random.default_rng(0).uniform(0, 400, (7, 2)),
    ],
    ids=["none", "one place", "one line", "too few"],
)
def test_pairs_that_determine_none_give_none(first: np.ndarray) -> None:
    assert of_four_pairs(first, first + 3.0, 3.0, 0) is None


def test_a_homography_that_turns_the_image_over_is_none() -> None:
    first = np.random.default_rng(0).uniform(0, 400, (60, 2))
    assert of_four_pairs(first, first * (-1, 1) + (640, 0), 3.0, 0) is None
