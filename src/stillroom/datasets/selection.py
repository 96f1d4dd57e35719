"""A part of a sequence, or one with frames taken away, blacked out or played backwards: `run --frames` and the like."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from stillroom.data.image import Image, RgbdImage
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import DatasetView, unpaired_s
from stillroom.errors import ConfigError
from stillroom.geometry.arrays import F64, I64, Bool
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset


class Selected(DatasetView):
    """A `Dataset` that shows some of another's images.

    Images keep the numbers they have in the original sequence, in `Image.index` and in every range, also when
    selections are stacked. Where they stand here is what `load` counts.
    """

    def __init__(self, inner: Dataset, kept: I64, blackout: Iterable[int] = ()) -> None:
        """Show the images at places `kept` (K,) of `inner`, in this order; those numbered in `blackout` are black."""
        super().__init__(inner)
        self._kept = kept
        self._blackout = frozenset(blackout)
        self._timestamps_s: F64 = np.asarray(inner.timestamps_s, dtype=np.float64)[kept]

    @property
    def timestamps_s(self) -> F64:
        """Times of the images shown (K,) float64 [s]."""
        return self._timestamps_s

    @property
    def unpaired_s(self) -> F64:
        """Times (M,) [s] of images that were left out for want of depth: those between neighbours shown both."""
        times_s, lost_s = np.asarray(self._inner.timestamps_s), unpaired_s(self._inner)
        is_shown = np.zeros(len(times_s), dtype=np.bool_)
        is_shown[self._kept] = True
        after = np.searchsorted(times_s, lost_s)
        before_is_shown = is_shown[np.maximum(after - 1, 0)]
        after_is_shown = is_shown[np.minimum(after, len(times_s) - 1)]
        return lost_s[before_is_shown & after_is_shown]

    @property
    def numbers(self) -> I64:
        """Numbers (K,) of the images shown in the original sequence."""
        return self._inner.numbers[self._kept]

    def __len__(self) -> int:
        """Number of images shown."""
        return len(self._kept)

    def load(self, index: int) -> Image:
        """Return the image at place `index` here, with its original number.

        Raises:
            IndexError: There is no such image.
            FrameError: It cannot be used.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"{self.name}: no image {index} in the selection; there are {len(self)}, from 0")
        image = self._inner.load(int(self._kept[index]))
        return image.black() if image.index in self._blackout else image


class Reversed(DatasetView):
    """A `Dataset` that plays another backwards: times and ground truth are mirrored, so that times increase.

    Depth that was taken after its colour image comes before it. Rows of a rolling shutter would be read upwards, which
    nothing that follows can do, so the camera has no readout.

    Numbers of images, which must increase, count from the end of the original: its last image is number 0.
    """

    def __init__(self, inner: Dataset) -> None:
        """Play `inner` from its last image to its first."""
        super().__init__(inner)
        times_s: F64 = np.asarray(inner.timestamps_s, dtype=np.float64)
        self._mirror_s = float(times_s[0] + times_s[-1])
        self._timestamps_s: F64 = self._mirror_s - times_s[::-1]

    @property
    def camera(self) -> Camera:
        """The calibration, with all rows read at once."""
        return replace(self._inner.camera, readout_s=0.0)

    @property
    def camera_source(self) -> str:
        """One line that says where the calibration comes from, and what became of the readout."""
        as_one = "; played backwards, its rows are read as one" if self._inner.camera.readout_s else ""
        return self._inner.camera_source + as_one

    @property
    def timestamps_s(self) -> F64:
        """Times (N,) float64 [s], mirrored between the first and the last."""
        return self._timestamps_s

    @property
    def unpaired_s(self) -> F64:
        """Mirrored times (M,) [s] of images that were left out for want of depth."""
        return self._mirror_s - unpaired_s(self._inner)[::-1]

    @property
    def groundtruth(self) -> Trajectory | None:
        """True poses at mirrored times."""
        return self._mirrored(self._inner.groundtruth)

    @property
    def groundtruth_at_camera(self) -> Trajectory | None:
        """The same moved to the camera, where they are those of another body."""
        return self._mirrored(self._inner.groundtruth_at_camera)

    @property
    def numbers(self) -> I64:
        """Numbers (N,) of the images, counted from the end of the original."""
        return self.original_length - 1 - self._inner.numbers[::-1]

    @property
    def is_reversed(self) -> bool:
        """Whether the images are played backwards; twice backwards is forwards."""
        return not self._inner.is_reversed

    def load(self, index: int) -> Image:
        """Return the image at place `index` from the end, with the number and the time that it has here.

        Raises:
            IndexError: There is no such image.
            FrameError: It cannot be used.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"{self.name}: no image {index} in the sequence; there are {len(self)}, from 0")
        image = self._inner.load(len(self) - 1 - index)
        number = self.original_length - 1 - image.index
        shown = image.at(number, float(self._timestamps_s[index]))
        return replace(shown, depth_after_s=-shown.depth_after_s) if isinstance(shown, RgbdImage) else shown

    def _mirrored(self, forward: Trajectory | None) -> Trajectory | None:
        if forward is None:
            return None
        return Trajectory(self._mirror_s - forward.timestamps_s[::-1], forward.T_world_cam[::-1])


def select(
    dataset: Dataset,
    frames: str | None = None,
    drop: Iterable[str] = (),
    blackout: Iterable[str] = (),
    reverse: bool = False,
) -> Dataset:
    """Apply the options of a run to a sequence. Each range is `a:b` as Python slices, in original numbers.

    Args:
        dataset: The sequence.
        frames: The images to keep; all where not given.
        drop: Images that do not exist for this run.
        blackout: Images that arrive black, without depth.
        reverse: Whether what is left is played backwards; see `Reversed`.

    Raises:
        ConfigError: A range is malformed, or touches no image that is left at its turn; or nothing is left at all.
    """
    drop, blackout = tuple(drop), tuple(blackout)
    if frames is None and not drop and not blackout:
        return Reversed(dataset) if reverse else dataset
    numbers, length = dataset.numbers, dataset.original_length
    kept = np.ones(len(numbers), dtype=np.bool_)
    if frames is not None:
        kept = _touched("frames", frames, numbers, kept, length)
    for text in drop:
        kept &= ~_touched("drop", text, numbers, kept, length)
    if not kept.any():
        raise ConfigError(f"drop {', '.join(drop)}: leaves no image of '{dataset.name}'; drop fewer")
    black = [_touched("blackout", text, numbers, kept, length) for text in blackout]
    dark = np.any(black, axis=0) if black else np.zeros(len(numbers), dtype=np.bool_)
    selected = Selected(dataset, np.flatnonzero(kept), numbers[dark].tolist())
    return Reversed(selected) if reverse else selected


def parse_range(text: str) -> slice:
    """Read `a:b` or `a:b:step`; either end may be left out or count from the end with a minus.

    Raises:
        ConfigError: It is no such range, or its step is not positive.
    """
    parts = text.split(":")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
    except ValueError:
        numbers = []
    if not 2 <= len(numbers) <= 3:
        raise ConfigError(f"'{text}' is no range of frames; write it like 200:560, :100 or 300:")
    chosen = slice(*numbers)
    if chosen.step is not None and chosen.step <= 0:
        raise ConfigError(f"'{text}': the step of a range of frames must be positive")
    return chosen


def _touched(option: str, text: str, numbers: I64, kept: Bool, length: int) -> Bool:
    """Return which of the kept images (N,) a range touches; a range that touches none is an error."""
    try:
        chosen = parse_range(text)
    except ConfigError as error:
        raise ConfigError(f"{option}: {error}") from None
    inside = np.zeros(length, dtype=np.bool_)
    inside[chosen] = True
    touched: Bool = inside[numbers] & kept
    if not touched.any():
        left = f"{int(numbers[kept][0])} to {int(numbers[kept][-1])}" if kept.any() else "none"
        raise ConfigError(f"{option} {text}: no such image; images left to choose from: {left}")
    return touched
