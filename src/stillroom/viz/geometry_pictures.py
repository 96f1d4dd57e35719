"""The ants' way through an image: nodes, circles, hulls of what moves, and the bands around them (Figure 6)."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stillroom.geometry import homography
from stillroom.geometry.arrays import F64, I32, U8, Bool, Floats
from stillroom.geometry.camera import Camera
from stillroom.viz.marks import INK, MOVING, SHIFT, STATIC, Color, draw_dot, draw_legend, enlarged

PATH: Color = (255, 196, 0)
BAND: Color = (255, 140, 110)
UNTESTED: Color = (150, 156, 166)
FADED = 0.8
DARKER = 0.75
CONTRAST = 2.0
"""How much more contrast differences have than the images."""


# The ants' way through an image: nodes, circles, hulls of what moves, and the bands around them (Figure 6).


@dataclass(frozen=True)
class AntWalk:
    """A search along a path.

    Attributes:
        points_px: The points (N, 2) [px].
        is_tested, moves: Which were tested, and which of these move (N,).
        path_px: Its nodes in order (n, 2) [px].
        radius_px, band_px: R and ΔZ [px].
        hulls: Corners (k, 2) [px] of the hulls of what moves.
    """

    points_px: F64
    is_tested: Bool
    moves: Bool
    path_px: F64
    radius_px: float
    band_px: float
    hulls: Sequence[F64]


def draw_ant_walk(image: U8, walk: AntWalk, scale: float = 1.0) -> U8:
    """Draw a search on an image (H, W, 3); return the picture (H·scale, W·scale, 3), RGB."""
    picture = enlarged(_faded(image), scale)
    for hull_px in walk.hulls:
        _draw_band(picture, hull_px, walk.band_px, scale)
    _draw_path(picture, walk.path_px, walk.radius_px, scale)
    on_picture = (walk.points_px + 0.5) * scale - 0.5
    for point in on_picture[~walk.is_tested]:
        _fill_circle(picture, point, 1.0 * scale, UNTESTED)
    for point in on_picture[walk.is_tested & ~walk.moves]:
        draw_dot(picture, point, STATIC, 0.85 * scale)
    for point in on_picture[walk.moves]:
        draw_dot(picture, point, MOVING, scale)
    _draw_ends(picture, walk.path_px, scale)
    n_tested, n_moving = np.count_nonzero(walk.is_tested), np.count_nonzero(walk.moves)
    entries: tuple[tuple[str, Color], ...] = (
        (f"{len(walk.points_px) - n_tested} not tested", UNTESTED),
        (f"{n_tested - n_moving} static", STATIC),
        (f"{n_moving} moving", MOVING),
        ("path from A to B", PATH),
    )
    draw_legend(picture, entries, scale)
    return picture


def _draw_band(picture: U8, hull_px: F64, band_px: float, scale: float) -> None:
    """Draw a hull, filled lightly, and the edge of the band around it."""
    around = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    circle = band_px * np.stack((np.cos(around), np.sin(around)), axis=1)
    corners = (hull_px[:, None] + circle).reshape(-1, 2).astype(np.float32)
    grown = np.asarray(cv2.convexHull(corners), dtype=np.float64)[:, 0]
    inside = picture.copy()
    cv2.fillConvexPoly(inside, _fixed(hull_px, scale), MOVING, cv2.LINE_AA, SHIFT)
    picture[:] = cv2.addWeighted(inside, 0.28, picture, 0.72, 0.0)
    cv2.polylines(picture, [_fixed(hull_px, scale)], True, MOVING, max(1, round(1.2 * scale)), cv2.LINE_AA, SHIFT)
    cv2.polylines(picture, [_fixed(grown, scale)], True, BAND, max(1, round(0.8 * scale)), cv2.LINE_AA, SHIFT)


def _draw_path(picture: U8, path_px: F64, radius_px: float, scale: float) -> None:
    """Draw the circles around the nodes, and the path from node to node."""
    for node in _fixed(path_px, scale):
        cv2.circle(picture, _pair(node), round(radius_px * scale * 2**SHIFT), PATH, 1, cv2.LINE_AA, SHIFT)
    if len(path_px) > 1:
        points = _fixed(path_px, scale)
        cv2.polylines(picture, [points], False, INK, max(2, round(2.6 * scale)), cv2.LINE_AA, SHIFT)
        cv2.polylines(picture, [points], False, PATH, max(1, round(1.4 * scale)), cv2.LINE_AA, SHIFT)
    for node in (path_px + 0.5) * scale - 0.5:
        _fill_circle(picture, node, 2.2 * scale, PATH)


def _draw_ends(picture: U8, path_px: F64, scale: float) -> None:
    """Write A and B at the ends of the path."""
    if len(path_px) == 0:
        return
    for letter, node in (("A", path_px[0]), ("B", path_px[-1])):
        center = (node + 0.5) * scale - 0.5
        _fill_circle(picture, center, 9.0 * scale, PATH)
        (width, height), _ = cv2.getTextSize(letter, cv2.FONT_HERSHEY_SIMPLEX, 0.5 * scale, max(1, round(1.5 * scale)))
        place = round(float(center[0]) - width / 2), round(float(center[1]) + height / 2)
        thickness = max(1, round(1.5 * scale))
        cv2.putText(picture, letter, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5 * scale, INK, thickness, cv2.LINE_AA)


def _fill_circle(picture: U8, center_px: F64, radius_px: float, color: Color) -> None:
    center = _pair(np.rint(center_px * 2**SHIFT).astype(np.int32))
    cv2.circle(picture, center, round(radius_px * 2**SHIFT), color, cv2.FILLED, cv2.LINE_AA, SHIFT)


def _fixed(points_px: Floats, scale: float) -> I32:
    """Return points (n, 2) of the image as cv2's drawing calls take them."""
    return np.asarray(np.rint(((points_px + 0.5) * scale - 0.5) * 2**SHIFT), dtype=np.int32)


def _pair(point: I32) -> tuple[int, int]:
    return int(point[0]), int(point[1])


def _faded(image: U8) -> U8:
    """Desaturate and darken an image, so that marks stand out."""
    gray = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    faded = cv2.addWeighted(gray, FADED * DARKER, image, (1.0 - FADED) * DARKER, 0.0)
    return np.asarray(faded, dtype=np.uint8)


# The earlier image warped to the present one, and the difference (PSPNet-SLAM, Figure 5).


def compensated(earlier: U8, H_then_now: F64, camera: Camera) -> tuple[U8, Bool]:
    """Warp an earlier image (H, W) by a homography of undistorted pixels, distortion included.

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
    """Draw the difference of two images (H, W), dark on white; white where the earlier one has no pixels."""
    difference = np.abs(now.astype(np.float32) - then)
    if seen is not None:
        difference[~seen] = 0.0
    gray = (255.0 - np.minimum(CONTRAST * difference, 255.0)).astype(np.uint8)
    return enlarged(np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2RGB), dtype=np.uint8), scale)


def draw_moving_points(image: U8, points_px: F64, moves: Bool, is_known: Bool, scale: float = 1.0) -> U8:
    """Draw the result of the test of points: dynamic red, static green; unknown ones are left out.

    Args:
        image: Colours (H, W, 3), RGB, as taken.
        points_px: Points (N, 2) in it [px].
        moves, is_known: Which are dynamic (N,), and of which the test has a result.
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
