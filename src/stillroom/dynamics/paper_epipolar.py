"""OC-SLAM's epipolar sieve exactly as in the paper (paper 2.2; docs/reference.md#oc-slam)."""

from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.geometry.arrays import Bool
from stillroom.geometry.epipolar import line_distances_px
from stillroom.geometry.robust import find_fundamental, usac
from stillroom.protocols import Parts

_MIN_FOR_F = 15


@dataclass(frozen=True)
class PaperEpipolarConfig:
    """The paper's rule, for comparison; `epipolar` is the one for real data.

    A fundamental matrix from the matches outside the boxes; matches inside them that lie further from their epipolar
    line than a threshold are removed; off while relocalizing and where too few matches would stay. The paper gives no
    thresholds, only that the motion model's is the smaller one. Unmatched keypoints are not classified, so that
    keyframes create map points on people.

    Attributes:
        motion_model_px, keyframe_px: Largest distance from the epipolar line at the two stages.
        inlier_px: Tolerance of the robust estimate of the matrix.
    """

    motion_model_px: float = bounded(1.0, least=0, pixels=1)
    keyframe_px: float = bounded(2.0, least=0, pixels=1)
    inlier_px: float = bounded(1.0, above=0, pixels=1)

    def build(self, parts: Parts) -> "PaperEpipolarSieve":
        """Return the sieve; its seed is that of the robust estimate."""
        return PaperEpipolarSieve(self, parts.seed)


class PaperEpipolarSieve:
    """Sieve 2 as in the paper. What a frame's first stage removed stays removed at its later ones."""

    def __init__(self, config: PaperEpipolarConfig, seed: int) -> None:
        """Prepare the robust estimator."""
        self.config = config
        self._usac = usac(config.inlier_px, seed, confidence=0.99)
        self._judged = -1
        self._is_static = np.zeros(0, dtype=np.bool_)

    def judge(self, question: Question) -> Motion:
        """Classify the matches inside boxes by a fundamental matrix of those outside (Eq. 1–2)."""
        stage, frame, matches = question.stage, question.frame, question.matches
        if frame.image.index != self._judged:
            self._judged, self._is_static = frame.image.index, np.ones(len(frame), dtype=np.bool_)
        movable = question.known
        if stage in (Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME) and movable.has_any:
            inside = question.may_move[matches.keypoint]
            fails = self._fails(stage, frame, matches, inside)
            is_static = self._is_static.copy()
            is_static[matches.keypoint[fails]] = False
            if question.leaves_enough(Motion(is_static, movable.movable)):
                self._is_static = is_static
        return Motion(self._is_static.copy(), movable.movable)

    def _fails(self, stage: Stage, frame: Frame, matches: Matches, inside: Bool) -> Bool:
        then_px = matches.reference_px.astype(np.float64)
        now_px = frame.keypoints.px[matches.keypoint].astype(np.float64)
        if np.count_nonzero(~inside) < _MIN_FOR_F or not inside.any():
            return np.zeros(len(matches), dtype=np.bool_)
        found = find_fundamental(then_px[~inside], now_px[~inside], self._usac)
        if found is None:
            return np.zeros(len(matches), dtype=np.bool_)
        limit_px = self.config.motion_model_px if stage is Stage.MOTION_MODEL else self.config.keyframe_px
        return inside & (line_distances_px(found[0], then_px, now_px) > limit_px)
