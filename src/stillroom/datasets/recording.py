"""Base classes of data sets: a whole recording, and a view of another data set."""

import logging
from collections.abc import Iterator
from typing import cast

import numpy as np

from stillroom.data.image import Image
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.errors import FrameError
from stillroom.geometry.arrays import F64, I64
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset, KnownScene, Origin, RenderedDataset

log = logging.getLogger(__name__)


def readable_images(dataset: Dataset) -> Iterator[Image]:
    """Yield the images of a data set in order; those that cannot be used are left out with a warning each."""
    for place in range(len(dataset)):
        try:
            image = dataset.load(place)
        except FrameError as error:
            log.warning("image %d is left out: %s", int(dataset.numbers[place]), error)
        else:
            yield image


def unpaired_s(dataset: Dataset) -> F64:
    """Return times (M,) [s] of colour images that were recorded and left out, as no depth image belongs to them.

    A data set that is not built on `Recording` need not know of any.
    """
    return np.asarray(getattr(dataset, "unpaired_s", ()), dtype=np.float64)


def sensor_of(origin: Origin) -> Sensor:
    """Return what kind of camera takes the images; RGB-D where a data set not built on `Recording` does not say it."""
    return Sensor(getattr(origin, "sensor", Sensor.RGBD))


def groundtruth_flaw(dataset: Origin) -> str:
    """Return why the ground truth that lies with a data set cannot be used; empty where it can, or there is none."""
    return str(getattr(dataset, "groundtruth_flaw", ""))


class Recording:
    """Base of a `Dataset` that is a whole sequence. A subclass provides four attributes and `load`.

    It has no ground truth unless a subclass gives some, and its images are numbered from 0 in their order.

    Attributes:
        name: Short name, used for the results folder.
        sensor: What kind of camera takes the images; RGB-D unless a subclass says otherwise.
        camera: The calibration in force; that of the rectified left images of stereo pairs.
        camera_source: One line that says where the calibration comes from.
        timestamps_s: Times of the colour images (N,) float64 [s], strictly increasing.
        groundtruth: True poses as the data set gives them.
        groundtruth_at_camera: The same moved to the camera, where the given ones are those of another body.
        is_reversed: Whether the images are played backwards; a recording is played as it was taken.
        unpaired_s: Times (M,) [s] of colour images that were recorded and left out, as no depth image belongs to them.
        groundtruth_flaw: Why the ground truth that lies with the images cannot be used; empty where it can, or where
            there is none.
    """

    name: str
    camera: Camera
    camera_source: str
    timestamps_s: F64
    sensor: Sensor = Sensor.RGBD
    groundtruth: Trajectory | None = None
    groundtruth_at_camera: Trajectory | None = None
    is_reversed: bool = False
    unpaired_s: F64 = np.zeros(0)
    groundtruth_flaw: str = ""

    @property
    def numbers(self) -> I64:
        """Numbers (N,) of the images: their places."""
        return np.arange(len(self), dtype=np.int64)

    @property
    def original_length(self) -> int:
        """Number of images of the original sequence, which is this one."""
        return len(self)

    def __len__(self) -> int:
        """Number of images."""
        return len(self.timestamps_s)

    def __iter__(self) -> Iterator[Image]:
        """Yield the images in order; those that cannot be used are left out with a warning each."""
        return readable_images(cast(Dataset, self))


def rendered(dataset: Dataset) -> RenderedDataset | None:
    """Return the rendered sequence that a data set is or shows a part of; None where it is none."""
    while isinstance(dataset, DatasetView):
        dataset = dataset.inner
    return cast(RenderedDataset, dataset) if isinstance(dataset, KnownScene) else None


class DatasetView:
    """Base of a `Dataset` that shows another one: it delegates to the other, except for what a subclass overrides."""

    def __init__(self, inner: Dataset) -> None:
        """Show `inner`."""
        self._inner = inner

    @property
    def inner(self) -> Dataset:
        """The data set that is shown."""
        return self._inner

    @property
    def name(self) -> str:
        """Name of the original."""
        return self._inner.name

    @property
    def sensor(self) -> Sensor:
        """What kind of camera takes the images."""
        return sensor_of(self._inner)

    @property
    def camera(self) -> Camera:
        """The calibration in force."""
        return self._inner.camera

    @property
    def camera_source(self) -> str:
        """Where the calibration comes from."""
        return self._inner.camera_source

    @property
    def timestamps_s(self) -> F64:
        """Times of the images (N,) float64 [s]."""
        return self._inner.timestamps_s

    @property
    def unpaired_s(self) -> F64:
        """Times (M,) [s] of colour images in this stretch that were left out for want of depth."""
        return unpaired_s(self._inner)

    @property
    def groundtruth_flaw(self) -> str:
        """Why the ground truth that lies with the images cannot be used; empty where it can, or there is none."""
        return groundtruth_flaw(self._inner)

    @property
    def groundtruth(self) -> Trajectory | None:
        """True poses of the whole original."""
        return self._inner.groundtruth

    @property
    def groundtruth_at_camera(self) -> Trajectory | None:
        """The same moved to the camera, where they are those of another body."""
        return self._inner.groundtruth_at_camera

    @property
    def numbers(self) -> I64:
        """Numbers (N,) of the images in the original sequence."""
        return self._inner.numbers

    @property
    def original_length(self) -> int:
        """Number of images of the original sequence."""
        return self._inner.original_length

    @property
    def is_reversed(self) -> bool:
        """Whether the images are played backwards."""
        return self._inner.is_reversed

    def __len__(self) -> int:
        """Number of images."""
        return len(self._inner)

    def __iter__(self) -> Iterator[Image]:
        """Yield the images in order; those that cannot be used are left out with a warning each."""
        return readable_images(self)

    def load(self, index: int) -> Image:
        """Return image `index`.

        Raises:
            IndexError: There is no such image.
            FrameError: It cannot be used.
        """
        return self._inner.load(index)
