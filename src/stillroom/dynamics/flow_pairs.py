"""Pairs of points of the last image and the present one by optical flow, and the epipolar lines that some of them draw.

The fundamental matrix of two neighbouring images is the tool of DS-SLAM, SOF-SLAM, and of `zhang-slam`. Between images
in which the camera has hardly moved it is close to degenerate: then nearly any lines fit what is static, each through
the place where its point was. What moves still leaves them, unless it moves along them.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np

from stillroom.data.frame import Frame
from stillroom.data.image import Image
from stillroom.features.optical_flow import OpticalFlow
from stillroom.geometry.arrays import F32, F64, Bool
from stillroom.geometry.epipolar import line_distances_px
from stillroom.geometry.robust import find_fundamental

MIN_FOR_F = 15
"""Fewer pairs than this draw no lines: seven make a matrix, and some of them are wrong."""
LEAST_WINDOW_PX = 3
"""OpenCV takes no smaller one; in small images a window may come to be."""


@dataclass(frozen=True)
class FlowPairs:
    """N points in two images; rows that were not found in both are to be left out.

    Attributes:
        then_px, now_px: Undistorted positions in the last image and the present one (N, 2) float64 [px].
        then_raw_px: Position in the last image as taken (N, 2) float32 [px].
        is_found: Which were found in both (N,).
    """

    then_px: F64 = field(repr=False)
    now_px: F64 = field(repr=False)
    then_raw_px: F32 = field(repr=False)
    is_found: Bool = field(repr=False)

    def lines_of(self, chosen: Bool, settings: cv2.UsacParams) -> F64 | None:
        """Return the fundamental matrix (3, 3), last to present, of the chosen pairs (N,); None where there is none."""
        used = chosen & self.is_found
        if np.count_nonzero(used) < MIN_FOR_F:
            return None
        found = find_fundamental(self.then_px[used], self.now_px[used], settings)
        return None if found is None else found[0]

    def off_lines(self, F_now_then: F64, limit_px: float) -> Bool:
        """Return which points (N,) were found, further than a limit [px] from their lines in the present image."""
        return self.is_found & (line_distances_px(F_now_then, self.then_px, self.now_px) > limit_px)


def flow_of(window_px: int, levels: int) -> OpticalFlow:
    """Return a flow with windows of a side [px], and levels above the image."""
    return OpticalFlow(max(LEAST_WINDOW_PX, window_px), levels)


def followed_back(frame: Frame, last: Image, flow: OpticalFlow) -> FlowPairs:
    """Follow every keypoint of a frame back into the last image, matched or not, so that each can be judged itself."""
    raw_px = frame.keypoints.raw_px
    then_raw_px, is_found = flow.follow(frame.image.gray, last.gray, raw_px)
    is_found = is_found & inside(then_raw_px, last, 0)
    then_px = frame.camera.undistort(then_raw_px).astype(np.float64)
    return FlowPairs(then_px, frame.keypoints.px.astype(np.float64), then_raw_px, is_found)


def inside(raw_px: F32, image: Image, margin_px: int) -> Bool:
    """Return which points (N, 2) lie in an image, and not within a margin of its edge."""
    x, y = raw_px.T
    right, lower = image.width - 1 - margin_px, image.height - 1 - margin_px
    within: Bool = (x >= margin_px) & (y >= margin_px) & (x <= right) & (y <= lower)
    return within
