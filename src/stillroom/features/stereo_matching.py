"""Depth of keypoints from a rectified pair of images (ORB-SLAM2: ComputeStereoMatches)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Keypoints
from stillroom.data.image import Image, StereoImage
from stillroom.data.sensor import Sensor
from stillroom.features.dense_stereo import SemiGlobalConfig
from stillroom.features.keypoint_depth import NoDepth
from stillroom.features.orb import OrbConfig
from stillroom.features.row_matching import RowKeypoints, agreeing, refine, search_rows
from stillroom.geometry.arrays import F32, F64, I64, U8
from stillroom.geometry.camera import Camera
from stillroom.geometry.hamming import words
from stillroom.protocols import Parts

LEAST_DISPARITY_PX = 0.01
"""What is found in the same column of both images is this much aside, so that its depth is finite (ORB-SLAM2)."""


@dataclass(frozen=True)
class StereoConfig:
    """How depth is found in a pair of images.

    Differs from ORB-SLAM2: the right image has more keypoints than the left one. Which of two weak corners is chosen
    depends on chance, and a keypoint whose counterpart was not chosen has no depth.

    Attributes:
        max_bits: Descriptors this far apart, or further, do not match.
        nearest: Depth of the nearest point that is looked for, in baselines.
        max_distance: Patches that differ this many times as much as the median, or more, do not match.
        right_share: Keypoints of the right image for each of the left one.
        dense: How a depth image is made of the pair, for the parts that need one: "none", or "sgbm" for OpenCV's
            semi-global matching.
        sgbm: How that is done.
    """

    max_bits: int = bounded(75, least=1, most=257)
    nearest: float = bounded(1.0, above=0)
    max_distance: float = bounded(2.1, above=0)
    right_share: float = bounded(2.0, above=0)
    dense: str = bounded("none", one_of=("none", "sgbm"))
    sgbm: SemiGlobalConfig = field(default_factory=SemiGlobalConfig)

    def build(self, parts: Parts, features: OrbConfig) -> "StereoMatcher":
        """Return the matcher of a camera's pairs, whose left keypoints are found as `features` says."""
        return StereoMatcher(self, features, parts)

    def build_dense(self, parts: Parts) -> Callable[[Image], F32] | None:
        """Return what makes depth images of a camera's pairs, timed; None where it has no pairs, or none is wanted."""
        wanted = self.dense == "sgbm" and parts.sensor is Sensor.STEREO
        return parts.clock.timed("depth image", self.sgbm.build(parts.camera)) if wanted else None


class StereoMatcher:
    """Finds the keypoints of the left image in the right one."""

    def __init__(self, config: StereoConfig, features: OrbConfig, parts: Parts) -> None:
        """Prepare the search for keypoints in right images."""
        self.config, self.camera = config, parts.camera
        n_right = max(1, round(features.n_features * config.right_share))
        # Most of them are weak: those are looked for at once.
        wide = replace(features, n_features=n_right, usual_score=features.weak_score)
        self._right = wide.build(parts, NoDepth())

    def measured(self, image: Image, levels: Sequence[U8], keypoints: Keypoints) -> Keypoints:
        """Return the keypoints with depth and right coordinate of those that are found in the right image.

        Raises:
            TypeError: The image is no pair.
        """
        if not isinstance(image, StereoImage):
            raise TypeError(f"{image.sensor.words} images have no right image; a StereoMatcher takes stereo pairs")
        right_levels, right = self._right.find(image.right)
        factors, config, camera = self._right.scales.factors, self.config, self.camera
        right_of = search_rows(
            _in_rows(keypoints), _in_rows(right), factors, camera.height, camera.fx / config.nearest, config.max_bits
        )
        matched = np.flatnonzero(right_of >= 0)
        found = refine(
            levels, right_levels,
            keypoints.px[matched], keypoints.octave[matched], right.px[right_of[matched], 0],
            (camera.width, camera.height),
        )  # fmt: skip
        disparity_px = keypoints.px[matched, 0] - found.x_px
        good = agreeing(found.distance, config.max_distance)
        good[good] &= (disparity_px[good] >= 0.0) & (disparity_px[good] < camera.fx / config.nearest)
        return with_disparity(keypoints, matched[good], disparity_px[good], camera)


def with_disparity(keypoints: Keypoints, found: I64, disparity_px: F64, camera: Camera) -> Keypoints:
    """Return keypoints with depth and right coordinate of those (K,) of which the disparity (K,) [px] is known."""
    depth_m, right_px = np.zeros(len(keypoints), np.float32), np.full(len(keypoints), -1.0, np.float32)
    disparity_px = np.maximum(disparity_px, LEAST_DISPARITY_PX)
    depth_m[found] = camera.bf / disparity_px
    right_px[found] = keypoints.px[found, 0] - disparity_px
    return replace(keypoints, depth_m=depth_m, right_px=right_px)


def _in_rows(keypoints: Keypoints) -> RowKeypoints:
    return RowKeypoints(keypoints.px, keypoints.octave, words(keypoints.descriptors))
