"""Robust estimates against the matrices that the pairs were made with."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillroom.geometry.robust import find_fundamental, find_homography, usac

K = np.array([[525.0, 0, 320], [0, 525, 240], [0, 0, 1]])
R = Rotation.from_rotvec([0.02, -0.05, 0.01]).as_matrix()
T_M = np.array([0.2, -0.05, 0.08])
N, N_WRONG = 200, 60


def seen(points_m: np.ndarray) -> np.ndarray:
    px = points_m @ K.T
    return px[:, :2] / px[:, 2:]


def pairs(depth_m: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """What two cameras see of points between two depths; the first pairs are wrong."""
    rng = np.random.default_rng(8)
    z = rng.uniform(*depth_m, N)
    points_m = np.column_stack((rng.uniform(-0.5, 0.5, N) * z, rng.uniform(-0.4, 0.4, N) * z, z))
    first, second = seen(points_m), seen(points_m @ R.T + T_M)
    second[:N_WRONG] += rng.uniform(20, 60, (N_WRONG, 2))
    return first, second


@pytest.mark.parametrize("magsac", [True, False])
def test_of_points_at_all_depths_the_essential_matrix_comes_back(magsac: bool) -> None:
    first, second = pairs((1.0, 6.0))
    found = find_fundamental(first, second, usac(1.0, 0, 0.99, magsac))
    assert found is not None
    F, agrees = found
    assert agrees[N_WRONG:].all()
    assert agrees[:N_WRONG].mean() < 0.1
    x, y, z = T_M
    E = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ R
    truth = np.linalg.inv(K).T @ E @ np.linalg.inv(K)
    F, truth = F / np.linalg.norm(F), truth / np.linalg.norm(truth)
    assert min(np.abs(F - truth).max(), np.abs(F + truth).max()) < 1e-4


@pytest.mark.parametrize("magsac", [True, False])
def test_of_points_on_a_plane_the_homography_comes_back(magsac: bool) -> None:
    first, second = pairs((3.0, 3.0))
    found = find_homography(first, second, usac(1.0, 0, 0.99, magsac))
    assert found is not None
    H, agrees = found
    assert agrees[N_WRONG:].all()
    assert not agrees[:N_WRONG].any()
    truth = K @ (R + np.outer(T_M, [0, 0, 1]) / 3.0) @ np.linalg.inv(K)
    np.testing.assert_allclose(H / H[2, 2], truth / truth[2, 2], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("find", [find_homography, find_fundamental])
def test_pairs_in_one_place_determine_nothing(find) -> None:  # type: ignore[no-untyped-def]
    same = np.tile([100.0, 80.0], (30, 1))
    assert find(same, same, usac(1.0, 0, 0.99)) is None


def test_the_seed_decides_which_samples_are_drawn() -> None:
    first, second = pairs((1.0, 6.0))
    second = second + np.random.default_rng(1).normal(0, 0.7, second.shape)

    def of(seed: int) -> np.ndarray:
        cv2.setRNGSeed(np.random.default_rng().integers(1 << 30).item())  # the estimators' own seed alone may count
        found = find_fundamental(first, second, usac(1.0, seed, 0.99, magsac=False))
        assert found is not None
        return found[0]

    np.testing.assert_array_equal(of(3), of(3))
    assert any(not np.array_equal(of(3), of(seed)) for seed in range(4, 10))
