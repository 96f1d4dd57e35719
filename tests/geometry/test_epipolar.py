"""The epipolar constraint against known geometry and OpenCV."""

import cv2
import numpy as np
import pytest
from plain_epipolar import fundamental_from_motion

from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.geometry.epipolar import (
    inverse_motion,
    line_distances_px,
    motion_fundamental,
    motion_line_distances_px,
)

CAMERA = Camera(640, 480, 542.8, 541.1, 315.6, 237.8)


def two_views(seed: int, n: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """T_second_first, and pixels (N, 2) of the same points in both views."""
    rng = np.random.default_rng(seed)
    T_second_first = se3.exp(np.concatenate((0.3 * rng.normal(size=3), 0.2 * rng.normal(size=3))))
    px = rng.uniform([0, 0], [640, 480], (n, 2))
    points = CAMERA.back_project(px, rng.uniform(1.5, 6, n))
    return T_second_first, px, CAMERA.project(se3.transform(T_second_first, points))


@pytest.mark.parametrize("seed", range(4))
def test_views_of_the_same_points_lie_on_their_epipolar_lines(seed: int) -> None:
    T_second_first, first_px, second_px = two_views(seed)
    F = fundamental_from_motion(T_second_first, CAMERA.K)
    assert line_distances_px(F, first_px, second_px).max() < 1e-8
    assert abs(np.linalg.det(F)) < 1e-12 * np.linalg.norm(F) ** 3
    backward = fundamental_from_motion(se3.inverse(T_second_first), CAMERA.K)
    assert line_distances_px(backward, second_px, first_px).max() < 1e-8


@pytest.mark.parametrize("seed", range(4))
def test_within_kernels_f_and_inverse_are_the_same(seed: int) -> None:
    T_second_first, _, _ = two_views(seed)
    expected = fundamental_from_motion(T_second_first, CAMERA.K)
    found = motion_fundamental(T_second_first, CAMERA.lens)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(inverse_motion(T_second_first), np.linalg.inv(T_second_first), atol=1e-14)


@pytest.mark.parametrize("seed", range(4))
def test_f_is_what_opencv_estimates_from_the_points(seed: int) -> None:
    T_second_first, first_px, second_px = two_views(seed)
    F = fundamental_from_motion(T_second_first, CAMERA.K)
    estimated, _ = cv2.findFundamentalMat(first_px, second_px, cv2.FM_8POINT)
    F, estimated = F / np.linalg.norm(F), estimated / np.linalg.norm(estimated)
    np.testing.assert_allclose(F, estimated * np.sign((F * estimated).sum()), atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_opencvs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_second_first, first_px, second_px = two_views(seed)
    second_px += rng.normal(0, 20, second_px.shape)
    F = fundamental_from_motion(T_second_first, CAMERA.K)
    # OpenCV's lines have a² + b² = 1.
    lines = cv2.computeCorrespondEpilines(first_px.reshape(-1, 1, 2), 1, F).reshape(-1, 3)
    expected_px = np.abs((lines[:, :2] * second_px).sum(axis=1) + lines[:, 2])
    assert expected_px.mean() > 5
    np.testing.assert_allclose(line_distances_px(F, first_px, second_px), expected_px, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(line_distances_px(-7.0 * F, first_px, second_px), expected_px, rtol=1e-6, atol=1e-6)


def test_each_pair_may_have_a_matrix_of_its_own() -> None:
    views = [two_views(seed, 3) for seed in range(5)]
    motions = np.stack([T for T, _, _ in views])
    F = fundamental_from_motion(motions, CAMERA.K)
    assert F.shape == (5, 3, 3)
    for own, (T, _, _) in zip(F, views, strict=True):
        np.testing.assert_allclose(own, fundamental_from_motion(T, CAMERA.K), atol=1e-15)
    first_px, second_px = (np.stack([view[k][0] for view in views]) for k in (1, 2))
    assert line_distances_px(F, first_px, second_px).max() < 1e-8
    moved_px = second_px + np.array([3.0, -2.0])
    moved = line_distances_px(F, first_px, moved_px)
    alone = [line_distances_px(F[i], first_px[[i]], moved_px[[i]])[0] for i in range(5)]
    np.testing.assert_allclose(moved, alone)


def test_a_point_that_steps_off_its_line_is_that_far_away() -> None:
    # Sideways motion: epipolar lines are rows.
    F = fundamental_from_motion(se3.exp(np.array([0.4, 0, 0, 0, 0, 0.0])), CAMERA.K)
    first_px = np.array([[100.0, 50], [300, 400]])
    second_px = first_px + np.array([[25, 3], [-60, -4]])
    np.testing.assert_allclose(line_distances_px(F, first_px, second_px), [3, 4])


def test_where_there_is_no_line_the_distance_is_infinite() -> None:
    F = fundamental_from_motion(se3.exp(np.array([0, 0, 0, 0.1, 0.2, 0.3])), CAMERA.K)  # a rotation has none
    assert np.isinf(line_distances_px(F, np.array([[10.0, 20]]), np.array([[11.0, 22]]))).all()
    forward = fundamental_from_motion(se3.exp(np.array([0, 0, 0.5, 0, 0, 0])), np.eye(3))
    assert np.isinf(line_distances_px(forward, np.zeros((1, 2)), np.array([[0.3, 0.1]]))).all()  # at the epipole
    assert line_distances_px(F, np.zeros((0, 2)), np.zeros((0, 2))).shape == (0,)


def test_distances_of_many_images_are_those_of_their_matrices() -> None:
    rng = np.random.default_rng(5)
    T = np.stack([se3.exp(rng.normal(0, 0.4, 6)) for _ in range(7)])
    first = rng.integers(0, 6, 200).astype(np.int32)
    first_px, second_px = rng.uniform(0, 480, (2, 200, 2))
    found = motion_line_distances_px(T[6], T[:6], first, first_px, second_px, CAMERA.lens)
    F = fundamental_from_motion(T[6] @ T[first], CAMERA.K)
    np.testing.assert_allclose(found, line_distances_px(F, first_px, second_px), rtol=1e-6, atol=1e-6)
    T[0] = np.eye(4)  # no motion, no line
    none = motion_line_distances_px(T[0], T[:1], np.zeros(1, np.int32), first_px[:1], second_px[:1], CAMERA.lens)
    assert np.isinf(none[0])
