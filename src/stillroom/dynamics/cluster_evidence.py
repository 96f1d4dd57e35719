"""The log-odds of motion of each pixel of the last image, so that clusters inherit them over time."""

from dataclasses import dataclass, field, replace

import numpy as np

from stillroom.compiled import njit
from stillroom.data.clusters import UNKNOWN, Clusters
from stillroom.data.frame import Frame
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I16, I64, U8, Bool
from stillroom.geometry.camera import Camera, Lens
from stillroom.geometry.distortion import seen_at
from stillroom.geometry.pixels import Shape, grown

STEP_PX = 8
"""Stride of the samples in rows and columns, in images 640 pixels long [px]."""
STAYS, MOVES, MOVES_IN_BOX = 0, 1, 2
"""Bits that apply to all pixels of a cluster."""


# Points on the clusters of an image, which are compared with earlier images.


@dataclass(frozen=True)
class ClusterSamples:
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
        self._last: tuple[Clusters, ClusterSamples] | None = None

    def take(self, frame: Frame, clusters: Clusters) -> ClusterSamples:
        """Return the samples of a frame; the same ones for the same clusters."""
        if self._last is None or self._last[0] is not clusters:
            self._last = (clusters, self._take(frame, clusters))
        return self._last[1]

    def _take(self, frame: Frame, clusters: Clusters) -> ClusterSamples:
        height, width = clusters.labels.shape
        step_px = frame.camera.in_pixels(STEP_PX)
        if self._camera is not frame.camera or self._rays.shape[:2] != (-(-height // step_px), -(-width // step_px)):
            self._camera, self._rays = frame.camera, _rays(frame.camera, height, width, step_px)
        return ClusterSamples(*points_on(clusters.labels, frame.image.depth_m, self._rays, step_px))


@njit(nogil=True, cache=True, error_model="numpy")
def points_on(labels: I16, depth_m: F32, rays: F64, step_px: int) -> tuple[I64, F64]:
    """Return the cluster (S,) and the point (S, 3) [m] of each known pixel of a cluster on the grid of rays.

    Args:
        labels: Label image (H, W).
        depth_m: Depth image (H, W) [m].
        rays: x/z and y/z (h, w, 2) of every `step_px`-th pixel.
        step_px: Their stride.
    """
    height, width = rays.shape[:2]
    cluster, points = np.empty(height * width, dtype=np.int64), np.empty((height * width, 3))
    n = 0
    for i in range(height):
        for j in range(width):
            label, z = labels[i * step_px, j * step_px], np.float64(depth_m[i * step_px, j * step_px])
            if label >= 0 and z > 0.0:
                cluster[n] = label
                points[n, 0], points[n, 1], points[n, 2] = rays[i, j, 0] * z, rays[i, j, 1] * z, z
                n += 1
    return cluster[:n], points[:n]


def _rays(camera: Camera, height: int, width: int, step_px: int) -> F64:
    """Return x/z and y/z (h, w, 2) of every `step_px`-th pixel."""
    column, row = np.meshgrid(np.arange(0, width, step_px), np.arange(0, height, step_px))
    px = camera.undistort(np.stack((column.ravel(), row.ravel()), axis=1).astype(np.float32))
    rays = camera.back_project(px, np.ones(len(px)))[:, :2]
    return rays.reshape(*column.shape, 2)


@dataclass(frozen=True)
class _Image:
    timestamp_s: float
    T_cam_world: F64
    belief: F32 = field(repr=False)
    depth_m: F32 = field(repr=False)


class Belief:
    """The log-odds of motion of each pixel of the last image.

    Clusters split and join from image to image, so none of them has an identity. A place has: a cluster of the present
    image inherits the mean log-odds of the pixels at which its points were seen in the last one, at about the same
    depth.
    """

    def __init__(self, fades_in_s: float, reach_m: float) -> None:
        """Start at zero log-odds.

        Args:
            fades_in_s: Time in which unsupported log-odds fall to 1/e [s].
            reach_m: How far a point may have moved in depth since the last image [m].
        """
        self._fades_in_s, self._reach_m = fades_in_s, reach_m
        self._last: _Image | None = None

    def of(self, samples: ClusterSamples, n_clusters: int, T_cam_world: F64, camera: Camera, now_s: float) -> F64:
        """Return what each cluster (K,) inherits; 0 for those that were not seen."""
        last = self._last
        if last is None or len(samples.cluster) == 0:
            return np.zeros(n_clusters)
        T_last_now = last.T_cam_world @ se3.inverse(T_cam_world)
        total = np.zeros(n_clusters)
        view = (last.belief, last.depth_m, T_last_now, camera.lens, camera.in_pixels(STEP_PX))
        inherit(samples.cluster, samples.points_cam_m, *view, self._reach_m, total)
        fade = np.exp(-max(0.0, now_s - last.timestamp_s) / self._fades_in_s)
        inherited: F64 = fade * total / np.maximum(samples.count(n_clusters), 1.0)
        return inherited

    def follow(self, T_new_old: F64) -> None:
        """Move what is remembered by a motion (4, 4) of the world's coordinates."""
        if self._last is not None:
            self._last = replace(self._last, T_cam_world=self._last.T_cam_world @ se3.inverse(T_new_old))

    def remember(self, frame: Frame, clusters: Clusters, belief: F64, T_cam_world: F64) -> None:
        """Keep the log-odds (K,) of a frame's clusters for the next image."""
        step_px = frame.camera.in_pixels(STEP_PX)
        labels = clusters.labels[::step_px, ::step_px]
        padded = np.append(belief, 0.0).astype(np.float32)  # planes and the unknown read the last entry
        depth_m = frame.image.depth_m[::step_px, ::step_px].copy()
        self._last = _Image(frame.timestamp_s, T_cam_world.copy(), padded[np.maximum(labels, -1)], depth_m)


@njit(nogil=True, cache=True, error_model="numpy")
def inherit(
    cluster: I64,
    points_m: F64,
    belief: F32,
    depth_m: F32,
    T: F64,
    lens: Lens,
    step_px: int,
    reach_m: float,
    total: F64,
) -> None:
    """Add to the total of each cluster (K,) the log-odds at which the last image saw its points.

    Args:
        cluster: Cluster of each point (S,).
        points_m: The points (S, 3) [m, present camera].
        belief, depth_m: Log-odds and depth [m] of every `step_px`-th pixel of the last image (h, w).
        T: Motion (4, 4) from the present camera to the last.
        lens: Of both.
        step_px: Stride of the last image's pixels.
        reach_m: How far a point may have moved in depth [m].
        total: Sums, written to.
    """
    for i in range(len(points_m)):
        u, v, z = seen_at(T, lens, points_m[i, 0], points_m[i, 1], points_m[i, 2])
        if not z > 0.1:
            continue
        column, row = np.rint(u / step_px), np.rint(v / step_px)
        if column >= 0.0 and row >= 0.0 and column < belief.shape[1] and row < belief.shape[0]:
            at = int(row), int(column)
            if abs(depth_m[at] - z) <= reach_m:
                total[cluster[i]] += belief[at]


# From log-odds of clusters to dynamic pixels.


class MovingPixels:
    """Marks the dynamic pixels; the result is cached for the same clusters and decisions."""

    def __init__(self, margin_px: int) -> None:
        """Start with nothing marked.

        Args:
            margin_px: What lies so close to something moving, and on no plane or other cluster, moves too.
        """
        self._margin_px = margin_px
        self._last: tuple[Clusters, U8, Bool] | None = None

    def of(self, clusters: Clusters, belief: F64, in_boxes: Bool) -> Bool:
        """Return the pixels (H, W) that move; not to be written to.

        Those of moving clusters and of clusters that boxes claim; of other clusters, what lies in a box and is not
        classified as static; and unknown pixels next to all these.

        Args:
            clusters: The clusters.
            belief: Their log-odds of moving (K,).
            in_boxes: Pixels in boxes (H, W).
        """
        said = np.full(len(clusters), STAYS, dtype=np.uint8)
        said[belief == 0] = MOVES_IN_BOX
        said[(belief > 0) | (clusters.box >= 0)] = MOVES
        return self.marked(clusters, said, in_boxes)

    def marked(self, clusters: Clusters, said_of: U8, in_boxes: Bool) -> Bool:
        """Return the pixels (H, W) of clusters by their bits (K,); other arguments and result as in `of`."""
        said = np.append(np.zeros(2, dtype=np.uint8), said_of)  # labels −2 and −1 read the first two
        last = self._last
        if last is not None and last[0] is clusters and np.array_equal(last[1], said):
            return last[2]
        moving = self._mark(clusters, said, in_boxes)
        self._last = (clusters, said, moving)
        return moving

    def _mark(self, clusters: Clusters, said: U8, in_boxes: Bool) -> Bool:
        labels = np.ascontiguousarray(clusters.labels)
        moving = np.zeros(labels.shape, dtype=np.uint8)
        if said.any():
            look_up(labels.ravel(), said, in_boxes.ravel().view(np.uint8), moving.ravel())
            near = grown(moving.view(np.bool_), self._margin_px, Shape.SQUARE).view(np.uint8)
            add_unknown(labels.ravel(), near.ravel(), moving.ravel())
        return moving.view(np.bool_)


@njit(nogil=True, cache=True)
def look_up(labels: I16, said: U8, in_boxes: U8, moving: U8) -> None:
    """Set `moving` (P,) to 1 where the bits of the pixel's label (P,) call for it, else to 0."""
    for i in range(len(labels)):
        # An index without a sign is not tested for counting from the end, which halves the time.
        word = said[np.uint64(labels[i] + 2)]
        moving[i] = (word & MOVES) | ((word >> 1) & in_boxes[i])


@njit(nogil=True, cache=True)
def add_unknown(labels: I16, near: U8, moving: U8) -> None:
    """Set `moving` (P,) to 1 where the pixel's label (P,) is unknown and something near moves."""
    for i in range(len(labels)):
        moving[i] |= near[i] & np.uint8(labels[i] == UNKNOWN)
