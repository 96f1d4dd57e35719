"""Finding the camera again when it was lost, against the last keyframes."""

from dataclasses import dataclass

import cv2
import numpy as np

from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.result import Tracked
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import F64, Bool
from stillroom.protocols import Pending
from stillroom.tracking.correspondences import with_keyframe
from stillroom.tracking.tracker import Tracker


@dataclass(frozen=True)
class RelocalizerConfig:
    """How a lost camera is found.

    Attributes:
        n_keyframes: Newest keyframes to try.
        min_matches: Matches that a candidate needs.
        reprojection_px: RANSAC's tolerance.
        min_inliers: Points that must agree with a pose before it is refined.
    """

    n_keyframes: int = 10
    min_matches: int = 20
    reprojection_px: float = 4.0
    min_inliers: int = 15

    def build(self, tracker: Tracker, seed: int = 0) -> "Relocalizer":
        """Return a relocalizer that refines its finds with the tracker."""
        return Relocalizer(self, tracker, seed)


class Relocalizer:
    """Matches with the newest keyframes, solves for the pose, lets the tracker refine it. Sieves are off here."""

    def __init__(self, config: RelocalizerConfig, tracker: Tracker, seed: int) -> None:
        """Keep what recovering needs."""
        self.config, self.tracker, self.seed = config, tracker, seed

    def recover(self, tracked: Tracked, semantics: Pending[Semantics], world: Map) -> Tracked:
        """Return the lost frame with a pose, or as it was when no keyframe recognises it."""
        for keyframe in world.alive_keyframes()[::-1][: self.config.n_keyframes]:
            matches = with_keyframe(tracked.frame, int(keyframe), world)
            if len(matches) < self.config.min_matches:
                continue
            solved = self._solve(tracked, matches, world)
            if solved is None:
                continue
            T_cam_world, inlier = solved
            point_ids = np.full(len(tracked.frame), -1, dtype=np.int32)
            point_ids[matches.keypoint[inlier]] = matches.point_id[inlier]
            found = self.tracker.locate(tracked.frame, T_cam_world, point_ids, semantics, world)
            if not found.lost:
                return found
        return tracked

    def _solve(self, tracked: Tracked, matches: Matches, world: Map) -> tuple[F64, Bool] | None:
        camera = tracked.frame.camera
        cv2.setRNGSeed(self.seed)
        found, rotation, translation, inliers = cv2.solvePnPRansac(
            world.points.position_m[matches.point_id],
            tracked.frame.keypoints.px[matches.keypoint].astype(np.float64),
            camera.K,
            np.zeros(4),
            iterationsCount=300,
            reprojectionError=self.config.reprojection_px,
            confidence=0.99,
            flags=cv2.SOLVEPNP_EPNP,
        )
        if not found or inliers is None or len(inliers) < self.config.min_inliers:
            return None
        T_cam_world = np.eye(4)
        T_cam_world[:3, :3] = cv2.Rodrigues(rotation)[0]
        T_cam_world[:3, 3] = translation[:, 0]
        is_inlier = np.zeros(len(matches), dtype=np.bool_)
        is_inlier[inliers[:, 0]] = True
        return T_cam_world, is_inlier
