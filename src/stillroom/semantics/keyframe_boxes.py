"""A detector that sees keyframes only, as Detect-SLAM's does: on every image it would be too slow for its time."""

from collections.abc import Collection

from stillroom.data.image import Image
from stillroom.data.semantics import Semantics, nothing
from stillroom.semantics.detector import Detector, of_boxes


class KeyframeBoxes:
    """Returns the detector's boxes of the first image and of keyframes, and nothing of the images between."""

    def __init__(self, detector: Detector, named: Collection[str] = ()) -> None:
        """Take a detector, and the classes among its own that are static unless people move them."""
        self.detector = detector
        self._named = named
        self._has_begun = False
        self._first: tuple[Image, Semantics] | None = None

    def __call__(self, image: Image) -> Semantics:
        """Return the boxes of the first image, where tracking begins; else nothing."""
        if self._has_begun:
            return nothing(image.height, image.width)
        self._has_begun = True
        self._first = image, self._detected(image)
        return self._first[1]

    def see(self, image: Image) -> Semantics:
        """Return the boxes of an image that becomes a keyframe; the first one is not detected twice."""
        first, self._first = self._first, None
        return first[1] if first is not None and first[0] is image else self._detected(image)

    def with_detector(self, detector: Detector) -> "KeyframeBoxes":
        """Return the same with another detector."""
        return KeyframeBoxes(detector, self._named)

    def _detected(self, image: Image) -> Semantics:
        return of_boxes(image, self.detector.detect(image), self._named)
