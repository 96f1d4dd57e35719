"""What is taken out of the map again: what moves, what later rays pass through, and what was never there for long."""

from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.image import RgbdImage
from stillroom.data.map import Map
from stillroom.dense.keyframe_cloud import UNIT_M, SurfaceConfig
from stillroom.dense.moving_removal import MovingPoints
from stillroom.dense.voxels.evidence_kernels import (
    NOTHING,
    DepthView,
    Scoring,
    Seeing,
    Voxels,
    answers,
    judge_in_view,
    judge_rows,
    mean_positions,
    rows_in,
)
from stillroom.dense.voxels.voxel_map import VoxelMap, block_centres_m, in_frustum
from stillroom.dense.witnesses import Witnesses, small_depth, views_of
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32, I64, U16, Bool
from stillroom.geometry.camera import Camera

COARSER = 2
"""Rays that carve are taken at the stride of the clouds times this."""

TYPICAL_DEPTH_M = 3.0


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
        every: Every how many-th frame is used. A keyframe is one of them; where no other frames are offered, all are.
    """

    removal: bool = True
    radius_m: float = bounded(0.05, least=0)
    tolerance_m: float = bounded(0.05, least=0)
    tolerance_share: float = bounded(0.035, least=0)
    hit: int = bounded(2, least=1)
    lowest: int = bounded(-6, most=0)
    highest: int = bounded(6, least=1)
    n_asked: int = bounded(8, least=1)
    every: int = bounded(4, least=1)


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
        self._far_m = surface.far_m
        self._size_px, self._lens = (camera.width, camera.height), camera.lens
        self._witnesses = Witnesses(camera, most_witnesses)
        self._scoring = Scoring(config.hit, config.lowest, config.highest)
        self._stride = COARSER * surface.stride
        self._seeing = Seeing(float(UNIT_M), self._stride, config.tolerance_m, config.tolerance_share)
        # Points of moving things lie no further apart than the radius, up to a typical depth.
        self._thinning = max(1, int(config.radius_m * camera.fx / TYPICAL_DEPTH_M / self._stride))
        self._since_judged = self._since_frame_judged = config.every

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return self._witnesses.n_bytes

    def refresh(self) -> None:
        """Follow the keyframes to where they are now: earlier images are asked about what they see from there."""
        self._witnesses.refresh(self.world)

    def in_view(self, block_keys: I64, T_world_cam: F64) -> Bool:
        """Return for blocks (B,) whether a camera at a pose (4, 4) may see into them."""
        centres_m = block_centres_m(block_keys, self.voxels.voxel_m)
        T_cam_world = se3.inverse(T_world_cam)
        return in_frustum(centres_m, self.voxels.block_radius_m, T_cam_world, self._lens, self._size_px, self._far_m)

    def judge_keyframe(
        self, keyframe: int, image: RgbdImage, excluded: Bool | None, T_world_cam: F64, now: int
    ) -> None:
        """Remove from the map what a keyframe shows to be moving, and let it carve if its turn has come.

        Args:
            keyframe: Its id; it is remembered by it.
            image: Its image.
            excluded: Pixels that move (H, W).
            T_world_cam: Its pose (4, 4).
            now: Time that voided voxels are marked with.
        """
        self._since_judged += 1
        self._since_frame_judged += 1
        depth = small_depth(image.depth_m, excluded, self._stride)
        # Frames between keyframes tell as much: where they are offered, a keyframe seldom needs to carve.
        if self._since_frame_judged > 2 * self.config.every:
            self._judge(depth, T_world_cam, now)
        if excluded is not None:
            self._remove_moving(depth, T_world_cam, now)
        self._witnesses.remember(keyframe, np.eye(4), T_world_cam, depth)

    def judge_frame(
        self, keyframe: int, T_keyframe_cam: F64, image: RgbdImage, excluded: Bool | None, T_world_cam: F64, now: int
    ) -> bool:
        """Let a frame carve if its turn has come; tell whether it had.

        Args:
            keyframe: The keyframe that it is remembered by …
            T_keyframe_cam: … and its pose in it (4, 4).
            image, excluded, T_world_cam, now: See above.
        """
        self._since_judged += 1
        self._since_frame_judged += 1
        if self._since_judged < self.config.every:
            return False
        self._since_frame_judged = 0
        depth = small_depth(image.depth_m, excluded, self._stride)
        self._judge(depth, T_world_cam, now)
        self._witnesses.remember(keyframe, T_keyframe_cam, T_world_cam, depth)
        return True

    def ask_earlier(self, newborn: I32) -> None:
        """Give voxels (M,) that were empty the score that remembered images give them, in order of time."""
        voxels, config = self.voxels, self.config
        rows = newborn[voxels.weight[newborn] > 0]
        if len(rows) == 0:
            return
        voxels.score[rows] = 0
        heard = np.zeros(len(rows), dtype=np.bool_)
        positions_m = mean_positions(rows, voxels.key, voxels.rows, voxels.voxel_m)
        for T_cam_world, depth in self._witnesses.choose(positions_m, self._far_m, config.n_asked, self.world):
            view = DepthView(T_cam_world, self._lens, views_of(depth))
            judge_rows(rows, positions_m, voxels.rows, view, self._seeing, self._scoring, heard)
        voxels.score[rows[~heard]] = 1  # nobody has said anything against these

    def _judge(self, depth: U16, T_world_cam: F64, now: int) -> None:
        """Let a small depth image (h, w) judge what is in view."""
        voxels, T_cam_world = self.voxels, se3.inverse(T_world_cam)
        near = voxels.blocks_near(T_cam_world, self._lens, self._size_px, self._far_m)
        view = DepthView(T_cam_world, self._lens, views_of(depth))
        judged = Voxels(voxels.key, voxels.rows, voxels.voxel_m)
        judge_in_view(near, judged, now, view, self._seeing, self._scoring)
        self._since_judged = 0

    def _remove_moving(self, depth: U16, T_world_cam: F64, now: int) -> None:
        """Empty voxels near moving pixels (h, w) of which the image says nothing else: neither static nor passed."""
        voxels, config = self.voxels, self.config
        moving = MovingPoints(self._moving_points(depth, T_world_cam))
        close = moving.near(voxels.block_centres_m, config.radius_m + voxels.block_radius_m)
        if not close.any():
            return
        rows = rows_in(close, voxels.rows)
        positions_m = mean_positions(rows, voxels.key, voxels.rows, voxels.voxel_m)
        perhaps = moving.perhaps_near(positions_m, config.radius_m)
        rows, positions_m = rows[perhaps], positions_m[perhaps]
        view = DepthView(se3.inverse(T_world_cam), self._lens, views_of(depth))
        said = answers(positions_m, view, self._seeing)
        open_to_it = said == NOTHING
        gone = moving.near(positions_m[open_to_it], config.radius_m)
        voxels.void(rows[open_to_it][gone], now, config.lowest)

    def _moving_points(self, depth: U16, T_world_cam: F64) -> F64:
        """Return points (M, 3) [m, world] of what moves."""
        step = self._thinning
        coarse = depth[::step, ::step]
        depth_m = np.multiply(coarse, UNIT_M, dtype=np.float32)
        row, column = np.nonzero((coarse % 2 == 1) & (depth_m <= self._far_m))
        raw_px = np.stack((column, row), axis=1).astype(np.float32) * np.float32(step * self._stride)
        points_cam_m = self.camera.back_project(self.camera.undistort(raw_px), depth_m[row, column])
        return se3.transform(T_world_cam, points_cam_m)
