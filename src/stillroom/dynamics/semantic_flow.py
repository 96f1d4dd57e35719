"""SOF-SLAM's sieve: the mask chooses the points of F, and geometry alone decides (docs/reference.md#sof-slam)."""

from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.frame import Frame, Keypoints
from stillroom.data.image import Image
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics, filled
from stillroom.dynamics.flow_pairs import flow_of, followed_back
from stillroom.dynamics.homography.past import TOO_OLD_S
from stillroom.geometry.arrays import F64, Bool
from stillroom.geometry.pixels import values_at
from stillroom.geometry.robust import usac
from stillroom.protocols import Parts

_MOST = 0.5


@dataclass(frozen=True)
class SemanticFlowConfig:
    """SOF-SLAM's semantic optical flow (Cui and Ma, IEEE Access 7, 2019).

    Each keypoint has a prior by its label: dynamic on the mask (people), potentially dynamic in the boxes of what is
    named (chairs), else static. Optical flow of the static ones gives F, last image to present; a keypoint further from
    its epipolar line is dynamic, whatever its label.

    Differs from the paper: flow goes from the keypoints of the present image back to the last, so that each of them is
    judged itself. Where there is no F or a keypoint is not found again the prior decides, which is not described: on
    the mask dynamic, elsewhere static. Parameters of flow and RANSAC are not given.

    Attributes:
        line_px: A keypoint further from its epipolar line is dynamic.
        judged: Which keypoints are: "every" one, or "labelled", those with a prior other than static.
        window_px: Side of the square around a keypoint that is followed.
        levels: Levels of the pyramid above the image.
        inlier_px: Tolerance of the matrix.
    """

    line_px: float = bounded(1.0, above=0, pixels=1)
    judged: str = bounded("every", one_of=("every", "labelled"))
    window_px: int = bounded(21, least=1, pixels=1)
    levels: int = bounded(3, least=0)
    inlier_px: float = bounded(1.0, above=0, pixels=1)

    def build(self, parts: Parts) -> "SemanticFlow":
        """Return the sieve; its seed is that of the robust estimate."""
        check(self)
        return SemanticFlow(self, parts.seed)


class SemanticFlow:
    """Sieve 2 of `sof-slam`. What it says depends on the image, its labels and the last image alone."""

    def __init__(self, config: SemanticFlowConfig, seed: int) -> None:
        """Start without a last image."""
        self.config = config
        self._flow = flow_of(config.window_px, config.levels)
        self._usac = usac(config.inlier_px, seed, confidence=0.99)
        self._last: tuple[Image, Bool] | None = None
        self._said: tuple[Keypoints, Semantics, Bool, Motion] | None = None

    def judge(self, question: Question) -> Motion:
        """Classify every keypoint; dynamic pixels are the mask's, and named boxes of whose keypoints most are."""
        keypoints, found, said = question.frame.keypoints, question.found, self._said
        if said is None or said[0] is not keypoints or said[1] is not found:
            labelled = found.movable | filled(found.named, found.height, found.width)
            is_dynamic = self._dynamic(question.frame, question.may_move, values_at(labelled, keypoints.raw_px))
            self._said = said = keypoints, found, labelled, _motion(is_dynamic, keypoints, found)
        return said[3]

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Keep the image and its labels, to compare the next one with."""
        if self._said is not None:
            self._last = frame.image, self._said[2]

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: no pose is stored."""

    def _dynamic(self, frame: Frame, on_mask: Bool, is_labelled: Bool) -> Bool:
        """Return which keypoints (N,) are dynamic, given those on the mask and all those with a prior."""
        if self._last is None or frame.timestamp_s - self._last[0].timestamp_s > TOO_OLD_S:
            return on_mask
        last, labelled_then = self._last
        pairs = followed_back(frame, last, self._flow)
        F_now_then = pairs.lines_of(~is_labelled & ~values_at(labelled_then, pairs.then_raw_px), self._usac)
        if F_now_then is None:
            return on_mask
        off_line = pairs.off_lines(F_now_then, self.config.line_px)
        if self.config.judged == "labelled":
            off_line &= is_labelled
        return off_line | (on_mask & ~pairs.is_found)


def _motion(is_dynamic: Bool, keypoints: Keypoints, found: Semantics) -> Motion:
    """Return keypoints (N,) as a motion of the whole image."""
    moving = found.movable
    for box in found.named:
        on_it = is_dynamic[values_at(filled((box,), found.height, found.width), keypoints.raw_px)]
        if len(on_it) > 0 and np.mean(on_it) > _MOST:
            moving = moving | filled((box,), found.height, found.width)
    return Motion(~is_dynamic, moving)
