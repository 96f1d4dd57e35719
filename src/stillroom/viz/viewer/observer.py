"""Shows a run while it goes on."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from stillroom.data.association import TUM_MAX_GAP_S, closest
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.map import Map
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.data.trajectory import Trajectory
from stillroom.geometry.align import align, align_poses
from stillroom.geometry.arrays import F64, I32
from stillroom.viz.viewer.blueprint import Eye, arranged
from stillroom.viz.viewer.recording import Recording
from stillroom.viz.viewer.scene import Scene

FLUSH_EVERY = 30
"""Frames between two looks at whether what was sent is delivered."""

MAX_VERTICES = 4000
"""Of a path that is shown; longer ones are thinned out."""


@dataclass
class Growing:
    """When to show again what grows, and costs as much as it is large: at steps that grow with it.

    So the cost of a whole run stays in proportion to its end.

    Attributes:
        share: Growth between two times, as a share of the size.
        least: The smallest growth.
    """

    share: float
    least: int
    _next: int = field(default=0, init=False)

    def is_due(self, size: int) -> bool:
        """Return whether it is time; the next time is then farther on."""
        if size < self._next:
            return False
        self._next = size + max(self.least, int(self.share * size))
        return True


@dataclass(frozen=True)
class Watched:
    """What a viewer reads of a running system.

    Attributes:
        world: The map. Another thread may change it while no lock is held.
        trajectory: Returns the poses as known now.
        stages_ms: Returns the wall time of each stage in the newest frame [ms].
        dense: Returns the dense map as known now; None where none is made.
        truth: True poses of the camera; None where they are not known.
    """

    world: Map
    trajectory: Callable[[], Trajectory]
    stages_ms: Callable[[], Mapping[str, float]]
    dense: Callable[[], DenseCloud | None]
    truth: Trajectory | None = None


class RunViewer:
    """Shows each frame of a run, and map and path whenever they have grown."""

    def __init__(self, recording: Recording, watched: Watched) -> None:
        """Show what is known before the first frame."""
        self._recording, self._watched = recording, watched
        self._scene = Scene(recording)
        self._first_s: float | None = None
        self._has_clusters: bool | None = None
        self._n_frames = self._n_keyframes = self._n_jumps = 0
        self._path_due, self._map_due, self._dense_due = Growing(0.05, 10), Growing(0.02, 1), Growing(0.3, 4)

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Show a frame.

        Raises:
            StillroomError: What was shown does not arrive.
        """
        frame, scene = tracked.frame, self._scene
        if self._first_s is None:
            self._first_s = result.timestamp_s
            scene.camera(frame.camera)
        self._recording.at(result.index, result.timestamp_s - self._first_s)
        self._arrange(semantics.clusters is not None)
        scene.pose(result.T_world_cam)
        scene.image(frame.image.rgb)
        scene.keypoints(frame.keypoints.raw_px, tracked.is_static, tracked.is_matched)
        scene.semantics(semantics, result.motion)
        counts = {"keypoints": result.n_keypoints, "static": result.n_static, "matches": result.n_inliers}
        scene.figures(result.state, counts)
        scene.stages(self._watched.stages_ms())
        self._show_what_grows(result.is_keyframe)
        self._n_frames += 1
        if self._n_frames % FLUSH_EVERY == 0:
            self._recording.flush()

    def conclude(self, cloud: DenseCloud | None = None) -> None:
        """Show map and path as they are in the end, at the time of the last frame.

        Args:
            cloud: The dense map; None to ask for it.

        Raises:
            StillroomError: What was shown does not arrive.
        """
        if self._n_frames == 0:
            return
        self._show_path()
        self._show_map()
        cloud = self._watched.dense() if cloud is None else cloud
        self._show_dense(cloud)
        if self._recording.is_file:  # who looks at a window has turned it as they like
            world = self._watched.world
            with world.lock:
                T_world_keyframes = world.keyframes.T_world_cam[world.keyframes.is_alive]
            eye = Eye.of(cloud, T_world_keyframes)
            self._recording.arrange(arranged(self._recording.rr, bool(self._has_clusters), eye=eye))
        self._recording.flush()

    def close(self) -> None:
        """Let go of the file or window."""
        self._recording.close()

    def abandon(self) -> None:
        """Let go of it after a failure, without waiting for it."""
        self._recording.abandon()

    def _arrange(self, has_clusters: bool) -> None:
        """Arrange the views when it is known what there is to see, and again when clusters come later."""
        if self._has_clusters is None or (has_clusters and not self._has_clusters):
            self._recording.arrange(arranged(self._recording.rr, has_clusters))
            self._has_clusters = has_clusters

    def _show_what_grows(self, is_keyframe: bool) -> None:
        n_jumps = len(self._watched.world.jumps)
        has_jumped, self._n_jumps = n_jumps != self._n_jumps, n_jumps
        self._n_keyframes += is_keyframe
        if has_jumped or (is_keyframe and self._map_due.is_due(self._n_keyframes)):
            self._show_map()
        if is_keyframe and self._dense_due.is_due(self._n_keyframes):
            self._show_dense(self._watched.dense())
        if self._path_due.is_due(self._n_frames) or has_jumped:
            self._show_path()

    def _show_path(self) -> None:
        with self._watched.world.lock:
            path = self._watched.trajectory()
        truth = self._watched.truth
        true_path = None if truth is None else truth_beside(path, truth)
        self._scene.path(
            path.positions_m[few(len(path))],
            None if true_path is None else true_path.positions_m[few(len(true_path))],
        )

    def _show_map(self) -> None:
        world = self._watched.world
        with world.lock:  # copies only: what is shown takes longer
            points_m = world.points.position_m[world.points.is_alive]
            T_world_keyframes = world.keyframes.T_world_cam.copy()
            alive = world.alive_keyframes()
            edges = world.covisibility.edges()
            loops = np.array(world.loop_edges, dtype=np.int32).reshape(-1, 2)
        self._scene.points(points_m)
        self._scene.keyframes(T_world_keyframes[alive])
        self._scene.graph(T_world_keyframes[:, :3, 3], edges[:, :2], loops)

    def _show_dense(self, cloud: DenseCloud | None) -> None:
        if cloud is not None:
            self._scene.dense(cloud)


def truth_beside(path: Trajectory, truth: Trajectory) -> Trajectory | None:
    """Return the ground truth of the times of a path, moved to lie along it; None where they share no time.

    Positions and rotations align them, so that this is well determined from the first frame on. Beside a path that is
    up to scale it has the path's lengths.
    """
    if len(path) == 0 or len(truth) == 0:
        return None
    nearest = closest(truth.timestamps_s, path.timestamps_s)
    near = np.abs(truth.timestamps_s[nearest] - path.timestamps_s) <= TUM_MAX_GAP_S
    if not near.any():
        return None
    T_truth_cam = truth.T_world_cam.copy()
    if not path.is_metric:
        T_truth_cam[:, :3, 3] *= align(truth.positions_m[nearest[near]], path.positions_m[near], with_scale=True).scale
    T_world_truth = align_poses(T_truth_cam[nearest[near]], path.T_world_cam[near])
    first, last = int(nearest[near][0]), int(nearest[near][-1]) + 1
    moved: F64 = T_world_truth @ T_truth_cam[first:last]
    return Trajectory(truth.timestamps_s[first:last], moved)


def few(n: int) -> I32:
    """Return up to MAX_VERTICES places among n, the first and the last with them."""
    return np.unique(np.linspace(0, max(n - 1, 0), min(n, MAX_VERTICES)).astype(np.int32))
