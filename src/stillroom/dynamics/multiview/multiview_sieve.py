"""DynaSLAM's rule: dynamic is what a network masks, and what multi-view geometry finds."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.frame import Frame
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.semantics import Instance, Semantics, union_of
from stillroom.dynamics.ants.search import ALL, REVERSE_ANTS, SEARCHES, ReverseSearchConfig, papers_search
from stillroom.dynamics.asking import ImageMemory
from stillroom.dynamics.multiview.multiview_geometry import AlongPath, GeometryConfig
from stillroom.dynamics.multiview.views import FARTHEST, NEAREST, KeyframesConfig
from stillroom.geometry.arrays import F64, Bool
from stillroom.geometry.pixels import Shape, grown, values_at
from stillroom.protocols import Parts

NEAR = 0.05, 0.02
"""Metres and radians that a pose may move after low-cost tracking before geometry runs again: less than its
resolution.
"""
_VARIANCE_M2 = 0.001
_DIFFERENT_M = 0.2
UNION, GEOMETRY_FIRST = "union", "geometry-first"
COMBINATIONS = (UNION, GEOMETRY_FIRST)


@dataclass(frozen=True)
class MultiViewConfig:
    """The sieve of the `dynaslam` presets, with the numbers that work best on Kinect-like depth.

    The paper's and its code's are `dynamics.kind = "multiview-paper"` and `"multiview-code"` (see `presets`).

    Attributes:
        network: Whether what is potentially dynamic counts as dynamic (N).
        geometry: Whether multi-view geometry is used (G).
        combination: "union" of both masks (DynaSLAM's code), or "geometry-first" (its paper): where both found the same
            object, geometry's mask is used.
        overlap_share: For "geometry-first": both found the same when geometry covers this share of a network's mask.
        dilation_px: Dilation of geometry's mask, by an ellipse; keypoints on its border are dropped too. A network's
            mask is dilated where it is made (`semantics.regions.dilate_px`).
        search: "all", every projected point is tested (DynaSLAM); or "reverse-ants", those that the reverse ant colony
            comes to (PSPNet-SLAM III.C).
        ants: The path and the search along it, for "reverse-ants".
        test: The geometry.
    """

    network: bool = True
    geometry: bool = True
    combination: str = bounded(UNION, one_of=COMBINATIONS)
    overlap_share: float = bounded(0.3, least=0, most=1)
    dilation_px: int = bounded(6, least=0, pixels=1)
    search: str = bounded(ALL, one_of=SEARCHES)
    ants: ReverseSearchConfig = field(default_factory=papers_search)
    test: GeometryConfig = field(default_factory=GeometryConfig)

    def build(self, parts: Parts | None = None) -> "MultiViewSieve":
        """Return the sieve; its seed is that of the ants."""
        check(self)
        return MultiViewSieve(self, 0 if parts is None else parts.seed)


class _Said(NamedTuple):
    """The last answer, and what it was made of: the stages of a frame ask the same."""

    frame: Frame
    known: Semantics
    found: Bool | None
    motion: Motion


class MultiViewSieve:
    """Sieve 2 of `dynaslam`."""

    def __init__(self, config: MultiViewConfig, seed: int = 0) -> None:
        """Start without keyframes."""
        self.config = config
        self.geometry = config.test.build()
        self._along = AlongPath(config.ants.build(seed)) if config.search == REVERSE_ANTS else None
        self._quick: ImageMemory[tuple[Bool | None]] = ImageMemory(*NEAR)
        self._said: _Said | None = None

    def judge(self, question: Question) -> Motion:
        """Classify every keypoint by the mask.

        Geometry runs once an image, at the pose of low-cost tracking (DynaSLAM III.B); where there is none, at the
        local-map stage, and the stages before use the network alone: their matches are of points that were found to be
        static in the last frame. With only a predicted pose everything would seem to move.
        """
        found, known, frame = self._mask(question) if self.config.geometry else None, question.found, question.frame
        said = self._said
        if said is None or said.found is not found or said.known is not known or said.frame is not frame:
            moving = self._moving(found, known)
            motion = Motion(~values_at(moving, frame.keypoints.raw_px), moving)
            self._said = said = _Said(frame, known, found, motion)
        return said.motion

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Store what is dynamic in the frame; a keyframe's depth is kept."""
        said = self._said
        if said is not None and said.frame.image is frame.image and self.config.geometry:
            self.geometry.views.note(frame, T_cam_world, said.motion.moving, keyframe)
        if self._along is not None:
            self._along.remember()

    def corrected(self, T_new_old: F64) -> None:
        """Correct the stored poses."""
        self.geometry.views.follow(T_new_old)
        self._quick.forget()

    def _mask(self, question: Question) -> Bool | None:
        """Return geometry's mask (H, W): that of low-cost tracking, or of this stage, where it may run; else None."""
        frame, T_cam_world = question.frame, question.T_cam_world
        if question.stage is Stage.LOW_COST:
            found = self.geometry.mask(frame, T_cam_world, question.world, self._along)
            return self._quick.keep(frame.image, T_cam_world, (found,))[0]
        quick = self._quick.near(frame.image, T_cam_world)
        if quick is not None:
            return quick[0]
        if question.stage is not Stage.LOCAL_MAP:
            return None
        return self.geometry.mask(frame, T_cam_world, question.world, self._along)

    def _moving(self, found: Bool | None, known: Semantics) -> Bool:
        """Return the union of both masks (H, W)."""
        moving = None if found is None or not found.any() else grown(found, self.config.dilation_px, Shape.ELLIPSE)
        if self.config.network and known.has_any:
            if found is not None and self.config.combination == GEOMETRY_FIRST:
                masked = without_found(known, found, self.config.overlap_share)
            else:
                masked = known.movable
            moving = masked if moving is None else moving | masked
        return np.zeros((known.height, known.width), dtype=np.bool_) if moving is None else moving


def without_found(known: Semantics, found: Bool, share: float) -> Bool:
    """Return what is potentially dynamic (H, W) without objects of which geometry found (H, W) at least a share."""
    kept = [thing for thing in known.objects if _both(thing, found) < share * thing.area_px]
    return union_of(kept, known.height, known.width)


def _both(thing: Instance, found: Bool) -> int:
    """Return how many pixels of an object geometry found."""
    return int(np.count_nonzero(found[thing.window] & thing.pixels))


# DynaSLAM's own numbers: the paper's, and those of its code (docs/reference.md#dynaslam).


def _paper() -> GeometryConfig:
    return GeometryConfig(
        keyframes=KeyframesConfig(least=5, choice=NEAREST, grid_px=0, apart_s=0.0),
        tau_m=0.4,
        tau_per_m=0.0,
        window_px=20,
        patch_px=20,
        patch_std_m=_VARIANCE_M2**0.5,
        patch_std_per_m=0.0,
        seen_through=False,
        growing_stride=1,
        mean_m=_DIFFERENT_M,
        mean_per_m=0.0,
        step_m=100.0,
        step_per_m=0.0,
        min_area_px=0,
    )


def _code() -> GeometryConfig:
    paper = _paper()
    keyframes = replace(paper.keyframes, choice=FARTHEST)
    return replace(paper, keyframes=keyframes, parallax_of_translations=True, tau_m=0.6)


@dataclass(frozen=True)
class PaperMultiViewConfig(MultiViewConfig):
    """The paper's numbers: the five keyframes nearest by distance and rotation, 30°, 0.4 m.

    Where the paper gives none (variance, region growing, dilation), its code's.
    """

    combination: str = bounded(GEOMETRY_FIRST, one_of=COMBINATIONS)
    dilation_px: int = bounded(15, least=0, pixels=1)
    test: GeometryConfig = field(default_factory=_paper)


@dataclass(frozen=True)
class CodeMultiViewConfig(MultiViewConfig):
    """The code's numbers: the five farthest of the last twenty keyframes, 30° from translations, 0.6 m, union."""

    combination: str = bounded(UNION, one_of=COMBINATIONS)
    dilation_px: int = bounded(15, least=0, pixels=1)
    test: GeometryConfig = field(default_factory=_code)
