"""OC-SLAM's epipolar sieve, adapted to real data: what lies in a box is dynamic until it is shown to be static."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from stillroom.data.frame import Frame
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.dynamics.depth_history import DepthHistory, DepthHistoryConfig
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64, Bool
from stillroom.geometry.epipolar import motion_line_distances_px
from stillroom.protocols import Parts


@dataclass(frozen=True)
class EpipolarConfig:
    """The sieve of the `oc-slam` preset (OC-SLAM 2.2).

    Differs from the paper: the fundamental matrix is Eq. 1's own F = K⁻ᵀ[t]×RK⁻¹, taken from the tracked pose and the
    keyframe that saw the point first, not estimated between neighbouring frames, where the camera has hardly moved and
    F is degenerate; depth decides where the line distance cannot (a surface must have been where the keypoint is
    now in earlier depth images, and never absent from there); and what is not shown to be static is dynamic.
    Section 2.2 as printed is `dynamics.kind = "paper-epipolar"`, with section 2.5 `"paper-clusters"`.

    Attributes:
        motion_model_px, keyframe_px, local_map_px: Largest distance from the epipolar line at each stage, on the
            finest level of the pyramid; tighter in the motion-model stage (paper 2.2).
        min_agreeing: Earlier depth images that must show the surface.
        history: Those images.
    """

    needs_depth_image: ClassVar[bool] = True

    motion_model_px: float = 2.0
    keyframe_px: float = 4.0
    local_map_px: float = 3.0
    min_agreeing: int = 1
    history: DepthHistoryConfig = field(default_factory=DepthHistoryConfig)

    def build(self, parts: Parts | None = None) -> "EpipolarSieve":
        """Return the sieve."""
        return EpipolarSieve(self)

    def threshold_px(self, stage: Stage) -> float:
        """Return the largest distance from the epipolar line at a stage."""
        by_stage = {Stage.MOTION_MODEL: self.motion_model_px, Stage.REFERENCE_KEYFRAME: self.keyframe_px}
        return by_stage.get(stage, self.local_map_px)


class EpipolarSieve:
    """Sieve 2 of `oc-slam`."""

    def __init__(self, config: EpipolarConfig) -> None:
        """Start without earlier images."""
        self.config = config
        self.history = DepthHistory(config.history)

    def judge(self, question: Question) -> Motion:
        """Classify every keypoint in a box by depth, and the matched ones by their epipolar lines too."""
        inside, matches = question.may_move, question.matches
        is_static = ~inside
        is_static[inside] = self._was_there_before(question.frame, np.flatnonzero(inside), question.T_cam_world)
        off_line = inside[matches.keypoint]
        off_line[off_line] = self.is_off_its_line(question, matches.keep(off_line))
        is_static[matches.keypoint[off_line]] = False
        return Motion(is_static, question.found.movable)

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Add the depth image to the history."""
        self.history.remember(frame, T_cam_world)

    def corrected(self, T_new_old: F64) -> None:
        """Correct the poses of the history."""
        self.history.follow(T_new_old)

    def _was_there_before(self, frame: Frame, keypoint: I64, T_cam_world: F64) -> Bool:
        """Return which keypoints (K,) lie on a surface that earlier depth images show at the same place."""
        kp = frame.keypoints
        depth_m = kp.depth_m[keypoint]
        points_cam = frame.camera.back_project(kp.px[keypoint], depth_m)
        points_world = se3.transform(se3.inverse(T_cam_world), points_cam)
        evidence = self.history.evidence(frame.camera, points_world, frame.timestamp_s)
        shown: Bool = (depth_m > 0) & (evidence.agrees >= self.config.min_agreeing) & (evidence.empty == 0)
        return shown

    def is_off_its_line(self, question: Question, matches: Matches) -> Bool:
        """Return which matches (M,) lie too far from the epipolar line of where their point was first seen."""
        if len(matches) == 0:
            return np.zeros(0, dtype=np.bool_)
        frame, world = question.frame, question.world
        oldest = world.oldest_observations(matches.point_id)
        distance_px = motion_line_distances_px(
            question.T_cam_world,
            world.keyframes.T_world_cam,
            world.keypoints.keyframe[oldest],
            world.keypoints.px[oldest].astype(np.float64),
            frame.keypoints.px[matches.keypoint].astype(np.float64),
            frame.camera.lens,
        )
        scale = frame.scales.factors[frame.keypoints.octave[matches.keypoint]]
        return np.asarray(distance_px > self.config.threshold_px(question.stage) * scale)
