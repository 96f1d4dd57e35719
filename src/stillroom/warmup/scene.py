"""A made-up scene: a wall that a camera glides along, something that stands before it, and something that moves."""

from collections.abc import Iterator

import cv2
import numpy as np

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box, Semantics
from stillroom.geometry.arrays import F32, U8
from stillroom.geometry.camera import Camera

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_factor=5000.0, bf=40.0)
N_IMAGES = 10
WALL_M, STEP_PX = 2.0, 16
STEP_M = STEP_PX * WALL_M / CAMERA.fx

PILLAR_M, PILLAR_PX = 1.4, 45
"""How near the pillar stands, and half its width."""

PERSON = Box(260.0, 120.0, 380.0, 400.0, "person", confidence=1.0)
PERSON_M = 1.8
"""So near to the wall that what he leaves behind there is looked for. He walks as fast as the camera."""

ROUND = 0.8
"""Depth of what is round, as a share of its width: it must not be taken for a plane."""


def images() -> Iterator[RgbdImage]:
    """Yield the images, with the box that a detector would find."""
    rows = CAMERA.height
    wall = _texture(0, rows, CAMERA.width + STEP_PX * N_IMAGES)
    pillar = _texture(1, rows, 2 * PILLAR_PX)
    person = _texture(2, rows, int(PERSON.x_max_px - PERSON.x_min_px))
    truth = Semantics(CAMERA.height, CAMERA.width, (PERSON,))
    for index in range(N_IMAGES):
        rgb = np.ascontiguousarray(wall[:, index * STEP_PX :][:, : CAMERA.width])
        depth_m = np.full(rgb.shape[:2], WALL_M, dtype=np.float32)
        _put(rgb, depth_m, person, (int(PERSON.x_min_px), int(PERSON.y_min_px)), int(PERSON.y_max_px), PERSON_M)
        left_px = 560 - round(index * STEP_M * CAMERA.fx / PILLAR_M)
        _put(rgb, depth_m, pillar, (left_px, 60), 440, PILLAR_M)
        yield RgbdImage(index, index / 10.0, rgb, depth_m, truth)


def _put(rgb: U8, depth_m: F32, picture: U8, upper_left_px: tuple[int, int], bottom_px: int, nearest_m: float) -> None:
    """Draw something upright and round into an image, in place, as far as it is in it."""
    left, top = upper_left_px
    right = min(left + picture.shape[1], rgb.shape[1])
    across = np.linspace(-1.0, 1.0, picture.shape[1])[: right - left]
    width_m = picture.shape[1] * nearest_m / CAMERA.fx
    rgb[top:bottom_px, left:right] = picture[top:bottom_px, : right - left]
    depth_m[top:bottom_px, left:right] = nearest_m + ROUND * width_m * across**2


def _texture(seed: int, height: int, width: int) -> U8:
    """Return noise (H, W, 3) with corners of every size."""
    rng = np.random.default_rng(seed)
    sizes_px = (8, 16, 32, 64)
    layers = [
        cv2.resize(
            rng.integers(0, 256 // len(sizes_px), (height // size + 1, width // size + 1), dtype=np.uint8),
            (width, height),
            interpolation=cv2.INTER_NEAREST,
        )
        for size in sizes_px
    ]
    gray = np.sum(layers, axis=0).astype(np.uint8)
    return np.repeat(gray[:, :, None], 3, axis=2)
