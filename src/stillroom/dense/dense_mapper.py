"""The dense map: the static pixels of keyframes in voxels, kept consistent with corrected poses."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.image import Image
from stillroom.data.map import Map, submaps
from stillroom.dense.carving import Carver, CarvingConfig
from stillroom.dense.cloud_store import CloudStore
from stillroom.dense.keyframe_cloud import I8, CloudMaker, KeyframeCloud, SurfaceConfig
from stillroom.dense.voxels.extraction import extract
from stillroom.dense.voxels.fusing_kernels import FULL_WEIGHT, SCORE, WEIGHT
from stillroom.dense.voxels.hash_kernels import unpack
from stillroom.dense.voxels.swapped_blocks import SwappedBlocks
from stillroom.dense.voxels.voxel_map import VoxelMap
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32, I64, Bool
from stillroom.protocols import P, Parts, T

TYPICAL_DEPTH_M = 2.5
NOT_FUSED = -1
FIRST_CAPACITY = 64
MB = float(1 << 20)
PATIENCE = 2.0
"""Poses of new keyframes fluctuate: while frames come, only what has moved by this factor more is fused again."""
CLOUD_SHARE, VOXEL_SHARE, WITNESS_SHARE = 0.45, 0.45, 0.1
"""What keyframe clouds, voxels and earlier depth images may take of the memory."""


# The poses under which images were fused, and which of them have changed in the map since.


class FusedViews:
    """The views: keyframes, or frames with a pose relative to one, numbered in order of arrival."""

    def __init__(self) -> None:
        """Start with none."""
        self._keyframe = np.zeros(FIRST_CAPACITY, dtype=np.int64)
        self._T_keyframe_cam = np.zeros((FIRST_CAPACITY, 4, 4))
        self._T_world_cam = np.zeros((FIRST_CAPACITY, 4, 4))
        self._added_at = np.zeros(FIRST_CAPACITY, dtype=np.int64)
        self._n = 0

    def new(self, keyframe: int, T_keyframe_cam: F64) -> int:
        """Add a view with a pose (4, 4) relative to a keyframe and return its number; it is not fused yet."""
        view = self._n
        if view == len(self._keyframe):
            for name in ("_keyframe", "_T_keyframe_cam", "_T_world_cam", "_added_at"):
                column = getattr(self, name)
                setattr(self, name, np.concatenate((column, np.zeros_like(column))))
        self._keyframe[view], self._T_keyframe_cam[view] = keyframe, T_keyframe_cam
        self._added_at[view] = NOT_FUSED
        self._n += 1
        return view

    def note(self, view: int, T_world_cam: F64, now: int) -> None:
        """Note that a view was fused under a pose (4, 4)."""
        self._T_world_cam[view], self._added_at[view] = T_world_cam, now

    def fused_under(self, view: int) -> tuple[F64, int]:
        """Return the pose (4, 4) under which, and the time at which a view was fused."""
        return self._T_world_cam[view], int(self._added_at[view])

    def pose_now(self, view: int, world: Map) -> F64:
        """Return `T_world_cam` (4, 4) of a view in the current map."""
        pose: F64 = world.keyframe_pose(int(self._keyframe[view])) @ self._T_keyframe_cam[view]
        return pose

    def forget(self, view: int) -> None:
        """Never correct a view again."""
        self._added_at[view] = NOT_FUSED

    def moved(self, world: Map, tolerance_m: float, with_culled: bool) -> list[int]:
        """Return the views whose pose in the map has changed, the farthest moved first.

        Args:
            world: The map.
            tolerance_m: How far a point at a typical depth may move.
            with_culled: Whether to include culled keyframes, by the pose of their parent.
        """
        views: I64 = np.flatnonzero(self._added_at[: self._n] != NOT_FUSED)
        with world.lock:
            if not with_culled:
                views = views[world.keyframes.is_alive[self._keyframe[views]]]
            poses = world.keyframe_poses(self._keyframe[views]) @ self._T_keyframe_cam[views]
        change = se3.inverse(self._T_world_cam[views]) @ poses
        moved_m = np.linalg.norm(change[:, :3, 3], axis=1) + TYPICAL_DEPTH_M * se3.angle_rad(change)
        order = np.argsort(-moved_m, kind="stable")
        finite = np.isfinite(moved_m[order])
        return [int(view) for view in views[order][finite & (moved_m[order] > tolerance_m)]]


@dataclass(frozen=True)
class DenseMapperConfig:
    """The dense map.

    Attributes:
        voxel_m: Edge of a voxel [m].
        surface: Which pixels are fused.
        carving: What is removed again.
        correction_m: A keyframe is fused again when its pose in the map has moved a point two metres and a half away by
            more than this.
        corrections: Views fused again with each new keyframe, at most; `refresh` does all.
        fuse_every: After this many frames without a keyframe, one of them is fused too: a static camera
            makes no keyframes, and things still appear. 0: keyframes only.
        least_pixels: A point needs the weight of this many pixels at one metre; a pixel at four counts 1/16.
        layer_voxels: How far to either side noise may smear a surface; it comes out as one layer. 0: as it is.
        max_memory_mb: What the map may hold in memory [MB]; the rest lies in a temporary file. What one view shows
            stays in any case, and the result of `cloud` comes on top.
        swap_folder: Where that file goes; None for the system's default. It takes about 0.4 MB for each fused image.
    """

    needs_depth_image: ClassVar[bool] = True

    voxel_m: float = bounded(0.02, above=0)
    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    carving: CarvingConfig = field(default_factory=CarvingConfig)
    correction_m: float = bounded(0.01, least=0)
    corrections: int = bounded(1, least=0)
    fuse_every: int = bounded(8, least=0)
    least_pixels: float = 0.0
    layer_voxels: int = bounded(1, least=0)
    max_memory_mb: float = bounded(512.0, above=0)
    swap_folder: Path | None = None

    def build(self, parts: Parts) -> "DenseMapper":
        """Return an empty dense map of the map's keyframes."""
        check(self, "dense")
        return DenseMapper(self, parts)


class DenseMapper:
    """Fuses keyframes, removes what moved, and fuses again after pose corrections."""

    def __init__(self, config: DenseMapperConfig, parts: Parts) -> None:
        """Start empty."""
        self.config, self.camera, self.world = config, parts.camera, parts.world
        camera, world, timed = parts.camera, parts.world, parts.clock.timed
        self.voxels = VoxelMap(config.voxel_m)
        self._maker = CloudMaker(config.surface, camera)
        self._clouds = CloudStore(self._maker.shape, CLOUD_SHARE * config.max_memory_mb * MB, config.swap_folder)
        self._swapped = SwappedBlocks(config.swap_folder)
        self._views = FusedViews()
        self._view_of: dict[int, int] = {}
        bytes_of_witness = self._maker.shape[0] * self._maker.shape[1] / 2
        most = max(16, int(WITNESS_SHARE * config.max_memory_mb * MB / bytes_of_witness))
        self._carver = Carver(config.carving, config.surface, camera, self.voxels, world, most)
        self._size_px, self._lens = (camera.width, camera.height), camera.lens
        self._newborn: I32 = np.zeros(0, dtype=np.int32)
        self._clock = 0
        self._last_keyframe = -1
        self._since_fused = 0
        self._fuse_image = timed("dense: fusing", self._fuse)
        self._judge_keyframe = timed("dense: removal", self._carver.judge_keyframe)
        self._remove_near_moving = timed("dense: removal", self._carver.remove_near_moving)
        self._ask_earlier = timed("dense: doubts", self._carver.ask_earlier)
        self._correct_some = timed("dense: corrections", self._correct)

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return self.voxels.n_bytes + self._clouds.n_bytes + self._carver.n_bytes

    def integrate(self, keyframe: int, image: Image, excluded: Bool | None = None) -> None:
        """Fuse a new keyframe's static pixels, and remove what it shows to be dynamic or gone.

        Args:
            keyframe: Its id in the map.
            image: Its image.
            excluded: Dynamic pixels (H, W).
        """
        T_world_cam = self.world.keyframe_pose(keyframe)
        if not np.all(np.isfinite(T_world_cam)):
            return
        if keyframe in self._view_of and self._view_of[keyframe] in self._clouds:
            self._take_out(self._view_of[keyframe])
        self._view_of[keyframe] = self._views.new(keyframe, np.eye(4))
        self._fuse_image(self._view_of[keyframe], image, excluded, T_world_cam)
        self._last_keyframe = keyframe
        if self.config.carving.scores:
            self._judge_keyframe(keyframe, image, excluded, T_world_cam, self._tick())
            self._ask_earlier(self._newborn)
        elif self.config.carving.by_tree and excluded is not None:
            self._remove_near_moving(image, excluded, T_world_cam, self._tick())
        self._correct_some(self.config.corrections)
        self._keep_within_bound(T_world_cam)

    def carve(self, image: Image, T_world_cam: F64, excluded: Bool | None = None) -> None:
        """Carve free space with a frame that is no keyframe; called for every frame, used at a stride.

        Args:
            image: Its image.
            T_world_cam: Its pose (4, 4).
            excluded: Dynamic pixels (H, W); their rays carve too, but show no surface.
        """
        if self._last_keyframe < 0 or not np.all(np.isfinite(T_world_cam)):
            return
        keyframe, scores = self._last_keyframe, self.config.carving.scores
        T_keyframe_cam = se3.inverse(self.world.keyframe_pose(keyframe)) @ T_world_cam
        self._since_fused += 1
        if scores and not self._carver.judge_frame(
            keyframe, T_keyframe_cam, image, excluded, T_world_cam, self._tick()
        ):
            return
        if 0 < self.config.fuse_every <= self._since_fused:
            self._fuse(self._views.new(keyframe, T_keyframe_cam), image, excluded, T_world_cam)
            if scores:
                self._carver.ask_earlier(self._newborn)
            elif self.config.carving.by_tree and excluded is not None:
                self._remove_near_moving(image, excluded, T_world_cam, self._tick())
            self._keep_within_bound(T_world_cam)

    def refresh(self) -> None:
        """Fuse all keyframes again whose poses in the map have changed, culled ones too."""
        self._carver.refresh()
        self._correct(None)

    def cloud(self) -> DenseCloud:
        """Return the static scene of the main sub-map as known now. `refresh` first where poses may have changed."""
        swapped, config = self._swapped.read_all(), self.config
        key = np.concatenate((self.voxels.key, swapped["key"]))
        rows = np.concatenate((self.voxels.rows, swapped["row"]))
        shown = rows[:, WEIGHT] >= max(1.0, config.least_pixels * FULL_WEIGHT)
        if config.carving.scores:
            shown &= rows[:, SCORE] > 0
        if self.world.n_submaps > 1:
            centres_m = (unpack(key) + 0.5) * config.voxel_m
            with self.world.lock:
                main = submaps.main(self.world)
            shown &= submaps.lies_in(main, centres_m)
        return extract(key[shown], rows[shown], config.voxel_m, config.layer_voxels)

    def _fuse(self, view: int, image: Image, excluded: Bool | None, T_world_cam: F64) -> None:
        self._bring_back_in_view(T_world_cam)
        cloud, normals = self._maker.make(image, excluded if self.config.carving.scores else None)
        self._put_in(view, cloud, normals, T_world_cam)
        self._since_fused = 0

    def _put_in(self, view: int, cloud: KeyframeCloud, normals: I8, T_world_cam: F64) -> None:
        """Add a cloud under a pose, and keep it; `_newborn` are then the voxels that had no weight before."""
        placed = self.voxels.place(cloud, self._maker.rays, normals, T_world_cam)
        self._swapped.back(self.voxels, self._swapped.of_pixels(placed.keys))
        self._newborn = self.voxels.add(placed)
        self._views.note(view, T_world_cam, self._tick())
        for lost in self._clouds.put(view, cloud):
            self._views.forget(lost)

    def _take_out(self, view: int) -> tuple[KeyframeCloud, I8]:
        """Subtract a view from where it was added, and return its cloud; voxels voided since are no longer usable."""
        cloud = self._clouds.take(view)
        normals = self._maker.find_surfaces(cloud)
        T_world_cam, added_at = self._views.fused_under(view)
        placed = self.voxels.place(cloud, self._maker.rays, normals, T_world_cam)
        self._swapped.back(self.voxels, self._swapped.of_pixels(placed.keys))
        self.voxels.subtract(placed, added_at)
        self._views.forget(view)
        return cloud, normals

    def _correct(self, most: int | None) -> None:
        """Fuse again the views whose pose changed, the largest change first; without a limit, culled keyframes too."""
        tolerance_m = self.config.correction_m * (1.0 if most is None else PATIENCE)
        for view in self._views.moved(self.world, tolerance_m, with_culled=most is None)[:most]:
            T_world_cam = self._views.pose_now(view, self.world)
            cloud, normals = self._take_out(view)
            self._put_in(view, cloud, normals, T_world_cam)
            if self.config.carving.scores:
                self._carver.ask_earlier(self._newborn)
            if most is None:
                self._keep_within_bound(T_world_cam)

    def _tick(self) -> int:
        self._clock += 1
        return self._clock

    def _bring_back_in_view(self, T_world_cam: F64) -> None:
        """Load the blocks from the file that are in view, so that they can be updated."""
        if len(self._swapped):
            keys = self._swapped.keys
            self._swapped.back(self.voxels, keys[self._carver.in_view(keys, T_world_cam)])

    def _keep_within_bound(self, T_world_cam: F64) -> None:
        bound = VOXEL_SHARE * self.config.max_memory_mb * MB
        if self.voxels.n_bytes > bound:
            needed = self.voxels.blocks_near(
                se3.inverse(T_world_cam), self._lens, self._size_px, self.config.surface.far_m
            )
            self._swapped.out(self.voxels, bound, needed, T_world_cam)


def _untimed(name: str, function: Callable[P, T]) -> Callable[P, T]:
    return function
