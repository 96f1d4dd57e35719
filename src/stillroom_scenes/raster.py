"""The kernels that find what is seen: patches as exact planes in a z-buffer.

On a plane seen through a pinhole, 1/z, and s/z and t/z of the patch's own coordinates, are linear functions of
the pixel. So a patch is six numbers for its shape, its outline in a row is one interval, and depth and texture are
exact at each pixel centre: nothing is clipped, subdivided or approximated.
"""

import math

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, Bool

NEAR_M = 0.05
PLANE_COLUMNS = 12  # 1/z, u/z, v/z, l/z: three coefficients (of x, of y, constant) each
NOTHING = -1
LONG_PX = 16  # from here on it pays to fill eight pixels at once


@njit(nogil=True, cache=True, error_model="numpy")
def _cross(a: F64, b: F64, out: F64) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(nogil=True, cache=True, error_model="numpy")
def planes_of(
    shape_m: F64,
    look: F64,
    kind: I32,
    T_cam_world: F64,
    intrinsics: F64,
    size: tuple[int, int],
    planes: F64,
    outline: F64,
    rows: I64,
) -> None:
    """Write each patch's linear functions of the pixel and the rows it may touch.

    Args:
        shape_m: Corner and edges (N, 9), world [m].
        look: Texture coordinates and light (N, 9).
        kind: Of the patches (N, 3).
        T_cam_world: World to camera (4, 4).
        intrinsics: fx, fy, cx, cy [px].
        size: Height and width of the image [px].
        planes: Out (N, 12): coefficients of x, y, 1 of 1/z, u/z, v/z and l/z.
        outline: Out (N, 6): the same of s/z and t/z.
        rows: Out (N, 3): first row and row after the last, equal for a patch that cannot be seen; 1 for a patch that
            may reach behind the camera, else 0.
    """
    p, e, f, n, r, q = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(shape_m.shape[0]):
        rows[i, 0], rows[i, 1], rows[i, 2] = 0, 0, 0
        for k in range(3):
            a, b, c = T_cam_world[k, 0], T_cam_world[k, 1], T_cam_world[k, 2]
            p[k] = a * shape_m[i, 0] + b * shape_m[i, 1] + c * shape_m[i, 2] + T_cam_world[k, 3]
            e[k] = a * shape_m[i, 3] + b * shape_m[i, 4] + c * shape_m[i, 5]
            f[k] = a * shape_m[i, 6] + b * shape_m[i, 7] + c * shape_m[i, 8]
        _cross(e, f, n)
        facing = n[0] * p[0] + n[1] * p[1] + n[2] * p[2]
        if facing > -1e-12:
            continue
        top, bottom, is_near = _row_range(p, e, f, kind[i, 0] == 1, intrinsics, size[0], size[1])
        if top >= bottom:
            continue
        _cross(f, n, r)
        _cross(n, e, q)
        er = e[0] * r[0] + e[1] * r[1] + e[2] * r[2]
        fq = f[0] * q[0] + f[1] * q[1] + f[2] * q[2]
        rp = (r[0] * p[0] + r[1] * p[1] + r[2] * p[2]) / er
        qp = (q[0] * p[0] + q[1] * p[1] + q[2] * p[2]) / fq
        for k in range(3):
            n[k] /= facing
            r[k] = r[k] / er - rp * n[k]
            q[k] = q[k] / fq - qp * n[k]
        # Now n·d = 1/z, r·d = s/z and q·d = t/z for the ray d of a pixel.
        _linear(1.0, 0.0, 0.0, n, r, q, intrinsics, planes, i, 0)
        for g in range(3):
            _linear(look[i, g], look[i, g + 3], look[i, g + 6], n, r, q, intrinsics, planes, i, 3 * g + 3)
        _linear(0.0, 1.0, 0.0, n, r, q, intrinsics, outline, i, 0)
        _linear(0.0, 0.0, 1.0, n, r, q, intrinsics, outline, i, 3)
        rows[i, 0], rows[i, 1], rows[i, 2] = top, bottom, is_near


@njit(nogil=True, cache=True, error_model="numpy")
def _linear(
    base: float, along_s: float, along_t: float, n: F64, r: F64, q: F64, intrinsics: F64, out: F64, i: int, at: int
) -> None:
    """Write (base + along_s s + along_t t) / z as coefficients of x, y, 1."""
    x = (base * n[0] + along_s * r[0] + along_t * q[0]) / intrinsics[0]
    y = (base * n[1] + along_s * r[1] + along_t * q[1]) / intrinsics[1]
    out[i, at], out[i, at + 1] = x, y
    out[i, at + 2] = base * n[2] + along_s * r[2] + along_t * q[2] - x * intrinsics[2] - y * intrinsics[3]


@njit(nogil=True, cache=True, error_model="numpy")
def _row_range(
    p: F64, e: F64, f: F64, is_triangle: bool, intrinsics: F64, height: int, width: int
) -> tuple[int, int, int]:
    top, bottom, left, right = math.inf, -math.inf, math.inf, -math.inf
    for corner in range(3 if is_triangle else 4):
        s, t = corner & 1, corner >> 1
        z = p[2] + s * e[2] + t * f[2]
        if z < NEAR_M:
            return 0, height, 1  # it reaches behind the camera: its rows' intervals tell
        x = intrinsics[0] * (p[0] + s * e[0] + t * f[0]) / z + intrinsics[2]
        y = intrinsics[1] * (p[1] + s * e[1] + t * f[1]) / z + intrinsics[3]
        top, bottom, left, right = min(top, y), max(bottom, y), min(left, x), max(right, x)
    if right < -0.5 or left > width - 0.5:
        return 0, 0, 0
    return max(0, math.ceil(top - 1e-6)), min(height, math.floor(bottom + 1e-6) + 1), 0


@njit(nogil=True, cache=True, error_model="numpy")
def _sides_of(
    planes: F64, outlines: F64, i: int, is_triangle: bool, is_near: bool, sides: F64
) -> tuple[int, int, float, float]:
    """Find the lines that bound a patch in the image, x = slope · y + offset.

    Args:
        planes: Of `planes_of` (N, 12).
        outlines: Of `planes_of` (N, 6).
        i: Number of the patch.
        is_triangle: Whether it is one.
        is_near: Whether it may reach behind the camera.
        sides: Out (2, 5, 2): slope and offset of the lines on its left, then of those on its right.

    Returns:
        Number of lines on the left, on the right; first and last row that level lines leave.
    """
    plane, outline = planes[i], outlines[i]
    left, right, top, bottom = 0, 0, -math.inf, math.inf
    for side in range(0 if is_near else 1, 4 if is_triangle else 5):
        if side == 0:  # in front of the camera: 1/z > 0
            a, by, b = plane[0], plane[1], plane[2] - 1e-9
        elif side == 1:  # s ≥ 0
            a, by, b = outline[0], outline[1], outline[2]
        elif side == 2:  # t ≥ 0
            a, by, b = outline[3], outline[4], outline[5]
        else:  # s ≤ 1, t ≤ 1; s + t ≤ 1 for a triangle
            k = 0 if side == 3 else 3
            a, by, b = plane[0] - outline[k], plane[1] - outline[k + 1], plane[2] - outline[k + 2]
            if is_triangle:
                a, by, b = a - outline[3], by - outline[4], b - outline[5]
        if abs(a) > 1e-14:
            which, at = (0, left) if a > 0.0 else (1, right)
            sides[which, at, 0], sides[which, at, 1] = -by / a, -b / a - math.copysign(1e-7, a)
            left, right = left + (1 - which), right + which
        elif by > 0.0:
            top = max(top, -b / by)
        elif by < 0.0:
            bottom = min(bottom, -b / by)
        elif b < 0.0:
            bottom = -math.inf
    return left, right, top, bottom


@njit(nogil=True, cache=True, error_model="numpy")
def visible_patch(planes: F64, outline: F64, rows: I64, kind: I32, nearest: F32, patch: I32) -> None:
    """Keep at each pixel the nearest patch.

    Args:
        planes: Of `planes_of` (N, 12).
        outline: Of `planes_of` (N, 6).
        rows: Of `planes_of` (N, 3).
        kind: Of the patches (N, 3).
        nearest: In and out: 1/z of what is nearest (H, W) float32 [1/m]; 0 where nothing is.
        patch: In and out: its number (H, W) int32.
    """
    sides = np.empty((2, 5, 2))
    for i in range(len(planes)):
        if rows[i, 0] >= rows[i, 1]:
            continue
        lefts, rights, top, bottom = _sides_of(planes, outline, i, kind[i, 0] == 1, rows[i, 2] == 1, sides)
        for y in range(rows[i, 0], rows[i, 1]):
            left, right = 0.0, nearest.shape[1] - 1.0
            for k in range(lefts):
                at = sides[0, k, 0] * y + sides[0, k, 1]
                left = at if at > left else left
            for k in range(rights):
                at = sides[1, k, 0] * y + sides[1, k, 1]
                right = at if at < right else right
            if left <= right and top <= y <= bottom:
                first, last = int(left), int(right)
                first += first < left
                start, step = planes[i, 0] * first + planes[i, 1] * y + planes[i, 2], planes[i, 0]
                if last - first >= LONG_PX:
                    _fill(nearest, patch, y, first, last + 1 - first, start, step, np.int32(i))
                else:
                    for k in range(last + 1 - first):
                        inverse = np.float32(start + step * k)
                        if inverse > nearest[y, first + k]:
                            nearest[y, first + k], patch[y, first + k] = inverse, i


@njit(nogil=True, cache=True, error_model="numpy")
def _fill(nearest: F32, patch: I32, y: int, first: int, count: int, start: float, step: float, i: np.int32) -> None:
    """Write a patch where it is nearer; unsigned indices and no branch let eight pixels go at once."""
    row, begin = np.uint64(y), np.uint64(first)
    for k in range(np.int32(max(0, count))):
        inverse = np.float32(start + step * k)
        x = begin + np.uint64(k)
        before, owner = nearest[row, x], patch[row, x]
        nearest[row, x] = inverse if inverse > before else before
        patch[row, x] = i if inverse > before else owner


@njit(nogil=True, cache=True, error_model="numpy")
def extents_of(instance: U8, is_mover: Bool, extents: I64, moving: Bool) -> None:
    """Find where each instance lies, and which pixels move.

    Args:
        instance: What each pixel shows (H, W).
        is_mover: Which instances move (256,).
        extents: Out (256, 5): number of pixels; first column, first row, last column, last row.
        moving: Out (H, W).
    """
    height, width = instance.shape
    for i in range(len(extents)):
        extents[i, 0], extents[i, 1], extents[i, 2], extents[i, 3], extents[i, 4] = 0, width, height, -1, -1
    for y in range(height):
        start = 0
        for x in range(1, width + 1):
            if x == width or instance[y, np.uint64(x)] != instance[y, start]:
                i = instance[y, start]
                moving[y, start:x] = is_mover[i]
                extents[i, 0] += x - start
                extents[i, 1], extents[i, 3] = min(extents[i, 1], start), max(extents[i, 3], x - 1)
                extents[i, 2], extents[i, 4] = min(extents[i, 2], y), max(extents[i, 4], y)
                start = x
