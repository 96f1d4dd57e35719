"""Rigid motions against scipy's Rotation and matrix exponential."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from stillroom.geometry import se3


def random_motions(seed: int, n: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.random(n, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.normal(0, 3, (n, 3))
    return T


def test_identity_moves_nothing() -> None:
    points = np.random.default_rng(0).normal(size=(4, 3))
    np.testing.assert_array_equal(se3.transform(se3.identity(), points), points)


@pytest.mark.parametrize("shape", [(), (7,), (2, 3)])
def test_inverse_agrees_with_numpy_on_stacks_of_any_shape(shape: tuple[int, ...]) -> None:
    T = random_motions(1, max(1, int(np.prod(shape)))).reshape((*shape, 4, 4))
    np.testing.assert_allclose(se3.inverse(T), np.linalg.inv(T), atol=1e-12)


def test_transform_is_the_matrix_product() -> None:
    T, points = random_motions(2, 1)[0], np.random.default_rng(2).normal(size=(9, 3))
    homogeneous = np.c_[points, np.ones(9)]
    np.testing.assert_allclose(se3.transform(T, points), (T @ homogeneous.T).T[:, :3], atol=1e-12)


def test_neighbouring_letters_cancel() -> None:
    T_a_b, T_b_c = random_motions(3, 2)
    points_c = np.random.default_rng(3).normal(size=(5, 3))
    np.testing.assert_allclose(
        se3.transform(T_a_b @ T_b_c, points_c), se3.transform(T_a_b, se3.transform(T_b_c, points_c)), atol=1e-12
    )


def test_skew_is_the_cross_product() -> None:
    v, w = np.random.default_rng(4).normal(size=(2, 3))
    np.testing.assert_allclose(se3.skew(v) @ w, np.cross(v, w), atol=1e-15)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-12, 1e-9, 2e-8, 1e-7, 1e-4, 0.1, 1.0, 3.0, np.pi, 5.0])
def test_exp_agrees_with_the_matrix_exponential(angle_rad: float) -> None:
    rng = np.random.default_rng(5)
    axis = rng.normal(size=3)
    xi = np.r_[rng.normal(size=3), angle_rad * axis / np.linalg.norm(axis)]
    generator = np.zeros((4, 4))
    generator[:3, :3] = np.cross(xi[3:], np.eye(3)).T  # column i is ω × e_i
    generator[:3, 3] = xi[:3]
    np.testing.assert_allclose(se3.exp(xi), expm(generator), atol=2e-8 if 1e-9 < angle_rad < 1e-6 else 1e-12)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-5, 0.3, 1.5, 3.1, np.pi])
def test_angle_is_exact_from_tiny_to_half_a_turn(angle_rad: float) -> None:
    axis = np.array([0.36, 0.48, -0.8])
    T = se3.from_rotation_translation(Rotation.from_rotvec(angle_rad * axis).as_matrix(), np.ones(3))
    assert float(se3.angle_rad(T)) == pytest.approx(angle_rad, rel=1e-7, abs=1e-15)


def test_angles_of_a_stack_agree_with_scipy() -> None:
    T = random_motions(6, 50)
    np.testing.assert_allclose(se3.angle_rad(T), Rotation.from_matrix(T[:, :3, :3]).magnitude(), atol=1e-9)


def test_orthonormalize_returns_the_nearest_rotation() -> None:
    rng = np.random.default_rng(7)
    T = random_motions(7, 1)[0]
    drifted = T.copy()
    drifted[:3, :3] = 1.3 * (T[:3, :3] + rng.normal(0, 0.05, (3, 3)))
    mended = se3.orthonormalize(drifted)
    R = mended[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_array_equal(mended[:3, 3], T[:3, 3])
    distance = np.linalg.norm(R - drifted[:3, :3])
    for _ in range(100):
        other = Rotation.from_rotvec(rng.normal(0, 0.05, 3)).as_matrix() @ R
        assert np.linalg.norm(other - drifted[:3, :3]) >= distance


def test_orthonormalize_of_many_is_that_of_each() -> None:
    rng = np.random.default_rng(4)
    many = np.tile(np.eye(4), (5, 1, 1))
    many[:, :3] += 0.2 * rng.normal(size=(5, 3, 4))
    many[2, :3, :3] = np.diag([1.0, 1.0, -0.9])
    np.testing.assert_allclose(se3.orthonormalize(many), [se3.orthonormalize(each) for each in many], atol=1e-14)


def test_orthonormalize_never_returns_a_mirror() -> None:
    assert np.linalg.det(se3.orthonormalize(np.diag([1.0, 1.0, -0.9, 1.0]))[:3, :3]) == pytest.approx(1.0)


def test_quaternions_agree_with_scipy_and_come_back() -> None:
    T = random_motions(8, 40)
    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    np.testing.assert_allclose(se3.from_quaternions_xyzw(quaternions, T[:, :3, 3]), T, atol=1e-12)
    back = se3.to_quaternions_xyzw(T)
    assert np.all(back[:, 3] >= 0)
    np.testing.assert_allclose(np.abs(np.sum(back * quaternions, axis=1)), 1.0, atol=1e-12)


def test_quaternions_of_another_length_are_normalised() -> None:
    q = np.array([[0.1, -0.2, 0.3, 0.9]])
    np.testing.assert_allclose(
        se3.from_quaternions_xyzw(q, np.zeros((1, 3))), se3.from_quaternions_xyzw(7 * q, np.zeros((1, 3))), atol=1e-12
    )
