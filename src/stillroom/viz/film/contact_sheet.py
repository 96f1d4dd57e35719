"""A picture of many pictures."""

from collections.abc import Sequence

import cv2
import numpy as np

from stillroom.geometry.arrays import U8

GAP_PX = 6
LETTERS = 0.45
PAPER, INK = 255, (34, 38, 44)
LABEL_PX = 20


def contact_sheet(columns: Sequence[tuple[str, Sequence[U8]]], width_px: int = 320, per_row: int = 4) -> U8:
    """Lay labelled stacks of pictures out on white paper, side by side and row by row.

    Args:
        columns: Each a label and the pictures (H, W, 3) below it; all pictures of one shape, all stacks of one height.
        width_px: Width of a picture on the sheet.
        per_row: How many stacks stand side by side.

    Returns:
        The sheet (h, w, 3); a small white one where there is nothing to show.
    """
    if not columns:
        return np.full((LABEL_PX, width_px, 3), PAPER, dtype=np.uint8)
    stacks = [_stack(label, pictures, width_px) for label, pictures in columns]
    height, width = stacks[0].shape[:2]
    n_across = min(per_row, len(stacks))
    n_down = -(-len(stacks) // n_across)
    size = n_down * (height + GAP_PX) + GAP_PX, n_across * (width + GAP_PX) + GAP_PX, 3
    sheet = np.full(size, PAPER, dtype=np.uint8)
    for place, stack in enumerate(stacks):
        top = GAP_PX + (place // n_across) * (height + GAP_PX)
        left = GAP_PX + (place % n_across) * (width + GAP_PX)
        sheet[top : top + height, left : left + width] = stack
    return sheet


def _stack(label: str, pictures: Sequence[U8], width_px: int) -> U8:
    """Return pictures on top of each other with a label above."""
    head = np.full((LABEL_PX, width_px, 3), PAPER, dtype=np.uint8)
    cv2.putText(head, label, (2, LABEL_PX - 6), cv2.FONT_HERSHEY_SIMPLEX, LETTERS, INK, 1, cv2.LINE_AA)
    parts = [head]
    for picture in pictures:
        size = width_px, round(picture.shape[0] * width_px / picture.shape[1])
        parts.append(np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8))
    return np.concatenate(parts)
