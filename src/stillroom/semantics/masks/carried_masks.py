"""Mask propagation for a slow network: it runs on every n-th image, and its result is available some images later."""

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.data.image import Image
from stillroom.protocols import Pending, Schedule
from stillroom.schedule import InOrder, Worker
from stillroom.semantics.masks.mask_segments import HalfImage, MaskSegments
from stillroom.semantics.masks.refine import RefineConfig, refined

log = logging.getLogger(__name__)

See = Callable[[Image, HalfImage], MaskSegments]


# Propagate a mask from the image in which it is known to a later one: by dense flow, gated by depth.
#
# NGD-SLAM's mask propagation does the same (docs/reference.md#ngd-slam): erode, follow one corner in each
# cell of 15 px by flow, take what is within ±0.3 m of their median depth. Differs from it: dense inverse-search flow
# (Kroeger et al., ECCV 2016) from image to image, with the border refined by depth at each step. It needs no corners,
# so it works on untextured clothes; and the mask keeps its shape, also where people occlude each other.


@dataclass(frozen=True)
class MaskCarryConfig:
    """How masks are propagated.

    Attributes:
        depth_step_m: A pixel whose depth changes by more than this between images belongs to another object [m].
    """

    depth_step_m: float = bounded(0.30, above=0)


def carried(segments: MaskSegments, earlier: HalfImage, now: HalfImage, config: MaskCarryConfig) -> MaskSegments:
    """Return the segments propagated to the next image.

    Args:
        segments: Those of an earlier image.
        earlier: That image.
        now: The next image, of the same size.
        config: How far depth may change between them.
    """
    if not segments.has_any and segments.named is None:
        return segments
    flow_px = now.flow_to(earlier)
    rows, columns = np.indices(now.shape, dtype=np.float32)
    x, y = columns + flow_px[..., 0], rows + flow_px[..., 1]
    label = cv2.remap(segments.label, x, y, cv2.INTER_NEAREST, borderValue=0)
    likely = cv2.remap(segments.probability, x, y, cv2.INTER_LINEAR, borderValue=0)
    before_m = cv2.remap(earlier.depth_m, x, y, cv2.INTER_NEAREST, borderValue=0)
    known = (before_m > 0) & (now.depth_m > 0)
    other = known & (np.abs(now.depth_m - before_m) > config.depth_step_m)
    label[other] = 0
    named = segments.named
    if named is not None:
        named = np.asarray(cv2.remap(named, x, y, cv2.INTER_NEAREST, borderValue=0), dtype=np.uint8)
        named[other] = 0
    found = MaskSegments(np.asarray(label, dtype=np.uint8), np.asarray(likely, dtype=np.float32), named)
    return replace(found, things=segments.things)


@dataclass(frozen=True)
class KnownImage:
    """The segments of an image, from the network or propagated.

    Attributes:
        segments: What is potentially dynamic in it.
        age: How many images ago the network saw it; 0 where it saw this one.
    """

    segments: MaskSegments
    age: int


@dataclass(frozen=True)
class _Answer:
    seen_at: int
    segments: Pending[MaskSegments]


NOTHING_YET = KnownImage(MaskSegments(np.zeros((0, 0), np.uint8), np.zeros((0, 0), np.float32)), 0)


MOST_RECENT = 256
"""How many images are kept at most while the network works on an older one; a result still older is dropped."""


class LateMasks:
    """Runs a network at a stride or as often as it keeps up, delays its results, and propagates them to the present."""

    def __init__(
        self,
        see: See,
        every: int,
        latency_frames: int,
        carry: MaskCarryConfig,
        refine: RefineConfig,
        schedule: Schedule | None = None,
    ) -> None:
        """Start without images.

        Args:
            see: The network: what is potentially dynamic in an image.
            every: Stride in images at which it runs. One that is late runs at one image more, and sees no image while
                it works on another.
            latency_frames: How many images later its result is available. The first is waited for: a map must not start
                with people.
            carry: How masks are propagated.
            refine: How their borders are refined, there and at each step to the present.
            schedule: Runs the network; at once by default.
        """
        self._see = see
        self._every = every
        self._latency = latency_frames
        self._carry = carry
        self._refine = refine
        self._schedule = schedule or InOrder()
        self._recent: deque[HalfImage] = deque()
        self._waiting: deque[_Answer] = deque()
        self._known = NOTHING_YET
        self._count = -1
        self._asked_at = -every
        self._is_late = False

    def __call__(self, image: Image) -> KnownImage:
        """Return the segments of an image; images come in order, and a step back resets."""
        view = HalfImage.of(image)
        if self._recent and (view.index <= self._recent[-1].index or view.shape != self._recent[-1].shape):
            self._forget()
        self._recent.append(view)
        self._count += 1
        now = self._count
        if now - self._asked_at >= self._stride and all(answer.segments.done() for answer in self._waiting):
            self._asked_at = now
            self._waiting.append(_Answer(now, self._schedule.submit(Worker.NETWORK, self._seen, image, view)))
        arrived = None
        while self._waiting and (now == 0 or self._has_come(self._waiting[0])):
            arrived = self._waiting.popleft()
        if arrived is not None and now - arrived.seen_at >= len(self._recent):
            log.warning("the network needs %d images for one; its masks are too old to be used", now - arrived.seen_at)
            arrived = None
        if arrived is not None:
            self._is_late = now - arrived.seen_at > self._latency
            self._known = KnownImage(self._to_the_present(arrived), now - arrived.seen_at)
        else:
            self._known = KnownImage(self._one_step(self._known.segments, -1), self._known.age + 1)
        self._drop_old_images()
        return self._known

    def _forget(self) -> None:
        self._recent.clear()
        self._waiting.clear()
        self._known = NOTHING_YET
        self._count, self._asked_at, self._is_late = -1, -self._every, False

    @property
    def _stride(self) -> int:
        """Stride in images at which the network runs now: one more where its last result was late."""
        return self._every + self._is_late

    def _seen(self, image: Image, view: HalfImage) -> MaskSegments:
        """Return what the network sees in an image, with refined borders."""
        return refined(self._see(image, view), view.depth_m, self._refine)

    def _has_come(self, answer: _Answer) -> bool:
        return answer.segments.done() and answer.seen_at + self._latency <= self._count

    def _drop_old_images(self) -> None:
        """Keep the images that a result may still have to pass: those since the oldest that the network works on."""
        behind = max((self._count - answer.seen_at for answer in self._waiting), default=0)
        while len(self._recent) > min(max(self._latency, behind) + 2, MOST_RECENT):
            self._recent.popleft()

    def _to_the_present(self, answer: _Answer) -> MaskSegments:
        segments = answer.segments.result()
        for back in range(self._count - answer.seen_at, 0, -1):
            segments = self._one_step(segments, -back)
        return segments

    def _one_step(self, segments: MaskSegments, place: int) -> MaskSegments:
        """Propagate segments to one of the recent images from the one before it."""
        earlier, now = self._recent[place - 1], self._recent[place]
        return refined(carried(segments, earlier, now, self._carry), now.depth_m, self._refine)
