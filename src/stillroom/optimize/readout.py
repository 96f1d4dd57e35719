"""The readout of a rolling shutter from a trajectory: how far the rows of an image are from where it says they are.

A point x of the camera at mid-frame is seen by row v from exp(s (ρ ν + b)) x: ρ the readout, s = (v + ½)/H − ½ the
row's share of it, ν the camera's velocity (the model of Oth, Furgale, Kneip and Siegwart, Rolling Shutter Camera
Calibration, CVPR 2013, in the first order, on images of a mapped room in place of a checkerboard). The twist b is the
map's own shear: frames that made it moved too, and a camera that sees one side of a room cannot tell a sheared room
from rows that lie askew. It stays the same for some frames, in which ν changes; ρ is what is common to all of them.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry import se3, twists
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera
from stillroom.optimize.observations import MIN_DEPTH_M

ITERATIONS = 5
SHEAR_M, SHEAR_RAD = 0.02, 0.02
"""Standard deviations of b: what 0.7 m/s and rad/s come to in 30 ms."""
OF_SHEAR = np.repeat((SHEAR_M, SHEAR_RAD), 3) ** -2.0
"""Inverse variances of b (6,)."""
_PRIOR_OF_SHEAR = np.diag(OF_SHEAR)
HUBER = 2.0
"""In deviations of a keypoint."""
LEAST_POINTS = 30
NEIGHBOURS = 2
"""Frames before and after one that its velocity is taken from: more would flatten a hand's tremor."""
LONGEST_STEP = 1.5
"""Times the median step between frames: over a longer one the motion is not known."""
BLOCK_FRAMES = 10
"""Frames that see one and the same shear."""
DRAWS = 400


class RowsSeen(NamedTuple):
    """What one frame saw of the map.

    Attributes:
        time_s: When.
        points_world_m: The points (N, 3) float64 [m].
        observed_px: u, v, u_right (N, 3) [px], undistorted, as seen at their rows' times.
        weights: Inverse variances (N, 3) [1/px²]; the third is 0 where there is no right coordinate.
        share: Where each row lies in the readout (N,), −½ for the first, ½ for the last.
    """

    time_s: float
    points_world_m: F64
    observed_px: F64
    weights: F64
    share: F64


class FrameEvidence(NamedTuple):
    """What one frame says of the readout and the shear of the map, whatever its pose.

    Attributes:
        information: Normal matrix (7, 7) of ρ [s] and b [m, rad], the pose eliminated.
        slope: Its product with their most likely values (7,).
        speed_px_s: How fast the image moved, the median of its points [px/s].
    """

    information: F64
    slope: F64
    speed_px_s: float


@dataclass(frozen=True)
class Readout:
    """The readout of a camera.

    Attributes:
        readout_s: The estimate [s].
        sigma_s: One standard deviation of it [s]: by a bootstrap over blocks of frames, or by the noise of keypoints,
            whichever is more.
        speed_px_s: How fast images moved, RMS over the frames [px/s].
        n_frames: Frames that it is from.
    """

    readout_s: float
    sigma_s: float
    speed_px_s: float
    n_frames: int


def velocities(times_s: F64, T_world_cam: F64) -> F64:
    """Return the velocities (N, 6) [m/s, rad/s] of a camera in its own frame.

    With them T_cam_world(t + τ) = exp(τ ν) T_cam_world(t). They are the derivatives of the polynomials through five
    poses each; NaN where these do not follow each other.

    Args:
        times_s: Times (N,) [s], increasing.
        T_world_cam: Poses (N, 4, 4).
    """
    n, width = len(times_s), 2 * NEIGHBOURS + 1
    found = np.full((n, 6), np.nan)
    if n < width:
        return found
    window = np.arange(n - width + 1)[:, None] + np.arange(width)
    middle = window[:, NEIGHBOURS]
    steps_s = np.diff(times_s)
    follows = (steps_s[window[:, :-1]] <= LONGEST_STEP * np.median(steps_s)).all(axis=1)
    window, middle = window[follows], middle[follows]
    T_cam_world = se3.inverse(T_world_cam[window])
    moved = twists.log((T_cam_world @ T_world_cam[middle][:, None]).reshape(-1, 4, 4)).reshape(-1, width, 6)
    after_s = times_s[window] - times_s[middle][:, None]
    powers = after_s[:, :, None] ** np.arange(width)
    found[middle] = np.linalg.solve(powers, moved)[:, 1]
    return found


def of_frame(seen: RowsSeen, T_cam_world: F64, velocity: F64, camera: Camera, readout_s: float) -> FrameEvidence | None:
    """Return what one frame says; None where it sees too little.

    Args:
        seen: What it saw.
        T_cam_world: Its pose (4, 4) at mid-frame, where to start.
        velocity: Of the camera (6,) [m/s, rad/s].
        camera: Intrinsics and bf.
        readout_s: Where to start [s].
    """
    if len(seen.share) < LEAST_POINTS:
        return None
    T, shear = T_cam_world, np.zeros(6)
    for _ in range(ITERATIONS):
        x = se3.transform(T, seen.points_world_m)
        away = seen.share[:, None] * (readout_s * velocity + shear)
        x = np.einsum("nij,nj->ni", twists.exp(away)[:, :3, :3], x) + away[:, :3]
        error, J_point = _projection(x, seen, camera)
        G = np.concatenate((np.broadcast_to(np.eye(3), (len(x), 3, 3)), -twists.skew(x)), axis=2)
        J_pose = J_point @ G
        J_shear = seen.share[:, None, None] * J_pose
        J = np.concatenate((J_pose, (J_shear @ velocity)[:, :, None], J_shear), axis=2)  # pose, ρ, b
        chi = np.sqrt(np.einsum("nk,nk->n", seen.weights, error**2))
        good = (x[:, 2] > MIN_DEPTH_M) * np.minimum(1.0, HUBER / np.maximum(chi, 1e-9))
        weighted = good[:, None, None] * seen.weights[:, :, None] * J
        H, b = np.einsum("nka,nkb->ab", weighted, J), np.einsum("nka,nk->a", weighted, error)
        free = np.r_[0:6, 7:13]
        with_prior = H[np.ix_(free, free)] + np.block(
            [[np.zeros((6, 6)), np.zeros((6, 6))], [np.zeros((6, 6)), _PRIOR_OF_SHEAR]]
        )
        step = -np.linalg.solve(with_prior, b[free] + np.concatenate((np.zeros(6), _PRIOR_OF_SHEAR @ shear)))
        T, shear = twists.exp(step[None, :6])[0] @ T, shear + step[6:]
    pose_first = np.linalg.solve(H[:6, :6], np.column_stack((H[:6, 6:], b[:6])))
    information = H[6:, 6:] - H[6:, :6] @ pose_first[:, :7]
    slope = -(b[6:] - H[6:, :6] @ pose_first[:, 7])
    known = np.concatenate(([readout_s], shear - step[6:]))  # where the last equations were made
    speed_px_s = float(np.median(np.linalg.norm((J_pose @ velocity)[:, :2], axis=1)))
    return FrameEvidence(information, slope + information @ known, speed_px_s)


@njit(nogil=True, cache=True)
def add_equations(H: F64, b: F64, moved_with: F64, velocity: F64, information: F64, slope: F64) -> None:
    """Add what a frame says whose pose and twist of rows were solved together, at the pose that was found.

    Args:
        H, b: Normal equations (12, 12), lower triangle, and (12,), of the pose and of the twist by which the last row
            is seen after the first, at no twist; those of `rolling_pose.linearize_rows` with shares in place of times.
        moved_with: The twist (6,) by which its keypoints had been moved to mid-frame.
        velocity: Of the camera (6,) [m/s, rad/s].
        information, slope: Those of a `FrameEvidence` (7, 7), (7,), added to.
    """
    rows, reduced = whole_of(H), b.copy()
    eliminate(rows, reduced, 0, 6)  # the pose
    for i in range(6):
        by_velocity, own = 0.0, -reduced[6 + i]
        for j in range(6):
            by_velocity += rows[6 + i, 6 + j] * velocity[j]
            own += rows[6 + i, 6 + j] * moved_with[j]
            information[1 + i, 1 + j] += rows[6 + i, 6 + j]
        information[0, 0] += velocity[i] * by_velocity
        information[0, 1 + i] += by_velocity
        information[1 + i, 0] += by_velocity
        slope[0] += velocity[i] * own
        slope[1 + i] += own


@njit(nogil=True, cache=True)
def whole_of(H: F64) -> F64:
    """Return a symmetric matrix (N, N) of which the lower triangle is given."""
    whole = np.empty_like(H)
    for i in range(len(H)):
        for j in range(i + 1):
            whole[i, j] = whole[j, i] = H[i, j]
    return whole


@njit(nogil=True, cache=True)
def eliminate(H: F64, b: F64, first: int, end: int) -> None:
    """Eliminate the unknowns from `first` to `end` from normal equations (N, N), (N,), in place, by Gauss.

    What is left of the others is their Schur complement. Unknowns of which nothing is known are left out.
    """
    for p in range(first, end):
        if not H[p, p] > 0.0:
            continue
        for i in range(len(H)):
            if first <= i <= p:
                continue
            factor = H[i, p] / H[p, p]
            for j in range(len(H)):
                H[i, j] -= factor * H[p, j]
            b[i] -= factor * b[p]


def agreed(frames: list[FrameEvidence], seed: int = 0, block_frames: int = BLOCK_FRAMES) -> Readout:
    """Return what frames, in order of time, agree on; there are enough for two blocks.

    Args:
        frames: What each says.
        seed: Of the bootstrap.
        block_frames: Frames that see one and the same shear.
    """
    n_blocks = len(frames) // block_frames
    own, information = np.array([of_block(block) for block in _split(frames, n_blocks)]).T
    rng = np.random.default_rng(seed)
    drawn = [_mean(own[chosen], information[chosen]) for chosen in rng.integers(0, n_blocks, (DRAWS, n_blocks))]
    sigma_s = max(float(np.std(drawn)), float(information.sum() ** -0.5))
    speed_px_s = float(np.sqrt(np.mean([frame.speed_px_s**2 for frame in frames])))
    return Readout(_mean(own, information), sigma_s, speed_px_s, len(frames))


def _split(frames: list[FrameEvidence], n_blocks: int) -> list[list[FrameEvidence]]:
    return [[frames[i] for i in block] for block in np.array_split(np.arange(len(frames)), n_blocks)]


def of_block(frames: list[FrameEvidence]) -> tuple[float, float]:
    """Return ρ [s] of frames that see one shear, and the inverse variance of it [1/s²]."""
    information = np.sum([frame.information for frame in frames], axis=0)
    readout_s, certainty = of_one_shear(information, np.sum([frame.slope for frame in frames], axis=0))
    return float(readout_s), float(certainty)


@njit(nogil=True, cache=True)
def of_one_shear(information: F64, slope: F64) -> tuple[float, float]:
    """Return ρ [s] and its inverse variance [1/s²] from sums of `FrameEvidence`; the shear is eliminated."""
    H, b = information.copy(), slope.copy()
    for i in range(6):
        H[1 + i, 1 + i] += OF_SHEAR[i]
    eliminate(H, b, 1, 7)
    known: float = max(H[0, 0], 1e-9)  # a camera that never moved tells nothing
    readout_s: float = b[0] / known
    return readout_s, known


def _mean(own: F64, information: F64) -> float:
    """Return the mean of estimates (N,) by their information (N,), in which single ones that are far off count less."""
    mean = float(np.median(own))
    for _ in range(10):
        off = np.abs(own - mean) * np.sqrt(information)
        scale = 1.4826 * float(np.median(off))
        weight = information * np.minimum(1.0, HUBER * scale / np.maximum(off, 1e-12)) if scale > 0.0 else information
        mean = float(weight @ own / weight.sum())
    return mean


def _projection(x: F64, seen: RowsSeen, camera: Camera) -> tuple[F64, F64]:
    """Return predicted minus observed (N, 3) [px] of points (N, 3) [m], and its derivative (N, 3, 3) by them."""
    z = np.maximum(x[:, 2], MIN_DEPTH_M)
    u, v = camera.fx * x[:, 0] / z + camera.cx, camera.fy * x[:, 1] / z + camera.cy
    error = np.stack((u, v, u - camera.bf / z), axis=1) - seen.observed_px
    J = np.zeros((len(x), 3, 3))
    J[:, 0, 0], J[:, 0, 2] = camera.fx / z, -(u - camera.cx) / z
    J[:, 1, 1], J[:, 1, 2] = camera.fy / z, -(v - camera.cy) / z
    J[:, 2, 0], J[:, 2, 2] = J[:, 0, 0], J[:, 0, 2] + camera.bf / z**2
    return error, J
