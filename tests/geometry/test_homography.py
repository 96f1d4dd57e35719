"""Homographies against known ones, OpenCV and scipy."""

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from stillroom.geometry import homography, se3
from stillroom.geometry.homography import HomographyFit

GRID = np.stack(np.meshgrid(np.arange(20.0, 640, 60), np.arange(20.0, 480, 60)), axis=-1).reshape(-1, 2)


def true_homography(seed: int) -> np.ndarray:
    """A turn of the camera, a few degrees about each axis, and a zoom."""
    rng = np.random.default_rng(seed)
    T = se3.exp(np.array([0, 0, 0, *rng.normal(0, 0.04, 3)]))
    K = np.array([[525.0, 0, 320], [0, 525, 240], [0, 0, 1]])
    return K @ T[:3, :3] @ np.linalg.inv(K) @ np.diag([1.02, 1.01, 1.0])


def pairs(seed: int, n: int = 120, noise_px: float = 0.7, wrong: float = 0.3) -> tuple[np.ndarray, ...]:
    """Noisy pairs in both images, some of them wrong, and which are right."""
    rng = np.random.default_rng(1000 + seed)
    first = rng.uniform((0, 0), (640, 480), (n, 2))
    second = homography.apply(true_homography(seed), first)
    is_wrong = rng.random(n) < wrong
    second[is_wrong] += rng.uniform(15, 60, (is_wrong.sum(), 2)) * rng.choice([-1, 1], (is_wrong.sum(), 2))
    return first + rng.normal(0, noise_px, (n, 2)), second + rng.normal(0, noise_px, (n, 2)), ~is_wrong


def true_error_px(H: np.ndarray, seed: int) -> float:
    """How far static points of the whole image are taken from where they truly go, root mean square."""
    errors = homography.transfer_errors_px(H, GRID, homography.apply(true_homography(seed), GRID))
    return float(np.sqrt(np.mean(errors**2)))


def test_apply_is_what_opencv_does() -> None:
    H = true_homography(1)
    expected = cv2.perspectiveTransform(GRID[:, None], H)[:, 0]
    np.testing.assert_allclose(homography.apply(H, GRID), expected, atol=1e-9)
    assert homography.apply(H, np.zeros((0, 2))).shape == (0, 2)


def test_the_right_pairs_are_told_from_the_wrong_ones() -> None:
    for seed in range(10):
        first, second, is_right = pairs(seed)
        fit = homography.estimate(first, second, 3.0, seed=0)
        assert fit is not None
        assert np.mean(fit.is_inlier[is_right]) > 0.95
        assert np.mean(fit.is_inlier[~is_right]) < 0.05


@pytest.mark.parametrize("noise_px", [0.3, 0.7])
@pytest.mark.parametrize("symmetric", [True, False])
def test_the_compensated_homography_is_better_than_ransac_alone(symmetric: bool, noise_px: float) -> None:
    plain, compensated = [], []
    for seed in range(60):
        first, second, _ = pairs(seed, noise_px=noise_px)
        fit = homography.estimate(first, second, 3.0, seed, magsac=False)
        assert fit is not None
        plain.append(true_error_px(fit.H_second_first, seed))
        compensated.append(true_error_px(homography.refine(fit, first, second, symmetric).H_second_first, seed))
    assert np.mean(compensated) < 0.85 * np.mean(plain)
    assert np.mean(np.array(compensated) < plain) >= 0.7


def test_on_top_of_magsac_the_compensation_gains_little_and_loses_nothing() -> None:
    errors = {"magsac": [], "compensated": [], "known inliers": []}
    for seed in range(100):
        first, second, is_right = pairs(seed)
        fit = homography.estimate(first, second, 3.0, seed)
        assert fit is not None
        best = homography.refine(HomographyFit(fit.H_second_first, is_right, 0.0), first, second)
        for name, H in (
            ("magsac", fit),
            ("compensated", homography.refine(fit, first, second)),
            ("known inliers", best),
        ):
            errors[name].append(true_error_px(H.H_second_first, seed))
    mean = {name: np.mean(values) for name, values in errors.items()}
    assert mean["compensated"] < 1.01 * mean["magsac"]
    assert mean["compensated"] < 1.03 * mean["known inliers"]


def of_four_pairs(first: np.ndarray, second: np.ndarray, seed: int) -> HomographyFit:
    """RANSAC by the book: of a hundred samples of four the one that most pairs agree with."""
    rng = np.random.default_rng(seed)
    best = HomographyFit(np.eye(3), np.zeros(len(first), dtype=bool), np.inf)
    for _ in range(100):
        four = rng.choice(len(first), 4, replace=False)
        H = cv2.getPerspectiveTransform(first[four].astype(np.float32), second[four].astype(np.float32))
        errors = homography.transfer_errors_px(H, first, second)
        if (errors < 3.0).sum() > best.is_inlier.sum():
            best = HomographyFit(H, errors < 3.0, float(np.sqrt(np.mean(errors[errors < 3.0] ** 2))))
    return best


@pytest.mark.parametrize("symmetric", [True, False])
def test_the_refinement_finds_the_least_error_that_scipy_finds(symmetric: bool) -> None:
    for seed in range(5):
        first, second, _ = pairs(seed)
        fit = of_four_pairs(first, second, seed)
        refined = homography.refine(fit, first, second, symmetric, iterations=30)
        a, b = first[refined.is_inlier], second[refined.is_inlier]

        def residuals(h: np.ndarray, a: np.ndarray = a, b: np.ndarray = b) -> np.ndarray:
            H = np.append(h, 1.0).reshape(3, 3)
            there = (b - homography.apply(H, a)).ravel()
            back = (a - homography.apply(np.linalg.inv(H), b)).ravel()
            return np.concatenate((there, back)) if symmetric else there

        H = fit.H_second_first / fit.H_second_first[2, 2]
        best = least_squares(residuals, H.ravel()[:8], x_scale="jac", xtol=1e-14, ftol=1e-14)
        found = refined.H_second_first
        found_cost = 0.5 * np.sum(residuals((found / found[2, 2]).ravel()[:8]) ** 2)
        assert found_cost == pytest.approx(best.cost, rel=1e-6)


def test_the_gradient_is_that_of_the_error() -> None:
    rng = np.random.default_rng(4)
    H = np.eye(3) + 0.05 * rng.normal(size=(3, 3))
    a, b = rng.normal(size=(2, 12, 2))
    weights = np.array([1.7, 0.6])
    normal, gradient = np.empty((9, 9)), np.empty(9)

    def error(h: np.ndarray) -> float:
        M = h.reshape(3, 3)
        there, back = b - homography.apply(M, a), a - homography.apply(np.linalg.inv(M), b)
        return float(weights[0] * np.sum(there**2) + weights[1] * np.sum(back**2))

    cost = homography.linearize(H, np.linalg.inv(H), a, b, weights, normal, gradient)
    assert cost == pytest.approx(error(H.ravel()))
    steps = 1e-6 * np.eye(9)
    numeric = [(error(H.ravel() + step) - error(H.ravel() - step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(2 * gradient, numeric, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(normal, normal.T)

    def residuals(h: np.ndarray) -> np.ndarray:
        M = h.reshape(3, 3)
        there, back = homography.apply(M, a) - b, homography.apply(np.linalg.inv(M), b) - a
        return np.concatenate((np.sqrt(weights[0]) * there.ravel(), np.sqrt(weights[1]) * back.ravel()))

    J = np.stack([(residuals(H.ravel() + step) - residuals(H.ravel() - step)) / 2e-6 for step in steps], axis=1)
    np.testing.assert_allclose(normal, J.T @ J, rtol=1e-5, atol=1e-5)
    assert np.linalg.eigvalsh(normal)[0] > -1e-9


def test_the_same_seed_gives_the_same_answer() -> None:
    first, second, _ = pairs(3)
    fits = [homography.estimate(first, second, 3.0, seed=9) for _ in range(3)]
    assert all(fit is not None for fit in fits)
    for fit in fits[1:]:
        np.testing.assert_array_equal(fit.H_second_first, fits[0].H_second_first)
        np.testing.assert_array_equal(fit.is_inlier, fits[0].is_inlier)


@pytest.mark.parametrize(
    "px",
    [
        np.zeros((0, 2)),
        GRID[:7],
        np.repeat(GRID[:1], 30, axis=0),
        np.stack((np.arange(30.0), 2 * np.arange(30.0)), axis=1),
    ],
    ids=["nothing", "too few", "one place", "one line"],
)
def test_pairs_that_determine_nothing_give_none(px: np.ndarray) -> None:
    assert homography.estimate(px, px + 3.0, 3.0, seed=0) is None


def test_pairs_that_do_not_agree_give_none_or_few_inliers() -> None:
    rng = np.random.default_rng(0)
    fit = homography.estimate(rng.uniform(0, 640, (60, 2)), rng.uniform(0, 640, (60, 2)), 2.0, seed=0)
    assert fit is None or fit.is_inlier.sum() < 20


def test_a_perfect_fit_stays_perfect() -> None:
    fit = HomographyFit(true_homography(2), np.ones(len(GRID), dtype=bool), 0.0)
    refined = homography.refine(fit, GRID, homography.apply(true_homography(2), GRID))
    assert true_error_px(refined.H_second_first, 2) < 1e-6


def test_the_compensated_image_shows_the_previous_one_where_it_is_now() -> None:
    rng = np.random.default_rng(5)
    previous = cv2.GaussianBlur(rng.integers(0, 256, (480, 640), dtype=np.uint8), (0, 0), 6)
    H = true_homography(6)
    warped = homography.compensate_image(previous, H)
    then = GRID[np.all((GRID > 80) & (GRID < (560, 400)), axis=1)]
    now = homography.apply(H, then)
    expected = cv2.remap(previous, then.astype(np.float32)[:, None], None, cv2.INTER_LINEAR).ravel()
    found = cv2.remap(warped, now.astype(np.float32)[:, None], None, cv2.INTER_LINEAR).ravel()
    assert np.abs(expected.astype(float) - found).max() <= 3
    assert homography.compensate_image(np.dstack([previous] * 3), H).shape == (480, 640, 3)


def test_a_turning_camera_moves_everything_by_one_homography() -> None:
    K = np.array([[525.0, 0, 320], [0, 520, 240], [0, 0, 1]])
    T = se3.exp(np.array([0.0, 0, 0, 0.02, -0.05, 0.03]))
    points = np.random.default_rng(1).uniform((-1, -1, 2), (1, 1, 9), (40, 3))
    project = [(p @ K.T)[:, :2] / p[:, 2:] for p in (points, se3.transform(T, points))]
    np.testing.assert_allclose(homography.apply(homography.of_rotation(T, K), project[0]), project[1], atol=1e-9)
