"""The offset of the clocks of colour and depth: whether depth fits where the camera was when it was taken.

Keypoints say where the camera was when the colour image was taken, T. A point x of the camera there is at
exp(τ ν + b) x when depth is taken, τ later, with the camera's velocity ν. There the depth image should show its depth:
it is looked up around the keypoint, on the plane that inverse depth has in a few pixels (inverse depth of a plane is
linear in the image). The twist b is what else keeps depth from colour, and stays the same for many frames: the depth
camera does not sit quite where it is registered to, and the map itself was made of depth that was taken too late. τ is
what is common to all frames while the velocity changes, as the readout is in `optimize/readout.py`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry import se3, twists
from stillroom.geometry.arrays import F32, F64
from stillroom.geometry.camera import Camera, Lens
from stillroom.geometry.distortion import distorted
from stillroom.optimize.observations import MIN_DEPTH_M
from stillroom.optimize.readout import HUBER, LEAST_POINTS, FrameEvidence, agreed

ITERATIONS = 5
APART_M, APART_RAD = 0.02, 0.02
"""Standard deviations of b."""
REACH_PX = 3
"""Half the window in which depth is a plane; of images 640 pixels long."""
LEAST_KNOWN = 0.7
"""Share of a window that must have depth."""
BENT_PX = 0.25
"""RMS distance of disparities [px] from their plane at which it is none: an edge, or a thing that is not flat."""
LEAST_SIGMA_PX = 0.15
"""Of a disparity on its plane: sensors know it better, but not free of bumps."""
BLOCK_FRAMES = 15
"""Frames that see one and the same b."""


class DepthSeen(NamedTuple):
    """What one frame saw of the map, and depth around it.

    Attributes:
        time_s: When colour was taken.
        after_s: How long after it depth was taken, as far as is known [s].
        points_world_m: The points (N, 3) float64 [m].
        px: Where they are seen (N, 2) [px], undistorted, at the time of colour.
        inverse_variances: Of that (N,) [1/px²].
        planes: Disparity there, its derivatives by x and y, and whether they are known (N, 4); see `disparity_planes`.
    """

    time_s: float
    after_s: float
    points_world_m: F64
    px: F64
    inverse_variances: F64
    planes: F64


@dataclass(frozen=True)
class ClockOffset:
    """How depth is stamped.

    Attributes:
        after_s: How much later depth was taken than is known [s]; negative where it is stamped late.
        sigma_s: One standard deviation of it [s].
        speed_px_s: How fast images moved, RMS over the frames [px/s].
        n_frames: Frames that it is from.
    """

    after_s: float
    sigma_s: float
    speed_px_s: float
    n_frames: int


@njit(nogil=True, cache=True)
def disparity_planes(px: F64, image_m: F32, lens: Lens, bf: float, reach: int) -> F64:
    """Return the planes of disparity bf/z around points: value [px], derivatives by x and y, and 1 where known (N, 4).

    Args:
        px: Undistorted points (N, 2) [px].
        image_m: Depth (H, W) [m].
        lens: Of the camera.
        bf: Baseline of the virtual stereo pair times fx [px·m].
        reach: Half the window [px].
    """
    height, width = image_m.shape
    planes = np.zeros((len(px), 4))
    H, b, plane = np.empty((3, 3)), np.empty(3), np.empty(3)
    for i in range(len(px)):
        x, y = (px[i, 0] - lens.cx) / lens.fx, (px[i, 1] - lens.cy) / lens.fy
        u, v = distorted(lens, x, y)
        column, row = int(np.rint(u)), int(np.rint(v))
        if not (reach <= column < width - reach and reach <= row < height - reach):
            continue
        H[:], b[:] = 0.0, 0.0
        n, squares = 0, 0.0
        for r in range(row - reach, row + reach + 1):
            for c in range(column - reach, column + reach + 1):
                if not image_m[r, c] > 0.0:
                    continue
                d = bf / float(image_m[r, c])
                dx, dy = c - u, r - v
                n += 1
                squares += d * d
                H[0, 0] += 1.0
                H[1, 0] += dx
                H[2, 0] += dy
                H[1, 1] += dx * dx
                H[2, 1] += dx * dy
                H[2, 2] += dy * dy
                b[0] += d
                b[1] += d * dx
                b[2] += d * dy
        if n < LEAST_KNOWN * (2 * reach + 1) ** 2:
            continue
        H[0, 1], H[0, 2], H[1, 2] = H[1, 0], H[2, 0], H[2, 1]
        plane[:] = np.linalg.solve(H, b)
        bent2 = (squares - plane[0] * b[0] - plane[1] * b[1] - plane[2] * b[2]) / n
        if bent2 > BENT_PX * BENT_PX:
            continue
        # By undistorted pixels: what one of them is in the image as taken.
        u_x, v_x = distorted(lens, x + 1.0 / lens.fx, y)
        u_y, v_y = distorted(lens, x, y + 1.0 / lens.fy)
        planes[i, 0] = plane[0]
        planes[i, 1] = plane[1] * (u_x - u) + plane[2] * (v_x - v)
        planes[i, 2] = plane[1] * (u_y - u) + plane[2] * (v_y - v)
        planes[i, 3] = 1.0
    return planes


class _Equations(NamedTuple):
    """Errors of a frame's image coordinates (N, 2) and disparities (N,) [px], with what they change by.

    `J_px` (N, 2, 6) is by the pose; `J_d` (N, 13) by the pose, by τ, and by b.
    """

    e_px: F64
    J_px: F64
    e_d: F64
    J_d: F64
    in_front: F64


def of_frame(seen: DepthSeen, T_cam_world: F64, velocity: F64, camera: Camera) -> FrameEvidence | None:
    """Return what one frame says of τ [s], beside `seen.after_s`, and of b, whatever its pose; None for too little.

    Args:
        seen: What it saw.
        T_cam_world: Its pose (4, 4), where to start.
        velocity: Of the camera (6,) [m/s, rad/s].
        camera: Intrinsics and bf.
    """
    if np.count_nonzero(seen.planes[:, 3]) < LEAST_POINTS:
        return None
    T, apart = T_cam_world, np.zeros(6)
    prior = np.diag(np.repeat((APART_M, APART_RAD), 3) ** -2.0)
    gradient2 = (seen.planes[:, 1:3] ** 2).sum(axis=1)
    w_d = seen.planes[:, 3] / (LEAST_SIGMA_PX**2 + gradient2 / seen.inverse_variances)
    free = np.r_[0:6, 7:13]
    for _ in range(ITERATIONS):
        rows = equations(seen, T, velocity, apart, camera)
        chi_px = np.sqrt(seen.inverse_variances * (rows.e_px**2).sum(axis=1))
        chi_d = np.sqrt(w_d) * np.abs(rows.e_d)
        w_px = rows.in_front * seen.inverse_variances * np.minimum(1.0, HUBER / np.maximum(chi_px, 1e-9))
        w_depth = rows.in_front * w_d * np.minimum(1.0, HUBER / np.maximum(chi_d, 1e-9))
        H, b = np.einsum("n,na,nb->ab", w_depth, rows.J_d, rows.J_d), rows.J_d.T @ (w_depth * rows.e_d)
        H[:6, :6] += np.einsum("n,nka,nkb->ab", w_px, rows.J_px, rows.J_px)
        b[:6] += np.einsum("n,nka,nk->a", w_px, rows.J_px, rows.e_px)
        with_prior = H[np.ix_(free, free)].copy()
        with_prior[6:, 6:] += prior
        slope = b[free] + np.concatenate((np.zeros(6), prior @ apart))
        step = -np.linalg.solve(with_prior, slope)
        T, before, apart = twists.exp(step[None, :6])[0] @ T, apart, apart + step[6:]
    eliminated = np.linalg.solve(H[:6, :6], np.column_stack((H[:6, 6:], b[:6])))
    information = H[6:, 6:] - H[6:, :6] @ eliminated[:, :7]
    slope = -(b[6:] - H[6:, :6] @ eliminated[:, 7])
    known = np.concatenate(([0.0], before))  # where the last equations were made
    speed_px_s = float(np.median(np.linalg.norm(rows.J_px @ velocity, axis=1)))
    return FrameEvidence(information, slope + information @ known, speed_px_s)


def equations(seen: DepthSeen, T_cam_world: F64, velocity: F64, apart: F64, camera: Camera) -> _Equations:
    """Return errors and derivatives of a frame at a pose (4, 4), τ = 0 and b (6,)."""
    x = se3.transform(T_cam_world, seen.points_world_m)
    away = twists.exp((seen.after_s * velocity + apart)[None])[0]
    x_then = se3.transform(away, x)
    px, J_x = _projected(x, camera)
    px_then, J_then = _projected(x_then, camera)
    z = np.maximum(x_then[:, 2], MIN_DEPTH_M)
    value, gradient = seen.planes[:, 0], seen.planes[:, 1:3]
    e_d = camera.bf / z - value - ((px_then - seen.px) * gradient).sum(axis=1)
    J_point = -np.einsum("nk,nka->na", gradient, J_then)
    J_point[:, 2] -= camera.bf / z**2
    J_away = np.einsum("na,nab->nb", J_point, _moved(x_then))
    J_pose = np.einsum("na,ab,nbc->nc", J_point, away[:3, :3], _moved(x))
    J_d = np.column_stack((J_pose, J_away @ velocity, J_away))
    in_front = (np.minimum(x[:, 2], x_then[:, 2]) > MIN_DEPTH_M).astype(np.float64)
    return _Equations(px - seen.px, J_x @ _moved(x), e_d, J_d, in_front)


def agreed_offset(frames: list[FrameEvidence], seed: int = 0) -> ClockOffset:
    """Return what frames, in order of time, agree on; there are enough for two blocks."""
    found = agreed(frames, seed, BLOCK_FRAMES)
    return ClockOffset(found.readout_s, found.sigma_s, found.speed_px_s, found.n_frames)


def _moved(x: F64) -> F64:
    """Return the derivatives (N, 3, 6) of exp(ξ) x by ξ at 0, of points (N, 3)."""
    return np.concatenate((np.broadcast_to(np.eye(3), (len(x), 3, 3)), -twists.skew(x)), axis=2)


def _projected(x: F64, camera: Camera) -> tuple[F64, F64]:
    """Return where points (N, 3) [m] are seen (N, 2) [px], and the derivatives (N, 2, 3) by them."""
    z = np.maximum(x[:, 2], MIN_DEPTH_M)
    px = np.stack((camera.fx * x[:, 0] / z + camera.cx, camera.fy * x[:, 1] / z + camera.cy), axis=1)
    J = np.zeros((len(x), 2, 3))
    J[:, 0, 0], J[:, 0, 2] = camera.fx / z, -camera.fx * x[:, 0] / z**2
    J[:, 1, 1], J[:, 1, 2] = camera.fy / z, -camera.fy * x[:, 1] / z**2
    return px, J
