"""The three kinds of image: what each has, and what all can be asked for."""

import numpy as np
import pytest

from stillroom.data.image import Image, MonoImage, RgbdImage, StereoImage
from stillroom.data.semantics import Box, Semantics
from stillroom.data.sensor import Sensor, sensor_called
from stillroom.errors import ConfigError

RGB = np.random.default_rng(0).integers(1, 255, (12, 16, 3), dtype=np.uint8)
DEPTH_M = np.full((12, 16), 1.5, np.float32)
RIGHT = RGB[..., 0].copy()
TRUTH = Semantics(12, 16, (Box(0.0, 0.0, 3.0, 3.0, "person", 1.0),))


def every_kind() -> list[Image]:
    return [
        RgbdImage(1.0, RGB, DEPTH_M, 3, "a", TRUTH),
        StereoImage(1.0, RGB, RIGHT, 3, "a", TRUTH),
        StereoImage(1.0, RGB, RIGHT, 3, "a", TRUTH, depth_of_pair=lambda: DEPTH_M),
        MonoImage(1.0, RGB, 3, "a", TRUTH),
    ]


@pytest.mark.parametrize("image", every_kind(), ids=lambda image: f"{image.sensor}-{image.has_depth_image}")
def test_all_kinds_can_be_asked_the_same(image: Image) -> None:
    assert (image.height, image.width) == (12, 16)
    assert image.gray.shape == (12, 16)
    assert image.shrunk(2).shape == (6, 8)
    assert next(iter(image.channels)) == "rgb"
    moved = image.at(7, 2.0)
    assert (moved.index, moved.timestamp_s, moved.name, type(moved)) == (7, 2.0, "a", type(image))
    np.testing.assert_array_equal(moved.known_depth_m, image.known_depth_m)
    assert image.known_depth_m.dtype == np.float32
    assert image.known_depth_m.any() == image.has_depth_image
    blind = image.without_depth()
    assert not blind.known_depth_m.any()
    np.testing.assert_array_equal(blind.rgb, RGB)
    assert blind.has_depth_image == (image.sensor is Sensor.RGBD)
    black = image.black()
    assert all(not channel.any() for channel in black.channels.values())
    assert black.truth is not None
    assert not black.truth.boxes
    assert image.rgb.any()
    assert image.truth is TRUTH


def test_only_what_has_a_depth_image_gives_one() -> None:
    rgbd, sparse, dense, mono = every_kind()
    assert rgbd.depth_m is DEPTH_M
    assert dense.depth_m is DEPTH_M
    for image in (sparse, mono):
        with pytest.raises(TypeError, match="what needs one must not be built for it"):
            _ = image.depth_m


def test_sensors_are_called_by_their_names() -> None:
    assert [sensor_called(name) for name in ("rgbd", "stereo", "monocular")] == list(Sensor)
    assert [sensor.is_metric for sensor in Sensor] == [True, True, False]
    with pytest.raises(ConfigError, match="sensor is 'rgb-d'; it must be one of rgbd, stereo, monocular"):
        sensor_called("rgb-d")
