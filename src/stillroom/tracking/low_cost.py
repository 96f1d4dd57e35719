"""Low-cost tracking: a pose before the other stages of tracking (DynaSLAM III.B, PSPNet-SLAM III.B).

Multi-view geometry needs a pose to find what is dynamic, and tracking needs to know that to find the pose. Low-cost
tracking breaks the circle: it localises the camera in the existing map, from what is not potentially dynamic. Sieve 2
is then called, with `Stage.LOW_COST`; the other stages start from the pose, and use what the sieve found.

Differs from DynaSLAM's code: the last frame is not restored and the present one is not built twice, because neither is
changed; and where it fails, the other stages follow, with larger windows.
"""

from dataclasses import dataclass, field

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.motion import Stage
from stillroom.data.question import Question
from stillroom.data.result import Tracked
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import F64
from stillroom.optimize import observations
from stillroom.optimize.pose import PoseOptimizerConfig
from stillroom.protocols import MatchSieve, Parts, Pending, QuickTracking
from stillroom.tracking import correspondences


@dataclass(frozen=True)
class NoLowCostConfig:
    """Tracking starts from the motion model's guess, as ORB-SLAM2's does; sieve 2 is first called there."""

    def build(self, parts: Parts, sieve: MatchSieve) -> QuickTracking:
        """Return the null object."""
        return NoLowCost()


class NoLowCost:
    """The null object: returns the guess."""

    def localize(self, frame: Frame, last: Tracked, T_cam_world: F64, semantics: Pending[Semantics], world: Map) -> F64:
        """Return the guess."""
        return T_cam_world


@dataclass(frozen=True)
class LowCostConfig:
    """When low-cost tracking accepts its pose (docs/reference.md#dynaslam).

    Attributes:
        window_px: Search window around a point's projection; doubled when too little is found.
        min_matches: Matches that it needs, and of those, inliers.
        pose: How the pose is found.
    """

    window_px: float = bounded(15.0, above=0)
    min_matches: int = bounded(20, least=0)
    pose: PoseOptimizerConfig = field(default_factory=PoseOptimizerConfig)

    def build(self, parts: Parts, sieve: MatchSieve) -> QuickTracking:
        """Return low-cost tracking that calls the sieve."""
        return LowCost(self, sieve)


class LowCost:
    """Projects the last frame's points, optimises the pose over the matches, and calls the sieve at it."""

    def __init__(self, config: LowCostConfig, sieve: MatchSieve) -> None:
        """Store the parts."""
        self.config, self.sieve = config, sieve
        self._optimize = config.pose.build()

    def localize(self, frame: Frame, last: Tracked, T_cam_world: F64, semantics: Pending[Semantics], world: Map) -> F64:
        """Return the pose, after the sieve was called at it; the guess where tracking fails."""
        for widen in (1.0, 2.0):
            window_px = widen * self.config.window_px
            matches = correspondences.with_last_frame(frame, last, T_cam_world, world, window_px)
            if len(matches) >= self.config.min_matches:
                break
        else:
            return T_cam_world
        kp = frame.keypoints
        right_px = kp.right_px[matches.keypoint]
        estimate = self._optimize(
            T_cam_world,
            world.points.position_m[matches.point_id],
            observations.observed_px(kp.px[matches.keypoint], right_px),
            observations.weights(kp.octave[matches.keypoint], right_px, frame.scales.inverse_variances),
            frame.camera,
        )
        if estimate.n_inliers < self.config.min_matches:
            return T_cam_world
        matches = matches.keep(estimate.is_inlier)
        self.sieve.judge(Question(Stage.LOW_COST, frame, matches, semantics, estimate.T_cam_world, world))
        return estimate.T_cam_world
