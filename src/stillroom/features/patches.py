"""Orientation and ORB descriptor of corners, from the patch around each, on one level of a pyramid.

Rublee et al., ICCV 2011. Corners are 19 pixels or more from the edges, so that patches lie within the level.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, I32, U8, U16

PATCH_RADIUS_PX = 15
N_TURNS = 256
"""The pattern is turned in steps of 1.4°, a tenth of what the descriptor notices; a table is faster than sines."""
REACH_PX = 13
"""No comparison reaches further than this from the keypoint, along x or y."""
TURNED_REACH_PX = 18
"""The same once it is turned: 13·√2 px."""
ROW = 64
"""Bytes of a row of a patch that is copied for its comparisons: two vectors, more than the turned pattern is wide."""
_BYTE, _SHORT, _INT, _LONG = (ir.IntType(bits) for bits in (8, 16, 32, 64))
_LANES = 32
"""Pixels of a row of the disc, one more than it is wide."""


def patch_half_widths() -> I32:
    """Return the half width of each row of the disc over which the orientation is taken, (16,) int32.

    The disc is OpenCV's: symmetric about the diagonal, so that its steep part mirrors the flat one. Rounding each row
    by itself, as one would, turns the angle by 2° in the median, and the descriptor differs from OpenCV's.
    """
    rows = np.arange(PATCH_RADIUS_PX + 1)
    widths = np.rint(np.sqrt(PATCH_RADIUS_PX**2 - rows**2)).astype(np.int32)
    mirrored = np.array([np.flatnonzero(widths >= row).max() for row in rows], dtype=np.int32)
    return np.where(rows * np.sqrt(2.0) > PATCH_RADIUS_PX, mirrored, widths).astype(np.int32)


def _load(builder: Any, data: Any, at: Any, kind: Any) -> Any:
    """Return the vector of bytes that begins at a place of an array."""
    return builder.load(builder.bitcast(builder.gep(data, [at]), kind.as_pointer()), align=1)


def _total(builder: Any, vector: Any) -> Any:
    """Return the sum of a vector of `_LANES` numbers."""
    lanes = _LANES
    while lanes > 1:
        lanes //= 2
        halves = [ir.Constant(ir.VectorType(_INT, lanes), [first + k for k in range(lanes)]) for first in (0, lanes)]
        vector = builder.add(*(builder.shuffle_vector(vector, vector, half) for half in halves))
    return builder.extract_element(vector, ir.Constant(_INT, 0))


@intrinsic
def _moments(typing_context: Any, flat: Any, at: Any, width: Any) -> Any:
    """Return the moments along x and y, two int32, of the disc whose middle row begins at `flat[at]` (kernels only).

    A row of pixels is one vector, and all sums are whole numbers of 16 bits: a column of the disc sums to 31 · 255 at
    most, and weighted by the rows to ±120 · 255.
    """
    half_widths = patch_half_widths()

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        shorts, ints = ir.VectorType(_SHORT, _LANES), ir.VectorType(_INT, _LANES)
        away = range(-PATCH_RADIUS_PX, _LANES - PATCH_RADIUS_PX)

        def row(number: int) -> Any:
            place = builder.add(args[1], builder.mul(args[2], ir.Constant(_LONG, number)))
            pixels = ir.VectorType(_BYTE, _LANES)
            inside = [255 if abs(x) <= half_widths[abs(number)] else 0 for x in away]
            return builder.zext(builder.and_(_load(builder, data, place, pixels), ir.Constant(pixels, inside)), shorts)

        columns, weighted = row(0), ir.Constant(shorts, [0] * _LANES)
        for number in range(1, PATCH_RADIUS_PX + 1):
            above, below = row(-number), row(number)
            columns = builder.add(columns, builder.add(above, below))
            difference = builder.mul(builder.sub(below, above), ir.Constant(shorts, [number] * _LANES))
            weighted = builder.add(weighted, difference)
        along_x = builder.mul(builder.zext(columns, ints), ir.Constant(ints, list(away)))
        sums = [_total(builder, along_x), _total(builder, builder.sext(weighted, ints))]
        return context.make_tuple(builder, signature.return_type, sums)

    return types.UniTuple(types.int32, 2)(flat, types.int64, types.int64), codegen


@njit(nogil=True, cache=True)
def orientations(image: U8, px: F32, angle_rad: F32) -> None:
    """Fill the angle (N,) from keypoint to the centroid of brightness in its disc (Rublee et al. 2011, 3.2)."""
    flat, width = image.reshape(-1), image.shape[1]
    for i in range(len(px)):
        m10, m01 = _moments(flat, int(px[i, 1]) * width + int(px[i, 0]) - PATCH_RADIUS_PX, width)
        angle_rad[i] = np.arctan2(np.float32(m01), np.float32(m10))


@njit(nogil=True, cache=True)
def blur(image: U8, once: U8, twice: U8) -> None:
    """Write an image (H, W) blurred by a 5×5 box, and that blurred again: the variance of OpenCV's Gaussian, σ = 2 px.

    The image goes on mirrored beyond its edges, without the pixel at the edge, as with `cv2.blur`.
    """
    _blur_by_box(image, once)
    _blur_by_box(once, twice)


@njit(nogil=True, cache=True)
def _blur_by_box(image: U8, blurred: U8) -> None:
    height, width = image.shape
    # Sums over five rows, with two columns more at either end. All in 16 bits: whole vectors hold twice as many.
    sums = np.empty(width + 4, np.uint16)
    inner = sums[2:-2]
    u1, u2, u3, u4, n = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4), np.uint64(width)
    first, second, third = image[0], image[1], image[2]
    for x in range(n):
        inner[x] = np.uint16(first[x]) + np.uint16(np.uint16(2) * np.uint16(np.uint16(second[x]) + np.uint16(third[x])))
    for y in range(height):
        if y > 0:
            entering, leaving = image[min(y + 2, 2 * (height - 1) - (y + 2))], image[abs(y - 3)]
            for x in range(n):
                inner[x] = np.uint16(np.uint16(inner[x] + np.uint16(entering[x])) - np.uint16(leaving[x]))
        sums[0], sums[1], sums[width + 2], sums[width + 3] = sums[4], sums[3], sums[width], sums[width - 1]
        row = blurred[y]
        for x in range(n):
            left = np.uint16(sums[x] + sums[x + u1])
            total = np.uint16(np.uint16(left + np.uint16(sums[x + u2] + sums[x + u3])) + sums[x + u4])
            # A 25th, rounded: 10/256 of it is too little, and what is left over is small.
            total = np.uint16(total + np.uint16(12))
            quotient = np.uint16(np.uint16(total * np.uint16(10)) >> np.uint16(8))
            left = np.uint16(total - np.uint16(quotient * np.uint16(25)))
            row[x] = np.uint8(np.uint16(quotient + np.uint16(np.uint16(left * np.uint16(41)) >> np.uint16(10))))


def turned_places(pattern: I32) -> U16:
    """Return the pattern (256, 4) turned by each of `N_TURNS` angles, (N_TURNS, 512) uint16.

    Of comparison k the first place is at 2k, the second at 2k + 1: the row times `ROW` and the column, both counted
    from the first that can be reached.
    """
    angle_rad = 2.0 * np.pi * np.arange(N_TURNS) / N_TURNS
    c, s = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    x, y = pattern.reshape(-1, 2).T.astype(np.float64)
    row, column = TURNED_REACH_PX + np.rint(x * s + y * c), TURNED_REACH_PX + np.rint(x * c - y * s)
    return np.asarray(ROW * row + column, dtype=np.uint16)


@intrinsic
def _copy_row(typing_context: Any, source: Any, at: Any, target: Any, to: Any) -> Any:
    """Copy `ROW` bytes from one flat array of bytes to another (kernels only)."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        there, here = (context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 2))
        row = ir.VectorType(_BYTE, ROW)
        place = builder.bitcast(builder.gep(here, [args[3]]), row.as_pointer())
        builder.store(_load(builder, there, args[1], row), place, align=1)
        return context.get_dummy_value()

    return types.void(source, types.int64, target, types.int64), codegen


@njit(nogil=True, cache=True)
def describe(blurred: U8, px: F32, angle_rad: F32, places: U16, descriptors: U8) -> None:
    """Fill the descriptors (N, 32): 256 comparisons of the blurred level, turned by the keypoint's angle."""
    # The patch is copied so that one small table holds for all levels, whatever their width.
    flat, width = blurred.reshape(-1), blurred.shape[1]
    n_rows = 2 * TURNED_REACH_PX + 1
    patch = np.empty(n_rows * ROW, np.uint8)
    per_rad, u1 = N_TURNS / (2.0 * np.pi), np.uint64(1)
    for i in range(len(px)):
        first = int(px[i, 1] - TURNED_REACH_PX) * width + int(px[i, 0] - TURNED_REACH_PX)
        for row in range(n_rows):
            _copy_row(flat, first + row * width, patch, row * ROW)
        turned = places[int(np.floor(angle_rad[i] * per_rad + 0.5)) % N_TURNS]
        for byte in range(np.uint64(32)):
            value = np.uint64(0)
            for bit in range(np.uint64(8)):
                k = np.uint64(16) * byte + np.uint64(2) * bit
                value |= np.uint64(patch[turned[k]] < patch[turned[k + u1]]) << bit
            descriptors[i, byte] = value
