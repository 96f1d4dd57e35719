"""PSPNet-SLAM's geometry as printed (III.B, III.C): projected features, DynaSLAM's test, and the ants' search."""

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import cv2
import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.frame import Frame
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.result import Tracked
from stillroom.data.semantics import Semantics
from stillroom.dynamics.ants.search import (
    REVERSE_ANTS,
    SEARCHES,
    ReverseSearchConfig,
    SearchResult,
    communities_of,
    exhaustive,
    papers_search,
)
from stillroom.dynamics.homography.past import TOO_OLD_S
from stillroom.dynamics.multiview.multiview_sieve import NEAR
from stillroom.dynamics.projected.compensation_frame import (
    CompensationFrame,
    CompensationFrameConfig,
    PreviousFrame,
    compensate,
)
from stillroom.dynamics.projected.occlusion import Occlusion, OcclusionConfig, occlusion_of
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32, Bool
from stillroom.geometry.pixels import values_at
from stillroom.protocols import Parts


@dataclass(frozen=True)
class PaperAntsConfig:
    """The sieve of the `pspnet-slam-paper` preset.

    The features of the very last frame are projected into the present one by the compensated homography, and along the
    ants' path DynaSLAM's test says of each projected point whether it is dynamic; around what is, the search grows.

    Differs from the paper:

    - DynaSLAM tests points that it projects by pose and depth; the paper applies its test to points projected by a
      homography, which have no depth of their own. Here such a point keeps the depth that the previous frame measured,
      read from the compensation frame at x′ = Hx. The camera's tracked motion makes of it z_proj, and the depth z′
      measured at x′ is compared: dynamic where z_proj − z′ > τ. The previous frame stands in the place of DynaSLAM's
      keyframe in the limit on the parallax.
    - The paper does not say which present keypoints are dynamic when projected points are: here those in the hull of a
      community, and those matched with a dynamic point.
    - The matches that the homography is found from are ORB's, outside the masks; the paper does not say. The pheromone
      on the edges of the path outlives the image, as in `PathConfig`.

    Attributes:
        search: "reverse-ants", along the path; or "all", every projected point.
        compensation: How the homography is found.
        test: DynaSLAM's test.
        ants: The path and the search along it.
    """

    needs_depth_image: ClassVar[bool] = True

    search: str = bounded(REVERSE_ANTS, one_of=SEARCHES)
    compensation: CompensationFrameConfig = field(default_factory=CompensationFrameConfig)
    test: OcclusionConfig = field(default_factory=OcclusionConfig)
    ants: ReverseSearchConfig = field(default_factory=papers_search)

    def build(self, parts: Parts) -> "PaperAntsSieve":
        """Return the sieve; its seed is that of RANSAC and of the ants."""
        check(self)
        return PaperAntsSieve(self, parts.seed)


@dataclass(frozen=True)
class Projected:
    """The result of the geometry on an image; kept for pictures and tests.

    Attributes:
        index: Number of the image.
        previous: The frame before.
        moved: Its image and features, compensated.
        test: The test, which can be run on other points.
        found: Result of the search; its points are the test's.
    """

    index: int
    previous: PreviousFrame = field(repr=False)
    moved: CompensationFrame = field(repr=False)
    test: Occlusion = field(repr=False)
    found: SearchResult

    @property
    def matched(self) -> I32:
        """Present keypoints (M,) that match a dynamic point."""
        is_dynamic = np.zeros(len(self.previous.frame), dtype=np.bool_)
        is_dynamic[self.test.keypoint[self.found.is_dynamic]] = True
        pairs: I32 = self.moved.present[is_dynamic[self.moved.previous]]
        return pairs

    def hulls(self, height: int, width: int) -> Bool:
        """Return the pixels (H, W) within the hulls of the communities."""
        filled = np.zeros((height, width), dtype=np.uint8)
        for hull_px in self.found.hulls:
            cv2.fillConvexPoly(filled, np.rint(hull_px).astype(np.int32), 1)
        return filled.view(np.bool_)


class _Compensated(NamedTuple):
    """What does not depend on the pose, and what it was made of."""

    frame: Frame
    known: Semantics
    moved: CompensationFrame | None


class _Found(NamedTuple):
    """The last result of the geometry, and the pose that it was made with."""

    compensated: _Compensated
    T_cam_world: F64
    projected: Projected | None


class PaperAntsSieve:
    """Sieve 2 of `pspnet-slam-paper`; a `KeyframeSieve`, for its network sees keyframes only.

    Attributes:
        projected: The result on the last image; None where there was nothing to compare with.
    """

    def __init__(self, config: PaperAntsConfig, seed: int = 0) -> None:
        """Start without earlier images."""
        self.config, self.seed = config, seed
        self._ants = config.ants.build(seed)
        self._previous: PreviousFrame | None = None
        self._compensated: _Compensated | None = None
        self._found: _Found | None = None
        self._masked: tuple[Frame, Bool] | None = None
        self._said: tuple[Frame, Semantics, Projected | None, Motion] | None = None
        self.projected: Projected | None = None

    def judge(self, question: Question) -> Motion:
        """Classify by the masks, and outside them by geometry.

        Geometry needs a pose: that of low-cost tracking (III.B), and where there is none that of the local map; the
        stages before then use the masks alone.
        """
        frame, known, projected = question.frame, question.found, self._examined(question)
        said = self._said
        if said is None or said[0] is not frame or said[1] is not known or said[2] is not projected:
            masked = known.movable_at(frame.keypoints.raw_px)
            self._masked = frame, masked
            self._said = said = frame, known, projected, _verdict(frame, known, masked, projected)
        return said[3]

    def take_up(self, tracked: Tracked, found: Semantics) -> Motion:
        """Add what the network finds in a keyframe; the next frame is compared with what that leaves."""
        frame = tracked.frame
        masked = found.movable_at(frame.keypoints.raw_px)
        before = self._masked[1] if self._is_of(frame) and self._masked is not None else masked
        self._masked = frame, masked | before
        return tracked.motion.united_with(Motion(~masked, found.movable))

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Store the frame as the previous one; the ants remember their search."""
        known = self._masked is not None and self._is_of(frame)
        masked = self._masked[1] if known and self._masked is not None else np.zeros(len(frame), dtype=np.bool_)
        self._previous = PreviousFrame(frame, masked, T_cam_world.copy())
        if self.projected is not None and self.projected.index == frame.image.index:
            self._ants.remember(self.projected.test.raw_px, self.projected.found)

    def _is_of(self, frame: Frame) -> bool:
        """Return whether the masks are those of a frame; a rolling shutter moves its keypoints, not where they are."""
        return self._masked is not None and self._masked[0].keypoints.raw_px is frame.keypoints.raw_px

    def corrected(self, T_new_old: F64) -> None:
        """Correct the stored pose."""
        if self._previous is not None:
            T_cam_world = self._previous.T_cam_world @ se3.inverse(T_new_old)
            self._previous = PreviousFrame(self._previous.frame, self._previous.is_masked, T_cam_world)
        self._found = None

    def _examined(self, question: Question) -> Projected | None:
        """Return the result of the geometry at this stage, or at an earlier one with nearly the same pose."""
        compensated, T_cam_world, found = self._frame_of(question), question.T_cam_world, self._found
        is_known = found is not None and found.compensated is compensated and question.stage is not Stage.LOW_COST
        if is_known and found is not None and se3.are_near(found.T_cam_world, T_cam_world, *NEAR):
            return found.projected
        if question.stage not in (Stage.LOW_COST, Stage.LOCAL_MAP):
            return None
        self.projected = self._search(compensated, T_cam_world)
        self._found = _Found(compensated, T_cam_world.copy(), self.projected)
        return self.projected

    def _frame_of(self, question: Question) -> _Compensated:
        """Return the compensation frame, made once for each image."""
        frame, known, made = question.frame, question.found, self._compensated
        if made is None or made.frame.keypoints.raw_px is not frame.keypoints.raw_px or made.known is not known:
            previous, moved = self._previous, None
            if previous is not None and 0.0 < frame.timestamp_s - previous.frame.timestamp_s <= TOO_OLD_S:
                masked = known.movable_at(frame.keypoints.raw_px)
                moved = compensate(previous, frame, masked, self.config.compensation, self.seed)
            self._compensated = made = _Compensated(frame, known, moved)
            self.projected = None
        return made

    def _search(self, compensated: _Compensated, T_cam_world: F64) -> Projected | None:
        """Test the projected points along the path, or all of them."""
        frame, moved, previous = compensated.frame, compensated.moved, self._previous
        if moved is None or previous is None:
            return None
        test = occlusion_of(previous, moved, frame, T_cam_world, self.config.test)
        if self.config.search == REVERSE_ANTS:
            found = self._ants.search(test.raw_px, test)
        else:
            found = communities_of(test.raw_px, exhaustive(test.raw_px, test), self.config.ants)
        return Projected(frame.image.index, previous, moved, test, found)


def _verdict(frame: Frame, known: Semantics, masked: Bool, projected: Projected | None) -> Motion:
    """Combine the masks, in which keypoints (N,) lie, and the geometry."""
    is_static = ~masked
    if projected is None:
        return Motion(is_static, known.movable)
    is_static[projected.matched] = False
    if not projected.found.hulls:
        return Motion(is_static, known.movable)
    hulls = projected.hulls(frame.image.height, frame.image.width)
    is_static &= ~values_at(hulls, frame.keypoints.raw_px)
    return Motion(is_static, known.movable | hulls)
