"""Elements of pictures of frames: boxes, dots, outlines, legends, drawn in place."""

import cv2
import numpy as np

from stillroom.data.semantics import Box
from stillroom.geometry.arrays import F32, U8, Bool, Floats

Color = tuple[int, int, int]

MOVING: Color = (235, 60, 50)
STATIC: Color = (70, 220, 95)
BOX: Color = (255, 255, 255)
INK: Color = (20, 20, 20)

TINT = 0.30
"""Share of red in dynamic pixels."""

TEXT = 0.22
"""Size of letters, for cv2's font, of a picture as large as the image."""

AROUND_PX = 4
"""Pixels of the image around a mask that its edge may depend on."""

SHIFT = 4
"""Sub-pixel bits of cv2's drawing calls."""


def enlarged(image: U8, scale: float) -> U8:
    """Return an image (H, W, 3) as a picture (H·scale, W·scale, 3) to draw on; the image is not touched."""
    size = round(image.shape[1] * scale), round(image.shape[0] * scale)
    return np.array(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)


def mix(picture: U8, colors: F32) -> None:
    """Mix colours of the size of the image into a picture, with edges as soft as the enlargement.

    Args:
        picture: The picture, changed in place.
        colors: Share times red, green, blue, and the share itself (H, W, 4), 0 … 1.
    """
    soft = _softly_enlarged(colors, picture.shape[1], picture.shape[0])
    picture[:] = np.rint(picture * (1.0 - soft[..., 3:]) + soft[..., :3]).astype(np.uint8)


def tint(picture: U8, mask: Bool, color: Color, share: float = TINT) -> None:
    """Mix a colour into the pixels of a mask (H, W) of the size of the image."""
    mix(picture, mask.astype(np.float32)[..., None] * np.array([*(share * np.array(color)), share], dtype=np.float32))


def draw_outline(picture: U8, mask: Bool, color: Color, thickness_px: int = 1) -> None:
    """Draw the edge of a mask (H, W) of the size of the image on a picture that may be larger."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    if width == 0:
        return
    # Only around the mask, for a frame may have many small clusters; with a margin for the soft edge.
    x0, y0 = max(0, x - AROUND_PX), max(0, y - AROUND_PX)
    part = mask[y0 : y + height + AROUND_PX, x0 : x + width + AROUND_PX]
    scale_x, scale_y = picture.shape[1] / mask.shape[1], picture.shape[0] / mask.shape[0]
    size = round(part.shape[1] * scale_x), round(part.shape[0] * scale_y)
    inside = (_softly_enlarged(part.astype(np.float32), *size) > 0.5).astype(np.uint8)
    outlines, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    moved = [outline + np.array([round(x0 * scale_x), round(y0 * scale_y)], np.int32) for outline in outlines]
    cv2.drawContours(picture, moved, -1, color, thickness_px, cv2.LINE_AA)


def _softly_enlarged(values: F32, width: int, height: int) -> F32:
    large = cv2.resize(values, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.GaussianBlur(large, (0, 0), 1.5), dtype=np.float32)


def draw_box(picture: U8, box: Box, scale: float, color: Color = BOX, thickness_px: int = 1) -> None:
    """Draw the edges of an image's box on a picture that is that many times larger."""
    x0, y0, x1, y1 = _edges_px(box, scale)
    cv2.rectangle(picture, (x0, y0), (x1, y1), color, thickness_px, cv2.LINE_AA)


def draw_label(picture: U8, box: Box, scale: float, color: Color = BOX, text_size: float = TEXT) -> None:
    """Write class and confidence of a box above it, or just inside where it reaches the picture's edge."""
    x0, y0, _, _ = _edges_px(box, scale)
    text = f"{box.label} {box.confidence:.2f}" + (f", propagated {box.carried}" if box.carried else "")
    size = text_size * scale
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    pad = round(2 * scale)
    left = min(max(0, x0), picture.shape[1] - width - 2 * pad)
    top = max(0, y0 - height - 2 * pad)
    cv2.rectangle(picture, (left, top), (left + width + 2 * pad, top + height + 2 * pad), color, cv2.FILLED)
    place = (left + pad, top + pad + height)
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)


def draw_legend(picture: U8, entries: tuple[tuple[str, Color], ...], scale: float) -> None:
    """Write each entry behind a dot of its colour on a dark strip in the lower left corner."""
    size, pad = 1.2 * TEXT * scale, round(4 * scale)
    widths = [cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0] for text, _ in entries]
    height = cv2.getTextSize("0", cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][1]
    bottom, right = picture.shape[0], sum(widths) + len(entries) * 4 * pad
    strip = picture[bottom - height - 3 * pad : bottom, :right]
    strip[:] = np.rint(0.3 * strip + 0.7 * np.array(INK)).astype(np.uint8)
    left, baseline = pad, bottom - round(1.5 * pad)
    for (text, color), width in zip(entries, widths, strict=True):
        draw_dot(picture, np.array([left + pad / 2, baseline - height / 2]), color, scale)
        place = (left + 2 * pad, baseline)
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, BOX, 1, cv2.LINE_AA)
        left += width + 4 * pad


def draw_dot(picture: U8, point_px: Floats, color: Color, scale: float) -> None:
    """Draw a dot with a dark rim at a point (2,) of the picture [px]."""
    center = _fixed(point_px)
    cv2.circle(picture, center, round(2.1 * scale * 2**SHIFT), INK, cv2.FILLED, cv2.LINE_AA, SHIFT)
    cv2.circle(picture, center, round(1.6 * scale * 2**SHIFT), color, cv2.FILLED, cv2.LINE_AA, SHIFT)


def draw_ring(picture: U8, point_px: Floats, color: Color, scale: float) -> None:
    """Draw a small thin ring around a point (2,) of the picture [px]."""
    cv2.circle(picture, _fixed(point_px), round(1.5 * scale * 2**SHIFT), color, 1, cv2.LINE_AA, SHIFT)


def _fixed(point_px: Floats) -> tuple[int, int]:
    return round(float(point_px[0]) * 2**SHIFT), round(float(point_px[1]) * 2**SHIFT)


def _edges_px(box: Box, scale: float) -> tuple[int, int, int, int]:
    # Pixel centres lie at integers in both images, so an edge moves by half a pixel when the image grows.
    x0, y0, x1, y1 = (round((edge + 0.5) * scale - 0.5) for edge in box.xyxy_px)
    return x0, y0, x1, y1
