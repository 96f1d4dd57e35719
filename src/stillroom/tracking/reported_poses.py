"""The poses that a user gets: at once, a few frames later, and in the end, under the trajectory prior.

Tracking, mapping and the motion model work with a frame's own pose, found from its matches alone; under the prior the
poses before it tell something of it, too. The newest frames' own poses are taken as known now: where mapping, a closed
loop or a merge of sub-maps moved a keyframe, the frames that refer to it moved along, which is no motion of the camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillroom.data.map import Map
from stillroom.data.result import FrameResult, FrameSummary, Recovery
from stillroom.data.trajectory import Trajectory
from stillroom.geometry.arrays import F64, I64
from stillroom.optimize.trajectory_prior import TrajectoryFilter, TrajectoryPriorConfig, smoothed


def reported_poses(prior: TrajectoryPriorConfig, world: Map) -> "ReportedPoses | OwnPoses":
    """Return what tells the poses of a map's frames, under a prior where it is in use."""
    return ReportedPoses(prior, world) if prior.enabled else OwnPoses()


@dataclass
class _Reported:
    """A frame's pose as last reported (4, 4), its time [s], and the sub-map that the pose was in then."""

    timestamp_s: float
    T_world_cam: F64
    submap: int


class ReportedPoses:
    """Tells poses under the trajectory prior."""

    def __init__(self, prior: TrajectoryPriorConfig, world: Map) -> None:
        """Start before the first frame."""
        self._prior, self._world, self._filter = prior, world, TrajectoryFilter(prior)
        self._reported: list[_Reported] = []

    @property
    def lag(self) -> int:
        """Frames that come after one before its pose in the lagged trajectory is settled."""
        return self._prior.lag

    def at_once(self, result: FrameResult, before: Sequence[FrameSummary]) -> FrameResult:
        """Return the result of a new frame with the pose to tell of it: what the frames so far say.

        Args:
            result: Its result, with its own pose.
            before: The results of all frames before it.
        """
        T_world_cam = self._settled(result, before)
        return result if T_world_cam is None else replace(result, T_world_cam=T_world_cam)

    def repeat(self, result: FrameSummary, before: Sequence[FrameSummary]) -> None:
        """Take notice of an image that repeats the one before, and so has its pose; arguments as `at_once`."""
        self._settled(result, before)

    def lagged(self, submap: int) -> Trajectory:
        """Return the poses each as settled a few frames later, of frames that were in a sub-map then."""
        reported = [each for each in self._reported if each.submap == submap]
        poses = np.array([each.T_world_cam for each in reported], dtype=np.float64).reshape(-1, 4, 4)
        return Trajectory(np.array([each.timestamp_s for each in reported]), poses, self._world.sensor.is_metric)

    def in_the_end(self, trajectory: Trajectory, n_agreeing: Sequence[int]) -> Trajectory:
        """Return a trajectory as one estimate.

        Args:
            trajectory: The frames' own poses (N).
            n_agreeing: Map points that agree with each (N).
        """
        weights = np.array(n_agreeing, dtype=np.float64)
        poses = smoothed(trajectory.timestamps_s, trajectory.T_world_cam, weights, self._prior)
        return replace(trajectory, T_world_cam=poses)

    def _settled(self, result: FrameSummary, before: Sequence[FrameSummary]) -> F64 | None:
        """Estimate the newest poses, and return that of a new frame (4, 4); None where it has none."""
        if result.T_reference_cam is None or result.T_world_cam is None:
            return None
        with self._world.lock:  # an image that repeats the one before comes while mapping goes on
            newest = self._together(result, before)
            keyframes = np.array([each.reference_keyframe for each in newest])
            own = _as_known_now(keyframes, [each.T_reference_cam for each in newest], self._world)
            submap = int(self._world.keyframes.submap[result.reference_keyframe])
        times_s = np.array([each.timestamp_s for each in newest])
        poses = self._filter.add(times_s, own, np.array([each.n_agreeing for each in newest], dtype=np.float64))
        self._reported.append(_Reported(result.timestamp_s, result.T_world_cam, submap))
        for reported, T_world_cam in zip(self._reported[-self.lag - 1 :][::-1], poses[::-1], strict=False):
            reported.T_world_cam, reported.submap = T_world_cam.copy(), submap
        return self._reported[-1].T_world_cam

    def _together(self, result: FrameSummary, before: Sequence[FrameSummary]) -> list[FrameSummary]:
        """Return the newest frames that have a pose, since the last relocalization, in the sub-map of the last one."""
        submaps = self._world.keyframes.submap
        submap, newest = submaps[result.reference_keyframe], [result]
        for each in reversed(before[-self._filter.reach :]):
            if len(newest) == self._filter.reach or newest[-1].recovery is not Recovery.NONE:
                break
            if each.T_reference_cam is None:
                continue
            if submaps[each.reference_keyframe] != submap:
                break
            newest.append(each)
        return newest[::-1]


class OwnPoses:
    """Without a prior: tells each frame's own pose."""

    lag = 0

    def at_once(self, result: FrameResult, before: Sequence[FrameSummary]) -> FrameResult:
        """Return the result as it is."""
        return result

    def repeat(self, result: FrameSummary, before: Sequence[FrameSummary]) -> None:
        """Do nothing."""

    def lagged(self, submap: int) -> None:
        """Return that no pose changes later."""
        return

    def in_the_end(self, trajectory: Trajectory, n_agreeing: Sequence[int]) -> Trajectory:
        """Return the trajectory as it is."""
        return trajectory


def _as_known_now(keyframes: I64, noted: Sequence[F64 | None], world: Map) -> F64:
    """Return poses `T_world_cam` (N, 4, 4), as known now, of poses noted in keyframes (N,); see `Map.placed_by`."""
    T_keyframe_cam = np.array(noted)
    T_keyframe_cam[:, :3, 3] *= world.keyframes.scale[keyframes][:, None]
    T_world_cam: F64 = world.keyframe_poses(keyframes) @ T_keyframe_cam
    return T_world_cam
