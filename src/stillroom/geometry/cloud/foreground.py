"""What of a box's pixels is the thing in the box: those near the depth that most of them have."""

import numpy as np

from stillroom.geometry.arrays import F32, I16, I32, Bool, Floats

NO_BOX = -1
BIN_M = 0.05
MANY = 0.6


def claim_foregrounds(
    z_m: F32,
    free: Bool,
    rows: I32,
    columns: I32,
    boxes_xyxy_px: Floats,
    half_depth_m: float,
    min_share: float,
) -> I16:
    """Give the samples of each box's foreground to the box, so that they can be clustered apart from the rest.

    The foreground's depth is the nearest at which a window over the depths holds many of the box's free samples. Boxes
    claim from the nearest on, and the depth of the next is taken from what is left: of a person half behind another,
    the rest.

    Args:
        z_m: Depths of the samples (h, w) [m].
        free: Which of them may be claimed (h, w): known, and on no plane.
        rows, columns: Their pixels (h,) and (w,) [px].
        boxes_xyxy_px: Edges of the boxes (B, 4) [px].
        half_depth_m: Half the depth that a thing in a box takes up [m].
        min_share: A box claims nothing where its foreground has less than this share of its samples.

    Returns:
        Box of each sample (h, w) int16, −1 for none.
    """
    owner = np.full(z_m.shape, NO_BOX, dtype=np.int16)
    windows = [_window(box, rows, columns) for box in boxes_xyxy_px]
    first = [_mode(z_m[at][free[at]], half_depth_m) for at in windows]
    # Of boxes at one depth the one with most support goes first; the other's foreground may be what is left of it.
    for k in sorted(range(len(windows)), key=lambda k: (round(first[k][0] / half_depth_m), -first[k][1], k)):
        at = windows[k]
        left = free[at] & (owner[at] == NO_BOX)
        centre_m, support = _mode(z_m[at][left], half_depth_m)
        if support == 0 or support < min_share * left.size:
            continue
        owner[at][left & (np.abs(z_m[at] - centre_m) <= half_depth_m)] = k
    return owner


def _window(box: Floats, rows: I32, columns: I32) -> tuple[slice, slice]:
    x0, y0, x1, y1 = box
    top, bottom = np.searchsorted(rows, (y0, np.nextafter(y1, np.inf)))
    left, right = np.searchsorted(columns, (x0, np.nextafter(x1, np.inf)))
    return slice(int(top), int(bottom)), slice(int(left), int(right))


def _mode(z_m: F32, half_depth_m: float) -> tuple[float, int]:
    """Return the middle of the nearest depth window that holds many samples [m], and how many.

    Many is `MANY` of what any window holds: people stand before furniture more often than behind it.
    """
    if len(z_m) == 0:
        return 0.0, 0
    counts = np.bincount((z_m / BIN_M).astype(np.int64))
    width = max(1, round(2.0 * half_depth_m / BIN_M))
    held = np.convolve(counts, np.ones(width, dtype=np.int64))
    last = int(np.argmax(held >= MANY * held.max()))
    # From where it starts to hold many on to where it holds most.
    while last + 1 < len(held) and held[last + 1] > held[last]:
        last += 1
    inside = np.sort(z_m[(z_m >= (last - width + 1) * BIN_M) & (z_m < (last + 1) * BIN_M)])
    return float(inside[len(inside) // 2]) if len(inside) else 0.0, int(held[last])
