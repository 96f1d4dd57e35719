"""The motions of a fundamental matrix and of a homography against OpenCV's."""

import cv2
import numpy as np
import pytest
from plain_epipolar import fundamental_from_motion

from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.geometry.two_views import motions

K = Camera(640, 480, 542.8, 541.1, 315.6, 237.8).K


def motion(seed: int) -> np.ndarray:
    """A motion whose translation has length 1."""
    rng = np.random.default_rng(seed)
    T = se3.exp(np.concatenate((rng.normal(size=3), 0.2 * rng.normal(size=3))))
    T[:3, 3] /= np.linalg.norm(T[:3, 3])
    return T


def nearest(T: np.ndarray, candidates: np.ndarray) -> float:
    return float(np.abs(candidates - T).max(axis=(1, 2)).min())


@pytest.mark.parametrize("seed", range(4))
def test_those_of_a_fundamental_matrix_are_opencvs(seed: int) -> None:
    T = motion(seed)
    F = fundamental_from_motion(T, K)
    ours = motions.of_fundamental(-3.0 * F, K)
    assert ours.shape == (4, 4, 4)
    assert nearest(T, ours) < 1e-9
    R1, R2, t = cv2.decomposeEssentialMat(K.T @ F @ K)
    for R in (R1, R2):
        for sign in (1.0, -1.0):
            assert nearest(se3.from_rotation_translation(R, sign * t.ravel()), ours) < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_those_of_a_homography_contain_opencvs_and_the_true_one(seed: int) -> None:
    T = motion(seed)
    normal = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
    H = K @ (T[:3, :3] + np.outer(T[:3, 3], normal) / 2.5) @ np.linalg.inv(K)
    ours = motions.of_homography(0.4 * H, K)
    assert ours.shape == (8, 4, 4)
    np.testing.assert_allclose(np.linalg.det(ours[:, :3, :3]), 1.0, atol=1e-9)
    assert nearest(T, ours) < 1e-7
    n_found, rotations, translations, _ = cv2.decomposeHomographyMat(H, K)
    assert n_found == 4
    for R, t in zip(rotations, translations, strict=True):
        assert nearest(se3.from_rotation_translation(R, t.ravel() / np.linalg.norm(t)), ours) < 1e-7


def test_a_homography_of_a_rotation_tells_no_motion() -> None:
    T = motion(0)
    assert len(motions.of_homography(K @ T[:3, :3] @ np.linalg.inv(K), K)) == 0
