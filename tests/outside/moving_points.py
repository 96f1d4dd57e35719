"""A sieve that owns a moving probability for each map point, after Detect-SLAM (Zhong et al., WACV 2018), in outline.

The probability follows what the masks say of a point's keypoints, goes with the point into every image that it is
matched in, and is handed on to the points that a new keyframe makes from their nearest neighbours in the image.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from stillroom.config import SlamConfig
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.presets.method import Method
from stillroom.protocols import Parts
from stillroom.semantics.masks.pspnet import PspNetConfig

COLUMN = "p_moving"


@dataclass(frozen=True)
class MovingPointsConfig:
    """How fast a probability follows what is seen, and above which a point moves."""

    gain: float = 0.3
    moves_above: float = 0.5

    def build(self, parts: Parts) -> "MovingPoints":
        """Return the sieve."""
        return MovingPoints(self, parts.world)


class MovingPoints:
    """Sieve 2: a match moves when its point probably does; a keypoint without a point, when a mask covers it."""

    def __init__(self, config: MovingPointsConfig, world: Map) -> None:
        self.config, self.world = config, world
        world.points.add_column(COLUMN, np.float32)

    def judge(self, question: Question) -> Motion:
        self.masked, matches = question.may_move, question.matches
        before = self.world.points.column(COLUMN)[matches.point_id]
        p_moving = self.masked.astype(np.float32)
        p_moving[matches.keypoint] = (1 - self.config.gain) * before + self.config.gain * self.masked[matches.keypoint]
        return Motion(p_moving <= self.config.moves_above, question.known.movable, 1.0 - p_moving)

    def remember(self, frame: Frame, T_cam_world: np.ndarray, keyframe: int) -> None:
        if keyframe < 0:
            return
        p_moving, point = self.world.points.column(COLUMN), self.world.points_of(keyframe)
        seen = point >= 0
        old = seen & (self.world.points.first_keyframe[np.maximum(point, 0)] < keyframe)
        p_moving[point[old]] += self.config.gain * (self.masked[old] - p_moving[point[old]])
        new = seen & ~old
        if old.any() and new.any():
            _, nearest = cKDTree(frame.keypoints.px[old]).query(frame.keypoints.px[new])
            p_moving[point[new]] = p_moving[point[old]][nearest]

    def corrected(self, T_new_old: np.ndarray) -> None:
        """Probabilities stay with their points."""


METHOD = Method(
    name="moving-points",
    summary="map points carry a probability of moving",
    config=replace(SlamConfig(method="moving-points"), semantics=PspNetConfig(), dynamics=MovingPointsConfig()),
)
