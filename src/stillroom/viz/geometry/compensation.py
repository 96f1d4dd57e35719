"""The earlier image brought to where the present one would have it, and what differs (PSPNet-SLAM, Figure 5)."""

import cv2
import numpy as np

from stillroom.geometry import homography
from stillroom.geometry.arrays import F64, U8, Bool
from stillroom.geometry.camera import Camera
from stillroom.viz.marks import MOVING, STATIC, draw_dot, draw_legend, enlarged

CONTRAST = 2.0
"""How much more contrast differences have than the images."""


def compensated(earlier: U8, H_then_now: F64, camera: Camera) -> tuple[U8, Bool]:
    """Move an earlier image (H, W) to where a homography of undistorted pixels says that it is now, lens included.

    Returns:
        The image (H, W), and which of its pixels the earlier one saw (H, W).
    """
    height, width = earlier.shape
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    now_px = camera.undistort(np.stack((column.ravel(), row.ravel()), axis=1).astype(np.float32))
    then_px = camera.distort(homography.apply(H_then_now, now_px)).reshape(height, width, 2).astype(np.float32)
    seen = np.all((then_px >= 0) & (then_px <= (width - 1, height - 1)), axis=2)
    moved = cv2.remap(earlier, then_px[..., 0], then_px[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, dtype=np.uint8), seen


def draw_difference(now: U8, then: U8, seen: Bool | None = None, scale: float = 1.0) -> U8:
    """Draw how two images (H, W) differ, dark on white; where the earlier one saw nothing, nothing differs."""
    difference = np.abs(now.astype(np.float32) - then)
    if seen is not None:
        difference[~seen] = 0.0
    gray = (255.0 - np.minimum(CONTRAST * difference, 255.0)).astype(np.uint8)
    return enlarged(np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2RGB), dtype=np.uint8), scale)


def draw_moving_points(image: U8, points_px: F64, moves: Bool, is_known: Bool, scale: float = 1.0) -> U8:
    """Draw what the test says of points: red what moves, green what does not; nothing where it could not tell.

    Args:
        image: Colours (H, W, 3), RGB, as taken.
        points_px: Points (N, 2) in it [px].
        moves, is_known: What the test says (N,), and where it says something.
        scale: How much larger than the image the picture is.
    """
    picture = enlarged(image, scale)
    on_picture = (points_px + 0.5) * scale - 0.5
    for point in on_picture[is_known & ~moves]:
        draw_dot(picture, point, STATIC, scale)
    for point in on_picture[moves]:
        draw_dot(picture, point, MOVING, scale)
    entries = (
        (f"{np.count_nonzero(is_known & ~moves)} static", STATIC),
        (f"{np.count_nonzero(moves)} moving", MOVING),
    )
    draw_legend(picture, entries, scale)
    return picture
