"""The scale of depth, from points that are triangulated from known poses.

Images and depth alone never tell it: a room twice as large, from twice as far, gives the same images, and depth that
reads twice as far agrees with them. Poses of the camera that are known in metres do. What the frames see of each point
of the map, its image coordinates alone, then says how far it is; measured depth is compared with that in inverse depth,
where the noise of both is even.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.geometry import twists
from stillroom.geometry.arrays import F64, I64, Bool
from stillroom.geometry.camera import Camera
from stillroom.optimize.observations import MIN_DEPTH_M
from stillroom.optimize.readout import HUBER

ITERATIONS = 12
LEAST_SEEN = 6
"""Frames that see a point."""
MOST_SIGMA = 0.05
"""Of a triangulated depth, as a share of it: points that are known worse are left out."""
LEAST_POINTS = 50
DEPTH_SIGMA = 0.01
"""Of one measured depth, as a share of it, bumps included."""
LEAST_SIGMA = 0.002
"""Of the scale: what it is off by on rendered rooms, where all else says that it is known ten times as well."""
PARTS = 8
"""Stretches of time, each left out once to say how certain the scale is."""


class PointsSeen(NamedTuple):
    """What F frames saw of P points, O times.

    Attributes:
        frame, point: Indices of the frame and of the point (O,).
        px: Where (O, 2) [px], undistorted, at the time of colour.
        inverse_variances: Of that (O,) [1/px²].
        planes: Disparity there, its derivatives by x and y, and whether they are known (O, 4).
        T_cam_world: Known poses (F, 4, 4).
        velocity: Of the camera (F, 6) [m/s, rad/s], in its own frame.
        after_s: How long after colour depth was taken (F,) [s].
    """

    frame: I64
    point: I64
    px: F64
    inverse_variances: F64
    planes: F64
    T_cam_world: F64
    velocity: F64
    after_s: F64


@dataclass(frozen=True)
class DepthScale:
    """What depth says a metre is.

    Attributes:
        scale: Measured depth as a share of the true one.
        sigma: One standard deviation of it, by leaving out a stretch of time after the other; 0.002 at least.
        n_points: Points that it is from.
    """

    scale: float
    sigma: float
    n_points: int


def depth_scale(seen: PointsSeen, points_world_m: F64, camera: Camera) -> DepthScale | None:
    """Return the scale of depth; None where too few points are seen from different places.

    Args:
        seen: What the frames saw, in order of time.
        points_world_m: Where the points are about (P, 3) [m], in the world of the known poses.
        camera: Intrinsics and bf.
    """
    found = _compared(seen, points_world_m, camera)
    if found is None:
        return None
    scale, n_points = found
    n_frames = len(seen.T_cam_world)
    part = np.minimum(seen.frame * PARTS // n_frames, PARTS - 1)
    without = [_compared(_only(seen, part != one), points_world_m, camera) for one in range(PARTS)]
    told = np.array([one[0] for one in without if one is not None])
    if len(told) < PARTS:
        return None
    sigma = float(np.sqrt((PARTS - 1) / PARTS * ((told - told.mean()) ** 2).sum()))
    return DepthScale(scale, max(sigma, LEAST_SIGMA), n_points)


def triangulated(seen: PointsSeen, points_world_m: F64, camera: Camera) -> tuple[F64, F64]:
    """Return points (P, 3) [m] and their information (P, 3, 3) [1/m²] from image coordinates alone, robustly.

    Arguments are those of `depth_scale`; points that are not determined come out anywhere, with little information.
    """
    T, n_points = seen.T_cam_world[seen.frame], len(points_world_m)
    points_m, H = points_world_m.copy(), np.zeros((n_points, 3, 3))
    for _ in range(ITERATIONS):
        x = np.einsum("oij,oj->oi", T[:, :3, :3], points_m[seen.point]) + T[:, :3, 3]
        z = np.maximum(x[:, 2], MIN_DEPTH_M)
        error = np.stack((camera.fx * x[:, 0] / z + camera.cx, camera.fy * x[:, 1] / z + camera.cy), axis=1) - seen.px
        J = np.zeros((len(x), 2, 3))
        J[:, 0, 0], J[:, 0, 2] = camera.fx / z, -camera.fx * x[:, 0] / z**2
        J[:, 1, 1], J[:, 1, 2] = camera.fy / z, -camera.fy * x[:, 1] / z**2
        J = J @ T[:, :3, :3]
        chi = np.sqrt(seen.inverse_variances * (error**2).sum(axis=1))
        weight = (x[:, 2] > MIN_DEPTH_M) * seen.inverse_variances * np.minimum(1.0, HUBER / np.maximum(chi, 1e-9))
        H = _summed(seen.point, np.einsum("o,oka,okb->oab", weight, J, J), n_points)
        slope = _summed(seen.point, np.einsum("o,oka,ok->oa", weight, J, error), n_points)
        step = np.linalg.solve(H + 1e-6 * np.eye(3), slope[:, :, None])[:, :, 0]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        points_m = points_m - step * np.minimum(1.0, 0.5 / np.maximum(length, 1e-9))  # at most half a metre
    return points_m, H


def _compared(seen: PointsSeen, points_world_m: F64, camera: Camera) -> tuple[float, int] | None:
    """Return the scale, and how many points tell it."""
    points_m, H = triangulated(seen, points_world_m, camera)
    covariance = np.linalg.inv(H + 1e-6 * np.eye(3))
    T = seen.T_cam_world[seen.frame]
    x = np.einsum("oij,oj->oi", T[:, :3, :3], points_m[seen.point]) + T[:, :3, 3]
    along = T[:, 2, :3]
    variance = np.einsum("oi,oij,oj->o", along, covariance[seen.point], along)
    sigma = np.sqrt(np.maximum(variance, 0.0)) / np.maximum(x[:, 2], MIN_DEPTH_M)
    n_seen = np.bincount(seen.point, minlength=len(points_m))[seen.point]
    good = (seen.planes[:, 3] > 0) & (n_seen >= LEAST_SEEN) & (x[:, 2] > MIN_DEPTH_M) & (sigma < MOST_SIGMA)
    n_points = len(np.unique(seen.point[good]))
    if n_points < LEAST_POINTS:
        return None
    away = twists.exp(seen.after_s[:, None] * seen.velocity)[seen.frame[good]]
    then = np.einsum("oij,oj->oi", away[:, :3, :3], x[good]) + away[:, :3, 3]
    px = camera.project(then)
    measured = seen.planes[good, 0] + ((px - seen.px[good]) * seen.planes[good, 1:3]).sum(axis=1)
    ratio = camera.bf / then[:, 2] / np.maximum(measured, 1e-6)
    # Errors of a triangulated point are in all that see it: each counts as one.
    weight = 1.0 / (n_seen[good] * sigma[good] ** 2 + DEPTH_SIGMA**2)
    scale = float(np.median(ratio))
    for _ in range(10):
        off = np.abs(ratio - scale)
        spread = 1.4826 * float(np.median(off)) + 1e-9
        robust = weight * np.minimum(1.0, HUBER * spread / np.maximum(off, 1e-12))
        scale = float(robust @ ratio / robust.sum())
    return scale, n_points


def _only(seen: PointsSeen, chosen: Bool) -> PointsSeen:
    return seen._replace(
        frame=seen.frame[chosen],
        point=seen.point[chosen],
        px=seen.px[chosen],
        inverse_variances=seen.inverse_variances[chosen],
        planes=seen.planes[chosen],
    )


def _summed(index: I64, parts: F64, n: int) -> F64:
    """Return the sums (n, …) of parts (O, …) by their index (O,)."""
    flat, total = parts.reshape(len(parts), -1), np.zeros((n, parts[0].size))
    for k in range(flat.shape[1]):
        total[:, k] = np.bincount(index, flat[:, k], minlength=n)
    return total.reshape(n, *parts.shape[1:])
