"""What the depth cloud of an image falls into (OC-SLAM 2.3–2.5): planes, and clusters of the rest, helped by boxes.

Plain Euclidean clustering fuses a person with the table he leans on (the paper's Figure 7). Here the foreground of
each box is clustered apart from all else, so that furniture beyond the box does not join.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from stillroom.data.cloud.clusters import PLANE, UNKNOWN, Clusters
from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Semantics
from stillroom.errors import ConfigError
from stillroom.geometry.arrays import F32, F64, I16, I32, I64, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.cloud.backproject import RayGrid, back_project, ray_grid
from stillroom.geometry.cloud.euclidean import depth_scaled, euclidean_clusters
from stillroom.geometry.cloud.foreground import NO_BOX, claim_foregrounds
from stillroom.geometry.cloud.labels import spread_labels
from stillroom.geometry.cloud.planes import PlaneLimits, Planes, find_planes
from stillroom.geometry.cloud.voxels import voxel_filter
from stillroom.protocols import Pending


@dataclass(frozen=True)
class NoClustersConfig:
    """There is nothing to choose."""

    def build(self, camera: Camera, seed: int) -> "NoClusters":
        """Return the clusterer."""
        return NoClusters()


class NoClusters:
    """Does not look at the depth cloud."""

    def __call__(self, image: RgbdImage, semantics: Pending[Semantics]) -> Semantics:
        """Return the semantics as they are."""
        return semantics.result()


@dataclass(frozen=True)
class DepthClustersConfig:
    """How the depth cloud of an image is taken apart.

    Attributes:
        stride: Every so many-th pixel of a row and column becomes a point [px].
        min_depth_m, max_depth_m: Range of depths that are looked at [m].
        voxel_m: Edge of the voxel filter [m].
        tolerance_m: Points no further apart than this are one cluster [m] …
        tolerance_share: … or than this share of their depth, if it is more: points lie thinner far away.
        min_points: Fewest points of a cluster, after the voxel filter.
        box_half_depth_m: Half the depth that a thing in a box takes up [m].
        box_min_share: A box helps only where its foreground fills this share of it.
        planes: What counts as a plane.
    """

    stride: int = 4
    min_depth_m: float = 0.2
    max_depth_m: float = 6.0
    voxel_m: float = 0.02
    tolerance_m: float = 0.04
    tolerance_share: float = 0.018
    min_points: int = 40
    box_half_depth_m: float = 0.40
    box_min_share: float = 0.10
    planes: PlaneLimits = field(default_factory=PlaneLimits)

    def build(self, camera: Camera, seed: int) -> "DepthClusterer":
        """Return the clusterer. Nothing in it is drawn by lot: the seed is not used.

        Raises:
            ConfigError: A value is impossible.
        """
        for key in ("stride", "min_points"):
            if getattr(self, key) < 1:
                raise ConfigError(f"clusters.{key} is {getattr(self, key)}; it must be at least 1")
        for key in ("voxel_m", "tolerance_m", "box_half_depth_m"):
            if not getattr(self, key) > 0:
                raise ConfigError(f"clusters.{key} is {getattr(self, key)}; it must be above 0")
        if not 0 <= self.min_depth_m < self.max_depth_m:
            raise ConfigError(
                f"clusters.max_depth_m is {self.max_depth_m} and min_depth_m {self.min_depth_m}; "
                "they must be a range of depths"
            )
        return DepthClusterer(self, camera)


@dataclass(frozen=True)
class _Found:
    """Clusters as they come: voxels, and the label of each free sample."""

    label_of: I32  # of each free sample (N,), −1 for none
    mean_m: F64  # of each voxel (M, 3)
    weight: I32  # its samples (M,)
    label: I32  # of each voxel (M,), −1 for none
    box: I32  # of each cluster (K,)


class DepthClusterer:
    """Adds clusters to what is known of an image."""

    def __init__(self, config: DepthClustersConfig, camera: Camera) -> None:
        """Take the camera; its rays are found at the first image."""
        self.config = config
        self._camera = camera
        self._grid: tuple[int, int, RayGrid] | None = None

    def __call__(self, image: RgbdImage, semantics: Pending[Semantics]) -> Semantics:
        """Return the semantics with the clusters of the image's depth; boxes are awaited after the planes."""
        config = self.config
        grid = self._grid_for(*image.depth_m.shape)
        points_m = back_project(image.depth_m, grid, config.min_depth_m, config.max_depth_m)
        planes = find_planes(points_m, grid.ray_area, config.planes)
        free = (points_m[..., 2] > 0) & (planes.plane_of < 0)
        known = semantics.result()
        owner = claim_foregrounds(
            points_m[..., 2],
            free,
            grid.rows,
            grid.columns,
            known.boxes_xyxy_px,
            config.box_half_depth_m,
            config.box_min_share,
        )
        found = self._cluster(points_m[free], owner[free], len(known.boxes))
        return replace(known, clusters=self._noun(image, grid, points_m, planes, free, found))

    def _grid_for(self, height: int, width: int) -> RayGrid:
        if self._grid is None or self._grid[:2] != (height, width):
            self._grid = (height, width, ray_grid(self._camera, height, width, self.config.stride))
        return self._grid[2]

    def _cluster(self, points_m: F32, owner: I16, n_boxes: int) -> _Found:
        """Cluster the foreground of each box, and what belongs to none; keep what has points enough, largest first."""
        config = self.config
        label_of = np.full(len(points_m), UNKNOWN, dtype=np.int32)
        means, weights, labels, boxes = [np.zeros((0, 3))], [np.zeros(0, np.int32)], [np.zeros(0, np.int32)], []
        n_clusters = 0
        for box in range(NO_BOX, n_boxes):
            chosen = np.flatnonzero(owner == box)
            if len(chosen) == 0:
                continue
            voxels = voxel_filter(points_m[chosen], config.voxel_m)
            scaled = depth_scaled(voxels.mean_m, config.tolerance_m, config.tolerance_share)
            label = euclidean_clusters(scaled, 1.0) + np.int32(n_clusters)
            label_of[chosen] = label[voxels.voxel_of]
            n_new = int(label.max()) + 1 - n_clusters
            n_clusters += n_new
            means.append(voxels.mean_m)
            weights.append(voxels.n_points)
            labels.append(label)
            boxes += [box] * n_new
        label = np.concatenate(labels)
        size = np.bincount(label, minlength=n_clusters)
        order = np.argsort(-size, kind="stable")[: int((size >= config.min_points).sum())]
        rank = np.full(n_clusters + 1, UNKNOWN, dtype=np.int32)  # the last is that of no cluster
        rank[order] = np.arange(len(order))
        box_of = np.asarray(boxes, dtype=np.int32)[order]
        return _Found(rank[label_of], np.concatenate(means), np.concatenate(weights), rank[label], box_of)

    def _noun(
        self, image: RgbdImage, grid: RayGrid, points_m: F32, planes: Planes, free: Bool, found: _Found
    ) -> Clusters:
        """Return the clusters with their label image and extents."""
        config = self.config
        labels = np.full(grid.shape, UNKNOWN, dtype=np.int16)
        labels[planes.plane_of >= 0] = PLANE
        labels[free] = found.label_of
        order: I64 = np.argsort(found.label, kind="stable")
        order = order[np.searchsorted(found.label[order], 0) :]  # those of no cluster come first
        of = found.label[order]
        start = np.searchsorted(of, np.arange(len(found.box)))
        mean_m, weight = found.mean_m[order], found.weight[order].astype(np.float64)
        if len(start):
            total = np.add.reduceat(weight, start)
            centroid_m = np.add.reduceat(mean_m * weight[:, None], start) / total[:, None]
            lower_m, upper_m = np.minimum.reduceat(mean_m, start), np.maximum.reduceat(mean_m, start)
        else:
            centroid_m = lower_m = upper_m = np.zeros((0, 3))
        return Clusters(
            labels=spread_labels(
                labels, points_m, image.depth_m, grid, config.tolerance_m, config.tolerance_share, UNKNOWN
            ),
            n_points=np.bincount(of, minlength=len(start)).astype(np.int32),
            centroid_m=centroid_m.astype(np.float32),
            lower_m=lower_m.astype(np.float32),
            upper_m=upper_m.astype(np.float32),
            box=found.box,
            planes=planes.coefficients,
        )
