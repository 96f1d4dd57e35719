"""What tracking says of one frame."""

from dataclasses import dataclass, field
from enum import Enum

from stillroom.data.frame import Frame
from stillroom.data.motion import Motion
from stillroom.geometry.arrays import F64, I32, Bool


class TrackingState(Enum):
    """Where tracking stands after a frame."""

    NOT_INITIALIZED = "not initialized"
    OK = "ok"
    LOST = "lost"


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
        recovered: Whether the pose came from recognising the scene after being lost.
    """

    frame: Frame
    state: TrackingState
    T_world_cam: F64 | None
    point_ids: I32 = field(repr=False)
    motion: Motion = field(repr=False)
    reference_keyframe: int = -1
    recovered: bool = False

    @property
    def lost(self) -> bool:
        """Whether there is a map but no pose in it."""
        return self.state is TrackingState.LOST

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
class FrameResult:
    """What `process` returns: light enough to keep for every frame.

    Attributes:
        index, timestamp_s: Place and time of the image in its sequence.
        state: Where tracking stands.
        T_world_cam: Pose as known at this moment (4, 4); None when lost.
        n_keypoints, n_static, n_inliers: Keypoints found, judged static, and agreeing with the pose.
        n_keyframes: Keyframes in the map after this frame.
        is_keyframe: Whether this frame became one.
        reference_keyframe: Id of the keyframe that the final trajectory hangs this frame on; −1 when lost.
        T_reference_cam: Pose in that keyframe (4, 4); None when lost.
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
