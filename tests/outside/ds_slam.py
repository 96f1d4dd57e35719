"""DS-SLAM in outline (Yu et al., IROS 2018): a person goes when enough points on it leave their epipolar lines."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillroom.config import SlamConfig
from stillroom.data.frame import Frame
from stillroom.data.image import Image
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics, union_of
from stillroom.dynamics.asking import ImageMemory
from stillroom.geometry.epipolar import line_distances_px
from stillroom.presets.method import Method
from stillroom.protocols import Parts
from stillroom.semantics.masks.pspnet import PspNetConfig


@dataclass(frozen=True)
class DsSlamConfig:
    """Largest distance from an epipolar line [px], and how many points beyond it make an object move."""

    line_px: float = 1.0
    min_moving: int = 3

    def build(self, parts: Parts) -> "DsSlam":
        """Return the sieve."""
        return DsSlam(self, parts.seed)


class DsSlam:
    """Sieve 2: optical flow from the last image, F by RANSAC, and the objects on which points do not obey it."""

    def __init__(self, config: DsSlamConfig, seed: int) -> None:
        self.config, self.usac = config, cv2.UsacParams()
        self.usac.randomGeneratorState, self.usac.threshold = seed, 0.5
        self.last: Image | None = None
        self.moving: ImageMemory[np.ndarray] = ImageMemory()

    def judge(self, question: Question) -> Motion:
        image, known = question.frame.image, question.known
        moving = self.moving.of(image)
        if moving is None:
            moving = self.moving.keep(image, question.T_cam_world, self.moving_in(image, known))
        column, row = np.rint(question.frame.keypoints.raw_px).astype(int).T
        return Motion(~moving[row, column], moving)

    def remember(self, frame: Frame, T_cam_world: np.ndarray, keyframe: int) -> None:
        self.last = frame.image

    def corrected(self, T_new_old: np.ndarray) -> None:
        """Nothing that is remembered lies in the world."""

    def moving_in(self, image: Image, known: Semantics) -> np.ndarray:
        """Return the pixels (H, W) of the objects that move; all of them where there is nothing to compare with."""
        if self.last is None or not known.has_any:
            return known.movable
        corners = cv2.goodFeaturesToTrack(self.last.gray, 1000, 0.01, 8)
        now, found, _ = cv2.calcOpticalFlowPyrLK(self.last.gray, image.gray, corners, None, winSize=(22, 22))
        here = np.rint(now[:, 0]).astype(int)
        found = (found[:, 0] == 1) & ((here >= 0) & (here < (image.width, image.height))).all(axis=1)
        then_px, now_px = corners[found, 0].astype(np.float64), now[found, 0].astype(np.float64)
        F, _ = cv2.findFundamentalMat(then_px, now_px, self.usac)
        if F is None or F.shape != (3, 3):
            return known.movable
        column, row = here[found][line_distances_px(F, then_px, now_px) > self.config.line_px].T
        off = np.zeros((image.height, image.width), dtype=bool)
        off[row, column] = True
        moves = [thing for thing in known.objects if (off[thing.window] & thing.pixels).sum() >= self.config.min_moving]
        return union_of(moves, image.height, image.width)


METHOD = Method(
    name="ds-slam-outline",
    summary="people on whom enough points leave their epipolar lines",
    config=replace(SlamConfig(method="ds-slam-outline"), semantics=PspNetConfig(), dynamics=DsSlamConfig()),
)
