"""Pixels from disk, against an independent decoder; and files that are none."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from stillroom.datasets.image_sequence import depth_in_metres, read_depth_units, read_rgb
from stillroom.errors import FrameError


@pytest.fixture
def noise() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 255, (40, 60, 3), dtype=np.uint8)


def test_colour_is_red_first(noise: np.ndarray, tmp_path: Path) -> None:
    Image.fromarray(noise).save(tmp_path / "a.png")
    rgb = read_rgb(tmp_path / "a.png")
    assert rgb.dtype == np.uint8
    assert np.array_equal(rgb, noise)


def test_a_gray_image_becomes_three_equal_channels(noise: np.ndarray, tmp_path: Path) -> None:
    Image.fromarray(noise[:, :, 0]).save(tmp_path / "a.png")
    assert np.array_equal(read_rgb(tmp_path / "a.png"), np.repeat(noise[:, :, :1], 3, axis=2))


def test_how_the_camera_was_held_is_ignored(noise: np.ndarray, tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # "turn by 90 degrees to look at it"
    Image.fromarray(noise).save(tmp_path / "a.jpg", exif=exif, quality=95)
    assert read_rgb(tmp_path / "a.jpg").shape == noise.shape


def test_depth_keeps_every_unit(tmp_path: Path) -> None:
    units = np.random.default_rng(2).integers(0, 65535, (40, 60), dtype=np.uint16)
    Image.fromarray(units).save(tmp_path / "d.png")
    came = read_depth_units(tmp_path / "d.png")
    assert np.array_equal(came, units)
    depth_m = depth_in_metres(came, 5000.0)
    assert depth_m.dtype == np.float32
    assert np.allclose(depth_m, units / 5000.0, rtol=1e-6)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_file_that_is_cut_off_is_no_image(suffix: str, noise: np.ndarray, tmp_path: Path) -> None:
    whole = cv2.imencode(suffix, noise)[1].tobytes()
    path = tmp_path / f"a{suffix}"
    for share in (0.5, 0.97):
        path.write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(FrameError, match="cut off"):
            read_rgb(path)


def test_a_jpeg_with_data_after_its_end_is_an_image(noise: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(cv2.imencode(".jpg", noise)[1].tobytes() + b"\0" * 500)
    assert read_rgb(path).shape == noise.shape


@pytest.mark.parametrize("content", [b"", b"not an image", b"\x89PNG\r\n\x1a\n" + b"x" * 100 + b"IEND\xaeB`\x82"])
def test_what_is_no_image_is_said(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(content)
    for read in (read_rgb, read_depth_units):
        with pytest.raises(FrameError, match="does not decode") as caught:
            read(path)
        assert str(path) in str(caught.value)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(FrameError, match="no such image"):
        read_rgb(tmp_path / "absent.png")


def test_8_bit_and_coloured_depth_are_refused(noise: np.ndarray, tmp_path: Path) -> None:
    Image.fromarray(noise[:, :, 0]).save(tmp_path / "gray.png")
    Image.fromarray(noise).save(tmp_path / "colour.png")
    with pytest.raises(FrameError, match=r"gray\.png: 1 channel\(s\) of 8 bits; depth must be one channel of 16"):
        read_depth_units(tmp_path / "gray.png")
    with pytest.raises(FrameError, match=r"colour\.png: 3 channel"):
        read_depth_units(tmp_path / "colour.png")
