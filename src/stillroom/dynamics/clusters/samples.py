"""Points on the clusters of an image: what stands for a cluster when its past is asked."""

from dataclasses import dataclass

import numpy as np

from stillroom.data.cloud.clusters import Clusters
from stillroom.data.frame import Frame
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64
from stillroom.geometry.camera import Camera

STEP_PX = 8
"""Every so many-th pixel of a row and column is a sample."""


@dataclass(frozen=True)
class Samples:
    """S points of an image that lie on its clusters.

    Attributes:
        cluster: Which cluster each lies on (S,).
        points_cam_m: Where (S, 3) [m, camera frame].
    """

    cluster: I64
    points_cam_m: F64

    def in_world(self, T_cam_world: F64) -> F64:
        """Return the points (S, 3) [m, world] under a pose (4, 4)."""
        return se3.transform(se3.inverse(T_cam_world), self.points_cam_m)

    def count(self, n_clusters: int, chosen: np.ndarray | None = None) -> F64:
        """Count the samples of each cluster (K,), or of those chosen (S,)."""
        which = self.cluster if chosen is None else self.cluster[chosen]
        return np.bincount(which, minlength=n_clusters).astype(np.float64)


class Sampler:
    """Takes samples of images of one camera."""

    def __init__(self) -> None:
        """Rays are found at the first image."""
        self._camera: Camera | None = None
        self._rays = np.zeros((0, 0, 2))
        self._last: tuple[Clusters, Samples] | None = None

    def take(self, frame: Frame, clusters: Clusters) -> Samples:
        """Return the samples of a frame; asked again for the same clusters, the same ones."""
        if self._last is None or self._last[0] is not clusters:
            self._last = (clusters, self._take(frame, clusters))
        return self._last[1]

    def _take(self, frame: Frame, clusters: Clusters) -> Samples:
        height, width = clusters.labels.shape
        if self._camera is not frame.camera or self._rays.shape[:2] != (-(-height // STEP_PX), -(-width // STEP_PX)):
            self._camera, self._rays = frame.camera, _rays(frame.camera, height, width)
        labels = clusters.labels[::STEP_PX, ::STEP_PX]
        depth_m = frame.image.depth_m[::STEP_PX, ::STEP_PX].astype(np.float64)
        on = (labels >= 0) & (depth_m > 0)
        z = depth_m[on][:, None]
        return Samples(labels[on].astype(np.int64), np.hstack((self._rays[on] * z, z)))


def _rays(camera: Camera, height: int, width: int) -> F64:
    """Return x/z and y/z (h, w, 2) of every `STEP_PX`-th pixel."""
    column, row = np.meshgrid(np.arange(0, width, STEP_PX), np.arange(0, height, STEP_PX))
    px = camera.undistort(np.stack((column.ravel(), row.ravel()), axis=1).astype(np.float32))
    rays = camera.back_project(px, np.ones(len(px)))[:, :2]
    return rays.reshape(*column.shape, 2)
