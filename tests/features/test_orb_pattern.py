"""The comparisons learned from OpenCV's answers, against OpenCV's answers on other images."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.features import orb as orb_pattern_module
from stillroom.features.orb import orb_pattern
from stillroom.features.patches import REACH_PX, describe, orientations, turned_places


def textured(seed: int = 0) -> np.ndarray:
    """An image with structure of several sizes, unlike the noise that the pattern was learned from."""
    rng = np.random.default_rng(seed)
    image = np.full((480, 640), 128.0)
    for sigma_px, contrast in ((1, 30), (3, 90), (9, 300)):
        image += contrast * cv2.GaussianBlur(rng.normal(size=image.shape), (0, 0), sigma_px)
    return np.clip(image, 0, 255).astype(np.uint8)


def opencv_features(image: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """OpenCV's keypoints of one level: positions, angles [rad], descriptors."""
    orb = cv2.ORB.create(1000, nlevels=1)
    keypoints, descriptors = orb.compute(image, orb.detect(image))
    angle_rad = np.deg2rad([keypoint.angle for keypoint in keypoints]).astype(np.float32)
    return np.asarray(cv2.KeyPoint.convert(keypoints), np.float32), angle_rad, descriptors


def opencv_blur(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(image, (7, 7), 2, sigmaY=2, borderType=cv2.BORDER_REFLECT_101)


def box_blur(image: np.ndarray) -> np.ndarray:
    return cv2.blur(cv2.blur(image, (5, 5)), (5, 5))


def agreement(first: np.ndarray, second: np.ndarray) -> float:
    return 1.0 - np.unpackbits(first ^ second).mean()


def described_by_numpy(blurred: np.ndarray, px: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    """The descriptor as Rublee et al. write it: the pattern turned by the exact angle, nearest pixels compared."""
    places = orb_pattern().reshape(-1, 2).astype(np.float64)
    c, s = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    x = px[:, :1].astype(int) + np.rint(places[:, 0] * c - places[:, 1] * s).astype(int)
    y = px[:, 1:].astype(int) + np.rint(places[:, 0] * s + places[:, 1] * c).astype(int)
    values = blurred[y, x]
    return np.packbits(values[:, 0::2] < values[:, 1::2], axis=1, bitorder="little")


def test_the_pattern_has_256_different_comparisons_within_reach() -> None:
    pattern = orb_pattern()
    assert pattern.shape == (256, 4)
    assert pattern.dtype == np.int32
    assert np.abs(pattern).max() == REACH_PX
    assert len(np.unique(pattern, axis=0)) == 256
    assert np.all(np.any(pattern[:, :2] != pattern[:, 2:], axis=1))


def test_the_plain_descriptor_is_opencvs() -> None:
    image = textured()
    px, angle_rad, descriptors = opencv_features(image)
    assert len(px) > 800
    assert agreement(described_by_numpy(opencv_blur(image), px, angle_rad), descriptors) > 0.995


@pytest.mark.parametrize(("blur", "least"), [(opencv_blur, 0.985), (box_blur, 0.94)])
def test_the_kernel_with_its_own_angles_is_close_to_opencv(
    blur: Callable[[np.ndarray], np.ndarray], least: float
) -> None:
    # Orientation, table of turns and pattern together; random descriptors agree in half their bits.
    image = textured(1)
    px, _, descriptors = opencv_features(image)
    own_rad, own = np.zeros(len(px), np.float32), np.zeros((len(px), 32), np.uint8)
    orientations(image, px, own_rad)
    describe(blur(image), px, own_rad, turned_places(orb_pattern()), own)
    assert agreement(own, descriptors) > least


def test_the_kernel_is_close_to_opencv_on_a_real_image(freiburg1: Path) -> None:
    image = cv2.imread(str(sorted((freiburg1 / "rgb").iterdir())[0]), cv2.IMREAD_GRAYSCALE)
    px, angle_rad, descriptors = opencv_features(image)
    assert len(px) > 100
    own = np.zeros((len(px), 32), np.uint8)
    offsets = turned_places(orb_pattern())
    for blurred, least in ((opencv_blur(image), 0.98), (box_blur(image), 0.95)):
        describe(blurred, px, angle_rad, offsets, own)
        assert agreement(own, descriptors) > least


def test_a_pattern_that_opencv_does_not_use_is_noticed() -> None:
    image = textured(2)
    px, angle_rad, descriptors = opencv_features(image)
    offsets = turned_places(np.ascontiguousarray(orb_pattern()[:, [2, 3, 0, 1]]))
    swapped = np.zeros((len(px), 32), np.uint8)
    describe(opencv_blur(image), px, angle_rad, offsets, swapped)
    assert agreement(swapped, descriptors) < 0.1


def test_a_comparison_that_is_found_a_pixel_off_is_moved_into_place() -> None:
    patches = np.random.default_rng(0).integers(0, 256, (3000, (2 * REACH_PX + 1) ** 2)).astype(float)
    true = np.array([200, 411])
    answers = patches[:, true[0]] < patches[:, true[1]]
    for off in ([1, 0], [-27, 28], [0, -26]):
        np.testing.assert_array_equal(orb_pattern_module._sharpened(true + off, patches, answers), true)


def test_a_descriptor_that_is_no_set_of_comparisons_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    patches, bits = orb_pattern_module._answers_on_noise()
    bits[:, 100] = patches.sum(axis=1) > np.median(patches.sum(axis=1))
    monkeypatch.setattr(orb_pattern_module, "_answers_on_noise", lambda: (patches, bits))
    with pytest.raises(AssertionError, match="differs from the expected one"):
        orb_pattern.__wrapped__()
