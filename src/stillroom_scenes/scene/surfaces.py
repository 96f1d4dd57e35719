"""Textures of large surfaces: plaster, carpet, wood, ceiling, metal, cloth. All drawn, all seeded."""

import cv2
import numpy as np

from stillroom.geometry.arrays import F32, U8

Rgb = tuple[int, int, int]


def speckle(rng: np.random.Generator, height: int, width: int, finest_px: int = 1, octaves: int = 5) -> F32:
    """Return noise (H, W) of unit deviation with equal power on each scale, so that it has corners at any distance."""
    total = np.zeros((height, width), dtype=np.float32)
    for octave in range(octaves):
        cell = finest_px << octave
        coarse_size = max(2, height // cell + 1), max(2, width // cell + 1)
        coarse = rng.standard_normal(coarse_size, dtype=np.float32)
        method = cv2.INTER_NEAREST if cell == 1 else cv2.INTER_LINEAR
        total += cv2.resize(coarse, (width, height), interpolation=method)
    return np.asarray(total / max(1e-6, float(total.std())), dtype=np.float32)


def tinted(values: F32, colour: Rgb) -> U8:
    """Return a picture (H, W, 3) of one colour, scaled by values (H, W) around 1."""
    picture = values[..., None] * np.array(colour, dtype=np.float32)
    return np.clip(picture, 0, 255, out=picture).astype(np.uint8)


def darken_borders(picture: U8, reach_px: int, strength: float) -> U8:
    """Return the picture darker towards its borders: the light that corners do not get."""
    height, width = picture.shape[:2]
    x = np.minimum(np.arange(width), np.arange(width)[::-1]) / reach_px
    y = np.minimum(np.arange(height), np.arange(height)[::-1]) / reach_px
    gain = (1.0 - strength * np.maximum(np.exp(-x)[None, :], np.exp(-y)[:, None])).astype(np.float32)
    return (picture * gain[..., None]).astype(np.uint8)


def plaster(rng: np.random.Generator, width: int, height: int, colour: Rgb) -> U8:
    """Draw a painted wall: faint roughness, some stains, scratches, screw holes and sockets near the floor."""
    picture = tinted(1.0 + 0.022 * speckle(rng, height, width, 1, 6), colour)
    for _ in range(width * height // 9000):  # holes and marks, mostly small
        centre = int(rng.integers(width)), int(rng.integers(height))
        gain = float(rng.uniform(0.35, 0.85))
        shade = tuple(int(c * gain) for c in colour)
        cv2.circle(picture, centre, int(rng.choice([1, 1, 1, 2, 3])), shade, -1, cv2.LINE_AA)
    for _ in range(width // 40):
        x, y = int(rng.integers(width)), int(rng.integers(height))
        end = x + int(rng.integers(-25, 25)), y + int(rng.integers(-25, 25))
        cv2.line(picture, (x, y), end, tuple(int(c * 0.85) for c in colour), 1, cv2.LINE_AA)
    skirting = max(4, height // 28)
    picture[-skirting:] = (picture[-skirting:] * 0.55).astype(np.uint8)
    for x in range(width // 9, width, width // 4):
        top = int(height * 0.86) + int(rng.integers(-4, 4))
        for k in range(int(rng.integers(1, 4))):
            corner = x + 22 * k, top
            cv2.rectangle(picture, corner, (corner[0] + 19, top + 19), (236, 236, 230), -1)
            cv2.rectangle(picture, corner, (corner[0] + 19, top + 19), (150, 150, 145), 1)
            cv2.circle(picture, (corner[0] + 10, top + 10), 6, (70, 70, 70), -1, cv2.LINE_AA)
    return picture


def carpet(rng: np.random.Generator, size_px: int, colour: Rgb, tiles: int) -> U8:
    """Draw carpet tiles, each of its own shade, with fibres and crumbs."""
    gains = np.repeat(np.repeat(rng.normal(1, 0.05, (tiles, tiles)), size_px // tiles + 1, 0), size_px // tiles + 1, 1)
    values = gains[:size_px, :size_px].astype(np.float32) + 0.11 * speckle(rng, size_px, size_px, 1, 5)
    step = size_px // tiles
    values[::step] *= 0.75
    values[:, ::step] *= 0.75
    picture = tinted(values, colour)
    for _ in range(size_px // 2):
        centre = int(rng.integers(size_px)), int(rng.integers(size_px))
        shade = tuple(int(v) for v in rng.integers(30, 220, 3))
        cv2.circle(picture, centre, int(rng.integers(1, 3)), shade, -1)
    return picture


def wood(rng: np.random.Generator, width: int, height: int, colour: Rgb, planks: int) -> U8:
    """Draw planks along the picture's width, with grain and knots."""
    values = np.ones((height, width), dtype=np.float32)
    grain = cv2.resize(rng.standard_normal((height, max(2, width // 24))).astype(np.float32), (width, height))
    values += 0.07 * grain + 0.04 * speckle(rng, height, width, 1, 4)
    step = max(1, height // planks)
    for top in range(0, height, step):
        values[top : top + step] *= rng.normal(1, 0.07)
        values[top : top + 1] *= 0.6
        joint = int(rng.integers(width))
        values[top : top + step, joint : joint + 2] *= 0.6
    picture = tinted(values, colour)
    for _ in range(max(2, width * height // 12000)):
        centre = int(rng.integers(width)), int(rng.integers(height))
        axes = int(rng.integers(2, 6)), int(rng.integers(1, 4))
        cv2.ellipse(picture, centre, axes, 0, 0, 360, tuple(int(c * 0.5) for c in colour), -1, cv2.LINE_AA)
    return picture


def ceiling(rng: np.random.Generator, size_px: int, tiles: int) -> U8:
    """Draw acoustic tiles with dots, and lamps in some of them."""
    picture = tinted(1.0 + 0.03 * speckle(rng, size_px, size_px, 1, 4), (214, 214, 208))
    step = size_px // tiles
    for _ in range(size_px * size_px // 150):
        x, y = int(rng.integers(size_px)), int(rng.integers(size_px))
        cv2.circle(picture, (x, y), 1, (165, 165, 160), -1)
    for k in range(0, size_px, step):
        picture[k : k + 2] = 120
        picture[:, k : k + 2] = 120
    for row in range(1, tiles, 3):
        for column in range(1, tiles, 2):
            corner = column * step + 4, row * step + 4
            cv2.rectangle(picture, corner, (corner[0] + step - 8, corner[1] + step - 8), (252, 252, 246), -1)
            for bar in range(4, step - 8, 8):
                line = corner[0] + bar
                cv2.line(picture, (line, corner[1]), (line, corner[1] + step - 8), (215, 215, 205), 1)
    return picture


def metal(rng: np.random.Generator, width: int, height: int, colour: Rgb) -> U8:
    """Draw painted metal with scratches."""
    picture = tinted(1.0 + 0.03 * speckle(rng, height, width, 1, 4), colour)
    for _ in range(max(6, width * height // 2500)):
        x, y = int(rng.integers(width)), int(rng.integers(height))
        end = x + int(rng.integers(-12, 12)), y + int(rng.integers(-12, 12))
        shade = tuple(int(np.clip(c * rng.uniform(0.6, 1.5), 0, 255)) for c in colour)
        cv2.line(picture, (x, y), end, shade, 1, cv2.LINE_AA)
    return picture


def weave(rng: np.random.Generator, size_px: int, colour: Rgb) -> U8:
    """Draw upholstery."""
    values = 1.0 + 0.12 * speckle(rng, size_px, size_px, 1, 3)
    values[::4] *= 0.9
    values[:, ::4] *= 0.9
    return darken_borders(tinted(values, colour), size_px // 8, 0.35)
