"""An OctoMap of the keyframes: occupied, free and unknown voxels, as DS-SLAM and L. Zhang et al. make them.

Each keyframe's depth pixels are rays (Hornung et al., OctoMap, Autonomous Robots 2013, sections 3.1 and 3.2): the voxel
that one ends in is hit, those before it are missed, and each adds to the log-odds of being occupied, within bounds, so
that what has changed is soon believed. Values are those of octomap_server, and of DS-SLAM where it sets others
(docs/reference.md#octomap). Differs from the papers: voxels lie in a hash table instead of a tree, as leaves of one
size; the map is made again from the keyframes when their poses are corrected, which octomap_server cannot; and there is
no limit of height above the floor, as DS-SLAM's launch file sets, for the world's axes are those of the first camera.
DS-SLAM leaves out people whether they move or not, and this map what it is told to exclude, the dynamic pixels. L.
Zhang et al. rasterise lines faster than OctoMap does, and their probabilities are not known; here there is one way to
walk along rays.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.image import Image
from stillroom.data.map import submaps
from stillroom.dense.cloud_store import CloudStore
from stillroom.dense.dense_mapper import MB, FusedViews
from stillroom.dense.keyframe_cloud import (
    I8,
    NORMAL_SCALE,
    UNIT_M,
    CloudMaker,
    KeyframeCloud,
    SurfaceConfig,
    in_units,
    smoothed,
    take_every,
)
from stillroom.dense.voxels.extraction import extract
from stillroom.dense.voxels.hash_kernels import unpack
from stillroom.dense.voxels.log_odds import LogOddsGrid, log_odds_of
from stillroom.dense.voxels.ray_kernels import Scan, Steps
from stillroom.dense.voxels.voxel_map import VoxelMap
from stillroom.geometry.arrays import F32, F64, U8, Bool
from stillroom.geometry.pixels import Shape, grown
from stillroom.protocols import Parts

NONE = -1


@dataclass(frozen=True)
class OctoMapConfig:
    """The occupancy map.

    Attributes:
        resolution_m: Edge of a voxel [m].
        hit: Probability that a voxel is occupied, given that a ray ends in it.
        miss: The same, given that a ray passes through it.
        clamp_low, clamp_high: Bounds of a voxel's probability; the narrower, the sooner it can change again.
        occupied: A voxel is occupied from this probability on.
        near_m, far_m: Range of depth; other pixels are left out.
        max_range_m: A longer ray frees voxels up to here, and hits none [m].
        stride: Stride in rows and columns [px].
        excluded_margin_px: Dilation of dynamic pixels; no ray goes through them [px].
        correction_m: The map is made again when the pose of a keyframe has moved a point two metres and a half away by
            more than this [m]. octomap_server never does.
        max_memory_mb: What the keyframes' clouds may hold in memory [MB]; the rest of them lies in a temporary file.
            Voxels come on top.
        swap_folder: Where that file goes; None for the system's default.
    """

    needs_depth_image: ClassVar[bool] = True

    resolution_m: float = bounded(0.05, above=0)
    hit: float = bounded(0.7, above=0.5, below=1)
    miss: float = bounded(0.4, above=0, below=0.5)
    clamp_low: float = bounded(0.12, above=0, below=0.5)
    clamp_high: float = bounded(0.97, above=0.5, below=1)
    occupied: float = bounded(0.5, above=0, below=1)
    near_m: float = bounded(0.01, least=0)
    far_m: float = bounded(8.0, above=0)
    max_range_m: float = bounded(5.0, above=0)
    stride: int = bounded(3, least=1, pixels=1)
    excluded_margin_px: int = bounded(20, least=0, pixels=1)
    correction_m: float = bounded(0.02, least=0)
    max_memory_mb: float = bounded(256.0, above=0)
    swap_folder: Path | None = None

    def contradiction(self) -> tuple[str, str] | None:
        """Return that a range is empty, or that no voxel could become occupied."""
        pairs = ("far_m", "near_m"), ("occupied", "clamp_low"), ("clamp_high", "occupied")
        return next((pair for pair in pairs if not getattr(self, pair[0]) > getattr(self, pair[1])), None)

    def build(self, parts: Parts) -> "OctoMap":
        """Return an empty occupancy map of the map's keyframes."""
        check(self, "dense")
        return OctoMap(self, parts)

    @property
    def steps(self) -> Steps:
        """What hits and misses add to log-odds, and their bounds."""
        values = self.hit, self.miss, self.clamp_low, self.clamp_high
        return Steps(*(np.float32(log_odds_of(value)) for value in values))


class OctoMap:
    """Inserts keyframes, and makes the map again after pose corrections."""

    def __init__(self, config: OctoMapConfig, parts: Parts) -> None:
        """Start empty."""
        self.config, self.world = config, parts.world
        # Normals come from where there are surfaces; rays from every pixel with depth.
        surface = SurfaceConfig(stride=config.stride, near_m=config.near_m, far_m=config.far_m, least_cosine=0.0)
        self._maker = CloudMaker(surface, parts.camera)
        x, y = np.moveaxis(self._maker.rays, 2, 0)
        self._range_per_m = np.sqrt(x * x + y * y + np.float32(1.0))
        self._to_camera = _to_camera(self._maker.rays, self._range_per_m)
        self._clouds = CloudStore(self._maker.shape, config.max_memory_mb * MB, config.swap_folder)
        self._views = FusedViews()
        self._view_of: dict[int, int] = {}
        self._insert = parts.clock.timed("dense: rays", self._insert_cloud)
        self._start_empty()

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return self.grid.n_bytes + self.hits.n_bytes + self._clouds.n_bytes

    def integrate(self, keyframe: int, image: Image, excluded: Bool | None = None) -> None:
        """Insert a new keyframe's rays.

        Args:
            keyframe: Its id in the map.
            image: Its image.
            excluded: Dynamic pixels (H, W); their rays neither hit nor miss.
        """
        T_world_cam = self.world.keyframe_pose(keyframe)
        if not np.all(np.isfinite(T_world_cam)):
            return
        self._leave_out(keyframe)
        view = self._view_of[keyframe] = self._views.new(keyframe, np.eye(4))
        self._put_in(view, self._cloud_of(image, excluded), T_world_cam)

    def carve(self, image: Image, T_world_cam: F64, excluded: Bool | None = None) -> None:
        """Do nothing: the papers' maps are made of keyframes alone."""

    def refresh(self) -> None:
        """Make the map again if poses of keyframes have changed, of culled ones too; a miss cannot be taken back.

        Keyframes whose clouds were lost, as there was no room in the temporary file, are then left out.
        """
        if self._is_stale or self._views.moved(self.world, self.config.correction_m, with_culled=True):
            self._start_empty()
            for view in sorted(self._view_of.values()):
                if view in self._clouds:
                    self._put_in(view, self._clouds.take(view), self._pose_of(view))

    def cloud(self) -> DenseCloud:
        """Return the occupied voxels of the main sub-map, and which are free. `refresh` where poses may have changed.

        A point is the mean of the pixels that ever hit its voxel, and so are its colour and its normal.
        """
        resolution_m = self.config.resolution_m
        key, log_odds = self.grid.key, self.grid.log_odds
        if self.world.n_submaps > 1:
            with self.world.lock:
                main = submaps.main(self.world)
            is_there = submaps.lies_in(main, (unpack(key) + 0.5) * resolution_m)
            key, log_odds = key[is_there], log_odds[is_there]
        row = self.hits.rows_of(key)
        is_occupied = (log_odds >= np.float32(log_odds_of(self.config.occupied))) & (row >= 0)
        shown = extract(key[is_occupied], self.hits.rows[row[is_occupied]], resolution_m, 0)
        return replace(shown, free=unpack(np.sort(key[~is_occupied])).astype(np.int32))

    def _start_empty(self) -> None:
        """Forget all voxels, but no keyframe."""
        self.grid = LogOddsGrid(self.config.steps)
        self.hits = VoxelMap(self.config.resolution_m)
        self._n_scans, self._is_stale = 0, False

    def _cloud_of(self, image: Image, excluded: Bool | None) -> KeyframeCloud:
        """Return the pixels of an image whose rays count, whatever their range."""
        config, stride = self.config, self.config.stride
        depth = in_units(image.depth_m, stride)
        rgb = np.empty((*depth.shape, 3), dtype=np.uint8)
        take_every(image.rgb, stride, rgb)
        cloud = KeyframeCloud(depth, rgb, (depth > 0).astype(np.uint8))
        cloud.usable[(cloud.depth_m < config.near_m) | (cloud.depth_m > config.far_m)] = 0
        if excluded is not None:
            cloud.usable[grown(excluded, config.excluded_margin_px, Shape.SQUARE)[::stride, ::stride]] = 0
        return cloud

    def _put_in(self, view: int, cloud: KeyframeCloud, T_world_cam: F64) -> None:
        """Insert a cloud under a pose, and keep it."""
        self._insert(cloud, T_world_cam)
        self._views.note(view, T_world_cam, self._n_scans)
        for lost in self._clouds.put(view, cloud):
            self._views.forget(lost)

    def _insert_cloud(self, cloud: KeyframeCloud, T_world_cam: F64) -> None:
        config, rays, depth_m = self.config, self._maker.rays, cloud.depth_m
        ends: U8 = (cloud.usable.view(np.bool_) & (depth_m * self._range_per_m <= config.max_range_m)).view(np.uint8)
        placed = self.hits.place(replace(cloud, usable=ends), rays, self._normals_of(cloud, ends), T_world_cam)
        self._n_scans += 1
        scan = Scan(
            self._n_scans,
            cloud.depth,
            cloud.usable,
            rays,
            float(UNIT_M),
            T_world_cam,
            config.resolution_m,
            config.max_range_m,
        )
        self.grid.insert(scan, placed.keys, ends)
        self.hits.add(placed)

    def _normals_of(self, cloud: KeyframeCloud, ends: U8) -> I8:
        """Return normals (h, w, 3): where a pixel lies on no surface, as at edges, the direction to the camera."""
        on_surface = ends.copy()
        normals = self._maker.find_surfaces(KeyframeCloud(smoothed(cloud.depth), cloud.rgb, on_surface))
        return np.where(on_surface[:, :, None] > 0, normals, self._to_camera)

    def _pose_of(self, view: int) -> F64:
        """Return the pose (4, 4) of a view in the map; the one that it was inserted under where there is none."""
        T_world_cam = self._views.pose_now(view, self.world)
        return T_world_cam if np.all(np.isfinite(T_world_cam)) else self._views.fused_under(view)[0]

    def _leave_out(self, keyframe: int) -> None:
        """Drop a keyframe's cloud, if there is one; its rays are gone with the next `refresh`."""
        view = self._view_of.get(keyframe, NONE)
        if view in self._clouds:
            self._clouds.take(view)
            self._views.forget(view)
            self._is_stale = True


def _to_camera(rays: F32, range_per_m: F32) -> I8:
    """Return the direction to the camera (h, w, 3), camera frame, unit length 127, of pixels with rays (h, w, 2)."""
    directions = np.dstack((rays, np.ones(rays.shape[:2], dtype=np.float32))) / range_per_m[:, :, None]
    return np.asarray(np.rint(-NORMAL_SCALE * directions), dtype=np.int8)
