"""Tracking between keyframes by optical flow, without new keypoints (NGD-SLAM; docs/reference.md#ngd-slam-tracking).

The keypoints of the last frame that see map points are followed into the present image by Lucas–Kanade. They keep
octave, angle and descriptor, both sieves classify them, and the pose is found from those that are static. Keypoints are
extracted again after two images, in fast turns and for a while after them, where too few points are left, and where a
keyframe is due.

Differs from NGD-SLAM: the search starts where the motion model expects a point, a point is followed back as well, the
pose is optimised from the motion model's guess without RANSAC, the rules for keyframes are ORB-SLAM2's, and keypoints
are extracted more often than keyframes come: with keyframes only, the error on Bonn `crowd` rises by a tenth.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame, Keypoints
from stillroom.data.image import Image
from stillroom.data.map import Map
from stillroom.data.result import Tracked
from stillroom.data.semantics import Semantics
from stillroom.features.keypoint_depth import depth_at
from stillroom.features.optical_flow import OpticalFlow
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, Bool
from stillroom.protocols import KeypointSieve, Pending

_NEAREST_M = 0.05
LEAST_WINDOW_PX = 3
"""OpenCV takes no smaller one."""


@dataclass(frozen=True)
class FlowConfig:
    """When a frame is tracked by flow, and how; see `tracking.between_keyframes`.

    Attributes:
        max_images: Images, one after the other, that are tracked by flow before keypoints are extracted again.
        max_gap_s: Longest time since the last image; between images of a slower camera things move too far.
        max_turn_px: A turn that shifts the image by more than this, from one to the next, is fast: images are blurred
            then, and points leave the view.
        calm_images: Images without a fast turn that must come first. A shaken camera is slow for an image or two where
            it turns back, and with flow there errors on freiburg1_rpy rise by a tenth.
        window_px: Side of the square around a point that is followed.
        levels: Levels of the pyramid above the image.
        max_return_px: A point that is followed back must arrive this near to where it was.
        min_inliers: Fewest inliers of the pose …
        min_share: … also as a share of the points that were followed.
        min_depth_m, max_depth_m: Depth outside this range counts as unknown.
    """

    max_images: int = bounded(2, least=0)
    max_gap_s: float = bounded(0.07, above=0)
    max_turn_px: float = bounded(10.0, above=0, pixels=1)
    calm_images: int = bounded(10, least=0)
    window_px: int = bounded(11, least=1, pixels=1)
    levels: int = bounded(1, least=0)
    max_return_px: float = bounded(0.5, above=0, pixels=1)
    min_inliers: int = bounded(100, least=0)
    min_share: float = bounded(0.6, least=0, most=1)
    min_depth_m: float = bounded(0.1, least=0)
    max_depth_m: float = bounded(20.0, above=0)


class PoseFinder(Protocol):
    """What tracking by flow needs of the tracker."""

    def expected(self, world: Map) -> tuple[Tracked, F64] | None:
        """Return the last frame as known now, and the guess `T_cam_world` (4, 4); None where either is unknown."""

    def locate_followed(
        self, frame: Frame, guess: F64, point_ids: I32, reference: int, semantics: Pending[Semantics], world: Map
    ) -> Tracked:
        """Return a frame whose keypoints see points (N,) with its pose, near a guess (4, 4)."""


class KeyframeRule(Protocol):
    """What tracking by flow needs of the keyframe policy."""

    def is_due(self, tracked: Tracked, world: Map) -> bool:
        """Return whether a frame should become a keyframe."""


class OrbAlways:
    """The null object: no frame is tracked by flow.

    Attributes:
        extracts_all: Whether keypoints of every image are extracted.
    """

    extracts_all = True

    def follow(self, image: Image, semantics: Pending[Semantics], world: Map) -> Tracked | None:
        """Return None."""
        return None


class FlowTracking:
    """Tracks images by flow where it may.

    Attributes:
        extracts_all: Whether keypoints of every image are extracted.
    """

    extracts_all = False

    def __init__(
        self, config: FlowConfig, poses: PoseFinder, keypoint_sieve: KeypointSieve, keyframes: KeyframeRule
    ) -> None:
        """Start; the first images have keypoints of their own."""
        self.config, self.poses, self.keypoint_sieve, self.keyframes = config, poses, keypoint_sieve, keyframes
        window_px = max(LEAST_WINDOW_PX, config.window_px)
        self._flow, self._back = OpticalFlow(window_px, config.levels), OpticalFlow(window_px, levels=0)
        self._n_in_a_row = self._n_calm = 0

    def follow(self, image: Image, semantics: Pending[Semantics], world: Map) -> Tracked | None:
        """Return the image's frame with its pose; None where keypoints have to be extracted.

        Args:
            image: The image after the tracker's last frame.
            semantics: What is potentially dynamic in it.
            world: The map.
        """
        config, expected, tracked = self.config, self.poses.expected(world), None
        if expected is not None and image.timestamp_s - expected[0].frame.timestamp_s > config.max_gap_s:
            expected = None
        self._n_calm = self._n_calm + 1 if expected is not None and self._is_calm(*expected) else 0
        if expected is not None and self._n_calm > config.calm_images and self._n_in_a_row < config.max_images:
            tracked = self._track(image, *expected, semantics, world)
        if tracked is not None and self.keyframes.is_due(tracked, world):
            tracked = None  # a keyframe has keypoints of its own
        self._n_in_a_row = 0 if tracked is None else self._n_in_a_row + 1
        return tracked

    def _is_calm(self, last: Tracked, guess: F64) -> bool:
        """Return whether the camera is expected to turn slowly."""
        assert last.T_world_cam is not None
        return last.frame.camera.fx * float(se3.angle_rad(guess @ last.T_world_cam)) <= self.config.max_turn_px

    def _track(
        self, image: Image, last: Tracked, guess: F64, semantics: Pending[Semantics], world: Map
    ) -> Tracked | None:
        """Return the image's frame, given the last one and a guess of the pose; None where too little is found."""
        seen, shift_px = expected_shifts(last, guess, world)
        frame, followed = self._follow(last.frame, image, seen, shift_px)
        if len(frame) < self.config.min_inliers:
            return None
        frame = self.keypoint_sieve(frame, semantics)
        point_ids, reference = last.point_ids[followed], last.reference_keyframe
        tracked = self.poses.locate_followed(frame, guess, point_ids, reference, semantics, world)
        enough = tracked.n_inliers >= max(self.config.min_inliers, self.config.min_share * len(frame))
        return tracked if enough else None

    def _follow(self, last: Frame, image: Image, seen: I32, shift_px: F32) -> tuple[Frame, I32]:
        """Return a frame with the keypoints that were found again, and which (N,) of the last frame's they are."""
        kp, config = last.keypoints, self.config
        start_px = kp.raw_px[seen]
        inside = self._is_inside(start_px + shift_px, image)
        seen, start_px, shift_px = seen[inside], start_px[inside], shift_px[inside]
        first, second = last.image.gray, image.gray
        raw_px, is_found = self._flow.follow(first, second, start_px, start_px + shift_px)
        back_px, is_back = self._back.follow(second, first, raw_px, start_px)
        is_back &= np.hypot(*(back_px - start_px).T) <= config.max_return_px
        found = is_found & is_back & self._is_inside(raw_px, image)
        seen, raw_px = seen[found], raw_px[found]
        px = last.camera.undistort(raw_px)
        depth_m = depth_at(image.depth_m, raw_px, np.float32(config.min_depth_m), np.float32(config.max_depth_m))
        keypoints = Keypoints(
            px=px,
            raw_px=raw_px,
            octave=kp.octave[seen],
            angle_rad=kp.angle_rad[seen],
            descriptors=kp.descriptors[seen],
            depth_m=depth_m,
            right_px=last.camera.right_coordinate(px[:, 0], depth_m),
        )
        return Frame(image, last.camera, last.scales, keypoints, np.ones(len(px), dtype=np.bool_)), seen

    def _is_inside(self, raw_px: F32, image: Image) -> Bool:
        """Return which points (N, 2) lie in an image, with the square around them."""
        margin = self.config.window_px // 2
        x, y = raw_px.T
        inside: Bool = (x >= margin) & (y >= margin) & (x < image.width - margin) & (y < image.height - margin)
        return inside


def expected_shifts(last: Tracked, T_cam_world: F64, world: Map) -> tuple[I32, F32]:
    """Return the keypoints (K,) of the last frame that see a point, and the shifts (K, 2) [px] expected of them.

    Args:
        last: The last frame, its pose and points as known now.
        T_cam_world: Predicted pose (4, 4) of the present one.
        world: The map.
    """
    assert last.T_world_cam is not None
    matched = np.flatnonzero(last.point_ids >= 0)
    # A point that mapping fused from two is followed once.
    _, first = np.unique(last.point_ids[matched], return_index=True)
    seen = matched[np.sort(first)].astype(np.int32)
    positions_m = world.points.position_m[last.point_ids[seen]]
    then_m, now_m = se3.transform(se3.inverse(last.T_world_cam), positions_m), se3.transform(T_cam_world, positions_m)
    ahead = np.minimum(then_m[:, 2], now_m[:, 2]) > _NEAREST_M
    camera = last.frame.camera
    shift_px = camera.project(now_m[ahead]) - camera.project(then_m[ahead])
    return seen[ahead], shift_px.astype(np.float32)
