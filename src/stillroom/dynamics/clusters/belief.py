"""What was believed of each place in the last image, so that a verdict goes with its cluster through time."""

from dataclasses import dataclass, field, replace

import numpy as np

from stillroom.data.cloud.clusters import Clusters
from stillroom.data.frame import Frame
from stillroom.dynamics.clusters.samples import STEP_PX, Samples
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64
from stillroom.geometry.camera import Camera


@dataclass(frozen=True)
class _Image:
    timestamp_s: float
    T_cam_world: F64
    belief: F32 = field(repr=False)
    depth_m: F32 = field(repr=False)


class Belief:
    """The last image's beliefs, pixel by pixel, as log-odds of moving.

    Clusters split and join from image to image, so none of them has an identity. A place has: a cluster of the present
    image inherits the mean of what was believed where its points were seen in the last one, at about the same depth.
    """

    def __init__(self, fades_in_s: float, reach_m: float) -> None:
        """Start without beliefs.

        Args:
            fades_in_s: Time in which a belief that nothing supports falls to 1/e [s].
            reach_m: How far a point may have moved in depth since the last image [m].
        """
        self._fades_in_s, self._reach_m = fades_in_s, reach_m
        self._last: _Image | None = None

    def of(self, samples: Samples, n_clusters: int, T_cam_world: F64, camera: Camera, now_s: float) -> F64:
        """Return what each cluster (K,) inherits; 0 for those that were not seen."""
        last = self._last
        if last is None or len(samples.cluster) == 0:
            return np.zeros(n_clusters)
        T_last_now = last.T_cam_world @ se3.inverse(T_cam_world)
        points = se3.transform(T_last_now, samples.points_cam_m)
        ahead = np.flatnonzero(points[:, 2] > 0.1)
        cell = np.rint(camera.distort(camera.project(points[ahead])) / STEP_PX).astype(np.int64)
        height, width = last.belief.shape
        inside = (cell >= 0).all(axis=1) & (cell[:, 0] < width) & (cell[:, 1] < height)
        ahead, column, row = ahead[inside], cell[inside, 0], cell[inside, 1]
        near = np.abs(last.depth_m[row, column] - points[ahead, 2]) <= self._reach_m
        total = np.bincount(samples.cluster[ahead[near]], last.belief[row, column][near], minlength=n_clusters)
        fade = np.exp(-max(0.0, now_s - last.timestamp_s) / self._fades_in_s)
        inherited: F64 = fade * total / np.maximum(samples.count(n_clusters), 1.0)
        return inherited

    def follow(self, T_new_old: F64) -> None:
        """Move what is remembered by a motion (4, 4) of the world's coordinates."""
        if self._last is not None:
            self._last = replace(self._last, T_cam_world=self._last.T_cam_world @ se3.inverse(T_new_old))

    def remember(self, frame: Frame, clusters: Clusters, belief: F64, T_cam_world: F64) -> None:
        """Keep the beliefs (K,) of a frame's clusters for the next image."""
        labels = clusters.labels[::STEP_PX, ::STEP_PX]
        padded = np.append(belief, 0.0).astype(np.float32)  # planes and the unknown read the last entry
        depth_m = frame.image.depth_m[::STEP_PX, ::STEP_PX].copy()
        self._last = _Image(frame.timestamp_s, T_cam_world.copy(), padded[np.maximum(labels, -1)], depth_m)
