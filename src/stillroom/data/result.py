"""The result of tracking one frame."""

from dataclasses import dataclass, field, fields
from enum import Enum

from stillroom.data.frame import Frame, Keypoints
from stillroom.data.motion import Motion
from stillroom.geometry.arrays import F64, I32, Bool


class TrackingState(Enum):
    """The state of tracking after a frame."""

    NOT_INITIALIZED = "not initialized"
    OK = "ok"
    LOST = "lost"


class Recovery(Enum):
    """How a frame was relocalized after tracking was lost."""

    NONE = "none"
    """Tracking was not lost, or still is."""
    LAST_KEYFRAMES = "last keyframes"
    """One of the newest keyframes was recognised."""
    PLACE = "place"
    """A place was recognised among all keyframes, by what it looks like."""
    NEW_SUBMAP = "new sub-map"
    """No place was recognised for a while; the frame begins a new sub-map."""


@dataclass(frozen=True)
class FirstView:
    """The image with which a map of a single camera begins, beside the one that it is tracked in.

    Attributes:
        tracked: The image, with its pose and what is dynamic in it.
        keypoint: Its keypoints (M,) int32 that see a point.
        matched: The keypoints (M,) int32 of the present frame that see the same point.
        points_world_m: The points (M, 3).
    """

    tracked: "Tracked"
    keypoint: I32 = field(repr=False)
    matched: I32 = field(repr=False)
    points_world_m: F64 = field(repr=False)


@dataclass(frozen=True)
class Tracked:
    """A frame with its place in the map; passed from tracking to mapping.

    Attributes:
        frame: The frame.
        state: OK when the pose is to be trusted.
        T_world_cam: Pose (4, 4); None when lost.
        point_ids: Map point of each keypoint (N,) int32; −1 where none. Only inliers of the pose.
        motion: What is dynamic in the image: pixels, and the classification of each keypoint.
        reference_keyframe: Id of the keyframe that shares most points; −1 before there is one.
        recovery: How the frame was relocalized, where tracking was lost before it.
        first_view: The other image of a map that a single camera begins with this frame; neither is in the map yet.
    """

    frame: Frame
    state: TrackingState
    T_world_cam: F64 | None
    point_ids: I32 = field(repr=False)
    motion: Motion = field(repr=False)
    reference_keyframe: int = -1
    recovery: Recovery = Recovery.NONE
    first_view: FirstView | None = None

    @property
    def recovered(self) -> bool:
        """Whether the frame was relocalized after tracking was lost."""
        return self.recovery in (Recovery.LAST_KEYFRAMES, Recovery.PLACE)

    @property
    def lost(self) -> bool:
        """Whether there is a map but no pose in it."""
        return self.state is TrackingState.LOST

    @property
    def is_static(self) -> Bool:
        """Which keypoints (N,) both sieves classify as static."""
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
        state: State of tracking.
        T_world_cam: Pose as reported at this moment (4, 4), under the trajectory prior if there is one; None when lost.
        n_keypoints, n_static, n_inliers: Keypoints found, judged static, and agreeing with the pose.
        n_keyframes: Keyframes in the map after this frame.
        is_keyframe: Whether this frame became one.
        reference_keyframe: Id of the keyframe that the final trajectory refers this frame to; −1 when lost.
        T_reference_cam: The frame's own pose, found from its matches, in that keyframe (4, 4), as `Map.noted_in` notes
            it; None when lost.
        submap: Id of the sub-map that the pose was in at this moment; it may be merged later.
        recovery: How the frame was relocalized, where tracking was lost before it.
        n_agreeing: Map points that the pose was found from: without those that a keyframe then made of its own depth,
            and 0 for an image that repeats the one before.
        n_looked: The same of the last look at the finished map, where that found the pose in the keyframe; else None.
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
    n_agreeing: int = 0
    n_looked: int | None = None

    @property
    def n_agreeing_finally(self) -> int:
        """Map points that the final pose was found from."""
        return self.n_agreeing if self.n_looked is None else self.n_looked


@dataclass(frozen=True)
class FrameResult(FrameSummary):
    """What `process` returns.

    Attributes:
        motion: What is dynamic: the pixels (H, W), and the classification of each keypoint.
        keypoints: The keypoints of the image.
    """

    motion: Motion = field(kw_only=True, repr=False)
    keypoints: Keypoints = field(kw_only=True, repr=False)

    @property
    def summary(self) -> FrameSummary:
        """The result without its arrays over pixels and keypoints: light enough to keep for every frame."""
        return FrameSummary(**{each.name: getattr(self, each.name) for each in fields(FrameSummary)})
