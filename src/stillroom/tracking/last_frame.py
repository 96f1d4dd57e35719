"""What tracking remembers of the last frame: its pose as mapping has moved it since, and the motion that led to it."""

from dataclasses import replace

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.result import Tracked
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.tracking.shutter import Before

RECOVERING_FRAMES = 30
"""A camera that was lost is taken to be recovering for a second."""


class ConstantVelocity:
    """Stores the motion between the last two frames."""

    def __init__(self) -> None:
        """Start without a velocity."""
        self._T_cam_last: F64 | None = None

    @property
    def is_known(self) -> bool:
        """Whether there were two neighbouring frames with a pose."""
        return self._T_cam_last is not None

    def predict(self, T_world_last: F64) -> F64:
        """Return the guess `T_cam_world` (4, 4) of the next frame, given the last pose as known now."""
        T_last_world = se3.inverse(T_world_last)
        return T_last_world if self._T_cam_last is None else self._T_cam_last @ T_last_world

    def update(self, T_world_last: F64, T_world_cam: F64) -> None:
        """Update from two neighbouring poses (4, 4)."""
        self._T_cam_last = se3.orthonormalize(se3.inverse(T_world_cam) @ T_world_last)

    def forget(self) -> None:
        """Drop the velocity, after a frame without a pose."""
        self._T_cam_last = None


class LastFrame:
    """The frame before the next one."""

    def __init__(self) -> None:
        """Start without earlier frames."""
        self._velocity = ConstantVelocity()
        self._tracked: Tracked | None = None
        self._T_reference_cam: F64 | None = None
        self._frames_since_recovery = 1 << 30

    @property
    def reference_keyframe(self) -> int:
        """Its reference keyframe; 0 where there is no last frame."""
        return self._tracked.reference_keyframe if self._tracked is not None else 0

    @property
    def is_recovering(self) -> bool:
        """Whether the camera was lost less than a second ago."""
        return self._frames_since_recovery < RECOVERING_FRAMES

    def as_known_now(self, world: Map) -> Tracked | None:
        """Return the frame with pose and points updated by mapping since; None where it has no pose."""
        if self._tracked is None:
            return None
        T_world_last = self._pose_as_known_now(world)
        return replace(self._tracked, T_world_cam=T_world_last, point_ids=world.current_ids(self._tracked.point_ids))

    def expected_next(self, last: Tracked | None) -> F64 | None:
        """Return the guess `T_cam_world` (4, 4) of the next frame, given the last as known now; None where unknown."""
        if last is None or last.T_world_cam is None or not self._velocity.is_known:
            return None
        return self._velocity.predict(last.T_world_cam)

    def before(self, frame: Frame, world: Map) -> Before | None:
        """Return the last frame, as known now, as that before the one given."""
        T_world_last = self._pose_as_known_now(world)
        if self._tracked is None or T_world_last is None:
            return None
        return Before(T_world_last, frame.timestamp_s - self._tracked.frame.timestamp_s)

    def remember(self, tracked: Tracked, world: Map) -> None:
        """Store the result of a frame, after mapping, in place of the one before."""
        if tracked.T_world_cam is None:
            self._velocity.forget()
            self._tracked, self._T_reference_cam = None, None
            return
        T_world_last = self._pose_as_known_now(world)
        if T_world_last is not None:
            self._velocity.update(T_world_last, tracked.T_world_cam)
        self._frames_since_recovery = 0 if tracked.recovered else self._frames_since_recovery + 1
        self._tracked = tracked
        self._T_reference_cam = world.noted_in(tracked.reference_keyframe, tracked.T_world_cam)

    def _pose_as_known_now(self, world: Map) -> F64 | None:
        if self._tracked is None or self._T_reference_cam is None:
            return None
        return world.placed_by(self._tracked.reference_keyframe, self._T_reference_cam)
