"""Triangulation against known points and OpenCV."""

import cv2
import numpy as np
import pytest

from stillroom.geometry import se3
from stillroom.geometry.epipolar import triangulate


def two_views(seed: int, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Two poses T_cam_world, rays (N, 2) of both and the points (N, 3)."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-2, -1.5, 2], [2, 1.5, 6], (200, 3))
    poses = [se3.exp(np.concatenate((0.4 * rng.normal(size=3), 0.1 * rng.normal(size=3)))) for _ in range(2)]
    rays = []
    for T in poses:
        p_cam = se3.transform(T, points)
        rays.append(p_cam[:, :2] / p_cam[:, 2:] + noise * rng.normal(size=(200, 2)))
    return poses[0], poses[1], rays[0], rays[1], points


@pytest.mark.parametrize("seed", range(4))
def test_exact_rays_meet_in_the_point(seed: int) -> None:
    first, second, first_rays, second_rays, points = two_views(seed)
    np.testing.assert_allclose(triangulate(first, second, first_rays, second_rays), points, atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_noisy_rays_meet_where_opencv_says(seed: int) -> None:
    first, second, first_rays, second_rays, points = two_views(seed, noise=0.002)
    found = triangulate(first, second, first_rays, second_rays)
    homogeneous = cv2.triangulatePoints(first[:3], second[:3], first_rays.T.copy(), second_rays.T.copy())
    np.testing.assert_allclose(found, (homogeneous[:3] / homogeneous[3]).T, rtol=1e-5, atol=1e-6)
    assert np.median(np.linalg.norm(found - points, axis=1)) > 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_noisy_rays_meet_where_the_singular_value_decomposition_says(seed: int) -> None:
    first, second, first_rays, second_rays, _ = two_views(seed, noise=0.01)
    found = triangulate(first, second, first_rays, second_rays)
    for point, a, b in zip(found, first_rays, second_rays, strict=True):
        rows = [ray[axis] * T[2] - T[axis] for T, ray in ((first, a), (second, b)) for axis in range(2)]
        *_, last = np.linalg.svd(np.array(rows))[2]
        np.testing.assert_allclose(point, last[:3] / last[3], rtol=1e-7)


def test_parallel_rays_meet_nowhere_near() -> None:
    first, second = se3.identity(), se3.exp(np.array([-0.2, 0, 0, 0, 0, 0]))
    rays = np.array([[0.1, 0.2], [-0.3, 0.0]])
    found = triangulate(first, second, rays, rays)
    assert np.all(~np.isfinite(found) | (np.abs(found).max(axis=1, keepdims=True) > 1e6))


def test_no_rays_give_no_points() -> None:
    assert triangulate(np.eye(4), np.eye(4), np.zeros((0, 2)), np.zeros((0, 2))).shape == (0, 3)
