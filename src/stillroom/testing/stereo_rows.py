"""Whether a pair of images is rectified: what both see must lie in the same row of both."""

from typing import Any

import cv2
import numpy as np

from stillroom.data.image import StereoImage
from stillroom.geometry.arrays import F64

N_CORNERS, QUALITY, APART_PX = 500, 0.01, 7.0
WINDOW_PX, LEVELS = 21, 5
MOST_RETURN_PX = 0.5
"""A corner that is followed into the right image and back must arrive this near to where it was."""


def disparities_px(image: StereoImage) -> F64:
    """Return how far corners (M, 2) of the left image lie to the left, and above, in the right one [px].

    Corners are followed by optical flow, to a fraction of a pixel, and back; the rows of the pair play no role in it.
    """
    start: Any = cv2.goodFeaturesToTrack(image.gray, N_CORNERS, QUALITY, APART_PX)
    if start is None:
        return np.zeros((0, 2))
    window_px = (WINDOW_PX, WINDOW_PX)
    left, right = image.gray, image.right
    end, found, _ = cv2.calcOpticalFlowPyrLK(
        left, right, start, np.empty_like(start), winSize=window_px, maxLevel=LEVELS
    )
    back, is_back, _ = cv2.calcOpticalFlowPyrLK(
        right, left, end, np.empty_like(start), winSize=window_px, maxLevel=LEVELS
    )
    returned = np.hypot(*(back - start)[:, 0].T) <= MOST_RETURN_PX
    good = (found.ravel() == 1) & (is_back.ravel() == 1) & returned
    return np.asarray((start - end)[good, 0], dtype=np.float64)
