"""OC-SLAM's dynamic geometrical constraint as printed (2.2): pairs in boxes against their epipolar lines.

It is one half of the paper's rejection; with the clusters of 2.5 (`dynamics/paper_clusters.py`) it is the whole.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.geometry.arrays import F64, U8, Bool
from stillroom.geometry.epipolar import line_distances_px, printed_line_distances
from stillroom.geometry.pixels import values_at
from stillroom.geometry.robust import find_fundamental, usac
from stillroom.protocols import Parts

CORRECTED, PRINTED = "corrected", "printed"
_MIN_FOR_F = 15


@dataclass(frozen=True)
class PaperEpipolarConfig:
    """The geometrical constraint of the paper's section 2.2, without its clusters.

    A fundamental matrix from the matches that lie outside the boxes of both images; matches inside the present ones
    that lie further from their epipolar line than a threshold lose their map point. Off while relocalizing. Unmatched
    keypoints are not classified, so that keyframes create map points on people.

    Differs from the paper: it prints no thresholds, only that the motion model's is the smaller one, and no estimator
    of F; here it is MAGSAC++, a RANSAC that weights its inliers. The "previous image" of a match with a keyframe is
    that keyframe. Like every sieve's, a result that leaves too few matches to track with is ignored.

    Attributes:
        motion_model_px, keyframe_px: Largest distance from the epipolar line at the two stages.
        inlier_px: Tolerance of the robust estimate of the matrix.
        distance: corrected, the distance of a point from a line; or printed, Eq. 2 as it stands, which rejects nothing
            (`geometry.epipolar.printed_line_distances`).
    """

    motion_model_px: float = bounded(1.0, least=0, pixels=1)
    keyframe_px: float = bounded(2.0, least=0, pixels=1)
    inlier_px: float = bounded(1.0, above=0, pixels=1)
    distance: str = bounded(CORRECTED, one_of=(CORRECTED, PRINTED))

    def build(self, parts: Parts) -> "PaperEpipolarSieve":
        """Return the sieve; its seed is that of the robust estimate."""
        return PaperEpipolarSieve(self, parts.seed)


class _Past(NamedTuple):
    """What was potentially dynamic in an image: its pixels as bits, row after row; None where nothing was."""

    shape: tuple[int, int]
    bits: U8 | None


class PairTest:
    """Which matches leave their epipolar lines (Eq. 1–2). Remembers the boxes of the last frame and of keyframes."""

    def __init__(self, config: PaperEpipolarConfig, seed: int) -> None:
        """Prepare the robust estimator."""
        self.config = config
        self._usac = usac(config.inlier_px, seed, confidence=0.99)
        self._asked: tuple[Frame, Bool] | None = None
        self._last: _Past | None = None
        self._keyframes: dict[int, _Past] = {}

    def off_line(self, question: Question) -> Bool:
        """Return which matches (M,) fail: none at stages without a threshold, or where there are too few for F."""
        frame, matches, config = question.frame, question.matches, self.config
        self._asked = frame, question.found.movable
        if question.stage not in (Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME):
            return np.zeros(len(matches), dtype=np.bool_)
        then_px = matches.reference_px.astype(np.float64)
        now_px = frame.keypoints.px[matches.keypoint].astype(np.float64)
        outside = ~question.may_move[matches.keypoint] & ~self._was_inside(frame, matches) & np.isfinite(then_px[:, 0])
        if np.count_nonzero(outside) < _MIN_FOR_F:
            return np.zeros(len(matches), dtype=np.bool_)
        found = find_fundamental(then_px[outside], now_px[outside], self._usac)
        if found is None:
            return np.zeros(len(matches), dtype=np.bool_)
        limit_px = config.motion_model_px if question.stage is Stage.MOTION_MODEL else config.keyframe_px
        distance = self._distances(found[0], then_px, now_px)
        fails: Bool = distance > limit_px
        return fails

    def remember(self, frame: Frame, keyframe: int) -> None:
        """Keep the boxes of a tracked frame, and for good those of a keyframe."""
        if self._asked is None or self._asked[0].image is not frame.image:
            return
        movable = self._asked[1]
        self._last = _Past((movable.shape[0], movable.shape[1]), np.packbits(movable) if movable.any() else None)
        if keyframe >= 0:
            self._keyframes[keyframe] = self._last

    def _distances(self, F: F64, then_px: F64, now_px: F64) -> F64:
        measure = printed_line_distances if self.config.distance == PRINTED else line_distances_px
        return measure(F, then_px, now_px)

    def _was_inside(self, frame: Frame, matches: Matches) -> Bool:
        """Return which matches (M,) lay in a box of the image that they were matched from."""
        past = self._last if matches.keyframe < 0 else self._keyframes.get(matches.keyframe)
        inside = np.zeros(len(matches), dtype=np.bool_)
        if past is None or past.bits is None:
            return inside
        known = np.flatnonzero(np.isfinite(matches.reference_px[:, 0]))
        rows, columns = past.shape
        movable = np.unpackbits(past.bits, count=rows * columns).reshape(rows, columns).view(np.bool_)
        inside[known] = values_at(movable, frame.camera.distort(matches.reference_px[known]))
        return inside


class PaperEpipolarSieve:
    """Sieve 2 of section 2.2. What a frame's first stage removed stays removed at its later ones."""

    def __init__(self, config: PaperEpipolarConfig, seed: int) -> None:
        """Start without earlier images."""
        self.config = config
        self.test = PairTest(config, seed)
        self._judged: Frame | None = None
        self._is_static = np.zeros(0, dtype=np.bool_)

    def judge(self, question: Question) -> Motion:
        """Classify the matches inside boxes by a fundamental matrix of those outside."""
        frame, matches, found = question.frame, question.matches, question.found
        if self._judged is None or not same_keypoints(self._judged, frame):
            self._judged, self._is_static = frame, np.ones(len(frame), dtype=np.bool_)
        fails = self.test.off_line(question) & question.may_move[matches.keypoint]
        if fails.any():
            is_static = self._is_static.copy()
            is_static[matches.keypoint[fails]] = False
            if question.leaves_enough(Motion(is_static, found.movable)):
                self._is_static = is_static
        return Motion(self._is_static.copy(), found.movable)

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Keep the boxes of the frame."""
        self.test.remember(frame, keyframe)

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: nothing that is kept depends on poses."""


def same_keypoints(first: Frame, second: Frame) -> bool:
    """Return whether two frames have the same keypoints of one image; a rolling shutter moves `px`, not `raw_px`."""
    return first.image is second.image and first.keypoints.raw_px is second.keypoints.raw_px
