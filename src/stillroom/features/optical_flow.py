"""Points tracked from one image to another by pyramidal Lucas–Kanade."""

from dataclasses import dataclass

import cv2
import numpy as np

from stillroom.geometry.arrays import F32, U8, Bool

_STEPS = 10
_LEAST_STEP_PX = 0.03


@dataclass(frozen=True)
class OpticalFlow:
    """How points are tracked.

    Attributes:
        window_px: Side of the square around a point that is tracked.
        levels: Levels of the pyramid above the image.
    """

    window_px: int
    levels: int

    def follow(self, first: U8, second: U8, first_px: F32, guess_px: F32 | None = None) -> tuple[F32, Bool]:
        """Find points (N, 2) [px] of one image (H, W) in another.

        Args:
            first, second: The images.
            first_px: The points in the first.
            guess_px: Initial guess (N, 2); None for the positions in the first.

        Returns:
            Where they are in the second (N, 2) float32 [px], and which were found (N,).
        """
        if len(first_px) == 0:
            return np.zeros((0, 2), dtype=np.float32), np.zeros(0, dtype=np.bool_)
        points = np.ascontiguousarray(first_px, dtype=np.float32).reshape(-1, 1, 2)
        start = np.empty_like(points) if guess_px is None else np.array(guess_px, dtype=np.float32).reshape(-1, 1, 2)
        second_px, found, _ = cv2.calcOpticalFlowPyrLK(
            first,
            second,
            points,
            start,
            winSize=(self.window_px, self.window_px),
            maxLevel=self.levels,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _STEPS, _LEAST_STEP_PX),
            flags=0 if guess_px is None else cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        return np.asarray(second_px[:, 0], dtype=np.float32), np.asarray(found.ravel() != 0)
