"""The sieve of `zhang-slam`: an object is dynamic when its own points say so (docs/reference.md#l-zhang-et-al)."""

from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.frame import Frame, Keypoints
from stillroom.data.image import Image
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics, filled
from stillroom.dynamics.flow_pairs import flow_of, followed_back
from stillroom.dynamics.homography.past import TOO_OLD_S
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, Bool
from stillroom.geometry.pixels import values_at
from stillroom.geometry.robust import usac
from stillroom.protocols import Parts


@dataclass(frozen=True)
class MovingObjectsConfig:
    """Which detected objects move (after L. Zhang et al., IEEE Access 6, 2018).

    The paper recognises objects with YOLO and leaves dynamic feature points out. Its rule was not to be had; this one
    is Stillroom's own. The points of an object are the keypoints in its box that are no further away than its
    foreground. One of them says that the object moves when it is off the epipolar line that the background draws, from
    the last image to the present one, or when it is not where the map has the point that it is matched with. An object
    moves when a share of its points says so, and when it has too few points to say. Its points are then dynamic, and
    what lies behind it in its box is unless it is shown to be static itself. All of its box is kept out of the dense
    map.

    Attributes:
        line_px: A keypoint further from its epipolar line says that its object moves.
        tolerance_m: One further from its map point does, too, at 1 m; the tolerance grows with depth [m].
        share: An object moves when more than this share of its points says so.
        min_points: With fewer points than this it moves.
        behind_m: What is this much further away than the nearer half of the points in a box is background [m].
        window_px: Side of the square around a keypoint that is followed.
        levels: Levels of the pyramid above the image.
        inlier_px: Tolerance of the matrix.
    """

    line_px: float = bounded(1.0, above=0, pixels=1)
    tolerance_m: float = bounded(0.03, above=0)
    share: float = bounded(0.2, above=0, below=1)
    min_points: int = bounded(5, least=1)
    behind_m: float = bounded(0.5, above=0)
    window_px: int = bounded(21, least=1, pixels=1)
    levels: int = bounded(3, least=0)
    inlier_px: float = bounded(1.0, above=0, pixels=1)

    def build(self, parts: Parts) -> "MovingObjects":
        """Return the sieve; its seed is that of the robust estimate."""
        check(self)
        return MovingObjects(self, parts.seed)


class MovingObjects:
    """Sieve 2 of `zhang-slam`. Lines are drawn once an image, matches are compared at every stage."""

    def __init__(self, config: MovingObjectsConfig, seed: int) -> None:
        """Start without a last image."""
        self.config = config
        self._flow = flow_of(config.window_px, config.levels)
        self._usac = usac(config.inlier_px, seed, confidence=0.99)
        self._last: tuple[Image, Bool] | None = None
        self._lined: tuple[Keypoints, Semantics, Bool, Bool] | None = None

    def judge(self, question: Question) -> Motion:
        """Classify object by object."""
        frame, found = question.frame, question.found
        off_line, on_line = self._lines(frame, found)
        off_map, on_map = self._places(question)
        says_moving = off_line | off_map
        says_static = (on_line | on_map) & ~says_moving
        is_static, moving = np.ones(len(frame), dtype=np.bool_), []
        for box in found.boxes:
            inside = values_at(filled((box,), found.height, found.width), frame.keypoints.raw_px)
            behind = inside & self._is_behind(frame.keypoints.depth_m, inside)
            judged = inside & ~behind & (says_moving | says_static)
            if judged.sum() < self.config.min_points or says_moving[judged].mean() > self.config.share:
                is_static &= ~inside | (behind & says_static)
                moving.append(box)
        return Motion(is_static, filled(moving, found.height, found.width))

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Keep the image and its boxes, to compare the next one with."""
        if self._lined is not None:
            self._last = frame.image, self._lined[1].movable

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: no pose is stored."""

    def _lines(self, frame: Frame, found: Semantics) -> tuple[Bool, Bool]:
        """Return which keypoints (N,) are off the lines that the background draws, and which are on them."""
        if self._lined is None or self._lined[0] is not frame.keypoints or self._lined[1] is not found:
            self._lined = frame.keypoints, found, *self._off_and_on(frame, found)
        return self._lined[2:]

    def _off_and_on(self, frame: Frame, found: Semantics) -> tuple[Bool, Bool]:
        unknown = np.zeros(len(frame), dtype=np.bool_)
        too_old = self._last is None or frame.timestamp_s - self._last[0].timestamp_s > TOO_OLD_S
        if self._last is None or too_old or not found.has_any:
            return unknown, unknown
        last, boxes_then = self._last
        pairs = followed_back(frame, last, self._flow)
        is_background = ~found.movable_at(frame.keypoints.raw_px) & ~values_at(boxes_then, pairs.then_raw_px)
        F_now_then = pairs.lines_of(is_background, self._usac)
        if F_now_then is None:
            return unknown, unknown
        off_line = pairs.off_lines(F_now_then, self.config.line_px)
        return off_line, pairs.is_found & ~off_line

    def _places(self, question: Question) -> tuple[Bool, Bool]:
        """Return which keypoints (N,) are not where the map has their point, and which are; none at a mere guess."""
        kp, matches = question.frame.keypoints, question.matches
        off, on = np.zeros((2, len(kp)), dtype=np.bool_)
        if question.stage is not Stage.LOCAL_MAP:
            return off, on
        depth_m = kp.depth_m[matches.keypoint]
        predicted_m = se3.transform(question.T_cam_world, question.world.points.position_m[matches.point_id])
        seen_m = question.frame.camera.back_project(kp.px[matches.keypoint], depth_m)
        away_m = np.linalg.norm(seen_m - predicted_m, axis=1)
        is_off = away_m > self.config.tolerance_m * np.maximum(depth_m, 1.0)
        off[matches.keypoint] = is_off & (depth_m > 0)
        on[matches.keypoint] = ~is_off & (depth_m > 0)
        return off, on

    def _is_behind(self, depth_m: F32, inside: Bool) -> Bool:
        """Return which keypoints (N,) have a depth behind the foreground of those inside a box (N,)."""
        known = depth_m[inside & (depth_m > 0)]
        if len(known) == 0:
            return np.zeros(len(depth_m), dtype=np.bool_)
        return np.asarray(depth_m > np.quantile(known, 0.25) + self.config.behind_m)
