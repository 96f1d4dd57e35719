"""Orientation and ORB descriptor of corners, on one level of the pyramid."""

import numpy as np
from numba import njit

from stillroom.geometry.arrays import F32, I32, U8

PATCH_RADIUS_PX = 15
BORDER_PX = 19
"""The turned pattern reaches 13·√2 px and rounds up; nothing closer to the edge can be described."""
N_TURNS = 256
"""The pattern is turned in steps of 1.4°, a tenth of what the descriptor notices; a table is faster than sines."""


def patch_half_widths() -> I32:
    """Return the half width of each row of the disc over which the orientation is taken, (16,) int32.

    The disc is OpenCV's: symmetric about the diagonal, so that its steep part mirrors the flat one. Rounding each row
    by itself, as one would, turns the angle by 2° in the median and with it the descriptor away from everyone's.
    """
    rows = np.arange(PATCH_RADIUS_PX + 1)
    widths = np.rint(np.sqrt(PATCH_RADIUS_PX**2 - rows**2)).astype(np.int32)
    mirrored = np.array([np.flatnonzero(widths >= row).max() for row in rows], dtype=np.int32)
    return np.where(rows * np.sqrt(2.0) > PATCH_RADIUS_PX, mirrored, widths).astype(np.int32)


@njit(nogil=True, cache=True)
def orientations(image: U8, px: F32, half_widths: I32, angle_rad: F32) -> None:
    """Fill the angle (N,) from keypoint to the centroid of brightness in its disc (Rublee et al. 2011, 3.2)."""
    radius = len(half_widths) - 1
    for i in range(len(px)):
        cx, cy = int(px[i, 0]), int(px[i, 1])
        m10, m01 = 0, 0
        for dx in range(-radius, radius + 1):
            m10 += dx * int(image[cy, cx + dx])
        for dy in range(1, radius + 1):
            total = 0
            for dx in range(-half_widths[dy], half_widths[dy] + 1):
                below, above = int(image[cy + dy, cx + dx]), int(image[cy - dy, cx + dx])
                total += below - above
                m10 += dx * (below + above)
            m01 += dy * total
        angle_rad[i] = np.arctan2(np.float32(m01), np.float32(m10))


def turned_offsets(pattern: I32, row_px: int) -> I32:
    """Return the pattern (256, 4) turned by each of `N_TURNS` angles, as offsets in a flat image with rows of `row_px`.

    Returns:
        Offsets (N_TURNS, 512) int32: of comparison k the first place at 2k, the second at 2k + 1.
    """
    angle_rad = 2.0 * np.pi * np.arange(N_TURNS) / N_TURNS
    c, s = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    x, y = pattern.reshape(-1, 2).T.astype(np.float64)
    return np.asarray(np.rint(x * s + y * c) * row_px + np.rint(x * c - y * s), dtype=np.int32)


@njit(nogil=True, cache=True)
def describe(blurred: U8, px: F32, angle_rad: F32, offsets: I32, descriptors: U8) -> None:
    """Fill the descriptors (N, 32): 256 comparisons of the blurred level, turned by the keypoint's angle."""
    flat = blurred.reshape(-1)
    per_rad = N_TURNS / (2.0 * np.pi)
    for i in range(len(px)):
        middle = int(px[i, 1]) * blurred.shape[1] + int(px[i, 0])
        turned = offsets[int(np.floor(angle_rad[i] * per_rad + 0.5)) % N_TURNS]
        for byte in range(32):
            value = 0
            for bit in range(8):
                k = 16 * byte + 2 * bit
                value |= (flat[middle + turned[k]] < flat[middle + turned[k + 1]]) << bit
            descriptors[i, byte] = value
