"""The scale of depth from triangulated points: on made-up rooms whose depth was scaled, moved in time and spoilt."""

import numpy as np
import pytest
from optimize_problems import CAMERA
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from stillroom.geometry import se3
from stillroom.optimize.depth_scale import PointsSeen, depth_scale, triangulated
from stillroom.optimize.readout import velocities

RATE_HZ, N_POINTS = 30.0, 300


def poses(times_s: np.ndarray, swing_m: float) -> np.ndarray:
    """A camera that sways and turns, T_world_cam (N, 4, 4)."""
    T = np.tile(np.eye(4), (len(times_s), 1, 1))
    swings = np.stack([np.sin(speed * times_s + k) for k, speed in enumerate((2.0, 3.1, 2.6))], axis=1)
    T[:, :3, :3] = Rotation.from_rotvec(0.08 * swings[:, ::-1]).as_matrix()
    T[:, :3, 3] = swing_m * swings
    return T


def seen_of(
    scale: float, late_s: float = 0.0, swing_m: float = 0.15, n_frames: int = 90, wrong: float = 0.05, seed: int = 0
) -> tuple[PointsSeen, np.ndarray]:
    """What frames see of points on tilted planes of their own, whose depth is scaled and late; and where they are."""
    rng = np.random.default_rng(seed)
    world = np.column_stack(
        (rng.uniform(-2, 2, N_POINTS), rng.uniform(-1.5, 1.5, N_POINTS), rng.uniform(1.5, 4, N_POINTS))
    )
    normals = np.column_stack((rng.uniform(-0.5, 0.5, (N_POINTS, 2)), np.full(N_POINTS, -1.0)))
    times_s = np.arange(n_frames) / RATE_HZ
    T, then = (se3.inverse(poses(at_s, swing_m)) for at_s in (times_s, times_s - late_s))
    parts = []
    for i in range(n_frames):
        exact = CAMERA.project(se3.transform(T[i], world))
        inside = np.flatnonzero((np.abs(exact - (320, 240)) < (310, 230)).all(axis=1) & (rng.random(N_POINTS) < 0.7))
        px = exact[inside] + 0.5 * rng.normal(size=(len(inside), 2))
        n, x = normals[inside] @ then[i, :3, :3].T, se3.transform(then[i], world[inside])
        slope = CAMERA.bf / scale * n / (n * x).sum(axis=1)[:, None]
        rays = np.column_stack(((px - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy), np.ones(len(px))))
        value = (slope * rays).sum(axis=1) * (1 + 0.01 * rng.normal(size=len(px)))
        bad = rng.random(len(px)) < wrong
        px[bad] += rng.uniform(-20, 20, (int(bad.sum()), 2))
        value[rng.random(len(px)) < wrong] *= 1.5
        planes = np.column_stack((value, slope[:, 0] / CAMERA.fx, slope[:, 1] / CAMERA.fy, np.ones(len(px))))
        parts.append((np.full(len(px), i), inside, px, np.ones(len(px)), planes))
    frame, point, px, inverse_variances, planes = (np.concatenate(part) for part in zip(*parts, strict=True))
    velocity = np.nan_to_num(velocities(times_s, poses(times_s, swing_m)))
    seen = PointsSeen(frame, point, px, inverse_variances, planes, T, velocity, np.full(n_frames, -late_s))
    return seen, world


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.03])
@pytest.mark.parametrize("late_s", [0.0, 0.015])
def test_a_scale_is_found_within_three_thousandths_from_points_that_are_off_by_it(scale: float, late_s: float) -> None:
    seen, world = seen_of(scale, late_s)
    found = depth_scale(seen, scale * world + 0.01, CAMERA)
    assert found is not None
    assert abs(found.scale - scale) < 0.003, "with one in twenty depths a third too near"
    assert 0.002 <= found.sigma < 0.003
    assert found.n_points > 200


def test_points_are_where_scipy_triangulates_them() -> None:
    seen, world = seen_of(1.0, wrong=0.0)
    found, _ = triangulated(seen, 1.03 * world, CAMERA)
    for point in range(0, N_POINTS, 30):
        mine = seen.point == point
        T, px = seen.T_cam_world[seen.frame[mine]], seen.px[mine]

        def residuals(p: np.ndarray, T: np.ndarray = T, px: np.ndarray = px) -> np.ndarray:
            return (CAMERA.project(T[:, :3, :3] @ p + T[:, :3, 3]) - px).ravel()

        if mine.sum() >= 6:
            # Huber's kernel bends 5 % of a normal distribution by a little.
            np.testing.assert_allclose(found[point], least_squares(residuals, world[point]).x, atol=0.01)


def test_a_camera_that_stays_in_one_place_tells_nothing() -> None:
    seen, world = seen_of(1.03, swing_m=1e-4)
    assert depth_scale(seen, world, CAMERA) is None


def test_few_points_tell_nothing() -> None:
    seen, world = seen_of(1.03)
    few = seen.point < 40
    assert depth_scale(PointsSeen(*(part[few] for part in seen[:5]), *seen[5:]), world, CAMERA) is None
