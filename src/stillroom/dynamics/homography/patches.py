"""Patch tracking between two images: Lucas–Kanade, a point at a time."""

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, U8

HALF_PX = 4
"""Half the side of a patch, on whatever level of the pyramid it is taken."""
N_PIXELS = (2 * HALF_PX + 1) ** 2
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
def take_patch(image: U8, x: float, y: float, patch: F64) -> float:
    """Write the patch around (x, y), which must be in view, row by row to `patch` (N_PIXELS,); return its mean."""
    column, row = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - column, y - row
    w00, w01, w10, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    total, n = 0.0, 0
    for r in range(row - HALF_PX, row + HALF_PX + 1):
        for c in range(column - HALF_PX, column + HALF_PX + 1):
            value = w00 * image[r, c] + w01 * image[r, c + 1] + w10 * image[r + 1, c] + w11 * image[r + 1, c + 1]
            patch[n] = value
            total += value
            n += 1
    return total / n


@njit(nogil=True, cache=True)
def take_gradients(image: U8, x: float, y: float, scratch: F64) -> bool:
    """Write a patch's gradients to rows 1 and 2 of `scratch` (4, N_PIXELS); return whether it is a corner."""
    take_patch(image, x + 1.0, y, scratch[1])
    take_patch(image, x - 1.0, y, scratch[3])
    for n in range(N_PIXELS):
        scratch[1, n] = 0.5 * (scratch[1, n] - scratch[3, n])
    take_patch(image, x, y + 1.0, scratch[2])
    take_patch(image, x, y - 1.0, scratch[3])
    for n in range(N_PIXELS):
        scratch[2, n] = 0.5 * (scratch[2, n] - scratch[3, n])
    xx = yy = xy = 0.0
    for n in range(N_PIXELS):
        xx += scratch[1, n] * scratch[1, n]
        yy += scratch[2, n] * scratch[2, n]
        xy += scratch[1, n] * scratch[2, n]
    least = 0.5 * (xx + yy - np.sqrt((xx - yy) * (xx - yy) + 4.0 * xy * xy))
    is_corner: bool = least > MIN_CONTRAST * MIN_CONTRAST * N_PIXELS
    return is_corner


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
        scratch: Room for patches (4, N_PIXELS).
        found: Where the patch is (2,) [px]; filled in.

    Returns:
        Similarity of the patches: their normalised correlation; NOT_SEEN where the patch has no corner or leaves
        an image.
    """
    (x, y), (u, v) = at, guess
    found[0], found[1] = u, v
    if not in_view(now, x, y) or not take_gradients(now, x, y, scratch):
        return NOT_SEEN
    mean = take_patch(now, x, y, scratch[0])
    xx = yy = xy = variance = 0.0
    for n in range(N_PIXELS):
        xx += scratch[1, n] * scratch[1, n]
        yy += scratch[2, n] * scratch[2, n]
        xy += scratch[1, n] * scratch[2, n]
        variance += (scratch[0, n] - mean) ** 2
    determinant = xx * yy - xy * xy
    likeness = NOT_SEEN
    for _ in range(iterations):
        if not in_view(then, found[0], found[1]):
            return NOT_SEEN
        other = take_patch(then, found[0], found[1], scratch[3])
        product = energy = 0.0
        for n in range(N_PIXELS):
            scratch[3, n] -= other
            product += scratch[3, n] * (scratch[0, n] - mean)
            energy += scratch[3, n] * scratch[3, n]
        likeness = product / np.sqrt(energy * variance + 1e-9)
        contrast = np.sqrt(variance / (energy + 1e-9))
        bx = by = 0.0
        for n in range(N_PIXELS):
            difference = contrast * scratch[3, n] - (scratch[0, n] - mean)
            bx += scratch[1, n] * difference
            by += scratch[2, n] * difference
        step_x, step_y = (yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant
        found[0] -= step_x
        found[1] -= step_y
        if step_x * step_x + step_y * step_y < _ENOUGH_PX * _ENOUGH_PX:
            break
    return likeness
