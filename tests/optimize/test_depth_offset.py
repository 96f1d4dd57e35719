"""The offset of the depth clock from what frames see of a map: on made-up rooms of tilted planes."""

from dataclasses import replace

import numpy as np
import pytest
from optimize_problems import CAMERA
from scipy.linalg import expm

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.optimize.depth_offset import (
    BENT_PX,
    ClockOffset,
    DepthSeen,
    agreed_offset,
    disparity_planes,
    equations,
    of_frame,
)
from stillroom.optimize.readout import velocities

N_FRAMES, RATE_HZ, N_POINTS = 120, 30.0, 600
MS = 1e-3


def matrix(twist: F64) -> F64:
    """exp of twists (…, 6) as matrices (…, 4, 4), by scipy."""
    generator = np.zeros((*twist.shape[:-1], 4, 4))
    a, b, c = np.moveaxis(twist[..., 3:], -1, 0)
    generator[..., 0, 1], generator[..., 0, 2], generator[..., 1, 2] = -c, b, -a
    generator[..., 1, 0], generator[..., 2, 0], generator[..., 2, 1] = c, -b, a
    generator[..., :3, 3] = twist[..., :3]
    return np.asarray(expm(generator))


def poses(times_s: F64) -> F64:
    """A hand that turns and sways, T_world_cam (N, 4, 4)."""
    swings = np.array([0.05, 0.03, 0.08, 0.08, 0.10, 0.05])
    speeds, phases = np.array([2.0, 3.1, 4.6, 5.0, 4.1, 6.3]), np.arange(6)
    return matrix(swings * np.sin(speeds * times_s[:, None] + phases))


def seen_of(
    time_s: float, true_s: float, known_s: float, apart: F64, rng: np.random.Generator, noise_px: float, wrong: float
) -> DepthSeen:
    """A frame's points, each on a plane of its own; depth is taken `true_s` later, from a place `apart` from there."""
    world = np.column_stack((rng.uniform(-3, 3, N_POINTS), rng.uniform(-2, 2, N_POINTS), rng.uniform(2, 5, N_POINTS)))
    normals = np.column_stack((rng.uniform(-0.8, 0.8, (N_POINTS, 2)), np.full(N_POINTS, -1.0)))
    px = CAMERA.project(se3.transform(se3.inverse(poses(np.array([time_s]))[0]), world))
    inside = (np.abs(px - (320, 240)) < (300, 220)).all(axis=1)
    world, normals, px = world[inside], normals[inside], px[inside]
    then = matrix(apart) @ se3.inverse(poses(np.array([time_s + true_s]))[0])
    n, x = normals @ then[:3, :3].T, se3.transform(then, world)
    slope = CAMERA.bf * n / (n * x).sum(axis=1)[:, None]  # disparity is slope · (ray_x, ray_y, 1)
    px = px + noise_px * rng.normal(size=px.shape)
    rays = np.column_stack(((px - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy), np.ones(len(px))))
    value = (slope * rays).sum(axis=1) + 0.2 * noise_px * rng.normal(size=len(px))
    value[rng.random(len(px)) < wrong] += 3.0
    planes = np.column_stack((value, slope[:, 0] / CAMERA.fx, slope[:, 1] / CAMERA.fy, np.ones(len(px))))
    return DepthSeen(time_s, known_s, world, px, np.ones(len(px)), planes)


def offset(
    true_s: float, known_s: float = 0.0, apart: F64 | None = None, seed: int = 0, gaps_s: float = 0.0
) -> ClockOffset:
    """What frames agree on, whose stamps are off by `true_s - known_s` and have gaps of their own."""
    rng = np.random.default_rng(seed)
    times_s = np.arange(N_FRAMES) / RATE_HZ
    T, found = poses(times_s), []
    velocity = velocities(times_s, T)
    nothing = np.zeros(6)
    for i, time_s in enumerate(times_s):
        gap_s = gaps_s * rng.uniform(-1, 1)
        seen = seen_of(
            float(time_s), true_s + gap_s, known_s + gap_s, nothing if apart is None else apart, rng, 0.4, 0.05
        )
        if np.isfinite(velocity[i]).all():
            found.append(of_frame(seen, se3.inverse(T[i]), velocity[i], CAMERA))
    assert all(one is not None for one in found)
    return agreed_offset([one for one in found if one is not None])


@pytest.mark.parametrize("true_ms", [-15.0, 0.0, 8.0])
def test_an_offset_is_found_within_its_uncertainty(true_ms: float) -> None:
    found = offset(true_ms * MS)
    assert abs(found.after_s - true_ms * MS) < max(3.0 * found.sigma_s, 0.4 * MS)
    assert found.sigma_s < 1.0 * MS


def test_a_depth_camera_that_sits_elsewhere_is_no_offset() -> None:
    apart = np.array([0.008, -0.005, 0.01, 0.004, 0.003, -0.005])
    found = offset(-15.0 * MS, apart=apart)
    assert abs(found.after_s + 15.0 * MS) < max(3.0 * found.sigma_s, 0.5 * MS)


def test_what_is_known_already_and_the_gaps_of_each_pair_are_taken_off() -> None:
    found = offset(-15.0 * MS, known_s=-10.0 * MS, gaps_s=12.0 * MS)
    assert abs(found.after_s + 5.0 * MS) < max(3.0 * found.sigma_s, 0.4 * MS)


def test_a_camera_at_rest_leaves_it_open() -> None:
    rng = np.random.default_rng(2)
    seen = [seen_of(0.5, 0.0, 0.0, np.zeros(6), rng, 0.4, 0.05) for _ in range(60)]
    T = se3.inverse(poses(np.array([0.5]))[0])
    found = [of_frame(one, T, 1e-3 * rng.normal(size=6), CAMERA) for one in seen]
    assert agreed_offset([one for one in found if one is not None]).sigma_s > 0.01


def test_too_few_planes_tell_nothing() -> None:
    seen = seen_of(0.5, 0.0, 0.0, np.zeros(6), np.random.default_rng(3), 0.4, 0.05)
    planes = seen.planes.copy()
    planes[20:, 3] = 0.0
    assert of_frame(seen._replace(planes=planes), se3.inverse(poses(np.array([0.5]))[0]), np.ones(6), CAMERA) is None


def test_derivatives_are_those_of_the_errors() -> None:
    rng = np.random.default_rng(4)
    seen = seen_of(0.5, -0.015, -0.01, np.zeros(6), rng, 0.4, 0.0)
    T, velocity, apart = se3.inverse(poses(np.array([0.5]))[0]), rng.normal(size=6), np.zeros(6)
    rows = equations(seen, T, velocity, apart, CAMERA)
    h = 1e-6
    for k in range(6):
        step = h * np.eye(6)[k]
        after, before = (equations(seen, matrix(sign * step) @ T, velocity, apart, CAMERA) for sign in (1, -1))
        np.testing.assert_allclose(rows.J_px[:, :, k], (after.e_px - before.e_px) / (2 * h), atol=1e-4)
        np.testing.assert_allclose(rows.J_d[:, k], (after.e_d - before.e_d) / (2 * h), atol=1e-4)
        after, before = (equations(seen, T, velocity, sign * step, CAMERA) for sign in (1, -1))
        # To the first order of the motion between colour and depth, which is 10 ms.
        np.testing.assert_allclose(rows.J_d[:, 7 + k], (after.e_d - before.e_d) / (2 * h), atol=1.0)
    after, before = (equations(seen._replace(after_s=-0.01 + sign * h), T, velocity, apart, CAMERA) for sign in (1, -1))
    np.testing.assert_allclose(rows.J_d[:, 6], (after.e_d - before.e_d) / (2 * h), atol=1e-4)


def test_planes_are_those_of_least_squares_and_edges_are_none() -> None:
    lens = replace(CAMERA, distortion=(0.2, -0.5, 0.003, 0.002, 0.4))
    rng = np.random.default_rng(5)
    rows, columns = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float64)
    image = (CAMERA.bf / (12.0 + 0.01 * columns - 0.02 * rows + 0.05 * rng.normal(size=rows.shape))).astype(np.float32)
    image[:, 400:] = 0.7  # a jump, and things without depth
    image[200:220, 100:120] = 0.0
    px = rng.uniform((20, 20), (CAMERA.width - 20, CAMERA.height - 20), (300, 2))
    planes = disparity_planes(px, image, lens.lens, CAMERA.bf, 3)
    raw = lens.distort(px)
    n_known = 0
    for point, at, plane in zip(px, raw, planes, strict=True):
        u, v = np.rint(at).astype(int)
        window = (slice(v - 3, v + 4), slice(u - 3, u + 4))
        z = image[window].astype(np.float64)
        A = np.column_stack((np.ones(z.size), columns[window].ravel() - at[0], rows[window].ravel() - at[1]))[
            z.ravel() > 0
        ]
        d = CAMERA.bf / z[z > 0]
        if len(d) < 0.7 * 49:
            assert plane[3] == 0.0
            continue
        found, rest = np.linalg.lstsq(A, d, rcond=None)[:2]
        assert plane[3] == (rest[0] / len(d) <= BENT_PX**2)
        if plane[3] == 0.0:
            continue
        n_known += 1
        assert plane[0] == pytest.approx(found[0], abs=1e-9)
        turned = np.array([lens.distort((point + step)[None])[0] - at for step in np.eye(2)])  # (2, 2), by undistorted
        np.testing.assert_allclose(plane[1:3], turned @ found[1:], atol=1e-9)
    assert n_known > 100
    assert (disparity_planes(np.array([[1.0, 240.0]]), image, CAMERA.lens, CAMERA.bf, 3) == 0.0).all()
