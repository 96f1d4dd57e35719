"""ORB features on a scale pyramid, spread evenly, with depth (ORB-SLAM2; Rublee et al., ICCV 2011)."""

from dataclasses import dataclass

import cv2
import numpy as np

from stillroom.data.frame import Frame, Keypoints, ScaleLevels
from stillroom.data.image import RgbdImage
from stillroom.features.corners import Corners, detect, spread
from stillroom.features.describe import BORDER_PX, describe, orientations, patch_half_widths, turned_offsets
from stillroom.features.orb_pattern import orb_pattern
from stillroom.geometry.arrays import F32, I64, U8
from stillroom.geometry.camera import Camera
from stillroom.protocols import Parts


@dataclass(frozen=True)
class OrbConfig:
    """How keypoints are found.

    Attributes:
        n_features: Keypoints to aim for in a frame.
        scale_factor, n_levels: The pyramid.
        strong_score, usual_score, weak_score: FAST scores. Corners that are not strong are taken only where there is
            no strong one; weak ones only in an image that is poor in corners (dark, blurred, bare walls).
        min_depth_m, max_depth_m: Depth outside this range counts as unknown.
    """

    n_features: int = 1000
    scale_factor: float = 1.2
    n_levels: int = 8
    strong_score: int = 20
    usual_score: int = 12
    weak_score: int = 7
    min_depth_m: float = 0.1
    max_depth_m: float = 20.0

    @property
    def scales(self) -> ScaleLevels:
        """The pyramid."""
        return ScaleLevels(self.scale_factor, self.n_levels)

    def build(self, parts: Parts) -> "OrbExtractor":
        """Return the extractor for a camera."""
        return OrbExtractor(self, parts.camera, parts.seed)


class OrbExtractor:
    """Finds ORB keypoints in images of one camera."""

    def __init__(self, config: OrbConfig, camera: Camera, seed: int = 0) -> None:
        """Prepare quotas and tables."""
        self.config, self.camera, self.seed = config, camera, seed
        self.scales = config.scales
        self._half_widths = patch_half_widths()
        shares = self.scales.factors**-1.0
        self._quotas = [int(q) for q in np.rint(config.n_features * shares / shares.sum())]
        self._sizes = [(max(1, round(camera.width / f)), max(1, round(camera.height / f))) for f in self.scales.factors]
        self._offsets = [turned_offsets(orb_pattern(), width_px) for width_px, _ in self._sizes]

    def extract(self, image: RgbdImage) -> Frame:
        """Return the frame of the image; a black image gives zero keypoints."""
        levels = self._pyramid(image.gray)
        corners = detect(levels, self.config.usual_score, BORDER_PX)
        if len(corners.score) < 2 * self.config.n_features:
            corners = detect(levels, self.config.weak_score, BORDER_PX)
        chosen = spread(corners, self._sizes, self._quotas, self.config.strong_score, self.seed)
        angle_rad, descriptors = self._describe(levels, corners, chosen)
        raw_px = self._to_finest_level(corners, chosen)
        px = self.camera.undistort(raw_px)
        depth_m = self._depth_at(image.depth_m, raw_px)
        keypoints = Keypoints(
            px=px,
            raw_px=raw_px,
            octave=corners.level[chosen],
            angle_rad=angle_rad,
            descriptors=descriptors,
            depth_m=depth_m,
            right_px=self.camera.right_coordinate(px[:, 0], depth_m),
        )
        return Frame(image, self.camera, self.scales, keypoints, np.ones(len(px), dtype=np.bool_))

    def _pyramid(self, gray: U8) -> list[U8]:
        levels = [gray]
        for size in self._sizes[1:]:
            levels.append(np.asarray(cv2.resize(levels[-1], size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8))
        return levels

    def _describe(self, levels: list[U8], corners: Corners, chosen: I64) -> tuple[F32, U8]:
        angle_rad = np.zeros(len(chosen), dtype=np.float32)
        descriptors = np.zeros((len(chosen), 32), dtype=np.uint8)
        edges = np.searchsorted(corners.level[chosen], np.arange(len(levels) + 1))
        for number, image in enumerate(levels):
            own = slice(edges[number], edges[number + 1])
            if own.start == own.stop:
                continue
            px = corners.px[chosen[own]]
            # Two 5×5 boxes have the variance of OpenCV's Gaussian (σ = 2 px) at two thirds of its cost.
            blurred = np.asarray(cv2.blur(cv2.blur(image, (5, 5)), (5, 5)), dtype=np.uint8)
            orientations(image, px, self._half_widths, angle_rad[own])
            describe(blurred, px, angle_rad[own], self._offsets[number], descriptors[own])
        return angle_rad, descriptors

    def _to_finest_level(self, corners: Corners, chosen: I64) -> F32:
        """Return positions (K, 2) in the image as taken; pixel centres, not corners, are what a resize keeps."""
        width_px, height_px = np.array(self._sizes, dtype=np.float64).T
        level = corners.level[chosen]
        ratio = np.stack((self.camera.width / width_px, self.camera.height / height_px), axis=1)[level]
        return np.asarray((corners.px[chosen] + 0.5) * ratio - 0.5, dtype=np.float32)

    def _depth_at(self, depth_m: F32, raw_px: F32) -> F32:
        column, row = np.rint(raw_px).astype(np.int64).T
        depth = depth_m[np.clip(row, 0, depth_m.shape[0] - 1), np.clip(column, 0, depth_m.shape[1] - 1)]
        known = (depth >= self.config.min_depth_m) & (depth <= self.config.max_depth_m)
        return np.where(known, depth, 0.0).astype(np.float32)
