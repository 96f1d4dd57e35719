"""Carry boxes on over the frames in which the detector misses them.

A person at the edge of the image, half hidden or blurred is missed for some frames; features on a missed person are
taken for static, which decides results: CFP-SLAM without such compensation is five times worse
(docs/reference.md#cfp-slam).
"""

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box, Semantics
from stillroom.geometry.arrays import F64
from stillroom.semantics.box_flow import FollowedBox, Follower
from stillroom.semantics.boxes import overlap
from stillroom.semantics.detector import Detector, of_boxes

ENTRY_SHARE = 0.025  # of the image's width: a box that comes so near to the border touches it


@dataclass(frozen=True)
class CarryConfig:
    """How boxes are carried on.

    Attributes:
        enabled: Whether at all; without it each image stands alone.
        max_carried: For how many frames a box outlives its last detection.
        continue_confidence: A box once found at the detector's full confidence goes on with this one.
        enter_confidence: From here on a box is believed at once where it touches the left or right border.
        min_iou: Least overlap of a detection with the box that it continues.
        velocity_weight: Share of the newest step in the velocity of a box.
        depth_range_m: Half the depth that a thing in a box takes up [m].
        min_points: Fewest corners whose flow moves a box; with fewer its velocity does.
        min_support: A carried box is dropped when less than this share of its pixels at its depth is left.
        min_visible: A carried box is dropped when less than this share of it lies in the image.
        max_covered: A carried box is dropped when it overlaps a detected one by more than this (IoU).
        grow: By what share of its width every box is grown on each side; boxes cut off arms, heads and feet.
    """

    enabled: bool = True
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
        """Return the confidence from which the detector must report boxes, for a box to be believed at another."""
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
        """Return the box so many frames later (4,) [px]."""
        return self.edges + np.tile(self.velocity_px * frames, 2)

    def move(self, edges: F64, frames: int, weight: float) -> None:
        """Put the box where it is so many frames later, and learn its velocity."""
        step_px = 0.5 * (edges[:2] + edges[2:] - self.edges[:2] - self.edges[2:]) / frames
        self.velocity_px = weight * step_px + (1.0 - weight) * self.velocity_px
        self.edges = edges

    def as_box(self, width: int, height: int, grow: float = 0.0) -> Box:
        """Return the part of it, grown on each side by a share of its width, that lies in the image."""
        more_px = grow * (self.edges[2] - self.edges[0])
        x0, y0 = np.clip(self.edges[:2] - more_px, 0.0, (width - 1, height - 1)).tolist()
        x1, y1 = np.clip(self.edges[2:] + more_px, 0.0, (width - 1, height - 1)).tolist()
        return Box(x0, y0, x1, y1, self.label, self.confidence, self.carried, self.track_id)


class CarriedBoxes:
    """A detector with a memory: every box has an identity, and outlives its last detection for a while."""

    def __init__(self, detector: Detector, confidence: float, config: CarryConfig, named: Collection[str] = ()) -> None:
        """Take boxes from a detector that reports them from `config.lowest(confidence)` on.

        Args:
            detector: Finds boxes in one image.
            confidence: From here on a box is believed at once.
            config: How boxes are carried on.
            named: The detector's classes that stand still unless somebody moves them.
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
        self._before: RgbdImage | None = None

    def __call__(self, image: RgbdImage) -> Semantics:
        """Return the boxes of this image, and those that are believed to be there still."""
        found = self.detector.detect(image)
        strong = [box for box in found if self._is_strong(box, image.width)]
        weak = [box for box in found if box not in strong and box.confidence >= self._config.continue_confidence]
        frames = self._frames_since(image)
        missed, new = self._continue(self._tracks, strong, frames)
        missed, _ = self._continue(missed, weak, frames)
        seen = [track for track in self._tracks if track not in missed] + [self._open(box) for box in new]
        carried = [track for track in missed if self._carry(track, image, frames)]
        self._tracks = seen + self._uncovered(carried, seen)
        self._before = image
        boxes = [track.as_box(image.width, image.height, self._config.grow) for track in self._tracks]
        boxes.sort(key=lambda box: (box.carried, -box.confidence, box.track_id))
        return of_boxes(image, boxes, self._named)

    def with_detector(self, detector: Detector) -> "CarriedBoxes":
        """Return the same with another detector, and without memory."""
        return CarriedBoxes(detector, self._confidence, self._config, self._named)

    def _is_strong(self, box: Box, width: int) -> bool:
        """Return whether a box is believed at once. People half outside the image look like less than people."""
        margin_px = ENTRY_SHARE * width
        entering = box.x_min_px <= margin_px or box.x_max_px >= width - 1 - margin_px
        return box.confidence >= (self._enter_confidence if entering else self._confidence)

    def _frames_since(self, image: RgbdImage) -> int:
        """Return how many frames after the last image this one is; forget all boxes if it does not follow it."""
        before = self._before
        if before is None:
            return 1
        if image.index <= before.index or image.rgb.shape != before.rgb.shape:
            self._tracks = []
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

    def _carry(self, track: _Track, image: RgbdImage, frames: int) -> bool:
        """Move a missed box to this image; tell whether it is still believed."""
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
        """Drop carried boxes that stand where a detected one does: it is the same thing, found again."""
        if not carried or not seen:
            return carried
        iou = overlap(np.array([track.edges for track in carried]), np.array([track.edges for track in seen]))
        # A chair that is found does not mean that nobody sits on it any more.
        is_named = [np.array([track.label in self._named for track in tracks]) for tracks in (carried, seen)]
        iou[is_named[0][:, None] != is_named[1][None, :]] = 0.0
        return [track for track, most in zip(carried, iou.max(axis=1), strict=True) if most <= self._config.max_covered]
