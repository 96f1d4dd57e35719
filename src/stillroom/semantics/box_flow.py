"""Follow a box from one image to the next without a detector: by the flow of what lies in it, at its depth."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from stillroom.data.image import RgbdImage
from stillroom.features.optical_flow import OpticalFlow
from stillroom.geometry.arrays import F32, F64, U8, Bool, Floats
from stillroom.geometry.pixels import values_at

MAX_CORNERS = 40
CORNER_QUALITY = 0.01
CORNER_DISTANCE_PX = 4  # in the halved image, in which flow is measured
FLOW = OpticalFlow(window_px=15, levels=2)
MARGIN_PX = 48  # around the box, so that flow may leave it; more than a person walks in a frame
CENTRAL_SHARE = 0.5  # the middle of a box, where its depth is read
CENTRAL_QUANTILE = 0.35  # what stands in a box stands before its background
DEPTH_STEP_PX = 4  # every fourth pixel tells how much of a box is at a depth


@dataclass(frozen=True)
class FollowedBox:
    """A box in one image, with the depth of what is in it.

    Attributes:
        edges: x_min y_min x_max y_max (4,) [px]; may reach beyond the image.
        depth_m: Depth of the thing in the box [m]; 0 where unknown.
        support: Share of the box at that depth when it was last detected.
    """

    edges: F64
    depth_m: float
    support: float


@dataclass(frozen=True)
class Follower:
    """How a box is followed.

    Attributes:
        depth_range_m: What lies in a box belongs to it when it is this near to the box's depth [m].
        min_points: Fewest corners whose flow counts.
        min_support: A box is lost when less than this share of its support is left.
    """

    depth_range_m: float
    min_points: int
    min_support: float

    def begin(self, image: RgbdImage, edges: F64) -> FollowedBox:
        """Look at a box in an image in which it was detected."""
        depth_m = _central_depth(image, edges)
        inside = image.depth_m[_pixels(edges, image)][::DEPTH_STEP_PX, ::DEPTH_STEP_PX]
        support = float(np.mean(self._near(inside, depth_m))) if inside.size and depth_m else 0.0
        return FollowedBox(edges, depth_m, support)

    def follow(self, before: RgbdImage, now: RgbdImage, box: FollowedBox, drift_px: F64) -> FollowedBox | None:
        """Return where a box of the image before is now; None where nothing speaks for its still being there.

        Args:
            before: The image in which the box is known.
            now: A later image of the same size.
            box: The box in the image before.
            drift_px: How far it is expected to have moved (2,) [px]; serves where there is nothing to follow.
        """
        flow_px = self._flow(before, now, box)
        edges = box.edges + np.tile(drift_px if flow_px is None else flow_px, 2)
        if box.depth_m == 0.0:
            return None if flow_px is None else FollowedBox(edges, 0.0, 0.0)
        inside = now.depth_m[_pixels(edges, now)][::DEPTH_STEP_PX, ::DEPTH_STEP_PX]
        near = self._near(inside, box.depth_m)
        # What stands before it hides it, and moved to get there: only a view of what lies behind says that it left.
        hidden = (inside > 0.0) & (inside < box.depth_m)
        if inside.size == 0 or np.mean(near | hidden) < self.min_support * box.support:
            return None
        return FollowedBox(edges, float(np.median(inside[near])) if near.any() else box.depth_m, box.support)

    def _flow(self, before: RgbdImage, now: RgbdImage, box: FollowedBox) -> F64 | None:
        """Return the median motion (2,) [px] of the corners that lie in the box at its depth in both images."""
        around = _pixels(box.edges, before, MARGIN_PX)
        old, new = _half(before.gray[around]), _half(now.gray[around])
        mask = self._mask(before, box, around)
        if min(old.shape) < FLOW.window_px or not mask.any():
            return None
        start: Any = cv2.goodFeaturesToTrack(old, MAX_CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX, mask=mask)
        if start is None:
            return None
        start = start[:, 0]
        end, is_found = FLOW.follow(old, new, start)
        arrived_px = 2.0 * end + np.array([around[1].start, around[0].start])
        good = is_found & self._stays(now, arrived_px, box.depth_m)
        if np.count_nonzero(good) < max(self.min_points, 1):
            return None
        return np.asarray(2.0 * np.median((end - start)[good], axis=0), dtype=np.float64)

    def _mask(self, image: RgbdImage, box: FollowedBox, around: tuple[slice, slice]) -> U8:
        """Return where in the halved surroundings of a box the thing in it is, as cv2 wants it."""
        inside = _pixels(box.edges, image)
        mask = np.zeros((image.height, image.width), dtype=np.uint8)
        mask[inside] = self._near(image.depth_m[inside], box.depth_m) if box.depth_m else 1
        rows, columns = (s.stop - s.start for s in around)
        return mask[around][: rows // 2 * 2 : 2, : columns // 2 * 2 : 2]

    def _stays(self, now: RgbdImage, points_px: Floats, depth_m: float) -> Bool:
        """Return which points (N, 2) lie in the image and, where depth is known, near the depth of the box."""
        nearest = np.rint(points_px)
        within = np.all((nearest >= 0) & (nearest < (now.width, now.height)), axis=1)
        at = values_at(now.depth_m, points_px)
        return np.asarray(within & ((at <= 0.0) | (depth_m == 0.0) | self._near(at, depth_m)))

    def _near(self, depth: F32, depth_m: float) -> Bool:
        return np.asarray(np.abs(depth - np.float32(depth_m)) <= self.depth_range_m)


def _central_depth(image: RgbdImage, edges: F64) -> float:
    """Return the depth of what stands in the middle of a box [m]; 0 where none is known."""
    center, half = 0.5 * (edges[:2] + edges[2:]), 0.5 * CENTRAL_SHARE * (edges[2:] - edges[:2])
    middle = image.depth_m[_pixels(np.concatenate([center - half, center + half]), image)]
    known = middle[middle > 0.0]
    return float(np.quantile(known, CENTRAL_QUANTILE)) if known.size else 0.0


def _pixels(edges: F64, image: RgbdImage, margin_px: int = 0) -> tuple[slice, slice]:
    """Return the rows and columns of a box in an image; empty where it lies outside."""
    x0, y0, x1, y1 = edges.tolist()
    rows = _span(y0, y1, margin_px, image.height)
    return rows, _span(x0, x1, margin_px, image.width)


def _span(first: float, last: float, margin_px: int, size: int) -> slice:
    start = min(max(math.ceil(first) - margin_px, 0), size)
    return slice(start, min(max(math.floor(last) + 1 + margin_px, start), size))


def _half(gray: U8) -> U8:
    """Return an image of half the size."""
    height, width = gray.shape[0] // 2, gray.shape[1] // 2
    if height == 0 or width == 0:
        return np.zeros((0, 0), dtype=np.uint8)
    even = gray[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
