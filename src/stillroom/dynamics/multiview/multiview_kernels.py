"""The two loops: is a point occluded by something new, and region growing from there."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillroom.compiled import njit
from stillroom.dynamics.multiview.views import STRIDE
from stillroom.geometry.arrays import F32, F64, I32, I64, U8
from stillroom.geometry.camera import Lens
from stillroom.geometry.distortion import distorted

I8 = NDArray[np.int8]
CELL = 2
OUTSIDE = 2
NOT_ASKED = 2


UNSEEN, STATIC, STEEP, BORDER, UNCONFIRMED, DYNAMIC = range(6)
"""Results for a point: out of view, or no depth there; not occluded; too large a parallax; depth variance of the
occluder too large; its keyframe did not see through there; dynamic.
"""

AGREES, EMPTY, UNKNOWN = 1, -1, 0


class Limits(NamedTuple):
    """The numbers of the tests of a point; numba reads a named tuple as it is.

    Attributes:
        min_parallax_cosine: Of the angle at the point between the two cameras.
        tau_m, tau_per_m: A point is occluded by something nearer by more than the first plus the second (1/m)
            times the squared depth.
        far_m: Points farther away than this are not tested.
        patch_px: Half the side of the patch of the variance test.
        std_m, std_per_m: Largest deviation of depth in it, likewise.
        confirm: Whether the keyframe must have seen through the place where it stands now.
        tolerance_m, tolerance_share: Depths agree within the larger of the first and this share of the depth.
    """

    min_parallax_cosine: float
    tau_m: float
    tau_per_m: float
    far_m: float
    patch_px: int
    std_m: float
    std_per_m: float
    confirm: bool
    tolerance_m: float
    tolerance_share: float


class Growth(NamedTuple):
    """The numbers of region growing.

    Attributes:
        mean_m, mean_per_m: Largest difference from the mean of the region so far: the first plus the second (1/m)
            times the squared depth.
        step_m, step_per_m: Largest difference from the neighbour, likewise.
        min_pixels: Regions smaller than this are dropped.
        min_seen_through: Regions are dropped of whose pixels a smaller share is seen through by more keyframes than
            agree; 0 where keyframes are not compared.
    """

    mean_m: float
    mean_per_m: float
    step_m: float
    step_per_m: float
    min_pixels: int
    min_seen_through: float


class Here(NamedTuple):
    """The present depth image.

    Attributes:
        depth_m: Depths (h, w) float32, at any stride; 0 where unknown.
        rays: Rays of its pixels at unit depth (h, w, 2) float32.
        T_world_cam: Its pose (4, 4).
        lens: Of whole images.
    """

    depth_m: F32
    rays: F32
    T_world_cam: F64
    lens: Lens


class KeyframeDepths(NamedTuple):
    """The keyframes.

    Attributes:
        depth_m: Every `stride`-th depth, and the nearest and farthest that it and its eight neighbours know
            (K, h, w, 3) float32; 0 where unknown or moving.
        T_cam_world: Their poses (K, 4, 4).
        T_here_cam: The same in the present camera's frame (K, 4, 4).
        centres_m: Where the keyframe's camera and the present one stand, in the keyframe's frame, (K, 2, 3); for the
            parallax.
        stride: Of the depths [px].
    """

    depth_m: F32
    T_cam_world: F64
    T_here_cam: F64
    centres_m: F64
    stride: int = STRIDE


class Points(NamedTuple):
    """Static points that the keyframes saw.

    Attributes:
        cam_m: Points (N, 3) [m, frame of the keyframe's camera].
        seen_in: The keyframe of each, (N,) int64.
        px: Their projections into the present image, column first, (N, 2) int32; −1 where outside.
        z_m: How deep (N,).
    """

    cam_m: F64
    seen_in: I64
    px: I32
    z_m: F64


class PointVerdicts(NamedTuple):
    """Results of the point test.

    Attributes:
        verdict: Written for the chosen points (N,) uint8.
        before_px: The pixel of a point's occluder (N, 2) int32, written where there is one.
    """

    verdict: U8
    before_px: I32


@njit(nogil=True, cache=True, error_model="numpy")
def project(points: Points, there: KeyframeDepths, lens: Lens, height: int, width: int) -> None:
    """Write `px` and `z_m` of the points for an image of a size."""
    T = there.T_here_cam
    for i in range(len(points.cam_m)):
        X, Y, Z = points.cam_m[i, 0], points.cam_m[i, 1], points.cam_m[i, 2]
        k = points.seen_in[i]
        z = T[k, 2, 0] * X + T[k, 2, 1] * Y + T[k, 2, 2] * Z + T[k, 2, 3]
        points.px[i, 0], points.px[i, 1], points.z_m[i] = -1, -1, z
        if z <= 0.1:
            continue
        x = (T[k, 0, 0] * X + T[k, 0, 1] * Y + T[k, 0, 2] * Z + T[k, 0, 3]) / z
        y = (T[k, 1, 0] * X + T[k, 1, 1] * Y + T[k, 1, 2] * Z + T[k, 1, 3]) / z
        u, v = distorted(lens, x, y)
        if u >= -0.5 and v >= -0.5 and u < width - 0.5 and v < height - 0.5:
            points.px[i, 0], points.px[i, 1] = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))


@njit(nogil=True, cache=True, error_model="numpy")
def judge_points(
    chosen: I64, points: Points, here: Here, there: KeyframeDepths, window: I32, limits: Limits, judged: PointVerdicts
) -> None:
    """Test chosen points of keyframes against the present depth image (DynaSLAM III.C).

    Args:
        chosen: Which points to test (M,).
        points: All points.
        here: The present depth image, whole.
        there: The keyframes.
        window: Offsets (W, 2) int32, nearest first, at which something nearer is searched.
        limits: The numbers.
        judged: Written.
    """
    verdict, before_px = judged
    for m in range(len(chosen)):
        i = chosen[m]
        z = points.z_m[i]
        verdict[i] = UNSEEN
        if points.px[i, 0] < 0 or z > limits.far_m:
            continue
        if _is_steep(points, i, there, limits.min_parallax_cosine):
            verdict[i] = STEEP
            continue
        column, row, nearer = _first_nearer(here.depth_m, points.px[i, 0], points.px[i, 1], z, window)
        if nearer == 0.0:
            continue
        verdict[i] = STATIC
        if nearer < 0.0 or z - nearer <= limits.tau_m + limits.tau_per_m * z * z:
            continue
        before_px[i, 0], before_px[i, 1] = column, row
        largest = limits.std_m + limits.std_per_m * nearer * nearer
        if _variance(here.depth_m, row, column, limits.patch_px) > largest * largest:
            verdict[i] = BORDER
        elif limits.confirm and sees(there, points.seen_in[i], here.lens, _place(here, row, column), limits) != EMPTY:
            verdict[i] = UNCONFIRMED
        else:
            verdict[i] = DYNAMIC


@njit(nogil=True, cache=True, error_model="numpy")
def _is_steep(points: Points, i: int, there: KeyframeDepths, min_cosine: float) -> bool:
    """Return whether the angle at a point between its keyframe's camera and the present one is too large."""
    X, Y, Z, c, k = points.cam_m[i, 0], points.cam_m[i, 1], points.cam_m[i, 2], there.centres_m, points.seen_in[i]
    ax, ay, az = c[k, 0, 0] - X, c[k, 0, 1] - Y, c[k, 0, 2] - Z
    bx, by, bz = c[k, 1, 0] - X, c[k, 1, 1] - Y, c[k, 1, 2] - Z
    norm = np.sqrt((ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz))
    return bool(ax * bx + ay * by + az * bz < min_cosine * norm)


@njit(nogil=True, cache=True, error_model="numpy")
def _first_nearer(depth_m: F32, column: int, row: int, z: float, window: I32) -> tuple[int, int, float]:
    """Return the pixel and depth of the nearest nearer one in a window; depth −1 if there is none, 0 if unknown."""
    known = False
    for k in range(len(window)):
        u, v = column + window[k, 0], row + window[k, 1]
        if u >= 0 and v >= 0 and u < depth_m.shape[1] and v < depth_m.shape[0]:
            seen = float(depth_m[v, u])
            known |= seen > 0.0
            if 0.0 < seen < z:
                return u, v, seen
    return column, row, -1.0 if known else 0.0


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _variance(depth_m: F32, row: int, column: int, reach: int) -> float:
    """Return the variance of the known depths of a square patch."""
    n = total = squares = 0.0
    origin = float(depth_m[row, column])
    left, right = max(0, column - reach), min(depth_m.shape[1], column + reach + 1)
    for v in range(max(0, row - reach), min(depth_m.shape[0], row + reach + 1)):
        line = depth_m[v, left:right]
        for u in range(len(line)):
            is_known = 1.0 if line[u] > 0.0 else 0.0
            difference = is_known * (line[u] - origin)
            n += is_known
            total += difference
            squares += difference * difference
    mean = total / n
    return squares / n - mean * mean


@njit(nogil=True, cache=True, error_model="numpy")
def _place(here: Here, row: int, column: int) -> tuple[float, float, float]:
    """Return where in the world a present pixel's surface is."""
    z, T = float(here.depth_m[row, column]), here.T_world_cam
    x, y = here.rays[row, column, 0] * z, here.rays[row, column, 1] * z
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def sees(there: KeyframeDepths, k: int, lens: Lens, place_m: tuple[float, float, float], limits: Limits) -> int:
    """Compare a place [world] with keyframe `k`: AGREES, EMPTY or UNKNOWN.

    The pixel and the nearest and farthest of its neighbours are compared: one that agrees is enough; EMPTY if all lie
    behind.
    """
    X, Y, Z = place_m
    T, depth_m, stride = there.T_cam_world, there.depth_m, there.stride
    z = T[k, 2, 0] * X + T[k, 2, 1] * Y + T[k, 2, 2] * Z + T[k, 2, 3]
    if z <= 0.1:
        return UNKNOWN
    x = (T[k, 0, 0] * X + T[k, 0, 1] * Y + T[k, 0, 2] * Z + T[k, 0, 3]) / z
    y = (T[k, 1, 0] * X + T[k, 1, 1] * Y + T[k, 1, 2] * Z + T[k, 1, 3]) / z
    u, v = distorted(lens, x, y)
    if not (u >= 0 and v >= 0 and u < stride * 10000 and v < stride * 10000):
        return UNKNOWN
    column, row = int(u / stride + 0.5), int(v / stride + 0.5)
    if row >= depth_m.shape[1] or column >= depth_m.shape[2]:
        return UNKNOWN
    tolerance = max(limits.tolerance_m, limits.tolerance_share * z)
    farthest = float(depth_m[k, row, column, 2])
    if farthest <= 0.0:
        return UNKNOWN
    seen, nearest = float(depth_m[k, row, column, 0]), float(depth_m[k, row, column, 1])
    if abs(seen - z) <= tolerance or abs(nearest - z) <= tolerance or abs(farthest - z) <= tolerance:
        return AGREES
    return EMPTY if nearest > z else UNKNOWN


@njit(nogil=True, cache=True, error_model="numpy")
def grow(seeds: I32, here: Here, there: KeyframeDepths, growth: Growth, limits: Limits, region: U8) -> None:
    """Grow regions on depth from seeds, breadth first, each by the running mean of what it has (DynaSLAM III.C).

    A pixel whose place more keyframes saw occupied than free is never added; without keyframes, all may be. They are
    compared once for each square of `CELL` pixels a side, about the pixel that comes first.

    Args:
        seeds: Pixels (M, 2), column first.
        here: The present depth image, at any stride.
        there: The keyframes to compare with.
        growth, limits: The numbers.
        region: Where the result is written (h, w): 1 in a region, else 0.
    """
    height, width = here.depth_m.shape
    # The image gets a border that is in no region, so that no pixel need be asked whether it is there.
    across, size = width + 2, (height + 2) * (width + 2)
    depth_m, taken = np.zeros(size, dtype=np.float32), np.full(size, OUTSIDE, dtype=np.uint8)
    said, queue = np.full(size, NOT_ASKED, dtype=np.int8), np.empty(height * width, dtype=np.int32)
    for row in range(height):
        start = (row + 1) * across + 1
        depth_m[start : start + width] = here.depth_m[row]
        taken[start : start + width] = 0
    for s in range(len(seeds)):
        first = (seeds[s, 1] + 1) * across + seeds[s, 0] + 1
        mean = float(depth_m[first])
        if mean <= 0.0 or taken[first] != 0:
            continue
        if said[first] == NOT_ASKED:
            _ask(here, there, first, limits, said)
        if said[first] == AGREES:
            continue
        queue[0], head, tail, through = first, 0, 1, int(said[first] == EMPTY)
        taken[first] = 1
        while head < tail:
            at = queue[head]
            head += 1
            for step in (-across, across, -1, 1):
                beside = at + step
                if taken[beside] != 0:
                    continue
                z = float(depth_m[beside])
                if z <= 0.0 or abs(z - mean) >= growth.mean_m + growth.mean_per_m * z * z:
                    continue
                if abs(z - depth_m[at]) > growth.step_m + growth.step_per_m * z * z:
                    continue
                if said[beside] == NOT_ASKED:
                    _ask(here, there, beside, limits, said)
                if said[beside] == AGREES:
                    continue
                through += said[beside] == EMPTY
                taken[beside] = 1
                queue[tail] = beside
                tail += 1
                mean += (z - mean) / tail
        if tail < growth.min_pixels or through < growth.min_seen_through * tail:
            taken[queue[:tail]] = OUTSIDE
    for row in range(height):
        start = (row + 1) * across + 1
        region[row] = taken[start : start + width] & 1


@njit(nogil=True, cache=True, error_model="numpy")
def _ask(here: Here, there: KeyframeDepths, at: int, limits: Limits, said: I8) -> None:
    """Write the majority of the keyframes on a present pixel's place for its cell: AGREES, EMPTY or UNKNOWN.

    `at` is the pixel's number in the image with a border (h + 2, w + 2), which `said` has.
    """
    across = here.depth_m.shape[1] + 2
    row, column = at // across - 1, at % across - 1
    votes, left, place_m = 0, len(there.depth_m), _place(here, row, column)
    while left > 0 and abs(votes) <= left:
        left -= 1
        votes += sees(there, left, here.lens, place_m, limits)
    corner = at - row % CELL * across - column % CELL
    for v in range(CELL):
        for u in range(CELL):
            said[corner + v * across + u] = AGREES if votes > 0 else EMPTY if votes < 0 else UNKNOWN
