"""One image as a sequence delivers it: RGB-D, a stereo pair, or a single image."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import cv2
import numpy as np

from stillroom.data.semantics import Semantics, nothing
from stillroom.data.sensor import Sensor
from stillroom.geometry.arrays import F32, U8

NO_INDEX = -1
"""Index of an image that belongs to no sequence."""


class Image(ABC):
    """A colour image, and what else the sensor gives at that moment; one of the three kinds below.

    What works for all of them takes an `Image`, and asks for what an image has (`has_depth_image`), not for its kind.

    Attributes:
        sensor: What kind of camera took it.
        timestamp_s: Time of the colour image [s].
        rgb: Colours (H, W, 3) uint8, RGB order, as taken (distorted) but for stereo pairs; three times the same where
            the camera sees no colours.
        index: Place of the image in its sequence, from 0; `Slam.process` counts images that have none.
        name: Name of its colour file without folder and suffix; "" for an image that never was a file.
        truth: The renderer's exact boxes and masks; None on real data.
        depth_after_s: How long after the colour image depth was taken, as far as is known [s]; negative where before.
            It contains the camera's `depth_offset_s`, and counts where that is not 0, or with `tracking.depth.in_time`.
    """

    sensor: ClassVar[Sensor]
    timestamp_s: float
    rgb: U8
    index: int
    name: str
    truth: Semantics | None
    depth_after_s: float = 0.0

    @property
    @abstractmethod
    def channels(self) -> dict[str, U8 | F32]:
        """All that the sensor measured, by the names of the attributes; each (H, W, …) on its pixels."""

    @property
    @abstractmethod
    def has_depth_image(self) -> bool:
        """Whether `depth_m` is there."""

    # Not a property: this one gives way to the field of a kind that stores its depth.
    @cached_property
    def depth_m(self) -> F32:
        """Depth (H, W) float32 [m] on the colour pixels; 0 where unknown.

        Raises:
            TypeError: The image has none (`has_depth_image`); parts that need one are not built for such a sensor.
        """
        raise TypeError(f"a {self.sensor.words} image has no depth image; what needs one must not be built for it")

    @cached_property
    def known_depth_m(self) -> F32:
        """Depth (H, W) float32 [m] for what only adds to its evidence: 0, unknown, where there is no depth image."""
        return self.depth_m if self.has_depth_image else np.zeros((self.height, self.width), dtype=np.float32)

    @abstractmethod
    def at(self, index: int, timestamp_s: float) -> Self:
        """Return the same image with another number and time [s]; what was computed of it is not there any more."""

    @abstractmethod
    def without_depth(self) -> Self:
        """Return the same colours, of which the sensor measured no depth."""

    @abstractmethod
    def black(self) -> Self:
        """Return the image that the sensor takes in darkness: black, of unknown depth, and empty in truth."""

    @cached_property
    def gray(self) -> U8:
        """Brightness (H, W) uint8."""
        return np.asarray(cv2.cvtColor(self.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)

    def shrunk(self, times: int) -> U8:
        """Return the brightness so many times smaller, made once: blocks of pixels, averaged.

        Pixel x of the small image has its centre at times·x + (times − 1)/2 of the large one.
        """
        known = self._shrunk.get(times)
        if known is None:
            size = self.width // times, self.height // times
            cut = self.gray[: size[1] * times, : size[0] * times]
            known = np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
            self._shrunk[times] = known
        return known

    @cached_property
    def _shrunk(self) -> dict[int, U8]:
        return {}

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.rgb.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.rgb.shape[1])

    def _black_truth(self) -> Semantics | None:
        return None if self.truth is None else nothing(self.height, self.width)


@dataclass(frozen=True)
class RgbdImage(Image):
    """A colour image with registered depth.

    Attributes:
        timestamp_s, rgb, index, name, truth, depth_after_s: See `Image`.
        depth_m: Depth (H, W) float32 [m] on the colour pixels; 0 where unknown.
    """

    sensor = Sensor.RGBD
    has_depth_image = True

    timestamp_s: float
    rgb: U8 = field(repr=False)
    depth_m: F32 = field(repr=False)
    index: int = NO_INDEX
    name: str = ""
    truth: Semantics | None = field(default=None, repr=False)
    depth_after_s: float = 0.0

    @property
    def channels(self) -> dict[str, U8 | F32]:
        """Colours and depth."""
        return {"rgb": self.rgb, "depth_m": self.depth_m}

    def at(self, index: int, timestamp_s: float) -> Self:
        """Return the same image with another number and time [s]."""
        return replace(self, index=index, timestamp_s=timestamp_s)

    def without_depth(self) -> Self:
        """Return the same colours, of unknown depth."""
        return replace(self, depth_m=np.zeros_like(self.depth_m))

    def black(self) -> Self:
        """Return a black image of unknown depth."""
        return replace(self.without_depth(), rgb=np.zeros_like(self.rgb), truth=self._black_truth())


@dataclass(frozen=True)
class StereoImage(Image):
    """The left image of a rectified pair with its right one: what both see lies in the same row of both.

    Attributes:
        timestamp_s, rgb, index, name, truth: See `Image`; `rgb` is the rectified left image, free of distortion.
        right: Brightness (H, W) uint8 of the rectified right image, taken at the same moment.
        depth_of_pair: Waits for the depth image (H, W) float32 [m] on the left pixels, 0 where unknown, where one is
            made of the pair (`stereo.dense`); None otherwise.
    """

    sensor = Sensor.STEREO

    timestamp_s: float
    rgb: U8 = field(repr=False)
    right: U8 = field(repr=False)
    index: int = NO_INDEX
    name: str = ""
    truth: Semantics | None = field(default=None, repr=False)
    depth_of_pair: Callable[[], F32] | None = field(default=None, repr=False, compare=False)

    @property
    def has_depth_image(self) -> bool:
        """Whether a depth image is made of the pair."""
        return self.depth_of_pair is not None

    @cached_property
    def depth_m(self) -> F32:
        """The depth image that is made of the pair (H, W) float32 [m]; waits for it.

        Raises:
            TypeError: None is made.
        """
        if self.depth_of_pair is None:
            raise TypeError("no depth image is made of this stereo pair; what needs one must not be built for it")
        return self.depth_of_pair()

    @property
    def channels(self) -> dict[str, U8 | F32]:
        """Colours of the left image and brightness of the right one; the depth image is made of them."""
        return {"rgb": self.rgb, "right": self.right}

    def at(self, index: int, timestamp_s: float) -> Self:
        """Return the same pair with another number and time [s]."""
        return replace(self, index=index, timestamp_s=timestamp_s)

    def without_depth(self) -> Self:
        """Return the same left image with a black right one."""
        return replace(self, right=np.zeros_like(self.right), depth_of_pair=None)

    def black(self) -> Self:
        """Return two black images."""
        return replace(self.without_depth(), rgb=np.zeros_like(self.rgb), truth=self._black_truth())


@dataclass(frozen=True)
class MonoImage(Image):
    """A single image.

    Attributes:
        timestamp_s, rgb, index, name, truth: See `Image`.
    """

    sensor = Sensor.MONOCULAR
    has_depth_image = False

    timestamp_s: float
    rgb: U8 = field(repr=False)
    index: int = NO_INDEX
    name: str = ""
    truth: Semantics | None = field(default=None, repr=False)

    @property
    def channels(self) -> dict[str, U8 | F32]:
        """The colours."""
        return {"rgb": self.rgb}

    def at(self, index: int, timestamp_s: float) -> Self:
        """Return the same image with another number and time [s]."""
        return replace(self, index=index, timestamp_s=timestamp_s)

    def without_depth(self) -> Self:
        """Return the image: it has no depth."""
        return self

    def black(self) -> Self:
        """Return a black image."""
        return replace(self, rgb=np.zeros_like(self.rgb), truth=self._black_truth())
