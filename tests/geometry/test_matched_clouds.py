"""Motions from matched points: against scipy on clean ones, and the truth among wrong ones."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillroom.geometry import se3, sim3
from stillroom.geometry.matched_clouds import fit_robustly, rigid_of_samples, similar_of_samples

T_TRUE = se3.exp(np.array([0.4, -1.2, 0.3, 0.5, -1.1, 2.0]))


def clouds(seed: int, n: int, wrong: float, noise_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, their counterparts, and which pairs are right."""
    rng = np.random.default_rng(seed)
    source = rng.uniform(-3, 3, (n, 3))
    target = se3.transform(T_TRUE, source) + noise_m * rng.normal(size=(n, 3))
    is_right = rng.random(n) >= wrong
    target[~is_right] = rng.uniform(-4, 4, ((~is_right).sum(), 3))
    return source, target, is_right


def within(source: np.ndarray, target: np.ndarray, limit_m: float):
    def agrees(T: np.ndarray) -> np.ndarray:
        moved = np.einsum("sij,nj->sni", T[:, :3, :3], source) + T[:, None, :3, 3]
        return np.linalg.norm(moved - target, axis=2) < limit_m

    return agrees


def test_samples_are_fitted_as_scipy_fits_them() -> None:
    rng = np.random.default_rng(5)
    source, target = rng.normal(size=(30, 3, 3)), rng.normal(size=(30, 3, 3))
    found = rigid_of_samples(source, target)
    for s, t, T in zip(source, target, found, strict=True):
        R, _ = Rotation.align_vectors(t - t.mean(axis=0), s - s.mean(axis=0))
        np.testing.assert_allclose(T[:3, :3], R.as_matrix(), atol=1e-8)
        np.testing.assert_allclose(se3.transform(T, s).mean(axis=0), t.mean(axis=0), atol=1e-12)


@pytest.mark.parametrize("wrong", [0.0, 0.4, 0.7])
@pytest.mark.parametrize("seed", range(3))
def test_right_pairs_are_told_from_wrong_ones(seed: int, wrong: float) -> None:
    source, target, is_right = clouds(seed, 120, wrong, 0.005)
    fit = fit_robustly(source, target, within(source, target, 0.03), np.random.default_rng(seed))
    assert fit is not None
    assert (fit.is_inlier == is_right).mean() > 0.98
    R, _ = Rotation.align_vectors(
        target[is_right] - target[is_right].mean(axis=0), source[is_right] - source[is_right].mean(axis=0)
    )
    np.testing.assert_allclose(fit.T_target_source[:3, :3], R.as_matrix(), atol=2e-3)
    assert np.linalg.norm(fit.T_target_source[:3, 3] - T_TRUE[:3, 3]) < 3e-3


def test_the_same_seed_gives_the_same_motion() -> None:
    source, target, _ = clouds(7, 80, 0.5, 0.01)
    fits = [fit_robustly(source, target, within(source, target, 0.02), np.random.default_rng(3)) for _ in range(2)]
    assert fits[0] is not None
    assert fits[1] is not None
    np.testing.assert_array_equal(fits[0].T_target_source, fits[1].T_target_source)


def test_chance_agrees_with_few() -> None:
    source, target, _ = clouds(7, 80, 1.0, 0.0)
    fit = fit_robustly(source, target, within(source, target, 0.3), np.random.default_rng(3))
    assert fit is None or fit.n_inliers <= 8


@pytest.mark.parametrize("n", [0, 1, 2])
def test_two_pairs_say_nothing(n: int) -> None:
    points = np.arange(3.0 * n).reshape(n, 3)
    assert fit_robustly(points, points, within(points, points, 1.0), np.random.default_rng(0)) is None


def test_three_pairs_are_enough() -> None:
    source = np.array([[0.0, 0, 2], [1, 0, 2], [0, 1, 3]])
    target = se3.transform(T_TRUE, source)
    fit = fit_robustly(source, target, within(source, target, 0.01), np.random.default_rng(0), n_samples=4)
    assert fit is not None
    np.testing.assert_allclose(fit.T_target_source, T_TRUE, atol=1e-9)


def test_samples_that_a_similarity_relates_give_it_back() -> None:
    rng = np.random.default_rng(8)
    source = rng.normal(size=(30, 3, 3))
    S_true = sim3.of(np.broadcast_to(T_TRUE, (30, 4, 4)), rng.uniform(0.2, 5.0, 30))
    target = source @ np.swapaxes(S_true[:, :3, :3], 1, 2) + S_true[:, None, :3, 3]
    np.testing.assert_allclose(similar_of_samples(source, target), S_true, atol=1e-9)
    one_place = np.zeros((1, 3, 3))
    assert np.isfinite(similar_of_samples(one_place, one_place + 1.0)).all()


@pytest.mark.parametrize("wrong", [0.0, 0.4, 0.7])
@pytest.mark.parametrize("scale", [0.4, 1.0, 2.5])
def test_the_scale_is_found_among_wrong_pairs(scale: float, wrong: float) -> None:
    source, target, is_right = clouds(3, 120, wrong, 0.005)
    source = source / scale
    fit = fit_robustly(source, target, within(source, target, 0.03), np.random.default_rng(1), with_scale=True)
    assert fit is not None
    assert (fit.is_inlier == is_right).mean() > 0.98
    assert float(sim3.scale(fit.T_target_source)) == pytest.approx(scale, rel=2e-3)
    np.testing.assert_allclose(sim3.rigid(fit.T_target_source)[:3, :3], T_TRUE[:3, :3], atol=2e-3)
