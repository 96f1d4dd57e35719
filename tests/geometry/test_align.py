"""Alignment against the motion that was put in, scipy's own solver, and a search for anything better."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillroom.geometry import se3
from stillroom.geometry.align import align, align_poses


def random_motion(rng: np.random.Generator) -> np.ndarray:
    return se3.from_rotation_translation(Rotation.random(random_state=rng).as_matrix(), rng.normal(0, 5, 3))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("with_scale", [False, True])
def test_finds_the_motion_that_was_put_in(seed: int, with_scale: bool) -> None:
    rng = np.random.default_rng(seed)
    source, T = rng.normal(0, 2, (50, 3)), random_motion(rng)
    scale = rng.uniform(0.3, 3) if with_scale else 1.0
    target = scale * source @ T[:3, :3].T + T[:3, 3]
    found = align(source, target, with_scale)
    assert found.scale == pytest.approx(scale, rel=1e-12)
    np.testing.assert_allclose(found.T_target_source, T, atol=1e-12)
    np.testing.assert_allclose(found.points(source), target, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_rotation_agrees_with_scipy_on_noisy_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source = rng.normal(0, 1, (40, 3))
    target = se3.transform(random_motion(rng), source) + rng.normal(0, 0.3, (40, 3))
    expected, _ = Rotation.align_vectors(target - target.mean(0), source - source.mean(0))
    np.testing.assert_allclose(align(source, target, False).T_target_source[:3, :3], expected.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("with_scale", [False, True])
def test_no_neighbouring_motion_is_better(with_scale: bool) -> None:
    rng = np.random.default_rng(3)
    source, target = rng.normal(0, 1, (20, 3)), rng.normal(0, 1, (20, 3))
    best = align(source, target, with_scale)
    cost = np.sum((best.points(source) - target) ** 2)
    for _ in range(200):
        T = se3.exp(rng.normal(0, 0.02, 6)) @ best.T_target_source
        scale = best.scale * (1 + with_scale * rng.normal(0, 0.05))
        assert np.sum((se3.transform(T, scale * source) - target) ** 2) >= cost


def test_a_mirror_image_is_not_a_motion() -> None:
    source = np.random.default_rng(0).normal(0, 1, (30, 3))
    found = align(source, source * [1, 1, -1], True)
    assert np.linalg.det(found.T_target_source[:3, :3]) == pytest.approx(1.0)
    assert found.scale > 0


@pytest.mark.parametrize("with_scale", [False, True])
@pytest.mark.parametrize(
    ("source", "target"),
    [
        (np.full((5, 3), 1e3), np.random.default_rng(0).normal(0, 1, (5, 3))),  # a camera that never moved
        (np.random.default_rng(0).normal(0, 1, (5, 3)), np.full((5, 3), 0.1)),
        (np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0.0, 0, 0], [0, 1, 0]])),
        (np.array([[1.0, 2, 3]]), np.array([[4.0, 4, 4]])),
    ],
    ids=["source in one place", "target in one place", "two points", "one point"],
)
def test_points_that_say_nothing_about_rotation(source: np.ndarray, target: np.ndarray, with_scale: bool) -> None:
    found = align(source, target, with_scale)
    assert found.scale == 1.0
    np.testing.assert_array_equal(found.T_target_source[:3, :3], np.eye(3))
    np.testing.assert_allclose(found.points(source).mean(0), target.mean(0), atol=1e-9)


def test_no_points_move_nothing() -> None:
    np.testing.assert_array_equal(align(np.zeros((0, 3)), np.zeros((0, 3)), True).T_target_source, np.eye(4))


def test_points_on_a_line_are_laid_upon_each_other() -> None:
    source = np.outer(np.linspace(0, 1, 9), [1.0, 0, 0])
    target = np.outer(np.linspace(0, 1, 9), [0, 0.6, 0.8]) + 4
    found = align(source, target, False)
    np.testing.assert_allclose(found.points(source), target, atol=1e-12)
    assert np.linalg.det(found.T_target_source[:3, :3]) == pytest.approx(1.0)


def test_poses_move_as_points_do_and_keep_rigid() -> None:
    rng = np.random.default_rng(5)
    poses = np.stack([random_motion(rng) for _ in range(6)])
    T = random_motion(rng)
    found = align(poses[:, :3, 3], 2.5 * se3.transform(T, poses[:, :3, 3]), True)
    moved = found.poses(poses)
    np.testing.assert_allclose(moved[:, :3, 3], found.points(poses[:, :3, 3]), atol=1e-12)
    np.testing.assert_allclose(moved[:, :3, :3], T[:3, :3] @ poses[:, :3, :3], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_poses_are_laid_upon_poses_also_where_the_camera_stood_still(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = random_motion(rng)
    turning = np.stack([se3.exp(np.array([0, 0, 0, *rng.normal(0, 0.4, 3)])) for _ in range(60)])
    np.testing.assert_allclose(align_poses(turning, T @ turning), T, atol=1e-12)
    np.testing.assert_allclose(align_poses(turning[:1], T @ turning[:1]), T, atol=1e-12)
    noisy = np.stack([T @ pose @ se3.exp(rng.normal(0, 0.01, 6)) for pose in turning])
    off = se3.inverse(T) @ align_poses(turning, noisy)
    assert np.linalg.norm(off[:3, 3]) < 0.006
    assert se3.angle_rad(off) < 0.006
