"""Patch tracking between two images: Lucas–Kanade, a point at a time."""

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, U8

HALF_PX = 4
"""Half the side of a patch, on whatever level of the pyramid it is taken."""
SIDE_PX = 2 * HALF_PX + 1
N_PIXELS = SIDE_PX**2
_WIDE_PX = SIDE_PX + 2
ROOM = 4, _WIDE_PX**2
"""Shape of the scratch of a search."""
MARGIN_PX = HALF_PX + 2
MIN_CONTRAST = 4.0
"""Root mean square gradient [gray levels a pixel] that a patch must have in its poorest direction, on average."""
NOT_SEEN = -1.5
"""The correlation of a patch without a corner, or outside the image."""
_ENOUGH_PX = 0.02


@njit(nogil=True, cache=True)
def in_view(image: U8, x: float, y: float) -> bool:
    """Return whether a patch around (x, y) lies in an image (h, w)."""
    height, width = image.shape
    inside: bool = MARGIN_PX <= x < width - MARGIN_PX - 1 and MARGIN_PX <= y < height - MARGIN_PX - 1
    return inside


@njit(nogil=True, cache=True)
def take_patch(image: U8, x: float, y: float, scratch: F64) -> float:
    """Write the patch around (x, y), which must be in view, row by row, and its gradients; return its mean.

    Args:
        image: The image (h, w).
        x, y: The middle of the patch [px].
        scratch: Of the shape ROOM; the patch less its mean, and its differences by x and by y are written to the first
            N_PIXELS of three rows. The last row is for the patch with a border of a pixel.
    """
    column, row = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - column, y - row
    w00, w01, w10, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    left, top = column - HALF_PX - 1, row - HALF_PX - 1
    patch, by_x, by_y, wide = scratch[0], scratch[1], scratch[2], scratch[3]
    for r in range(_WIDE_PX):
        upper, lower = image[top + r, left : left + _WIDE_PX + 1], image[top + r + 1, left : left + _WIDE_PX + 1]
        for c in range(_WIDE_PX):
            wide[_WIDE_PX * r + c] = w00 * upper[c] + w01 * upper[c + 1] + w10 * lower[c] + w11 * lower[c + 1]
    total = 0.0
    for r in range(SIDE_PX):
        for c in range(SIDE_PX):
            n, m = SIDE_PX * r + c, _WIDE_PX * (r + 1) + c + 1
            patch[n] = wide[m]
            by_x[n] = 0.5 * (wide[m + 1] - wide[m - 1])
            by_y[n] = 0.5 * (wide[m + _WIDE_PX] - wide[m - _WIDE_PX])
            total += patch[n]
    mean = total / N_PIXELS
    for n in range(N_PIXELS):
        patch[n] -= mean
    return mean


@njit(nogil=True, cache=True, fastmath={"reassoc", "contract"})
def moments(scratch: F64) -> tuple[float, float, float, float, float, float, float, float]:
    """Return sums over a patch p and its differences g, h, as `take_patch` wrote them: p², gg, hh, gh, pg, ph, g, h."""
    pp = gg = hh = gh = pg = ph = sum_g = sum_h = 0.0
    for n in range(N_PIXELS):
        p, g, h = scratch[0, n], scratch[1, n], scratch[2, n]
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
def compare(image: U8, x: float, y: float, mean: float, scratch: F64) -> tuple[float, float, float, float, float]:
    """Return sums over the patch t around (x, y), which must be in view, and p, g, h of `moments`: t, t², tp, tg, th.

    Of t, `mean` is taken off: what is large in all its values would cost digits.
    """
    column, row = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - column, y - row
    w00, w01, w10, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    left, top = column - HALF_PX, row - HALF_PX
    sum_t = tt = tp = tg = th = 0.0
    for r in range(SIDE_PX):
        upper = image[top + r, left : left + SIDE_PX + 1]
        lower = image[top + r + 1, left : left + SIDE_PX + 1]
        for c in range(SIDE_PX):
            n = SIDE_PX * r + c
            t = w00 * upper[c] + w01 * upper[c + 1] + w10 * lower[c] + w11 * lower[c + 1] - mean
            sum_t += t
            tt += t * t
            tp += t * scratch[0, n]
            tg += t * scratch[1, n]
            th += t * scratch[2, n]
    return sum_t, tt, tp, tg, th


@njit(nogil=True, cache=True)
def find_patch(
    now: U8,
    at: tuple[float, float],
    then: U8,
    guess: tuple[float, float],
    iterations: int,
    scratch: F64,
    found: F64,
) -> float:
    """Find the patch around a point in another image, from an initial guess.

    Inverse compositional Lucas–Kanade (Baker and Matthews 2004) of a shift, with normalised brightness and contrast:
    the gradients are those of the patch, computed once.

    Args:
        now, at: Image (h, w), and x and y of the point in it [px].
        then, guess: The other image, and x and y of the guess [px].
        iterations: Most steps.
        scratch: Room for `take_patch`, of the shape ROOM.
        found: Where the patch is (2,) [px]; filled in.

    Returns:
        Similarity of the patches: their normalised correlation; NOT_SEEN where the patch has no corner or leaves
        an image.
    """
    (x, y), (u, v) = at, guess
    found[0], found[1] = u, v
    if not in_view(now, x, y):
        return NOT_SEEN
    mean = take_patch(now, x, y, scratch)
    variance, xx, yy, xy, px, py, sum_x, sum_y = moments(scratch)
    least = 0.5 * (xx + yy - np.sqrt((xx - yy) * (xx - yy) + 4.0 * xy * xy))
    if not least > MIN_CONTRAST * MIN_CONTRAST * N_PIXELS:
        return NOT_SEEN  # no corner
    determinant = xx * yy - xy * xy
    likeness = NOT_SEEN
    for _ in range(iterations):
        if not in_view(then, found[0], found[1]):
            return NOT_SEEN
        total, squares, product, along_x, along_y = compare(then, found[0], found[1], mean, scratch)
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
