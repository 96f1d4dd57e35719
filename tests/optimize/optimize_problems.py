"""Random problems and plain numpy versions of the kernels, written from the formulas and not from the kernels."""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry import se3
from stillroom.geometry.camera import Camera

CAMERA = Camera(640, 480, 542.8, 541.1, 315.6, 237.8)
INTRINSICS = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, CAMERA.bf, 1.0])


@dataclass
class PoseProblem:
    T_true: np.ndarray
    T_guess: np.ndarray
    points: np.ndarray
    observed: np.ndarray
    weights: np.ndarray
    is_wrong: np.ndarray


def pose_problem(seed: int, n: int = 300, wrong: float = 0.2, noise: float = 1.0, angle: float = 0.03) -> PoseProblem:
    """A camera before n points, 80 % with a right coordinate, a share of them matched 20 to 80 px wrong."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.8, 6.0, n)
    px = np.stack((rng.uniform(0, 640, n), rng.uniform(0, 480, n)), axis=1)
    T_true = se3.exp(np.concatenate((rng.normal(size=3), 0.5 * rng.normal(size=3))))
    points = se3.transform(se3.inverse(T_true), CAMERA.back_project(px, z))
    sigma = 1.2 ** rng.integers(0, 8, n)
    observed = np.column_stack((px, px[:, 0] - CAMERA.bf / z)) + noise * rng.normal(size=(n, 3)) * sigma[:, None]
    weights = np.repeat(1.0 / sigma[:, None] ** 2, 3, axis=1)
    has_right = rng.random(n) < 0.8
    weights[~has_right, 2] = 0.0
    observed[~has_right, 2] = -1.0
    is_wrong = rng.random(n) < wrong
    shift = rng.uniform(20, 80, (n, 2)) * rng.choice([-1.0, 1.0], (n, 2)) * sigma[:, None]
    observed[is_wrong, :2] += shift[is_wrong]
    T_guess = se3.exp(np.concatenate((0.05 * rng.normal(size=3), angle * rng.normal(size=3)))) @ T_true
    return PoseProblem(T_true, T_guess, points, observed, weights, is_wrong)


def predict(T_cam_world: np.ndarray, points: np.ndarray) -> np.ndarray:
    """u, v, u_right (N, 3) by the pinhole formula."""
    x, y, z = se3.transform(T_cam_world, points).T
    u = CAMERA.fx * x / z + CAMERA.cx
    return np.stack((u, CAMERA.fy * y / z + CAMERA.cy, u - CAMERA.bf / z), axis=1)


def chi_squares(T_cam_world: np.ndarray, points: np.ndarray, observed: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted squared errors (N,), infinite behind the camera."""
    error = np.where(weights > 0, predict(T_cam_world, points) - observed, 0.0)
    in_front = se3.transform(T_cam_world, points)[:, 2] > 1e-3
    return np.where(in_front, (weights * error**2).sum(axis=1), np.inf)


def huber_rho(chi2: np.ndarray, delta2: np.ndarray) -> np.ndarray:
    """Huber's ρ(χ²), g2o's convention."""
    return np.where(chi2 <= delta2, chi2, 2 * np.sqrt(delta2 * chi2) - delta2)


def limits(weights: np.ndarray) -> np.ndarray:
    """The chi-square limit of each observation (N,)."""
    return np.where(weights[:, 2] > 0, 7.815, 5.991)


def camera_jacobian(T_cam_world: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Derivative (3, 6) of the prediction by a left twist, from central differences."""
    columns = []
    for k in range(6):
        xi = np.zeros(6)
        xi[k] = 1e-6
        ahead, back = (predict(se3.exp(s * xi) @ T_cam_world, point[None])[0] for s in (1.0, -1.0))
        columns.append((ahead - back) / 2e-6)
    return np.stack(columns, axis=1)


def point_jacobian(T_cam_world: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Derivative (3, 3) of the prediction by the world point, from central differences."""
    steps = 1e-6 * np.eye(3)
    columns = [
        (predict(T_cam_world, (point + s)[None])[0] - predict(T_cam_world, (point - s)[None])[0]) / 2e-6 for s in steps
    ]
    return np.stack(columns, axis=1)


def pose_distance(T_a: np.ndarray, T_b: np.ndarray) -> tuple[float, float]:
    """Translation [m] and angle [rad] between two poses."""
    between = T_a @ se3.inverse(T_b)
    return float(np.linalg.norm(between[:3, 3])), float(se3.angle_rad(between))
