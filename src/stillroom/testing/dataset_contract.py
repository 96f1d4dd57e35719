"""The contract of every `Dataset`. A data set that passes this in a test may be called supported.

In a test of your own::

    from stillroom.testing.dataset_contract import KnownPixel, check_dataset

    def test_my_dataset():
        check_dataset(MyDataset("..."), KnownPixel(index=0, row=10, column=20, rgb=(200, 30, 30), depth_m=1.5))
"""

from dataclasses import dataclass

import numpy as np

from stillroom.data.image import Image, StereoImage
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import sensor_of
from stillroom.errors import FrameError
from stillroom.geometry.arrays import F32, U8
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset
from stillroom.testing.stereo_rows import disparities_px

SAMPLED_FRAMES = 9
FEWEST_CORNERS, MOST_ROWS_PX = 30, 1.0
"""With fewer corners found in both images of a pair nothing is said of its rows; by how much these may differ [px]."""
PLAUSIBLE_DEPTH_M = (0.05, 60.0)
"""The median depth of a room; millimetres taken for metres, or raw units, lie far outside."""


@dataclass(frozen=True)
class KnownPixel:
    """One pixel whose colour and depth are known independently: only that can detect swapped channels.

    Attributes:
        index: Place of the image in the data set.
        row, column: The pixel.
        rgb: Its colour, red first.
        depth_m: Its depth [m], 0 where unknown; not compared where None.
        colour_tolerance: How far each channel may be off, for lossy images.
    """

    index: int
    row: int
    column: int
    rgb: tuple[int, int, int]
    depth_m: float | None = None
    colour_tolerance: int = 0


def check_dataset(dataset: Dataset, *known_pixels: KnownPixel) -> None:
    """Check that a data set fulfils the contract.

    Reads at most `SAMPLED_FRAMES` different frames, each up to three times.

    Raises:
        AssertionError: It does not; the message says which rule is broken, and where.
    """
    _check_description(dataset)
    _check_borders(dataset)
    places = np.unique(np.linspace(0, len(dataset) - 1, SAMPLED_FRAMES).astype(int)).tolist()
    first_pass = {place: _load(dataset, place) for place in places}
    assert any(image is not None for image in first_pass.values()), "no sampled frame can be loaded"
    for place, image in first_pass.items():
        if image is not None:
            _check_image(dataset, place, image)
    if sensor_of(dataset) is Sensor.STEREO:
        _check_rows(dataset, first_pass)
    _check_repeats(dataset, first_pass)
    _check_iteration(dataset)
    for pixel in known_pixels:
        _check_pixel(dataset, pixel)


def _check_iteration(dataset: Dataset) -> None:
    readable = [place for place in range(min(len(dataset), 3)) if _load(dataset, place) is not None]
    for place, image in zip(readable, dataset, strict=False):
        assert image.index == int(dataset.numbers[place]), f"iterating gives image {image.index} in place {place}"
        assert image.timestamp_s == float(dataset.timestamps_s[place]), f"iterating gives another time in place {place}"


def _check_description(dataset: Dataset) -> None:
    assert dataset.name, "name is empty; the results folder is called by it"
    assert "/" not in dataset.name, f"name '{dataset.name}' has a slash; the results folder is called by it"
    assert dataset.camera_source.strip(), "camera_source is empty; it must say where the calibration comes from"
    assert "\n" not in dataset.camera_source, "camera_source has more than one line"
    assert len(dataset) > 0, "a data set without images must not open"
    times_s = dataset.timestamps_s
    assert isinstance(times_s, np.ndarray), "timestamps_s is no array"
    assert times_s.dtype == np.float64, f"timestamps_s is {times_s.dtype}, not float64"
    assert times_s.shape == (len(dataset),), f"timestamps_s has shape {times_s.shape}, length is {len(dataset)}"
    assert np.all(np.isfinite(times_s)), "a timestamp is not finite"
    assert np.all(np.diff(times_s) > 0), "timestamps_s must strictly increase"
    _check_numbers(dataset)
    _check_groundtruth("groundtruth", dataset.groundtruth)
    _check_groundtruth("groundtruth_at_camera", dataset.groundtruth_at_camera)
    if dataset.groundtruth_at_camera is not None:
        assert dataset.groundtruth is not None, "groundtruth_at_camera without groundtruth; give it as groundtruth"


def _check_numbers(dataset: Dataset) -> None:
    numbers, length = dataset.numbers, dataset.original_length
    assert isinstance(numbers, np.ndarray), "numbers is no array"
    assert numbers.dtype == np.int64, f"numbers is {numbers.dtype}, not int64"
    assert numbers.shape == (len(dataset),), f"numbers has shape {numbers.shape}, length is {len(dataset)}"
    assert np.all(np.diff(numbers) > 0), "numbers must strictly increase"
    assert type(length) is int, f"original_length is a {type(length).__name__}, not int"
    assert numbers[0] >= 0, f"numbers start at {numbers[0]}; the first of the original is 0"
    assert numbers[-1] < length, f"numbers go up to {numbers[-1]}, but original_length is {length}"
    assert type(dataset.is_reversed) is bool, f"is_reversed is a {type(dataset.is_reversed).__name__}, not bool"


def _check_groundtruth(what: str, groundtruth: Trajectory | None) -> None:
    if groundtruth is None:
        return
    assert len(groundtruth) > 0, f"{what} without poses; it must be None then"
    assert groundtruth.T_world_cam.shape == (len(groundtruth), 4, 4), f"{what} poses are not (M, 4, 4)"
    assert np.all(np.diff(groundtruth.timestamps_s) > 0), f"{what} times must strictly increase"
    R = groundtruth.T_world_cam[:, :3, :3]
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-6), f"a {what} rotation is none"


def _check_borders(dataset: Dataset) -> None:
    for index in (-1, len(dataset), len(dataset) + 1000):
        try:
            dataset.load(index)
        except IndexError:
            continue
        except FrameError as error:
            raise AssertionError(f"load({index}) says FrameError; an absent image is an IndexError") from error
        raise AssertionError(f"load({index}) gives an image, of {len(dataset)}; it must raise IndexError")


def _load(dataset: Dataset, place: int) -> Image | None:
    """Load a frame; None for an unusable one, which a data set may have."""
    try:
        return dataset.load(place)
    except FrameError:
        return None


def _check_image(dataset: Dataset, place: int, image: Image) -> None:
    assert image.timestamp_s == dataset.timestamps_s[place], f"image {place} has another time than timestamps_s"
    number = int(dataset.numbers[place])
    assert image.index == number, f"image {place} is numbered {image.index}, but numbers says {number}"
    sensor = sensor_of(dataset)
    assert image.sensor is sensor, f"image {place} is {image.sensor.words}, but the data set says {sensor.words}"
    check_pixels(dataset.camera, place, image)


def _check_rows(dataset: Dataset, images: dict[int, Image | None]) -> None:
    """Check that pairs are rectified: corners lie in one row of both images, and not further right in the right."""
    assert not dataset.camera.is_distorted, "the camera of rectified pairs has a distortion"
    for place, image in images.items():
        off_px = disparities_px(image) if isinstance(image, StereoImage) else np.zeros((0, 2))
        if len(off_px) < FEWEST_CORNERS:
            continue
        across_px, down_px = np.median(off_px[:, 0]), np.median(np.abs(off_px[:, 1]))
        assert down_px <= MOST_ROWS_PX, f"pair {place}: rows differ by {down_px:.1f} px; is it rectified?"
        assert across_px > -MOST_ROWS_PX, f"pair {place}: the right image shows things further right; left for right?"


def check_pixels(camera: Camera, place: int, image: Image) -> None:
    """Check types, sizes and plausibility of what was measured, for an image of a data set or a camera.

    Raises:
        AssertionError: Something is wrong with them.
    """
    size = (camera.height, camera.width)
    assert image.rgb.dtype == np.uint8, f"image {place}: rgb is {image.rgb.dtype}, not uint8"
    assert image.rgb.shape == (*size, 3), f"image {place}: rgb is {image.rgb.shape}, the camera {size}"
    for name, pixels in image.channels.items():
        assert pixels.flags.c_contiguous, f"image {place}: {name} is not contiguous; kernels need it to be"
    if isinstance(image, StereoImage):
        assert image.right.dtype == np.uint8, f"image {place}: right is {image.right.dtype}, not uint8"
        assert image.right.shape == size, f"image {place}: right is {image.right.shape}, the camera {size}"
    if image.has_depth_image:
        _check_depth(size, place, image)
    if image.truth is not None:
        assert (image.truth.height, image.truth.width) == size, f"image {place}: truth is of another size"


def _check_depth(size: tuple[int, int], place: int, image: Image) -> None:
    assert image.depth_m.dtype == np.float32, f"image {place}: depth_m is {image.depth_m.dtype}, not float32"
    assert image.depth_m.shape == size, f"image {place}: depth_m is {image.depth_m.shape}, the camera {size}"
    assert np.all(np.isfinite(image.depth_m)), f"image {place}: depth_m has NaN or infinity; unknown is 0"
    assert np.all(image.depth_m >= 0), f"image {place}: depth_m is negative somewhere; unknown is 0"
    known_m = image.depth_m[image.depth_m > 0]
    if len(known_m):
        low, high = PLAUSIBLE_DEPTH_M
        median_m = float(np.median(known_m))
        assert low < median_m < high, f"image {place}: the median depth is {median_m} m; is the depth factor right?"


@dataclass(frozen=True)
class _Taken:
    """What an image was when it was loaded first, whatever a caller does to its arrays."""

    index: int
    channels: dict[str, U8 | F32]

    @staticmethod
    def of(image: Image) -> "_Taken":
        return _Taken(image.index, {name: channel.copy() for name, channel in image.channels.items()})


def _check_repeats(dataset: Dataset, first_pass: dict[int, Image | None]) -> None:
    """Load again in reverse order, twice each: neither the order nor changes to an image by a caller may matter."""
    copies = {place: image and _Taken.of(image) for place, image in first_pass.items()}
    for place, before in reversed(copies.items()):
        for _ in range(2):
            again = _load(dataset, place)
            assert (again is None) == (before is None), f"image {place} loads at one time and fails at another"
            if again is None or before is None:
                continue
            assert again.index == before.index, f"image {place} changes its number"
            for name, channel in again.channels.items():
                copy = before.channels[name]
                assert np.array_equal(channel, copy), f"image {place}: {name} differs when it is loaded again"
                if channel.flags.writeable:
                    channel[:] = channel + 1


def _check_pixel(dataset: Dataset, known: KnownPixel) -> None:
    image = dataset.load(known.index)
    rgb = image.rgb[known.row, known.column].astype(int)
    where = f"image {known.index}, row {known.row}, column {known.column}"
    off = np.abs(rgb - np.array(known.rgb)).max()
    assert off <= known.colour_tolerance, f"{where}: rgb is {tuple(rgb.tolist())}, not {known.rgb}; is it BGR?"
    if known.depth_m is not None:
        assert image.has_depth_image, f"{where}: there is no depth image, but a depth is known"
        depth_m = float(image.depth_m[known.row, known.column])
        assert np.isclose(depth_m, known.depth_m, rtol=1e-5), f"{where}: depth is {depth_m} m, not {known.depth_m}"
