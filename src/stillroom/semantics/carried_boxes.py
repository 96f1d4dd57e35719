"""Propagate boxes over the frames in which the detector misses them.

A person at the edge of the image, half hidden or blurred is missed for some frames; features on a missed person are
taken for static, which dominates the error: CFP-SLAM without such compensation is five times worse
(docs/reference.md#cfp-slam).
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.image import Image
from stillroom.data.semantics import Box, Semantics
from stillroom.features.optical_flow import OpticalFlow
from stillroom.geometry.arrays import F32, F64, U8, Bool, Floats
from stillroom.geometry.pixels import in_pixels, pixel_scale, values_at
from stillroom.semantics.detector import Detector, of_boxes, overlap

MAX_CORNERS = 40
CORNER_QUALITY = 0.01
SHRINK = 2  # flow is measured in images of half the size, of those 640 pixels long
CORNER_DISTANCE_PX = 4  # there
FLOW = OpticalFlow(window_px=15, levels=2)
MARGIN_PX = 48  # around the box, so that flow may leave it; more than a person walks in a frame
CENTRAL_SHARE = 0.5  # central part of a box, in which its depth is measured
CENTRAL_QUANTILE = 0.35  # an object in a box is nearer than its background
DEPTH_STEP_PX = 4  # stride of the pixels that count for the support of a depth
SOON_S = 0.05  # a person who is not seen at once walks six centimetres in it
ENTRY_SHARE = 0.025  # of the image's width: a box that comes so near to the border touches it


# Track a box from one image to the next without a detector: by the optical flow in it, at its depth.


@dataclass(frozen=True)
class FollowedBox:
    """A box in one image, with the depth of what is in it.

    Attributes:
        edges: x_min y_min x_max y_max (4,) [px]; may reach beyond the image.
        depth_m: Depth of the object in the box [m]; 0 where unknown.
        support: Share of the box at that depth when it was last detected.
    """

    edges: F64
    depth_m: float
    support: float


@dataclass(frozen=True)
class Follower:
    """How a box is tracked.

    Attributes:
        depth_range_m: What lies in a box belongs to it when it is this near to the box's depth [m].
        min_points: Fewest corners whose flow counts.
        min_support: A box is lost when less than this share of its support is left.
    """

    depth_range_m: float
    min_points: int
    min_support: float

    def begin(self, image: Image, edges: F64) -> FollowedBox:
        """Start tracking a box in an image in which it was detected."""
        depth_m = _central_depth(image, edges)
        step_px = _in_pixels(DEPTH_STEP_PX, image)
        inside = image.known_depth_m[_pixels(edges, image)][::step_px, ::step_px]
        support = float(np.mean(self._near(inside, depth_m))) if inside.size and depth_m else 0.0
        return FollowedBox(edges, depth_m, support)

    def follow(self, before: Image, now: Image, box: FollowedBox, drift_px: F64) -> FollowedBox | None:
        """Return the box of the image before in this one; None where it is lost.

        Args:
            before: The image in which the box is known.
            now: A later image of the same size.
            box: The box in the image before.
            drift_px: Predicted motion (2,) [px]; used where there is no flow.
        """
        flow_px = self._flow(before, now, box)
        edges = box.edges + np.tile(drift_px if flow_px is None else flow_px, 2)
        if box.depth_m == 0.0:
            return None if flow_px is None else FollowedBox(edges, 0.0, 0.0)
        step_px = _in_pixels(DEPTH_STEP_PX, now)
        inside = now.known_depth_m[_pixels(edges, now)][::step_px, ::step_px]
        near = self._near(inside, box.depth_m)
        # Something nearer occludes it, and is dynamic too: only a view of the background shows that it left.
        hidden = (inside > 0.0) & (inside < box.depth_m)
        if inside.size == 0 or np.mean(near | hidden) < self.min_support * box.support:
            return None
        return FollowedBox(edges, float(np.median(inside[near])) if near.any() else box.depth_m, box.support)

    def _flow(self, before: Image, now: Image, box: FollowedBox) -> F64 | None:
        """Return the median motion (2,) [px] of the corners that lie in the box at its depth in both images."""
        around, times = _pixels(box.edges, before, _in_pixels(MARGIN_PX, before)), _in_pixels(SHRINK, before)
        old, new = _shrunk(before.gray[around], times), _shrunk(now.gray[around], times)
        mask = self._mask(before, box, around, times)
        if min(old.shape) < FLOW.window_px or not mask.any():
            return None
        start: Any = cv2.goodFeaturesToTrack(old, MAX_CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX, mask=mask)
        if start is None:
            return None
        start = start[:, 0]
        end, is_found = FLOW.follow(old, new, start)
        arrived_px = times * end + np.array([around[1].start, around[0].start])
        good = is_found & self._stays(now, arrived_px, box.depth_m)
        if np.count_nonzero(good) < max(self.min_points, 1):
            return None
        return np.asarray(times * np.median((end - start)[good], axis=0), dtype=np.float64)

    def _mask(self, image: Image, box: FollowedBox, around: tuple[slice, slice], times: int) -> U8:
        """Return where in the shrunk surroundings of a box the object in it is, as cv2 takes it."""
        inside = _pixels(box.edges, image)
        mask = np.zeros((image.height, image.width), dtype=np.uint8)
        mask[inside] = self._near(image.known_depth_m[inside], box.depth_m) if box.depth_m else 1
        rows, columns = (s.stop - s.start for s in around)
        return mask[around][: rows // times * times : times, : columns // times * times : times]

    def _stays(self, now: Image, points_px: Floats, depth_m: float) -> Bool:
        """Return which points (N, 2) lie in the image and, where depth is known, near the depth of the box."""
        nearest = np.rint(points_px)
        within = np.all((nearest >= 0) & (nearest < (now.width, now.height)), axis=1)
        at = values_at(now.known_depth_m, points_px)
        return np.asarray(within & ((at <= 0.0) | (depth_m == 0.0) | self._near(at, depth_m)))

    def _near(self, depth: F32, depth_m: float) -> Bool:
        return np.asarray(np.abs(depth - np.float32(depth_m)) <= self.depth_range_m)


def _central_depth(image: Image, edges: F64) -> float:
    """Return the depth of the object in the middle of a box [m]; 0 where unknown."""
    center, half = 0.5 * (edges[:2] + edges[2:]), 0.5 * CENTRAL_SHARE * (edges[2:] - edges[:2])
    middle = image.known_depth_m[_pixels(np.concatenate([center - half, center + half]), image)]
    known = middle[middle > 0.0]
    return float(np.quantile(known, CENTRAL_QUANTILE)) if known.size else 0.0


def _pixels(edges: F64, image: Image, margin_px: int = 0) -> tuple[slice, slice]:
    """Return the rows and columns of a box in an image; empty where it lies outside."""
    x0, y0, x1, y1 = edges.tolist()
    rows = _span(y0, y1, margin_px, image.height)
    return rows, _span(x0, x1, margin_px, image.width)


def _span(first: float, last: float, margin_px: int, size: int) -> slice:
    start = min(max(math.ceil(first) - margin_px, 0), size)
    return slice(start, min(max(math.floor(last) + 1 + margin_px, start), size))


def _in_pixels(length_px: int, image: Image) -> int:
    """Return a length of images 640 pixels long in this image [px]."""
    return in_pixels(length_px, pixel_scale(image.width, image.height))


def _shrunk(gray: U8, times: int) -> U8:
    """Return an image so many times smaller."""
    height, width = gray.shape[0] // times, gray.shape[1] // times
    if height == 0 or width == 0:
        return np.zeros((0, 0), dtype=np.uint8)
    whole = gray[: times * height, : times * width]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


@dataclass(frozen=True)
class CarryConfig:
    """How boxes are propagated.

    Attributes:
        enabled: Whether boxes are propagated; if not, each image is independent, and the detector sees each.
        every: Stride in images at which the detector runs; in those between, a box reaches from where it was to where
            its velocity leads. An image that is more than 50 ms later than the detector's last is seen anyway.
        max_carried: Largest number of frames over which a box is propagated.
        continue_confidence: Confidence of a detection that continues a track; the detector's full one starts it.
        enter_confidence: Confidence that starts a track where a box touches the left or right border.
        min_iou: Least overlap of a detection with the box that it continues.
        velocity_weight: Share of the newest step in the velocity of a box.
        depth_range_m: Half the depth extent of an object in a box [m].
        min_points: Fewest corners whose flow moves a box; with fewer its velocity is used.
        min_support: A propagated box is dropped when less than this share of its pixels at its depth is left.
        min_visible: A propagated box is dropped when less than this share of it lies in the image.
        max_covered: A propagated box is dropped when it overlaps a detected one by more than this (IoU).
        grow: Share of its width by which every box is enlarged on each side; boxes cut off arms, heads and feet.
    """

    enabled: bool = True
    every: int = bounded(1, least=1)
    max_carried: int = bounded(30, least=0)
    continue_confidence: float = bounded(0.40, least=0, most=1)
    enter_confidence: float = bounded(0.50, least=0, most=1)
    min_iou: float = bounded(0.30, least=0, most=1)
    velocity_weight: float = bounded(0.5, least=0, most=1)
    depth_range_m: float = bounded(0.35, least=0)
    min_points: int = bounded(6, least=0)
    min_support: float = bounded(0.5, least=0, most=1)
    min_visible: float = bounded(0.2, least=0, most=1)
    max_covered: float = bounded(0.6, least=0, most=1)
    grow: float = bounded(0.0, least=0)

    def lowest(self, confidence: float) -> float:
        """Return the lowest confidence that the detector must report, given the one that starts a track."""
        return min(confidence, self.continue_confidence, self.enter_confidence)


@dataclass(eq=False)
class _Track:
    """A box over time; its edges (4,) may reach beyond the image."""

    track_id: int
    edges: F64
    label: str
    confidence: float
    velocity_px: F64 = field(default_factory=lambda: np.zeros(2))
    carried: int = 0
    followed: FollowedBox | None = None

    def predicted(self, frames: int) -> F64:
        """Return the predicted box `frames` frames later (4,) [px]."""
        return self.edges + np.tile(self.velocity_px * frames, 2)

    def move(self, edges: F64, frames: int, weight: float) -> None:
        """Update the box `frames` frames later, and its velocity."""
        step_px = 0.5 * (edges[:2] + edges[2:] - self.edges[:2] - self.edges[2:]) / frames
        self.velocity_px = weight * step_px + (1.0 - weight) * self.velocity_px
        self.edges = edges

    def as_box(self, width: int, height: int, grow: float = 0.0, later: int = 0) -> Box:
        """Return the part in the image, enlarged on each side by a share of its width.

        Args:
            width, height: Of the image [px].
            grow: The share.
            later: Frames since the box was known; it then reaches from where it was to where it is predicted.
        """
        ahead = self.predicted(later)
        edges = np.concatenate((np.minimum(self.edges, ahead)[:2], np.maximum(self.edges, ahead)[2:]))
        more_px = grow * (edges[2] - edges[0])
        x0, y0 = np.clip(edges[:2] - more_px, 0.0, (width - 1, height - 1)).tolist()
        x1, y1 = np.clip(edges[2:] + more_px, 0.0, (width - 1, height - 1)).tolist()
        return Box(x0, y0, x1, y1, self.label, self.confidence, self.carried + later, self.track_id)


class CarriedBoxes:
    """A tracking detector: every box has an identity, and is propagated for a while after its last detection."""

    def __init__(self, detector: Detector, confidence: float, config: CarryConfig, named: Collection[str] = ()) -> None:
        """Take boxes from a detector that reports them from `config.lowest(confidence)` on.

        Args:
            detector: Finds boxes in one image.
            confidence: Confidence that starts a track.
            config: How boxes are propagated.
            named: The detector's classes that are static unless people move them.
        """
        check(config, "carry")
        self.detector = detector
        self._confidence = confidence
        self._enter_confidence = min(confidence, config.enter_confidence)
        self._config = config
        self._named = named
        self._follower = Follower(config.depth_range_m, config.min_points, config.min_support)
        self._tracks: list[_Track] = []
        self._next_id = 0
        self._before: Image | None = None
        self._n_since = 0

    def __call__(self, image: Image) -> Semantics:
        """Return the boxes of this image, detected and propagated."""
        frames = self._frames_since(image)
        if self._is_between(image):
            return self._reported(image, frames)
        found = self.detector.detect(image)
        strong = [box for box in found if self._is_strong(box, image.width)]
        weak = [box for box in found if box not in strong and box.confidence >= self._config.continue_confidence]
        missed, new = self._continue(self._tracks, strong, frames)
        missed, _ = self._continue(missed, weak, frames)
        seen = [track for track in self._tracks if track not in missed] + [self._open(box) for box in new]
        carried = [track for track in missed if self._carry(track, image, frames)]
        self._tracks = seen + self._uncovered(carried, seen)
        self._before = image
        return self._reported(image, 0)

    def _is_between(self, image: Image) -> bool:
        """Return whether the detector need not see an image; count the images that it did not."""
        is_soon = self._before is not None and image.timestamp_s - self._before.timestamp_s <= SOON_S
        self._n_since = (self._n_since + 1) % self._config.every if is_soon else 0
        return self._n_since > 0

    def _reported(self, image: Image, later: int) -> Semantics:
        """Return the boxes in an image, `later` frames after the detector last ran."""
        size = image.width, image.height
        boxes = [track.as_box(*size, self._config.grow, later) for track in self._tracks]
        boxes = [box for box in boxes if box.area_px > 0.0]
        boxes.sort(key=lambda box: (box.carried, -box.confidence, box.track_id))
        return of_boxes(image, boxes, self._named)

    def with_detector(self, detector: Detector) -> "CarriedBoxes":
        """Return the same with another detector, and without memory."""
        return CarriedBoxes(detector, self._confidence, self._config, self._named)

    def _is_strong(self, box: Box, width: int) -> bool:
        """Return whether a box starts a track. People half outside the image have lower confidence."""
        margin_px = ENTRY_SHARE * width
        entering = box.x_min_px <= margin_px or box.x_max_px >= width - 1 - margin_px
        return box.confidence >= (self._enter_confidence if entering else self._confidence)

    def _frames_since(self, image: Image) -> int:
        """Return how many frames after the detector's last image this one is; forget all if it is not a later one."""
        before = self._before
        if before is None:
            return 1
        if image.index <= before.index or image.rgb.shape != before.rgb.shape:
            self._tracks, self._before = [], None
            return 1
        return image.index - before.index

    def _continue(self, tracks: list[_Track], boxes: list[Box], frames: int) -> tuple[list[_Track], list[Box]]:
        """Give each box to the track that it overlaps most; return the tracks and boxes without a partner."""
        if not tracks or not boxes:
            return tracks, boxes
        found = np.array([box.xyxy_px for box in boxes])
        iou = overlap(np.array([track.predicted(frames) for track in tracks]), found)
        iou[[[track.label != box.label for box in boxes] for track in tracks]] = 0.0
        free_tracks, free_boxes = list(range(len(tracks))), list(range(len(boxes)))
        for flat in np.argsort(-iou, axis=None, kind="stable"):
            i, k = divmod(int(flat), len(boxes))
            if iou[i, k] < max(self._config.min_iou, 1e-6):
                break
            if i in free_tracks and k in free_boxes:
                free_tracks.remove(i)
                free_boxes.remove(k)
                tracks[i].move(found[k], frames, self._config.velocity_weight)
                tracks[i].confidence = boxes[k].confidence
                tracks[i].carried = 0
                tracks[i].followed = None
        return [tracks[i] for i in free_tracks], [boxes[k] for k in free_boxes]

    def _open(self, box: Box) -> _Track:
        self._next_id += 1
        return _Track(self._next_id - 1, np.array(box.xyxy_px), box.label, box.confidence)

    def _carry(self, track: _Track, image: Image, frames: int) -> bool:
        """Propagate a missed box to this image; return whether it is kept."""
        before = self._before
        track.carried += frames
        if before is None or track.carried > self._config.max_carried:
            return False
        known = track.followed or self._follower.begin(before, track.edges)
        track.followed = self._follower.follow(before, image, known, track.velocity_px * frames)
        if track.followed is None:
            return False
        full_px = np.prod(track.followed.edges[2:] - track.followed.edges[:2])
        track.move(track.followed.edges, frames, self._config.velocity_weight)
        visible = track.as_box(image.width, image.height).area_px
        return visible >= max(self._config.min_visible * float(full_px), 1.0)

    def _uncovered(self, carried: list[_Track], seen: list[_Track]) -> list[_Track]:
        """Drop propagated boxes that overlap a detected one: it is the same object, detected again."""
        if not carried or not seen:
            return carried
        iou = overlap(np.array([track.edges for track in carried]), np.array([track.edges for track in seen]))
        # A detected chair does not mean that nobody sits on it any more.
        is_named = [np.array([track.label in self._named for track in tracks]) for tracks in (carried, seen)]
        iou[is_named[0][:, None] != is_named[1][None, :]] = 0.0
        return [track for track, most in zip(carried, iou.max(axis=1), strict=True) if most <= self._config.max_covered]
