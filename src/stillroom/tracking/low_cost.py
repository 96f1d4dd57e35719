"""Low-cost tracking: a quick pose before tracking proper (DynaSLAM III.B, PSPNet-SLAM III.B).

Multi-view geometry needs a pose to tell what moves, and tracking must know what moves to find the pose. Low-cost
tracking breaks the circle: it localises the camera in the map already made, from what the network does not call
movable. Sieve 2 is then asked, with `Stage.LOW_COST`; tracking proper starts from the pose, and its stages hear what
the sieve found.

Differs from DynaSLAM's code: the last frame is not restored and the present one is not built twice, because neither is
changed; and a camera that is not found here is left to tracking proper, which looks further.
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
    """Tracking starts from the motion model's guess, as ORB-SLAM2's does; sieve 2 is first asked there."""

    def build(self, parts: Parts, sieve: MatchSieve) -> QuickTracking:
        """Return what does nothing."""
        return NoLowCost()


class NoLowCost:
    """Leaves the guess as it is."""

    def localize(self, frame: Frame, last: Tracked, T_cam_world: F64, semantics: Pending[Semantics], world: Map) -> F64:
        """Return the guess."""
        return T_cam_world


@dataclass(frozen=True)
class LowCostConfig:
    """When low-cost tracking trusts what it found (docs/reference.md#dynaslam).

    Attributes:
        window_px: Search window around a point's projection; doubled when too little is found.
        min_matches: Matches that it needs, and of those, inliers.
        pose: How the pose is found.
    """

    window_px: float = bounded(15.0, above=0)
    min_matches: int = bounded(20, least=0)
    pose: PoseOptimizerConfig = field(default_factory=PoseOptimizerConfig)

    def build(self, parts: Parts, sieve: MatchSieve) -> QuickTracking:
        """Return low-cost tracking that asks the sieve."""
        return LowCost(self, sieve)


class LowCost:
    """Projects the last frame's points, optimises the pose over what is found, and asks the sieve under it."""

    def __init__(self, config: LowCostConfig, sieve: MatchSieve) -> None:
        """Keep what is needed; no past."""
        self.config, self.sieve = config, sieve
        self._optimize = config.pose.build()

    def localize(self, frame: Frame, last: Tracked, T_cam_world: F64, semantics: Pending[Semantics], world: Map) -> F64:
        """Return the quick pose, after the sieve has been asked under it; the guess where there is none."""
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
