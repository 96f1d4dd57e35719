"""PSPNet-SLAM's geometry as a match sieve: what the compensated homography does not explain, found along a path."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from stillroom.bounds import bounded, check
from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.data.image import Image
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics
from stillroom.dynamics.ants.search import ReverseSearchConfig, SearchResult, communities_of, exhaustive
from stillroom.dynamics.homography.compensation import CameraMotion, Compensation, CompensationConfig
from stillroom.dynamics.homography.past import Past, view_of
from stillroom.dynamics.homography.point_motion import DYNAMIC, UNKNOWN, ImageView, PointTest, PointTestConfig
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I64, U8, Bool
from stillroom.geometry.pixels import values_at
from stillroom.protocols import Parts

SEARCHES = ("reverse", "exhaustive")


@dataclass(frozen=True)
class CompensatedHomographyConfig:
    """The sieve of the `pspnet-slam` preset (PSPNet-SLAM III.B and III.C).

    The keypoints outside the masks are followed to an earlier image; a homography is fitted to them, and compensated.
    Those of them near a path are tested: a point moves when it was elsewhere in the earlier image than the
    homography says, or its place was empty.

    Differs from the paper: one homography cannot explain a scene with depth, in which static points shift by their
    parallax. So a point is static, too, when the camera's motion in space and its depth explain where it was, and one
    without a depth when it was shifted along its epipolar line. The earlier image is not the very last one, to which
    little has moved. The paper's own rule is `test.use_depth = false`, `earlier_s = 0`.

    Attributes:
        earlier_s: Age of the image that the present one is compared with [s].
        search: reverse, along the path; or exhaustive, every point.
        fill_px, fill_m: Pixels in the hull of a moving community move when they are this near to one of its points, in
            the image and in depth; the wall behind it does not.
        compensation: How the camera's motion is found.
        test: When a point moves.
        ants: The path and the search along it.
    """

    earlier_s: float = bounded(0.1, least=0)
    search: str = bounded("reverse", one_of=SEARCHES)
    fill_px: float = bounded(40.0, least=0, pixels=1)
    fill_m: float = bounded(0.15, least=0)
    compensation: CompensationConfig = field(default_factory=CompensationConfig)
    test: PointTestConfig = field(default_factory=PointTestConfig)
    ants: ReverseSearchConfig = field(default_factory=ReverseSearchConfig)

    def build(self, parts: Parts) -> "CompensatedHomographySieve":
        """Return the sieve; its seed is that of MAGSAC and of the ants."""
        check(self)
        return CompensatedHomographySieve(self, parts.seed)


@dataclass(frozen=True)
class Findings:
    """The result of the geometry on an image; kept for pictures and tests.

    Attributes:
        index: Number of the image.
        candidates: Keypoints outside the masks (K,), which were searched.
        found: Result of the search; its points are the candidates.
        verdicts: Result of the test for each candidate (K,), UNKNOWN where it was not tested.
        camera_motion: How the camera moved.
        test: The test, which can be run on other points.
    """

    index: int
    candidates: I64
    found: SearchResult
    verdicts: I64
    camera_motion: CameraMotion
    test: PointTest = field(repr=False)


class CompensatedHomographySieve:
    """Sieve 2 of `pspnet-slam`. An image is classified at the first call, with the pose known by then."""

    def __init__(self, config: CompensatedHomographyConfig, seed: int = 0) -> None:
        """Start without earlier images."""
        self.config, self.seed = config, seed
        self._compensation = Compensation(config.compensation, seed)
        self._past = Past(config.earlier_s)
        self._ants = config.ants.build(seed)
        self._asked: Frame | None = None
        self._remembered: Image | None = None
        self.findings: Findings | None = None
        self._said: tuple[Semantics, Motion] | None = None

    def judge(self, question: Question) -> Motion:
        """Classify by the masks, and outside them by geometry."""
        frame, known = question.frame, question.found
        if self._asked is None or self._asked.image is not frame.image:
            self._view, self.findings = view_of(frame.image), None
        # A later stage tries again with a better pose, in case the first one gave no result.
        again = self.findings is None or self._asked is None or self._asked.keypoints is not frame.keypoints
        if again or self._said is None or self._said[0] is not known:
            masked = known.movable_at(frame.keypoints.raw_px)
            if again:
                self.findings = self.examine(frame, known, masked, self._view, question.T_cam_world)
            self._said = known, self._verdict(frame, known, masked)
        self._asked = frame
        return self._said[1]

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Store an image for the next one; the ants are updated once."""
        if self._asked is None or self._asked.image is not frame.image:
            return
        self._past.remember(frame, self._view, T_cam_world)
        if self.findings is not None and self._remembered is not frame.image:
            self._ants.remember(self.findings.test.raw_px, self.findings.found)
            self._remembered = frame.image

    def corrected(self, T_new_old: F64) -> None:
        """Correct the stored poses."""
        self._past.follow(T_new_old)

    def examine(
        self, frame: Frame, known: Semantics, masked: Bool, view: ImageView, T_cam_world: F64
    ) -> Findings | None:
        """Return the result of the geometry; None where there is nothing to compare with, or it cannot be compared."""
        for earlier in self._past.before(frame):
            guess = earlier.T_cam_world @ se3.inverse(T_cam_world)
            camera_motion = self._compensation(frame, masked, view.half, earlier.view.half, guess)
            if camera_motion is not None:
                return self._search(frame, known, masked, view, earlier.view, camera_motion)
        return None

    def _search(
        self,
        frame: Frame,
        known: Semantics,
        masked: Bool,
        view: ImageView,
        earlier: ImageView,
        camera_motion: CameraMotion,
    ) -> Findings:
        """Test the keypoints that are not masked (N,) along the path, or all of them."""
        kp, config, candidates = frame.keypoints, self.config, np.flatnonzero(~masked)
        test = PointTest(
            config.test,
            frame.camera,
            view,
            earlier,
            kp.raw_px[candidates].astype(np.float64),
            kp.px[candidates].astype(np.float64),
            np.asarray(kp.depth_m[candidates], dtype=np.float64),
            camera_motion.T_then_now,
            np.asarray(np.linalg.inv(camera_motion.H_now_then), dtype=np.float64),
        )
        verdicts = np.full(len(candidates), UNKNOWN, dtype=np.int64)

        def is_dynamic(which: I64) -> Bool:
            verdicts[which] = test(which)
            return np.asarray(verdicts[which] == DYNAMIC)

        if config.search == "exhaustive":
            found = communities_of(test.raw_px, exhaustive(test.raw_px, is_dynamic), config.ants)
        else:
            found = self._ants.search(test.raw_px, is_dynamic, known.movable if known.has_any else None)
        return Findings(frame.image.index, candidates, found, verdicts, camera_motion, test)

    def _verdict(self, frame: Frame, known: Semantics, masked: Bool) -> Motion:
        """Combine the masks, in which keypoints (N,) lie, and the geometry."""
        moving, findings, is_static = known.movable, self.findings, ~masked
        if findings is None:
            return Motion(is_static, moving)
        is_static[findings.candidates[findings.found.is_dynamic]] = False
        if findings.found.hulls:
            geometry = self._filled(findings, frame.image.known_depth_m)
            # What could not be tested gets the label of its community.
            lone = values_at(geometry, findings.test.raw_px) & (findings.verdicts == UNKNOWN)
            is_static[findings.candidates[lone]] = False
            moving = moving | geometry
        return Motion(is_static, moving)

    def _filled(self, findings: Findings, depth_m: F32) -> Bool:
        """Return the pixels (H, W) of communities: in the hull of one, and near a member, also in depth."""
        found, test, filled = findings.found, findings.test, np.zeros(depth_m.shape, dtype=np.bool_)
        for hull_px, members in zip(found.hulls, found.members, strict=True):
            hull = np.zeros(depth_m.shape, dtype=np.uint8)
            cv2.fillConvexPoly(hull, np.rint(hull_px).astype(np.int32), 1)
            members_px, members_m = test.raw_px[members], test.depth_m[members]
            fill(hull, members_px, members_m, self.config.fill_px, self.config.fill_m, depth_m, filled)
        return filled


@njit(nogil=True, cache=True)
def fill(
    hull: U8, members_px: F64, members_m: F64, radius_px: float, margin_m: float, depth_m: F32, filled: Bool
) -> None:
    """Mark the pixels (H, W) of a hull that are near a member (M, 2) [px], (M,) [m]: in the image, and in depth.

    A pixel without a depth is near in depth; a member without one is near only such pixels.
    """
    height, width = hull.shape
    for k in range(len(members_px)):
        x, y = members_px[k]
        for row in range(max(0, int(np.ceil(y - radius_px))), min(height, int(y + radius_px) + 1)):
            half = np.sqrt(max(0.0, radius_px * radius_px - (row - y) * (row - y)))
            for column in range(max(0, int(np.ceil(x - half))), min(width, int(x + half) + 1)):
                if hull[row, column] == 0 or filled[row, column]:
                    continue
                z = depth_m[row, column]
                if z <= 0.0 or (members_m[k] > 0.0 and abs(z - members_m[k]) <= margin_m):
                    filled[row, column] = True
