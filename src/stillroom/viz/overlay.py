"""A frame with the verdict drawn on it: what moves in red, what stays in green."""

import numpy as np

from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import U8, Bool, Floats
from stillroom.viz.marks import (
    MOVING,
    STATIC,
    draw_box,
    draw_dot,
    draw_label,
    draw_legend,
    draw_outline,
    draw_ring,
    enlarged,
    tint,
)


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
    picture = enlarged(image, scale)
    if moving.any():
        tint(picture, moving, MOVING)
        draw_outline(picture, moving, MOVING)
    for box in semantics.boxes:
        draw_box(picture, box, scale)
        draw_label(picture, box, scale)
    # Pixel centres lie at integers in both images, so a point moves by half a pixel when the image grows.
    points_px = (np.asarray(keypoints_raw_px, dtype=np.float64) + 0.5) * scale - 0.5
    for point in points_px[is_static & ~is_matched]:
        draw_ring(picture, point, STATIC, scale)
    for point in points_px[is_static & is_matched]:
        draw_dot(picture, point, STATIC, scale)
    for point in points_px[~is_static]:
        draw_dot(picture, point, MOVING, scale)
    n_static = int(np.count_nonzero(is_static))
    draw_legend(picture, ((f"{n_static} static", STATIC), (f"{len(is_static) - n_static} moving", MOVING)), scale)
    return picture
