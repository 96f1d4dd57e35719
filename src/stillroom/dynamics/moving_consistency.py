"""DS-SLAM's sieve: a person on whom enough points leave their epipolar lines goes whole (docs/reference.md#ds-slam)."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.frame import Frame
from stillroom.data.image import Image
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import Instance, Semantics, union_of
from stillroom.dynamics.asking import ImageMemory
from stillroom.dynamics.flow_pairs import FlowPairs, flow_of, inside
from stillroom.dynamics.homography.past import TOO_OLD_S
from stillroom.geometry.arrays import F32, F64, U8, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.pixels import Shape, grown, values_at
from stillroom.geometry.robust import usac
from stillroom.protocols import Parts

_SUBPIXEL_REACH_PX = 10
_SUBPIXEL_END = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.03


@dataclass(frozen=True)
class MovingConsistencyConfig:
    """DS-SLAM's moving-consistency check (Yu et al., IROS 2018, section III-C); numbers are those of its code.

    Corners of the last image are followed into the present one. A fundamental matrix by RANSAC from all of them, again
    from its inliers, gives each an epipolar line; what lies off it is an outlier. A segment of the mask on which there
    are enough outliers moves, and all its keypoints go; on the others all stay.

    Differs from the paper: where there is no last image, or no matrix, every segment moves, as nothing shows that it is
    static. No number of outliers is given for "enough", and the code has one; here it takes three, so that one error of
    the flow does not decide. All of the mask is kept out of the dense map, moving or not, as in the code.

    Attributes:
        corners: Most corners that are followed.
        quality: Weakest corner, as a share of the strongest.
        apart_px: Least distance of two corners.
        window_px: Side of the square around a corner that is followed.
        levels: Levels of the pyramid above the image.
        edge_px: A point this near to the edge of the image is dropped …
        max_difference: … and one whose 3×3 pixels differ by more than this, summed; 2295 is all there can be.
        inlier_px: Tolerance of the matrix.
        line_px: A point further from its line is an outlier.
        reach_px: A segment reaches this far beyond its pixels when outliers on it are counted.
        min_outliers: A segment with so many outliers moves. The code has 1.
        segments: Which segments go when one moves: "own", that one (the paper), or "all" (the code).
    """

    corners: int = bounded(1000, least=1)
    quality: float = bounded(0.01, above=0, below=1)
    apart_px: float = bounded(8.0, above=0, pixels=1)
    window_px: int = bounded(22, least=1, pixels=1)
    levels: int = bounded(5, least=0)
    edge_px: int = bounded(5, least=1, pixels=1)
    max_difference: int = bounded(2120, least=0)
    inlier_px: float = bounded(0.1, above=0, pixels=1)
    line_px: float = bounded(1.0, above=0, pixels=1)
    reach_px: int = bounded(15, least=0, pixels=1)
    min_outliers: int = bounded(3, least=1)
    segments: str = bounded("own", one_of=("own", "all"))

    def build(self, parts: Parts) -> "MovingConsistency":
        """Return the sieve; its seed is that of RANSAC."""
        check(self)
        return MovingConsistency(self, parts.seed)


class MovingConsistency:
    """Sieve 2 of `ds-slam`. What it says depends on the image, its mask and the last image alone."""

    def __init__(self, config: MovingConsistencyConfig, seed: int) -> None:
        """Start without a last image."""
        self.config = config
        self._flow = flow_of(config.window_px, config.levels)
        self._ransac = usac(config.inlier_px, seed, confidence=0.99, magsac=False)
        self._last: Image | None = None
        self._moving: ImageMemory[Bool] = ImageMemory()

    def judge(self, question: Question) -> Motion:
        """Classify the keypoints of segments that move as dynamic, and the pixels of all segments."""
        image, found = question.frame.image, question.found
        if not found.has_any:
            return question.nothing_moves()
        moving = self._moving.of(image)
        if moving is None:
            moving = self._moving_in(image, found, question.frame.camera)
            self._moving.keep(image, question.T_cam_world, moving)
        return Motion(~values_at(moving, question.frame.keypoints.raw_px), found.movable)

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Keep the image, to compare the next one with."""
        self._last = frame.image

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: no pose is stored."""

    def _moving_in(self, image: Image, found: Semantics, camera: Camera) -> Bool:
        """Return the pixels (H, W) of the segments that move."""
        last = self._last
        is_young = last is not None and image.timestamp_s - last.timestamp_s <= TOO_OLD_S
        outliers_px = self._outliers_px(last, image, camera) if last is not None and is_young else None
        if outliers_px is None:
            return found.movable
        config = self.config
        moving = [
            thing for thing in found.objects if count_on(thing, outliers_px, config.reach_px) >= config.min_outliers
        ]
        if moving and config.segments == "all":
            return found.movable
        return union_of(moving, image.height, image.width)

    def _outliers_px(self, last: Image, image: Image, camera: Camera) -> F32 | None:
        """Return where in the image as taken (O, 2) [px] points are off their lines; None where there are no lines."""
        then_px, now_px = self._followed(last, image, camera.in_pixels(_SUBPIXEL_REACH_PX))
        pairs = FlowPairs(
            camera.undistort(then_px).astype(np.float64),
            camera.undistort(now_px).astype(np.float64),
            then_px,
            np.ones(len(then_px), dtype=np.bool_),
        )
        first = pairs.lines_of(pairs.is_found, self._ransac)
        if first is None:
            return None
        F_now_then = pairs.lines_of(~pairs.off_lines(first, self.config.inlier_px), self._ransac)
        return None if F_now_then is None else now_px[pairs.off_lines(F_now_then, self.config.line_px)]

    def _followed(self, last: Image, image: Image, reach_px: int) -> tuple[F32, F32]:
        """Return corners of the last image (P, 2) and where they are in this one (P, 2) [px, as taken].

        Args:
            last: The last image.
            image: This one.
            reach_px: Half the side of the square in which a corner is refined.
        """
        config = self.config
        corners: Any = cv2.goodFeaturesToTrack(last.gray, config.corners, config.quality, config.apart_px)
        if corners is None:
            return np.zeros((0, 2), dtype=np.float32), np.zeros((0, 2), dtype=np.float32)
        refined = cv2.cornerSubPix(last.gray, corners, (reach_px, reach_px), (-1, -1), _SUBPIXEL_END)
        then_px = np.asarray(refined[:, 0], dtype=np.float32)
        now_px, is_found = self._flow.follow(last.gray, image.gray, then_px)
        for px, of in ((then_px, last), (now_px, image)):
            is_found &= inside(px, of, config.edge_px)
        then_px, now_px = then_px[is_found], now_px[is_found]
        alike = differences(last.gray, image.gray, then_px, now_px) <= config.max_difference
        return then_px[alike], now_px[alike]


def differences(first: U8, second: U8, first_px: F32, second_px: F32) -> F64:
    """Return the summed difference of 3×3 pixels around points (P, 2) of two images (H, W), (P,); none at an edge."""
    step = np.arange(-1, 2)
    patches = []
    for image, px in ((first, first_px), (second, second_px)):
        column, row = np.rint(px).astype(np.int64).T
        patches.append(image[row[:, None, None] + step[:, None], column[:, None, None] + step].astype(np.float64))
    return np.asarray(np.abs(patches[0] - patches[1]).sum(axis=(1, 2)))


def count_on(thing: Instance, points_px: F32, reach_px: int) -> int:
    """Return how many points (P, 2) of the image as taken lie on an object, or this near to it [px]."""
    pixels = grown(np.pad(thing.pixels, reach_px), reach_px, Shape.SQUARE)
    at = np.rint(points_px).astype(np.int64) - (thing.x_px - reach_px, thing.y_px - reach_px)
    at = at[np.all((at >= 0) & (at < pixels.shape[::-1]), axis=1)]
    return int(np.count_nonzero(pixels[at[:, 1], at[:, 0]]))
