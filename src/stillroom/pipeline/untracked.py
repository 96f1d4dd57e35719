"""Why a run tracked nothing."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillroom.data.image import Image
from stillroom.data.result import FrameSummary
from stillroom.data.sensor import Sensor

BLACK_BELOW = 8
FEW_KEYPOINTS = 100
MOST = 0.9
N_ROWS = 8


@dataclass
class Seen:
    """What the images of a run were like.

    Attributes:
        n_images: How many could be read.
        n_black: How many of them are black.
        n_without_depth: How many are not black and have no depth at all.
    """

    n_images: int = 0
    n_black: int = 0
    n_without_depth: int = 0

    def add(self, image: Image) -> tuple[bool, bool]:
        """Look at an image; return whether it is black, and whether it has no depth though it is not."""
        is_black = not any(int(rows.max()) >= BLACK_BELOW for rows in _few_first(image.rgb))
        is_blind = (
            not is_black and image.sensor is Sensor.RGBD and not any(rows.any() for rows in _few_first(image.depth_m))
        )
        self.n_images += 1
        self.n_black += is_black
        self.n_without_depth += is_blind
        return is_black, is_blind


def _few_first(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a few rows of an image (H, W, …), which nearly always decide, and the whole."""
    return pixels[:: max(1, len(pixels) // N_ROWS)], pixels


BEGINNINGS = {
    Sensor.RGBD: "too few keypoints have a depth to begin a map; do the depth images show what the colour images show?",
    Sensor.STEREO: (
        "too few keypoints are found in both images to begin a map; are they rectified, and of one moment?"
    ),
    Sensor.MONOCULAR: "no map could be begun; does the camera move sideways, past things at different depths?",
}
"""Why there may be no map, by the sensor."""


def likely_reason(
    seen: Seen, results: list[FrameSummary], localized_in: Path | None, sensor: Sensor = Sensor.RGBD
) -> str:
    """Return the likely reason for which no image of a run has a pose, and what to look at.

    Args:
        seen: What the images were like.
        results: How tracking went.
        localized_in: The map of earlier runs in which it began; None for a run that made its own.
        sensor: What kind of camera took the images.
    """
    if seen.n_images == 0:
        return "no image could be read"
    if seen.n_black >= MOST * seen.n_images:
        return f"{seen.n_black} of {seen.n_images} images are black"
    if seen.n_without_depth + seen.n_black >= MOST * seen.n_images:
        return (
            f"{seen.n_without_depth} of {seen.n_images} images have no depth anywhere; "
            "look at the depth images: are they those of the sensor, and 16 bits deep?"
        )
    n_keypoints = int(np.median([result.n_keypoints for result in results]))
    n_static = int(np.median([result.n_static for result in results]))
    if n_keypoints < FEW_KEYPOINTS:
        return (
            f"images show too little to track: {n_keypoints} keypoints (median); is the lens covered, or the wall bare?"
        )
    if n_static < FEW_KEYPOINTS:
        return f"nearly all was taken for moving: of {n_keypoints} keypoints {n_static} stayed; try another method"
    if localized_in is not None:
        return (
            f"no place of {localized_in} was recognised in {seen.n_images} images; "
            "is it a map of this room, and does the camera look where the map's did?"
        )
    return BEGINNINGS[sensor]
