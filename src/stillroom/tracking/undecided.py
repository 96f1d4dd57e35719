"""Frames that were found row by row before it was clear that the camera's rows are read at once; found again then."""

from dataclasses import dataclass, replace

import numpy as np

from stillroom.data.frame import Keypoints
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.result import Tracked
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32
from stillroom.geometry.camera import Camera
from stillroom.optimize.depth_terms import Terms
from stillroom.optimize.pose import PoseOptimizer

MOST_FRAMES = 300
"""Frames that are kept: what is still not clear after ten seconds, of a camera that hardly moves, costs little."""


@dataclass
class _Frame:
    """What a frame saw, as it was taken.

    Attributes:
        index: Of its image.
        T_world_cam: Its pose (4, 4) when it was found.
        point_ids: The points that it saw (M,).
        terms: Where (M), not moved, and how much each counts.
        p_static: How much each counts (M,); None for 1.
        keyframe: Its id, where it became one; −1 else.
        keypoints: All its keypoints then.
    """

    index: int
    T_world_cam: F64
    point_ids: I32
    terms: Terms
    p_static: F32 | None
    keyframe: int = -1
    keypoints: Keypoints | None = None


class Undecided:
    """The frames since the last verdict."""

    def __init__(self) -> None:
        """Start without any."""
        self._frames: list[_Frame] = []

    def clear(self) -> None:
        """Forget them: they were found in the right way."""
        self._frames.clear()

    def add(self, tracked: Tracked, matches: Matches, terms: Terms) -> None:
        """Keep a frame that has a pose, with the terms of its matches (M) where they were seen."""
        assert tracked.T_world_cam is not None
        p_static = tracked.motion.p_static
        likely = None if p_static is None else p_static[matches.keypoint]
        if self._frames and self._frames[-1].index == tracked.frame.image.index:
            self._frames.pop()  # found another time
        self._frames.append(_Frame(tracked.frame.image.index, tracked.T_world_cam, matches.point_id, terms, likely))
        del self._frames[:-MOST_FRAMES]

    def became_keyframe(self, keyframe: int, tracked: Tracked) -> None:
        """Take notice that a frame became a keyframe."""
        if self._frames and self._frames[-1].index == tracked.frame.image.index:
            self._frames[-1].keyframe, self._frames[-1].keypoints = keyframe, tracked.frame.keypoints

    def put_back(self, optimize: PoseOptimizer, camera: Camera, world: Map) -> list[int]:
        """Put the keyframes among them back to what was seen, in the map; return their ids."""
        frames = [frame for frame in self._frames if frame.keypoints is not None]
        frames = [frame for frame in frames if world.keyframes.is_alive[frame.keyframe]]
        for frame in frames:
            assert frame.keypoints is not None
            put_back(frame.keyframe, frame.keypoints, _found(frame, optimize, camera, world), camera, world)
        return [frame.keyframe for frame in frames]

    def found_again(self, optimize: PoseOptimizer, camera: Camera, world: Map) -> dict[int, F64]:
        """Find all of them again, rows read at once, and forget them.

        Returns:
            Poses `T_world_cam` (4, 4) by the index of the image.
        """
        found = {frame.index: _found(frame, optimize, camera, world) for frame in self._frames}
        self.clear()
        return found


def _found(frame: _Frame, optimize: PoseOptimizer, camera: Camera, world: Map) -> F64:
    """Return the pose `T_world_cam` (4, 4) of a frame, rows read at once."""
    ids = world.current_ids(frame.point_ids)
    known = ids >= 0
    estimate = optimize(
        se3.inverse(frame.T_world_cam),
        world.points.position_m[ids[known]],
        frame.terms.observed_px[known],
        frame.terms.weights[known],
        camera,
        None if frame.p_static is None else frame.p_static[known],
        frame.terms.intrinsics[5],
    )
    return se3.orthonormalize(se3.inverse(estimate.T_cam_world))


def as_taken(keypoints: Keypoints, camera: Camera) -> Keypoints:
    """Return keypoints where they were seen, whatever they were moved by."""
    px = camera.undistort(keypoints.raw_px)
    return replace(keypoints, px=px, right_px=camera.right_coordinate(px[:, 0], keypoints.depth_m))


def put_back(keyframe: int, keypoints: Keypoints, T_world_cam: F64, camera: Camera, world: Map) -> None:
    """Put the keypoints of a keyframe back to where they were seen, in the map, and what was made of them.

    Args:
        keyframe: Its id.
        keypoints: Its keypoints.
        T_world_cam: Its pose (4, 4).
        camera: The calibration.
        world: The map.
    """
    table, points, rows = world.keypoints, world.points, world.rows(keyframe)
    taken = as_taken(keypoints, camera)
    table.px[rows], table.right_px[rows] = taken.px, taken.right_px
    world.moved_keypoints.add(keyframe)
    world.keyframes.T_world_cam[keyframe] = T_world_cam
    ids = table.point[rows]
    own = np.flatnonzero((ids >= 0) & (keypoints.depth_m > 0))
    own = own[points.first_keyframe[ids[own]] == keyframe]
    points.position_m[ids[own]] = se3.transform(T_world_cam, camera.back_project(taken.px[own], taken.depth_m[own]))
    world.refresh_geometry(ids[own])
