"""What is taken out of the map again: what moves, what later rays pass through, and what was never there for long."""

from dataclasses import dataclass

import numpy as np

from stillroom.data.image import RgbdImage
from stillroom.data.map import Map
from stillroom.dense.keyframe_cloud import UNIT_M, SurfaceConfig, in_units
from stillroom.dense.moving_removal import near_moving
from stillroom.dense.voxels.evidence_kernels import HIT, judge_in_view, judge_rows, mean_positions
from stillroom.dense.voxels.voxel_map import VoxelMap, block_centres_m, in_frustum
from stillroom.dense.witnesses import Witnesses, lens_of, views_of
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32, I64, U8, U16, Bool
from stillroom.geometry.camera import Camera

COARSER = 2
"""Rays that carve are taken at the stride of the clouds times this."""


@dataclass(frozen=True)
class CarvingConfig:
    """What is taken out.

    Each voxel has a score. A depth image in which it is a surface raises the score by `hit`, one whose rays pass
    through it lowers it by 1, between `lowest` and `highest`. Voxels with a score above 0 are shown, and one that is
    passed at `lowest` is emptied. A voxel that gets its first pixels starts with the score that earlier images give
    it: what appears where they saw through must be hit again and again before it is shown.

    Attributes:
        removal: Whether anything is taken out; without, moving pixels are fused like all others.
        radius_m: Voxels nearer than this to what moves are emptied, unless the same image shows them to stay.
        tolerance_m, tolerance_share: A ray passes a voxel when it ends behind it by more than the larger of the first
            and this share of the depth, with all rays around it.
        hit, lowest, highest: See above.
        n_asked: Earlier images that are asked about new voxels.
        every: Every how many-th frame that is no keyframe is used.
    """

    removal: bool = True
    radius_m: float = 0.05
    tolerance_m: float = 0.05
    tolerance_share: float = 0.035
    hit: int = 2
    lowest: int = -10
    highest: int = 12
    n_asked: int = 12
    every: int = 3


class Carver:
    """Judges the voxels of a map by depth images."""

    def __init__(
        self,
        config: CarvingConfig,
        surface: SurfaceConfig,
        camera: Camera,
        voxels: VoxelMap,
        world: Map,
        most_witnesses: int,
    ) -> None:
        """Start without earlier images."""
        self.config, self.voxels, self.world, self.camera = config, voxels, world, camera
        self._stride = COARSER * surface.stride
        self._far_m = surface.far_m
        self._size_px, self._lens = (camera.width, camera.height), lens_of(camera)
        self._witnesses = Witnesses(camera, most_witnesses)
        self._limits = config.lowest, config.highest
        self._n_offered = 0

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return self._witnesses.n_bytes

    def wants_frame(self) -> bool:
        """Count a frame that is offered, and tell whether it is one to use."""
        self._n_offered += 1
        return self._n_offered % self.config.every == 0

    def in_view(self, block_keys: I64, T_world_cam: F64) -> Bool:
        """Tell of blocks (B,) whether a camera at a pose (4, 4) may see into them."""
        centres_m = block_centres_m(block_keys, self.voxels.voxel_m)
        T_cam_world = se3.inverse(T_world_cam)
        return in_frustum(centres_m, self.voxels.block_radius_m, T_cam_world, self._lens, self._size_px, self._far_m)

    def judge_keyframe(
        self, keyframe: int, image: RgbdImage, excluded: Bool | None, T_world_cam: F64, now: int
    ) -> None:
        """Let a keyframe carve, and remove from the map what it shows to be moving.

        Args:
            keyframe: Its id; it is remembered by it.
            image: Its image.
            excluded: Pixels that move (H, W).
            T_world_cam: Its pose (4, 4).
            now: Time that voided voxels are marked with.
        """
        depth, moving = self._small(image, excluded)
        near, said = self._judge(depth, moving, T_world_cam, now)
        self._remove_moving(depth, moving, T_world_cam, near, said, now)
        self._witnesses.remember(keyframe, np.eye(4), T_world_cam, depth, moving)

    def judge_frame(self, keyframe: int, image: RgbdImage, excluded: Bool | None, T_world_cam: F64, now: int) -> None:
        """Let a frame carve that is remembered by its place beside a keyframe. Arguments as above."""
        depth, moving = self._small(image, excluded)
        self._judge(depth, moving, T_world_cam, now)
        T_keyframe_cam = se3.inverse(self.world.keyframe_pose(keyframe)) @ T_world_cam
        self._witnesses.remember(keyframe, T_keyframe_cam, T_world_cam, depth, moving)

    def ask_earlier(self, newborn: I32) -> None:
        """Give voxels (M,) that were empty the score that remembered images give them, in order of time."""
        voxels, config = self.voxels, self.config
        rows = newborn[voxels.weight[newborn] > 0]
        if len(rows) == 0:
            return
        voxels.score[rows] = 0
        positions_m = mean_positions(rows, voxels.key, voxels.rows, voxels.voxel_m)
        for witness in self._witnesses.choose(positions_m, self._far_m, config.n_asked, self.world):
            judge_rows(
                rows,
                positions_m,
                voxels.rows,
                witness.T_cam_world,
                self._lens,
                witness.views(),
                self._stride,
                config.tolerance_m,
                config.tolerance_share,
                config.hit,
                self._limits,
            )

    def _small(self, image: RgbdImage, excluded: Bool | None) -> tuple[U16, Bool]:
        depth = in_units(image.depth_m[:: self._stride, :: self._stride])
        if excluded is None:
            return depth, np.zeros(depth.shape, dtype=np.bool_)
        return depth, excluded[:: self._stride, :: self._stride].copy()

    def _judge(self, depth: U16, moving: Bool, T_world_cam: F64, now: int) -> tuple[Bool, U8]:
        """Let a small depth image (h, w) judge what is in view; return blocks (B,) in view, and what it said (N,)."""
        voxels, config = self.voxels, self.config
        T_cam_world = se3.inverse(T_world_cam)
        near = voxels.blocks_near(T_cam_world, self._lens, self._size_px, self._far_m)
        said = np.zeros(voxels.n_rows, dtype=np.uint8)
        judge_in_view(
            near,
            voxels.key,
            voxels.rows,
            now,
            voxels.voxel_m,
            T_cam_world,
            self._lens,
            views_of(depth, moving),
            self._stride,
            config.tolerance_m,
            config.tolerance_share,
            config.hit,
            self._limits,
            said,
        )
        return near, said

    def _remove_moving(self, depth: U16, moving: Bool, T_world_cam: F64, near: Bool, said: U8, now: int) -> None:
        """Empty the voxels near moving pixels (h, w); those that the same image shows as static surface stay."""
        voxels, config = self.voxels, self.config
        known = moving & (depth > 0) & (depth * UNIT_M <= self._far_m)
        if not known.any():
            return
        row, column = np.nonzero(known)
        raw_px = np.stack((column, row), axis=1).astype(np.float32) * np.float32(self._stride)
        depth_m = np.multiply(depth[known], UNIT_M, dtype=np.float32)
        moving_m = se3.transform(T_world_cam, self.camera.back_project(self.camera.undistort(raw_px), depth_m))
        close = near & near_moving(moving_m, voxels.block_centres_m, config.radius_m + voxels.block_radius_m)
        rows = np.flatnonzero(close[voxels.block])
        rows = rows[(said[rows] != HIT) & (voxels.weight[rows] > 0)].astype(np.int32)
        positions_m = mean_positions(rows, voxels.key, voxels.rows, voxels.voxel_m)
        gone = near_moving(moving_m, positions_m, config.radius_m)
        voxels.void(rows[gone], now, config.lowest)
