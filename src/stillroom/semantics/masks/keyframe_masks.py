"""Masks of a network that sees keyframes only, propagated to the images between.

The segmentation threads of PSPNet-SLAM (Figure 2) and Detect-SLAM do so. Which images become keyframes is known after
they were tracked, and on a live schedule later images have been called by then.
"""

from collections import deque

from stillroom.data.image import Image
from stillroom.protocols import Schedule
from stillroom.schedule import InOrder, Worker
from stillroom.semantics.masks.carried_masks import KnownImage, MaskCarryConfig, See, carried
from stillroom.semantics.masks.mask_segments import HalfImage, MaskSegments
from stillroom.semantics.masks.refine import RefineConfig, refined

KEPT = 32
"""How many images are kept for the masks of a keyframe to pass; more than any schedule begins ahead."""


class AskedMasks:
    """Runs a network on the first image and on those that it is told to see; propagates the last result."""

    def __init__(
        self, see: See, carry: MaskCarryConfig, refine: RefineConfig, schedule: Schedule | None = None
    ) -> None:
        """Start without images.

        Args:
            see: The network: what is potentially dynamic in an image.
            carry: How masks are propagated.
            refine: How their borders are refined, there and at each step to the present.
            schedule: Runs the network; at once by default.
        """
        self._see, self._carry, self._refine = see, carry, refine
        self._schedule = schedule or InOrder()
        self._recent: deque[HalfImage] = deque(maxlen=KEPT)
        self._known: KnownImage | None = None
        self._seen: tuple[Image, KnownImage] | None = None

    def __call__(self, image: Image) -> KnownImage:
        """Return the segments of an image; images come in order, and a step back resets."""
        view = HalfImage.of(image)
        if self._recent and (view.index <= self._recent[-1].index or view.shape != self._recent[-1].shape):
            self._recent.clear()
            self._known = self._seen = None
        self._recent.append(view)
        if self._known is None:
            self._known = self._found(image, view)
        else:
            earlier = self._recent[-2]
            self._known = KnownImage(self._one_step(self._known.segments, earlier, view), self._known.age + 1)
        return self._known

    def see(self, image: Image) -> KnownImage:
        """Run the network on an image that was called, unless it has seen it; later images start from its result."""
        if self._seen is not None and self._seen[0] is image:
            return self._seen[1]
        views = list(self._recent)
        place = next((k for k, view in enumerate(views) if view.index == image.index), None)
        if place is None:
            # So many images were called since that this one is dropped: its masks stay its own.
            return self._found(image, HalfImage.of(image))
        found = self._found(image, views[place])
        segments, later = found.segments, views[place + 1 :]
        for earlier, view in zip(views[place:], later, strict=False):
            segments = self._one_step(segments, earlier, view)
        self._known = KnownImage(segments, len(later))
        return found

    def _found(self, image: Image, view: HalfImage) -> KnownImage:
        """Return what the network finds in an image, with refined borders; kept for a second question."""
        segments = self._schedule.submit(Worker.NETWORK, self._see, image, view).result()
        found = KnownImage(refined(segments, view.depth_m, self._refine), 0)
        self._seen = image, found
        return found

    def _one_step(self, segments: MaskSegments, earlier: HalfImage, now: HalfImage) -> MaskSegments:
        return refined(carried(segments, earlier, now, self._carry), now.depth_m, self._refine)
