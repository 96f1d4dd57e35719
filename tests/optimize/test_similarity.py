"""The similarity of two cameras by what both see: against scipy's least squares, and the truth among wrong pairs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from small_world import CAMERA

from stillroom.geometry import se3, sim3
from stillroom.optimize import similarity
from stillroom.optimize.similarity import SharedPoints, SimilarityConfig, SimilarityOptimizer

S_TRUE = sim3.of(se3.exp(np.array([0.3, -0.1, 0.2, 0.05, -0.2, 0.1])), 1.4)


def shared(seed: int, n: int, noise_px: float, one_way: float = 0.0) -> SharedPoints:
    """Points before both cameras; a share of them is not seen by the second camera."""
    rng = np.random.default_rng(seed)
    of_second_m = CAMERA.back_project(rng.uniform((60, 60), (580, 420), (n, 2)), rng.uniform(1.5, 6.0, n))
    of_first_m = of_second_m @ S_TRUE[:3, :3].T + S_TRUE[:3, 3]
    first_px, second_px = CAMERA.project(of_first_m), CAMERA.project(of_second_m)
    octave_factor = 1.2 ** rng.integers(0, 4, n)
    seen = rng.random(n) >= one_way
    return SharedPoints(
        of_second_m,
        first_px + noise_px * octave_factor[:, None] * rng.normal(size=(n, 2)),
        1.0 / octave_factor**2,
        np.where(seen[:, None], of_first_m, 0.0),
        second_px + noise_px * octave_factor[:, None] * rng.normal(size=(n, 2)),
        np.where(seen, 1.0 / octave_factor**2, 0.0),
    )


def residuals(S: np.ndarray, points: SharedPoints) -> np.ndarray:
    """Whitened errors in both images, by the camera's own projection, and of depths."""
    back = sim3.inverse(S)
    forth_px = CAMERA.project(points.of_second_m @ S[:3, :3].T + S[:3, 3]) - points.first_px
    seen = points.second_weights > 0
    depth = np.log((points.of_second_m @ S[:3, :3].T + S[:3, 3])[seen, 2] / points.of_first_m[seen, 2])
    back_px = CAMERA.project(points.of_first_m[seen] @ back[:3, :3].T + back[:3, 3]) - points.second_px[seen]
    return np.concatenate(
        (
            (np.sqrt(points.first_weights)[:, None] * forth_px).ravel(),
            (np.sqrt(points.second_weights[seen])[:, None] * back_px).ravel(),
            depth / SimilarityConfig().depth_sigma,
        )
    )


@pytest.mark.parametrize("one_way", [0.0, 0.7])
@pytest.mark.parametrize("seed", range(3))
def test_the_minimum_is_scipys(seed: int, one_way: float) -> None:
    points = shared(seed, 60, 0.4, one_way)
    start = S_TRUE @ sim3.exp(np.array([[0.05, -0.04, 0.06, 0.02, 0.03, -0.02, 0.1]]))[0]
    found = SimilarityConfig(10, 20).build()(start, points, CAMERA)
    assert found.is_inlier.all()
    best = least_squares(lambda step: residuals(S_TRUE @ sim3.exp(step[None])[0], points), np.zeros(7), xtol=1e-15)
    assert (residuals(found.S_first_second, points) ** 2).sum() == pytest.approx(2.0 * best.cost, rel=1e-8)
    np.testing.assert_allclose(found.S_first_second, S_TRUE @ sim3.exp(best.x[None])[0], atol=1e-5)


def test_derivatives_are_those_of_finite_differences() -> None:
    points = shared(3, 20, 0.5, 0.3)
    S = S_TRUE @ sim3.exp(np.array([[0.05, -0.04, 0.06, 0.02, 0.03, -0.02, 0.1]]))[0]
    terms = similarity._terms(S, points, CAMERA, 0.05)
    for k in range(7):
        step = np.zeros((1, 7))
        step[0, k] = 1e-6
        ahead = similarity._terms(S @ sim3.exp(step)[0], points, CAMERA, 0.05)
        behind = similarity._terms(S @ sim3.exp(-step)[0], points, CAMERA, 0.05)
        for term, more, less in zip(terms, ahead, behind, strict=True):
            seen = term.weight > 0
            numeric = (more.error - less.error)[seen] / 2e-6
            np.testing.assert_allclose(term.jacobian[seen, :, k], numeric, rtol=1e-5, atol=1e-4)


def test_the_scale_is_known_where_both_cameras_stand_at_one_place() -> None:
    """There the images say nothing of it: pixels fit at any scale."""
    rng = np.random.default_rng(6)
    points, scale = shared(5, 80, 0.3), float(sim3.scale(S_TRUE))
    of_first_m = scale * points.of_second_m
    unsure = 1.0 + 0.05 * rng.normal(size=(80, 1))  # the first map's depths
    here = replace(points, of_first_m=of_first_m * unsure, first_px=CAMERA.project(of_first_m))
    start = sim3.of(np.eye(4), 1.2 * scale)
    px = similarity.chi2(start, here, CAMERA)
    assert (px[0] < 1e-9).all()
    assert (px[1] <= similarity.CHI2).mean() > 0.95
    found = SimilarityOptimizer()(start, here, CAMERA)
    assert float(sim3.scale(found.S_first_second)) == pytest.approx(scale, rel=0.015)


def test_wrong_pairs_are_told_and_do_not_pull() -> None:
    rng, points = np.random.default_rng(0), shared(1, 100, 0.4)
    wrong = rng.random(100) < 0.25
    first_px = np.where(wrong[:, None], rng.uniform((0, 0), (639, 479), (100, 2)), points.first_px)
    start = S_TRUE @ sim3.exp(np.array([[0.03, -0.02, 0.03, 0.01, 0.02, -0.01, 0.05]]))[0]
    found = SimilarityOptimizer()(start, replace(points, first_px=first_px), CAMERA)
    assert not found.is_inlier[wrong].any()
    assert found.is_inlier[~wrong].mean() > 0.95
    assert float(sim3.scale(found.S_first_second)) == pytest.approx(1.4, rel=3e-3)


def test_a_point_wrong_in_either_image_alone_is_an_outlier() -> None:
    points = shared(2, 50, 0.2)
    second_px = points.second_px.copy()
    second_px[7] += 20.0
    assert np.flatnonzero(~SimilarityOptimizer()(S_TRUE, replace(points, second_px=second_px), CAMERA).is_inlier) == 7


def test_points_behind_a_camera_agree_with_nothing() -> None:
    points = shared(4, 40, 0.2)
    of_second_m = points.of_second_m.copy()
    of_second_m[3] = (0.0, 0.0, -2.0)
    found = SimilarityOptimizer()(S_TRUE, replace(points, of_second_m=of_second_m), CAMERA)
    assert np.flatnonzero(~found.is_inlier) == 3
    assert np.isfinite(found.S_first_second).all()
