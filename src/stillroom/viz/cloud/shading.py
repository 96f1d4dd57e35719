"""Light on a splatted cloud: what faces the eye is bright, what lies in a corner or behind an edge is darker."""

import cv2
import numpy as np

from stillroom.geometry.arrays import F32, Bool
from stillroom.geometry.growing import Shape, element
from stillroom.viz.cloud.splat import Splats

HEADLIGHT = 0.25
"""Share of the light that comes from the eye; the rest comes from everywhere."""

CREASES = 0.55
"""How much darker the deepest crease is than open ground."""

DEEP = 0.012
"""A step back by this share of the depth is as deep as a crease gets."""

NOISE = 0.0012
"""Steps below this share of the depth are the sensor's noise, not a crease."""


def fill_gaps(splats: Splats, gap_px: int) -> tuple[Splats, Bool]:
    """Fill what is empty but so narrow that discs of twice the diameter would cover it.

    Args:
        splats: What the view sees.
        gap_px: Width of the widest gap that is filled.

    Returns:
        The splats without gaps, in which `nearest` still says −1 there, and where anything is now (H, W).
    """
    covered = (splats.nearest >= 0).astype(np.uint8)
    if gap_px < 1:
        return splats, covered.astype(np.bool_)
    kernel = element(gap_px // 2, Shape.ELLIPSE)
    closed = np.asarray(cv2.morphologyEx(covered, cv2.MORPH_CLOSE, kernel), dtype=np.bool_)
    gaps = closed & (covered == 0)
    sigma = gap_px / 2.0
    share = cv2.GaussianBlur(covered.astype(np.float32), (0, 0), sigma)[gaps]

    def filled(values: F32) -> F32:
        blurred = cv2.GaussianBlur(values, (0, 0), sigma)[gaps]
        result = values.copy()
        result[gaps] = blurred / np.maximum(share if values.ndim == 2 else share[:, None], 1e-6)
        return result

    whole = Splats(splats.nearest, filled(splats.depth_m), filled(splats.normals), filled(splats.rgb))
    return whole, closed


def shade(splats: Splats, covered: Bool, rays: F32, reach_px: float) -> F32:
    """Return the brightness (H, W) in 0 … 1 of what a view sees.

    Args:
        splats: What it sees.
        covered: Where it sees anything (H, W).
        rays: Unit vectors towards the eye (H, W, 3) [view frame].
        reach_px: Over how many pixels creases are looked for, at most.
    """
    length = np.linalg.norm(splats.normals, axis=2)
    facing = np.einsum("ijk,ijk->ij", splats.normals, rays) / np.maximum(length, 1e-6)
    lit = 1.0 - HEADLIGHT + HEADLIGHT * np.clip(facing, 0.0, 1.0)
    dark = np.zeros(covered.shape, dtype=np.float32)
    reaches = (1.0, 0.4, 0.15)
    for reach in reaches:
        dark += creases(splats.depth_m, covered, max(1, round(reach * reach_px))) / len(reaches)
    return np.asarray(lit * (1.0 - CREASES * dark), dtype=np.float32)


def creases(depth_m: F32, covered: Bool, reach_px: int) -> F32:
    """Return how deep each pixel lies behind its surroundings (H, W), 0 … 1: eye-dome lighting that spares planes.

    (Boucheny, 2009, compares depths with each neighbour, which darkens every plane that is seen at a slant. Inverse
    depth of a plane is linear in the image, so the mean of two opposite neighbours is compared here.)

    Args:
        depth_m: Depth (H, W) [m].
        covered: Where it is known (H, W).
        reach_px: Distance of the neighbours.
    """
    inverse = np.where(covered, 1.0 / np.maximum(depth_m, 1e-6), 0.0).astype(np.float32)
    known = covered.astype(np.float32)
    sigma = 0.35 * reach_px + 0.5
    share = np.asarray(cv2.GaussianBlur(known, (0, 0), sigma), dtype=np.float32)
    blurred = np.asarray(cv2.GaussianBlur(inverse, (0, 0), sigma), dtype=np.float32)
    inverse = np.where(share > 0.05, blurred / np.maximum(share, 0.05), np.float32(0.0))
    r, s = reach_px, max(1, round(reach_px * 0.7071))
    padded = cv2.copyMakeBorder(inverse, r, r, r, r, cv2.BORDER_CONSTANT, value=0.0)
    height, width = depth_m.shape

    def moved(dx: int, dy: int) -> F32:
        there = padded[r + dy : r + dy + height, r + dx : r + dx + width]
        # Nothing known there: as if nothing stood before this pixel.
        return np.where(there > 0.0, there, inverse)

    deep = np.zeros_like(inverse)
    for dx, dy in ((r, 0), (0, r), (s, s), (s, -s)):
        step = (0.5 * (moved(dx, dy) + moved(-dx, -dy)) - inverse) / np.maximum(inverse, 1e-6)
        deep += np.clip((step - NOISE) / DEEP, 0.0, 1.0)
    return np.where(covered, deep / 4.0, 0.0).astype(np.float32)
