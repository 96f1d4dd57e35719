"""Patch tracking between two images: Lucas–Kanade, a point at a time."""

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, F64, U8

HALF_PX = 4
"""Half the side of a patch, on whatever level of the pyramid it is taken."""
SIDE_PX = 2 * HALF_PX + 1
N_PIXELS = SIDE_PX**2
_ACROSS = SIDE_PX + 3
"""Columns that are read at once. Whatever is of a patch has rows of as many values, of which the last do not count, so
that loops over it have no inner loop of a few pixels.
"""
_SPAN = _ACROSS * (SIDE_PX - 1) + SIDE_PX
_COUNTS = (np.arange(_SPAN) % _ACROSS < SIDE_PX).astype(np.float32)
"""1 for the pixels of a patch, 0 between its rows."""
_HALF = np.float32(0.5)
ROOM = 6, _ACROSS * _ACROSS
"""Shape of the float32 scratch of a search: the patch less its mean, its differences by x and by y; a part of an image,
and the same between its columns, and its rows.
"""
MARGIN_PX = HALF_PX + 2
MIN_CONTRAST = 4.0
"""Root mean square gradient [gray levels a pixel] that a patch must have in its poorest direction, on average."""
NOT_SEEN, NO_CORNER = -1.5, -2.0
"""The correlation of a patch that leaves the other image, and of one without a corner or outside its own image."""
_ENOUGH_PX = 0.02


@njit(nogil=True, cache=True)
def in_view(image: U8, x: float, y: float) -> bool:
    """Return whether a patch around (x, y) lies in an image (h, w)."""
    height, width = image.shape
    inside: bool = MARGIN_PX <= x < width - MARGIN_PX - 1 and MARGIN_PX <= y < height - MARGIN_PX - 1
    return inside


@njit(nogil=True, cache=True)
def read_part(image: U8, top: int, left: int, n_rows: int, part: F32) -> None:
    """Write a part of an image, `_ACROSS` columns wide."""
    for r in range(n_rows):
        line = image[top + r, left : left + _ACROSS]
        for c in range(_ACROSS):
            part[_ACROSS * r + c] = line[c]


@njit(nogil=True, cache=True, fastmath={"reassoc", "contract"})
def take_patch(image: U8, x: float, y: float, scratch: F32) -> float:
    """Write the patch around (x, y), which must be in view, and its differences to `scratch`; return its mean."""
    column, row = int(np.floor(x)), int(np.floor(y))
    fx, fy = np.float32(x - column), np.float32(y - row)
    patch, by_x, by_y, part, along, wide = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5]
    read_part(image, row - HALF_PX - 1, column - HALF_PX - 1, _ACROSS, part)
    for n in range(_ACROSS * _ACROSS - 1):
        along[n] = part[n] + fx * (part[n + 1] - part[n])
    for n in range(_ACROSS * (_ACROSS - 1) - 1):
        wide[n] = along[n] + fy * (along[n + _ACROSS] - along[n])
    total, corner = np.float32(0.0), _ACROSS + 1
    for n in range(_SPAN):
        total += _COUNTS[n] * wide[corner + n]
    mean = total / np.float32(N_PIXELS)
    for n in range(_SPAN):
        patch[n] = _COUNTS[n] * (wide[corner + n] - mean)
        by_x[n] = _COUNTS[n] * _HALF * (wide[corner + n + 1] - wide[corner + n - 1])
        by_y[n] = _COUNTS[n] * _HALF * (wide[corner + n + _ACROSS] - wide[corner + n - _ACROSS])
    return float(mean)


@njit(nogil=True, cache=True, fastmath={"reassoc", "contract"})
def moments(scratch: F32) -> tuple[float, float, float, float, float, float, float, float]:
    """Return sums over a patch p and its differences g, h, as `take_patch` wrote them: p², gg, hh, gh, pg, ph, g, h."""
    pp = gg = hh = gh = pg = ph = sum_g = sum_h = 0.0
    for n in range(_SPAN):
        p, g, h = float(scratch[0, n]), float(scratch[1, n]), float(scratch[2, n])
        pp += p * p
        gg += g * g
        hh += h * h
        gh += g * h
        pg += p * g
        ph += p * h
        sum_g += g
        sum_h += h
    return pp, gg, hh, gh, pg, ph, sum_g, sum_h


@njit(nogil=True, cache=True, fastmath={"reassoc", "contract"})
def compare(fx: float, fy: float, mean: float, scratch: F32) -> tuple[float, float, float, float, float]:
    """Return sums over a patch t of the part that was read, and p, g, h of `moments`: t, t², tp, tg, th.

    Args:
        fx, fy: How far the patch lies to the right of the part's pixels, and below them, 0 to 1 [px].
        mean: What is taken off t: what is large in all its values would cost digits.
        scratch: Of the shape ROOM.
    """
    patch, by_x, by_y, part, along = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    right, below, off = np.float32(fx), np.float32(fy), np.float32(mean)
    for n in range(_SPAN + _ACROSS):
        along[n] = part[n] + right * (part[n + 1] - part[n])
    sum_t = tt = tp = tg = th = np.float32(0.0)
    for n in range(_SPAN):
        t = _COUNTS[n] * (along[n] + below * (along[n + _ACROSS] - along[n]) - off)
        sum_t += t
        tt += t * t
        tp += t * patch[n]
        tg += t * by_x[n]
        th += t * by_y[n]
    return float(sum_t), float(tt), float(tp), float(tg), float(th)


@njit(nogil=True, cache=True)
def find_patch(
    now: U8,
    at: tuple[float, float],
    then: U8,
    guess: tuple[float, float],
    iterations: int,
    scratch: F32,
    found: F64,
) -> float:
    """Find the patch around a point in another image, from an initial guess.

    Inverse compositional Lucas–Kanade (Baker and Matthews 2004) of a shift, with normalised brightness and contrast:
    the gradients are those of the patch, computed once.

    Args:
        now, at: Image (h, w), and x and y of the point in it [px].
        then, guess: The other image, and x and y of the guess [px].
        iterations: Most steps.
        scratch: Of the shape ROOM.
        found: Where the patch is (2,) [px]; filled in.

    Returns:
        Similarity of the patches: their normalised correlation; NO_CORNER where there is no patch to be found, and
        NOT_SEEN where it leaves the other image.
    """
    x, y = at
    found[0], found[1] = guess
    if not in_view(now, x, y):
        return NO_CORNER
    mean = take_patch(now, x, y, scratch)
    variance, xx, yy, xy, px, py, sum_x, sum_y = moments(scratch)
    least = 0.5 * (xx + yy - np.sqrt((xx - yy) * (xx - yy) + 4.0 * xy * xy))
    if not least > MIN_CONTRAST * MIN_CONTRAST * N_PIXELS:
        return NO_CORNER
    determinant = xx * yy - xy * xy
    likeness, column, row = NOT_SEEN, -1, -1
    for _ in range(iterations):
        if not in_view(then, found[0], found[1]):
            return NOT_SEEN
        u, v = np.floor(found[0]), np.floor(found[1])
        if int(u) != column or int(v) != row:  # Else the part that was read still holds the patch.
            column, row = int(u), int(v)
            read_part(then, row - HALF_PX, column - HALF_PX, SIDE_PX + 1, scratch[3])
        total, squares, product, along_x, along_y = compare(found[0] - u, found[1] - v, mean, scratch)
        other = total / N_PIXELS
        energy = max(0.0, squares - total * other)
        likeness = product / np.sqrt(energy * variance + 1e-9)
        contrast = np.sqrt(variance / (energy + 1e-9))
        bx = contrast * (along_x - other * sum_x) - px
        by = contrast * (along_y - other * sum_y) - py
        step_x, step_y = (yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant
        found[0] -= step_x
        found[1] -= step_y
        if step_x * step_x + step_y * step_y < _ENOUGH_PX * _ENOUGH_PX:
            break
    return likeness
