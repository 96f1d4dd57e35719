"""OC-SLAM's combined mismatch rejection as printed (2.5): a cluster of which most pairs fail goes, with its box."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from stillroom.data.clusters import Clusters
from stillroom.data.frame import Frame
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import Box
from stillroom.dynamics.paper_epipolar import PairTest, PaperEpipolarConfig, same_keypoints
from stillroom.geometry.arrays import F32, F64, Bool
from stillroom.protocols import Parts


@dataclass(frozen=True)
class PaperClustersConfig:
    """The paper's whole rule: sections 2.2 and 2.5.

    The pairs in each cluster of the depth cloud are put to the epipolar constraint. Where more than half of them fail,
    the cluster is that of a moving object: all keypoints on it go, and all in the prediction box that covers it. Pairs
    in boxes that fail go in any case (2.2). Nothing is remembered but the boxes of earlier images.

    Differs from the paper: Eq. 5 as printed lacks the division by the depth; clusters are projected with it. See
    `PaperEpipolarConfig` for thresholds and the estimate of F.

    Attributes:
        pairs: The epipolar constraint.
    """

    needs_depth_image: ClassVar[bool] = True

    pairs: PaperEpipolarConfig = field(default_factory=PaperEpipolarConfig)

    def build(self, parts: Parts) -> "PaperClusterSieve":
        """Return the sieve; its seed is that of the robust estimate."""
        return PaperClusterSieve(self, parts.seed)


@dataclass
class _Verdict:
    """What the stages of an image found so far; what one of them removes stays removed.

    Attributes:
        frame: The frame.
        is_static: Its keypoints (N,).
        moves: Its clusters (K,) of which most pairs failed.
    """

    frame: Frame
    is_static: Bool
    moves: Bool


class PaperClusterSieve:
    """Sieve 2 of `oc-slam-paper`."""

    def __init__(self, config: PaperClustersConfig, seed: int) -> None:
        """Start without earlier images."""
        self.config = config
        self.test = PairTest(config.pairs, seed)
        self._verdict: _Verdict | None = None

    def judge(self, question: Question) -> Motion:
        """Classify the pairs in boxes one by one, and clusters by most of their pairs."""
        frame, matches, off_line = question.frame, question.matches, self.test.off_line(question)
        clusters, n_clusters = question.known.clusters, 0
        if clusters is not None:
            n_clusters = len(clusters)
        verdict = self._verdict
        if verdict is None or not same_keypoints(verdict.frame, frame) or len(verdict.moves) != n_clusters:
            everything = np.ones(len(frame), dtype=np.bool_)
            self._verdict = verdict = _Verdict(frame, everything, np.zeros(n_clusters, dtype=np.bool_))
        if off_line.any():
            is_static, moves = verdict.is_static.copy(), verdict.moves
            is_static[matches.keypoint[off_line & question.may_move[matches.keypoint]]] = False
            if clusters is not None:
                moves = moves | most_fail(clusters, frame.keypoints.raw_px[matches.keypoint], off_line)
                is_static &= ~goes_with(clusters, moves, question.known.boxes, frame.keypoints.raw_px)
            if question.leaves_enough(Motion(is_static, question.found.movable)):
                verdict.is_static, verdict.moves = is_static, moves
        return Motion(verdict.is_static.copy(), pixels_of(clusters, verdict.moves, frame))

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Keep the boxes of the frame."""
        self.test.remember(frame, keyframe)

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: nothing that is kept depends on poses."""


def most_fail(clusters: Clusters, raw_px: F32, fails: Bool) -> Bool:
    """Return of which clusters (K,) more than half of the pairs fail, given where the pairs (M, 2) lie [px]."""
    cluster = clusters.labels_at(raw_px).astype(np.int64)
    on = cluster >= 0
    n_pairs = np.bincount(cluster[on], minlength=len(clusters))
    n_failing = np.bincount(cluster[on & fails], minlength=len(clusters))
    most: Bool = 2 * n_failing > n_pairs
    return most


def goes_with(clusters: Clusters, moves: Bool, boxes: tuple[Box, ...], raw_px: F32) -> Bool:
    """Return which keypoints (N, 2) [px] lie on moving clusters (K,), or in the boxes that cover these."""
    goes = np.append(moves, (False, False))[clusters.labels_at(raw_px)]  # planes and the unknown read the last two
    for number in np.unique(clusters.box[moves & (clusters.box >= 0)]):
        x0, y0, x1, y1 = boxes[number].xyxy_px
        x, y = raw_px.T
        goes |= (x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1)
    return goes


def pixels_of(clusters: Clusters | None, moves: Bool, frame: Frame) -> Bool:
    """Return the pixels (H, W) of moving clusters (K,)."""
    if clusters is None or not moves.any():
        return np.zeros((frame.image.height, frame.image.width), dtype=np.bool_)
    return np.append(moves, (False, False))[clusters.labels]
