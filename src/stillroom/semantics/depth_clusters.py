"""Segmentation of an image's depth cloud (OC-SLAM 2.3–2.5): planes, and clusters of the rest, helped by boxes.

Plain Euclidean clustering fuses a person with the table he leans on (the paper's Figure 7). Here the foreground of each
box is clustered separately, so that furniture beyond the box is not included.
"""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.clusters import PLANE, UNKNOWN, Clusters
from stillroom.data.image import Image
from stillroom.data.semantics import Semantics, boxes_xyxy_px
from stillroom.geometry.arrays import F32
from stillroom.geometry.camera import Camera
from stillroom.geometry.cloud.backproject import RayGrid, back_project, ray_grid
from stillroom.geometry.cloud.cloud_segments import (
    CloudSegments,
    SegmentLimits,
    claim_foregrounds,
    segment,
)
from stillroom.geometry.cloud.label_image import spread_labels
from stillroom.geometry.cloud.planes import PlaneLimits, Planes, find_planes
from stillroom.protocols import Parts, Pending


@dataclass(frozen=True)
class NoClustersConfig:
    """No settings."""

    def build(self, parts: Parts | None = None) -> "NoClusters":
        """Return the clusterer."""
        return NoClusters()


class NoClusters:
    """The null object: no clusters."""

    def __call__(self, image: Image, semantics: Pending[Semantics]) -> Semantics:
        """Return the semantics as they are."""
        return semantics.result()


@dataclass(frozen=True)
class DepthClustersConfig:
    """How the depth cloud of an image is clustered.

    Attributes:
        stride: Stride in rows and columns of the pixels that become points [px].
        min_depth_m, max_depth_m: Range of depths that are used [m].
        box_half_depth_m: Half the depth extent of an object in a box [m].
        box_min_share: A box helps only where its foreground fills this share of it.
        leave_out_masked: What a mask covers belongs to no cluster, where there is a mask: a carried object is not
            merged with its carrier. The boxes that help are then those of named objects; those of the mask are not
            needed.
        planes: What counts as a plane.
        segments: How the rest becomes clusters.
    """

    needs_depth_image: ClassVar[bool] = True

    stride: int = bounded(4, least=1, pixels=1)
    min_depth_m: float = bounded(0.2, least=0)
    max_depth_m: float = bounded(6.0, above=0)
    box_half_depth_m: float = bounded(0.40, above=0)
    box_min_share: float = bounded(0.10, least=0, most=1)
    leave_out_masked: bool = False
    planes: PlaneLimits = field(default_factory=PlaneLimits)
    segments: SegmentLimits = field(default_factory=SegmentLimits)

    def contradiction(self) -> tuple[str, str] | None:
        """Return that the nearest depth is not below the farthest."""
        fits = self.min_depth_m < self.max_depth_m
        return None if fits else ("max_depth_m", "min_depth_m")

    def build(self, parts: Parts) -> "DepthClusterer":
        """Return the clusterer; it makes no random choice.

        Raises:
            ConfigError: A value is impossible.
        """
        check(self, "clusters")
        return DepthClusterer(self, parts.camera)


class DepthClusterer:
    """Adds clusters to the semantics of an image."""

    def __init__(self, config: DepthClustersConfig, camera: Camera) -> None:
        """Take the camera; its rays are computed at the first image."""
        self.config = config
        self._camera = camera
        self._grid: tuple[int, int, RayGrid] | None = None

    def __call__(self, image: Image, semantics: Pending[Semantics]) -> Semantics:
        """Return the semantics with the clusters of the image's depth; boxes are awaited after the planes."""
        config = self.config
        grid = self._grid_for(*image.depth_m.shape)
        points_m = back_project(image.depth_m, grid, config.min_depth_m, config.max_depth_m)
        planes = find_planes(points_m, grid.ray_area, config.planes)
        z_m = np.ascontiguousarray(points_m[..., 2])
        free = (z_m > 0) & (planes.plane_of < 0)
        known = semantics.result()
        boxes_px = known.boxes_xyxy_px
        if config.leave_out_masked:
            boxes_px = boxes_xyxy_px(known.named)
            if known.mask is not None:
                free &= ~known.mask[grid.pixels]
        owner = claim_foregrounds(
            z_m,
            free,
            grid.rows,
            grid.columns,
            boxes_px,
            config.box_half_depth_m,
            config.box_min_share,
        )
        found = segment(points_m, free, owner, boxes_px, grid, config.segments)
        return replace(known, clusters=self._noun(image, grid, points_m, planes, found))

    def _grid_for(self, height: int, width: int) -> RayGrid:
        if self._grid is None or self._grid[:2] != (height, width):
            self._grid = (height, width, ray_grid(self._camera, height, width, self.config.stride))
        return self._grid[2]

    def _noun(self, image: Image, grid: RayGrid, points_m: F32, planes: Planes, found: CloudSegments) -> Clusters:
        """Return the clusters with their label image."""
        labels = found.segment_of.astype(np.int16)
        np.putmask(labels, planes.plane_of >= 0, PLANE)
        limits = self.config.segments
        steps = (limits.tolerance_m, limits.tolerance_share)
        return Clusters(
            labels=spread_labels(labels, points_m, image.depth_m, grid, *steps, UNKNOWN),
            n_points=found.n_points,
            centroid_m=found.centroid_m,
            lower_m=found.lower_m,
            upper_m=found.upper_m,
            box=found.box,
            planes=planes.coefficients,
        )
