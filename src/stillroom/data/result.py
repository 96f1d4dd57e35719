"""What tracking says of one frame."""

from dataclasses import dataclass, field, fields
from enum import Enum

from stillroom.data.frame import Frame, Keypoints
from stillroom.data.motion import Motion
from stillroom.geometry.arrays import F64, I32, Bool


class TrackingState(Enum):
    """Where tracking stands after a frame."""

    NOT_INITIALIZED = "not initialized"
    OK = "ok"
    LOST = "lost"


class Recovery(Enum):
    """How a frame got its pose back, where the camera was lost before it."""

    NONE = "none"
    """It was not lost, or it is still."""
    LAST_KEYFRAMES = "last keyframes"
    """One of the newest keyframes was recognised."""
    PLACE = "place"
    """A place was recognised among all keyframes, by what it looks like."""
    NEW_SUBMAP = "new sub-map"
    """Nothing was recognised for a while; the frame begins a piece of map of its own."""


@dataclass(frozen=True)
class Tracked:
    """A frame with its place in the map; handed from tracking to mapping.

    Attributes:
        frame: The frame.
        state: OK when the pose is to be trusted.
        T_world_cam: Pose (4, 4); None when lost.
        point_ids: Map point of each keypoint (N,) int32; −1 where none. Only inliers of the pose.
        motion: What moves in the image, and the verdict on each keypoint.
        reference_keyframe: Id of the keyframe that shares most points; −1 before there is one.
        recovery: How the frame got its pose back after the camera was lost.
    """

    frame: Frame
    state: TrackingState
    T_world_cam: F64 | None
    point_ids: I32 = field(repr=False)
    motion: Motion = field(repr=False)
    reference_keyframe: int = -1
    recovery: Recovery = Recovery.NONE

    @property
    def recovered(self) -> bool:
        """Whether the pose came from recognising the scene after being lost."""
        return self.recovery in (Recovery.LAST_KEYFRAMES, Recovery.PLACE)

    @property
    def lost(self) -> bool:
        """Whether there is a map but no pose in it."""
        return self.state is TrackingState.LOST

    @property
    def is_static(self) -> Bool:
        """Which keypoints (N,) both sieves take to be static."""
        static: Bool = self.frame.is_static & self.motion.is_static
        return static

    @property
    def is_matched(self) -> Bool:
        """Which keypoints (N,) have a map point."""
        matched: Bool = self.point_ids >= 0
        return matched

    @property
    def n_inliers(self) -> int:
        """Number of map points that agree with the pose."""
        return int(self.is_matched.sum())


@dataclass(frozen=True)
class FrameSummary:
    """What is kept of every frame.

    Attributes:
        index, timestamp_s: Place and time of the image in its sequence.
        state: Where tracking stands.
        T_world_cam: Pose as known at this moment (4, 4); None when lost.
        n_keypoints, n_static, n_inliers: Keypoints found, judged static, and agreeing with the pose.
        n_keyframes: Keyframes in the map after this frame.
        is_keyframe: Whether this frame became one.
        reference_keyframe: Id of the keyframe that the final trajectory hangs this frame on; −1 when lost.
        T_reference_cam: Pose in that keyframe (4, 4); None when lost.
        submap: The piece of the map that the pose was in at this moment; pieces that join later become one.
        recovery: How the frame got its pose back after the camera was lost.
    """

    index: int
    timestamp_s: float
    state: TrackingState
    T_world_cam: F64 | None
    n_keypoints: int
    n_static: int
    n_inliers: int
    n_keyframes: int
    is_keyframe: bool
    reference_keyframe: int
    T_reference_cam: F64 | None
    submap: int = 0
    recovery: Recovery = Recovery.NONE


@dataclass(frozen=True)
class FrameResult(FrameSummary):
    """What `process` returns.

    Attributes:
        motion: What moves: the pixels (H, W), and the verdict on each keypoint.
        keypoints: The keypoints of the image.
    """

    motion: Motion = field(kw_only=True, repr=False)
    keypoints: Keypoints = field(kw_only=True, repr=False)

    @property
    def summary(self) -> FrameSummary:
        """The result without its arrays over pixels and keypoints: light enough to keep for every frame."""
        return FrameSummary(**{each.name: getattr(self, each.name) for each in fields(FrameSummary)})
