"""DynaSLAM's rule for what moves: what a network says may move, and what multi-view geometry says does."""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np

from stillroom.data.frame import Frame
from stillroom.data.image import RgbdImage
from stillroom.data.map import Map
from stillroom.data.map.jumps import JumpFollower
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Instance, Semantics, nothing, union_of
from stillroom.dynamics.enough import or_less
from stillroom.dynamics.multiview.geometry import GeometryConfig
from stillroom.dynamics.multiview.views import CHOICES
from stillroom.errors import ConfigError
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, U8, Bool
from stillroom.protocols import Pending

UNION, GEOMETRY_FIRST = "union", "geometry-first"
COMBINATIONS = (UNION, GEOMETRY_FIRST)

NEAR = 0.05, 0.02
"""Metres and radians that a pose may move after low-cost tracking before geometry is asked again: less than it sees."""


@dataclass(frozen=True)
class MultiViewConfig:
    """The sieve of the `dynaslam` presets, with the numbers that work best on Kinect-like depth.

    The paper's and its code's are `dynamics.kind = "multiview-paper"` and `"multiview-code"` (see `presets`).

    Attributes:
        network: Whether what may move counts as moving (N).
        geometry: Whether multi-view geometry is asked (G).
        combination: "union" of both masks (DynaSLAM's code), or "geometry-first" (its paper): where both found the
            same thing, geometry's mask stands for it.
        overlap_share: For "geometry-first": both found the same when geometry covers this share of a network's mask.
        dilation_px: How far geometry's mask is grown, as an ellipse; keypoints on its border go with it. A network's
            mask is grown where it is made (`semantics.regions.dilate_px`).
        min_matches: Geometry is not heard where fewer matches than this would stay, nor then the network: tracking
            needs 30 that agree.
        test: The geometry.
    """

    network: bool = True
    geometry: bool = True
    combination: str = UNION
    overlap_share: float = 0.3
    dilation_px: int = 6
    min_matches: int = 40
    test: GeometryConfig = field(default_factory=GeometryConfig)

    def build(self, seed: int = 0) -> "MultiViewSieve":
        """Return the sieve.

        Raises:
            ConfigError: A value is impossible.
        """
        if self.combination not in COMBINATIONS:
            raise ConfigError(f"combination is '{self.combination}'; there are {', '.join(COMBINATIONS)}")
        if self.test.keyframes.choice not in CHOICES:
            raise ConfigError(f"choice is '{self.test.keyframes.choice}'; there are {', '.join(CHOICES)}")
        for name, value in (("growing_stride", self.test.growing_stride), ("kept", self.test.keyframes.kept)):
            if value < 1:
                raise ConfigError(f"{name} is {value}; it must be 1 or more")
        return MultiViewSieve(self)


@dataclass(frozen=True)
class _Found:
    """What geometry found in low-cost tracking: the image, its pose there (4, 4), and the mask (H, W)."""

    image: RgbdImage
    T_cam_world: F64
    mask: Bool | None


class MultiViewSieve:
    """Sieve 2 of `dynaslam`."""

    def __init__(self, config: MultiViewConfig) -> None:
        """Start without a past."""
        self.config = config
        self.geometry = config.test.build()
        self._quick: _Found | None = None
        self._jumps = JumpFollower()

    def judge(
        self,
        stage: Stage,
        frame: Frame,
        matches: Matches,
        semantics: Pending[Semantics],
        T_cam_world: F64,
        world: Map,
    ) -> Motion:
        """Judge every keypoint by the mask that it lies in.

        Geometry is asked once an image, under the pose of low-cost tracking (DynaSLAM III.B); where there is none, at
        the local-map stage, and the stages before are judged by the network alone: their matches are of points that
        were found to be static in the last frame. Under a mere guess of the pose everything would seem to move.
        """
        if stage is Stage.RELOCALIZATION:
            return Motion.none(len(frame), frame.image.height, frame.image.width)
        if self._jumps.follow(world, (self.geometry.views,)):
            self._quick = None
        self.geometry.views.settle(world)
        found = self._mask(stage, frame, T_cam_world, world) if self.config.geometry else None
        known = semantics.result()
        moving = self._moving(found, known)
        column, row = np.rint(frame.keypoints.raw_px).astype(np.int64).T
        motion = Motion(~moving[row, column], moving)
        if stage is Stage.LOCAL_MAP and self.config.geometry:
            self.geometry.views.note(frame, T_cam_world, moving)
        at_least = known if self.config.network else nothing(known.height, known.width)
        return or_less(motion, frame, at_least, matches, self.config.min_matches)

    def _mask(self, stage: Stage, frame: Frame, T_cam_world: F64, world: Map) -> Bool | None:
        """Return geometry's mask (H, W): what low-cost tracking found, or this stage, where it may ask; else None."""
        quick = self._quick
        if stage is Stage.LOW_COST:
            quick = self._quick = _Found(frame.image, T_cam_world.copy(), self.geometry.mask(frame, T_cam_world, world))
        if quick is not None and quick.image is frame.image and se3.are_near(quick.T_cam_world, T_cam_world, *NEAR):
            return quick.mask
        return self.geometry.mask(frame, T_cam_world, world) if stage is Stage.LOCAL_MAP else None

    def _moving(self, found: Bool | None, known: Semantics) -> Bool:
        """Return what moves (H, W) by both accounts; an array of its own."""
        moving = np.zeros((known.height, known.width), dtype=np.bool_)
        if self.config.network and known.has_any:
            if found is not None and self.config.combination == GEOMETRY_FIRST:
                moving |= without_found(known, found, self.config.overlap_share)
            else:
                moving |= known.movable
        if found is not None:
            moving |= dilated(found, self.config.dilation_px)
        return moving


def without_found(known: Semantics, found: Bool, share: float) -> Bool:
    """Return what may move (H, W) without the objects of which geometry found (H, W) at least a share."""
    kept = [thing for thing in known.objects if _both(thing, found) < share * thing.area_px]
    return union_of(kept, known.height, known.width)


def _both(thing: Instance, found: Bool) -> int:
    """Return how many pixels of an object geometry found."""
    return int(np.count_nonzero(found[thing.window] & thing.pixels))


def dilated(mask: Bool, reach_px: int) -> Bool:
    """Return a mask (H, W) grown by an ellipse of this reach."""
    if reach_px <= 0 or not mask.any():
        return mask
    return np.asarray(cv2.dilate(mask.view(np.uint8), _ellipse(reach_px))).view(np.bool_)


@lru_cache
def _ellipse(reach_px: int) -> U8:
    size = 2 * reach_px + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)
