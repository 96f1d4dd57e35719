"""The camera goes on as it went."""

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64


class ConstantVelocity:
    """Remembers the motion between the last two frames."""

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
        """Learn from two neighbouring poses (4, 4)."""
        self._T_cam_last = se3.orthonormalize(se3.inverse(T_world_cam) @ T_world_last)

    def forget(self) -> None:
        """Drop the velocity, after a frame without a pose."""
        self._T_cam_last = None
