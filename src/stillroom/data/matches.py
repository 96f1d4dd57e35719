"""Keypoints of the present frame matched with points of the map."""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F32, I32, Bool


@dataclass(frozen=True)
class Matches:
    """M pairs of a keypoint of the present frame and a map point, with where the point was seen before.

    Attributes:
        keypoint: Index of the keypoint in the present frame (M,) int32; each at most once.
        point_id: Id of the map point (M,) int32; each at most once.
        reference_px: Undistorted pixel of the point in the image that it is matched from (M, 2) float32:
            the last frame in the motion-model stage, a keyframe in the others. NaN where not known.
        keyframe: Id of the keyframe that `reference_px` are in; −1 where they are in the last frame, or not known.
    """

    keypoint: I32
    point_id: I32
    reference_px: F32
    keyframe: int = -1

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self.keypoint)

    def keep(self, chosen: Bool) -> "Matches":
        """Return the pairs that are chosen (M,)."""
        return Matches(self.keypoint[chosen], self.point_id[chosen], self.reference_px[chosen], self.keyframe)

    @staticmethod
    def of(point_ids: I32) -> "Matches":
        """Return the pairs of a frame whose keypoints see the points (N,), −1 for none; references unknown."""
        keypoint = np.flatnonzero(point_ids >= 0).astype(np.int32)
        return Matches(keypoint, point_ids[keypoint], np.full((len(keypoint), 2), np.nan, dtype=np.float32))
