"""A frame with the verdict drawn on it: what moves in red, what stays in green."""

import cv2
import numpy as np

from stillroom.data.semantics import Box, Semantics
from stillroom.geometry.arrays import U8, Bool, Floats

Color = tuple[int, int, int]

MOVING: Color = (235, 60, 50)
STATIC: Color = (70, 220, 95)
BOX: Color = (255, 255, 255)
INK: Color = (20, 20, 20)

TINT = 0.30
"""Share of red in moving pixels."""

TEXT = 0.22
"""Size of letters, for cv2's font, of a picture as large as the image."""

SHIFT = 4
"""Sub-pixel bits of cv2's drawing calls."""


def draw_verdict(
    image: U8,
    keypoints_raw_px: Floats,
    is_static: Bool,
    is_matched: Bool,
    semantics: Semantics,
    moving: Bool,
    scale: float = 2.0,
) -> U8:
    """Draw a verdict on an image.

    Moving keypoints are red dots; static ones are green, dots where they have a map point and small rings where
    they have none. What moves is tinted, boxes have thin edges and a label, the counts stand in the corner.

    Args:
        image: Colours (H, W, 3), RGB, as taken.
        keypoints_raw_px: Keypoints (N, 2) in the image as taken [px].
        is_static: Verdict on them (N,).
        is_matched: Which of them have a map point (N,).
        semantics: What may move.
        moving: Pixels that do move (H, W).
        scale: How much larger than the image the picture is.

    Returns:
        The picture (H·scale, W·scale, 3), RGB.
    """
    height, width = round(image.shape[0] * scale), round(image.shape[1] * scale)
    picture = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    _tint(picture, moving)
    for box in semantics.boxes:
        _draw_box(picture, box, scale)
    # Pixel centres lie at integers in both images, so a point moves by half a pixel when the image grows.
    points_px = (np.asarray(keypoints_raw_px, dtype=np.float64) + 0.5) * scale - 0.5
    for point in points_px[is_static & ~is_matched]:
        _draw_ring(picture, point, STATIC, scale)
    for point in points_px[is_static & is_matched]:
        _draw_dot(picture, point, STATIC, scale)
    for point in points_px[~is_static]:
        _draw_dot(picture, point, MOVING, scale)
    n_static = int(np.count_nonzero(is_static))
    _draw_legend(picture, ((f"{n_static} static", STATIC), (f"{len(is_static) - n_static} moving", MOVING)), scale)
    return picture


def _tint(picture: U8, moving: Bool) -> None:
    """Mix red into the moving pixels, in place, with an edge as soft as the enlargement."""
    if not moving.any():
        return
    height, width = picture.shape[:2]
    soft = cv2.resize(moving.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    soft = cv2.GaussianBlur(soft, (0, 0), 1.5)
    share = (TINT * soft)[..., None]
    mixed = picture * (1.0 - share) + np.array(MOVING, dtype=np.float32) * share
    picture[:] = np.rint(mixed).astype(np.uint8)
    mask = (soft > 0.5).astype(np.uint8)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, outlines, -1, MOVING, 1, cv2.LINE_AA)


def _draw_box(picture: U8, box: Box, scale: float) -> None:
    x0, y0, x1, y1 = (round((edge + 0.5) * scale - 0.5) for edge in box.xyxy_px)
    cv2.rectangle(picture, (x0, y0), (x1, y1), BOX, 1, cv2.LINE_AA)
    text = f"{box.label} {box.confidence:.2f}" + (f", carried {box.carried}" if box.carried else "")
    size = TEXT * scale
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    pad = round(2 * scale)
    left = min(max(0, x0), picture.shape[1] - width - 2 * pad)
    top = max(0, y0 - height - 2 * pad)
    cv2.rectangle(picture, (left, top), (left + width + 2 * pad, top + height + 2 * pad), BOX, cv2.FILLED)
    place = (left + pad, top + pad + height)
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)


def _draw_legend(picture: U8, entries: tuple[tuple[str, Color], ...], scale: float) -> None:
    """Write each entry behind a dot of its colour on a dark strip in the lower left corner, in place."""
    size, pad = 1.2 * TEXT * scale, round(4 * scale)
    widths = [cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0] for text, _ in entries]
    height = cv2.getTextSize("0", cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][1]
    bottom, right = picture.shape[0], sum(widths) + len(entries) * 4 * pad
    strip = picture[bottom - height - 3 * pad : bottom, :right]
    strip[:] = np.rint(0.3 * strip + 0.7 * np.array(INK)).astype(np.uint8)
    left, baseline = pad, bottom - round(1.5 * pad)
    for (text, color), width in zip(entries, widths, strict=True):
        _draw_dot(picture, np.array([left + pad / 2, baseline - height / 2]), color, scale)
        place = (left + 2 * pad, baseline)
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, BOX, 1, cv2.LINE_AA)
        left += width + 4 * pad


def _draw_dot(picture: U8, point_px: Floats, color: Color, scale: float) -> None:
    center = _fixed(point_px)
    cv2.circle(picture, center, round(2.1 * scale * 2**SHIFT), INK, cv2.FILLED, cv2.LINE_AA, SHIFT)
    cv2.circle(picture, center, round(1.6 * scale * 2**SHIFT), color, cv2.FILLED, cv2.LINE_AA, SHIFT)


def _draw_ring(picture: U8, point_px: Floats, color: Color, scale: float) -> None:
    cv2.circle(picture, _fixed(point_px), round(1.5 * scale * 2**SHIFT), color, 1, cv2.LINE_AA, SHIFT)


def _fixed(point_px: Floats) -> tuple[int, int]:
    return round(float(point_px[0]) * 2**SHIFT), round(float(point_px[1]) * 2**SHIFT)
