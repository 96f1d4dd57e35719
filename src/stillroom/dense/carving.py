"""Removal from the map: dynamic points, free-space carving by later rays, and what was seen only briefly."""

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.image import Image
from stillroom.data.map import Map
from stillroom.dense.keyframe_cloud import UNIT_M, SurfaceConfig, in_units
from stillroom.dense.voxels.evidence_kernels import (
    NOTHING,
    Scoring,
    Seeing,
    SmallDepthView,
    VoxelColumns,
    answers,
    count_in_view,
    judge_in_view,
    judge_rows,
    mean_positions,
    rows_in,
)
from stillroom.dense.voxels.voxel_map import VoxelMap, block_centres_m, in_frustum
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, U16, Bool, Floats
from stillroom.geometry.camera import Camera
from stillroom.geometry.pixels import Shape, element

EVIDENCE, KD_TREE = "evidence", "kd-tree"
MOST_CELLS = 1 << 21
SAMPLES = 64
LEAST_SHARE = 0.1
"""An earlier depth image is used when it has at least this share of the points in view."""
COARSER = 2
"""Rays that carve are taken at the stride of the clouds times this."""
TYPICAL_DEPTH_M = 3.0


# Removal of what moves from what was fused before (OC-SLAM 2.6): voxels near moving points, found by Kd-tree.


class MovingPoints:
    """Dynamic points, with radius queries."""

    def __init__(self, points_world_m: F64) -> None:
        """Take the points (M, 3) [m, world]."""
        self._points_m = points_world_m
        self._tree: Any = None
        if len(points_world_m):
            from scipy.spatial import cKDTree

            self._tree = cKDTree(points_world_m, balanced_tree=False, compact_nodes=False)

    def near(self, candidates_world_m: Floats, radius_m: float) -> Bool:
        """Return which candidates (N, 3) lie within a radius of the points, (N,)."""
        near = np.zeros(len(candidates_world_m), dtype=np.bool_)
        if self._tree is None or len(candidates_world_m) == 0:
            return near
        lower, upper = self._box(radius_m)
        inside = np.flatnonzero(_inside(candidates_world_m, lower, upper))
        if len(inside) == 0:
            return near
        distance_m, _ = self._tree.query(candidates_world_m[inside], distance_upper_bound=radius_m)
        near[inside] = np.isfinite(distance_m)
        return near

    def perhaps_near(self, candidates_world_m: F32, radius_m: float) -> Bool:
        """Return which candidates (N, 3) may lie within a radius, (N,): all that do, and some slightly farther away.

        A look-up in a grid of cells takes a tenth of a query of the tree.
        """
        if self._tree is None:
            return np.zeros(len(candidates_world_m), dtype=np.bool_)
        lower, upper = self._box(radius_m)
        edge_m = max(radius_m, float(np.prod(upper - lower) / MOST_CELLS) ** (1 / 3))
        marked = np.zeros(tuple(((upper - lower) / edge_m).astype(np.int64) + 1), dtype=np.uint8)
        mark_cells(self._points_m, lower, edge_m, marked)
        near: Bool = in_marked_cells(candidates_world_m, lower, edge_m, marked)
        return near

    def _box(self, margin_m: float) -> tuple[F64, F64]:
        return self._points_m.min(axis=0) - margin_m, self._points_m.max(axis=0) + margin_m


def _inside(points_m: Floats, lower_m: F64, upper_m: F64) -> Bool:
    """Return which points (N, 3) lie in a box, axis by axis: numpy is slow along short ones."""
    inside = np.ones(len(points_m), dtype=np.bool_)
    for axis in range(3):
        inside &= (points_m[:, axis] >= lower_m[axis]) & (points_m[:, axis] <= upper_m[axis])
    return inside


@njit(nogil=True, cache=True)
def mark_cells(points_m: F64, lower_m: F64, edge_m: float, marked: U8) -> None:
    """Set the cells (A, B, C) that points (M, 3) lie in, and those around them; all points lie in the grid."""
    for n in range(len(points_m)):
        i = int((points_m[n, 0] - lower_m[0]) / edge_m)
        j = int((points_m[n, 1] - lower_m[1]) / edge_m)
        k = int((points_m[n, 2] - lower_m[2]) / edge_m)
        for a in range(max(0, i - 1), min(marked.shape[0], i + 2)):
            for b in range(max(0, j - 1), min(marked.shape[1], j + 2)):
                for c in range(max(0, k - 1), min(marked.shape[2], k + 2)):
                    marked[a, b, c] = 1


@njit(nogil=True, cache=True)
def in_marked_cells(points_m: F32, lower_m: F64, edge_m: float, marked: U8) -> Bool:
    """Return which points (N, 3) lie in marked cells (A, B, C), (N,); outside the grid nothing is marked."""
    found = np.zeros(len(points_m), dtype=np.bool_)
    for n in range(len(points_m)):
        x = (points_m[n, 0] - lower_m[0]) / edge_m
        y = (points_m[n, 1] - lower_m[1]) / edge_m
        z = (points_m[n, 2] - lower_m[2]) / edge_m
        if 0.0 <= x < marked.shape[0] and 0.0 <= y < marked.shape[1] and 0.0 <= z < marked.shape[2]:
            found[n] = marked[int(x), int(y), int(z)] == 1
    return found


# Earlier depth images, subsampled: was a place free space before something appeared there?


@dataclass(frozen=True)
class Witness:
    """A subsampled depth image (h, w), with its pose relative to a keyframe.

    Attributes:
        keyframe: The keyframe.
        T_keyframe_cam: Pose in it (4, 4).
        depth: Depths in units, the lowest bit set where a pixel is dynamic.
    """

    keyframe: int
    T_keyframe_cam: F64
    depth: U16 = field(repr=False)


def small_depth(depth_m: F32, is_moving: Bool | None, stride: int) -> U16:
    """Return depths (H, W) [m] subsampled by the stride, in units; the lowest bit marks dynamic pixels (H, W)."""
    depth: U16 = in_units(depth_m, stride) & np.uint16(0xFFFE)
    if is_moving is not None:
        depth |= is_moving[::stride, ::stride] & (depth > 0)
    return depth


def views_of(depth: U16) -> U16:
    """Return depth, nearest and farthest of the neighbourhood (h, w, 3); see `evidence_kernels.look`."""
    square = element(1, Shape.SQUARE)
    # What is unknown, 0, becomes the farthest: 0 − 1 wraps around.
    nearest = cv2.erode(depth - np.uint16(1), square) + np.uint16(1)
    return np.asarray(cv2.merge((depth, nearest, cv2.dilate(depth, square))), dtype=np.uint16)


class Witnesses:
    """The subsampled images in order of time; when there are too many, every second of the older half is dropped."""

    def __init__(self, camera: Camera, most: int) -> None:
        """Start without any; keep at most `most`."""
        self.most = most
        self._size_px = camera.width, camera.height
        self._lens = camera.lens
        self._all: list[Witness] = []
        self._T_cam_world = np.zeros((most + 1, 4, 4))

    def __len__(self) -> int:
        """How many there are."""
        return len(self._all)

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return len(self._all) * self._all[0].depth.nbytes if self._all else 0

    def remember(self, keyframe: int, T_keyframe_cam: F64, T_world_cam: F64, depth: U16) -> None:
        """Keep a small depth image (h, w) as `small_depth` gives it."""
        self._T_cam_world[len(self._all)] = se3.inverse(T_world_cam)
        self._all.append(Witness(keyframe, T_keyframe_cam, depth))
        if len(self._all) > self.most:
            half = len(self._all) // 2
            kept = [*range(0, half, 2), *range(half, len(self._all))]
            self._all = [self._all[i] for i in kept]
            self._T_cam_world[: len(kept)] = self._T_cam_world[kept]

    def refresh(self, world: Map) -> None:
        """Update all poses from the keyframes; `choose` does so only for those that it returns."""
        for i, witness in enumerate(self._all):
            self._T_cam_world[i] = se3.inverse(world.keyframe_pose(witness.keyframe) @ witness.T_keyframe_cam)

    def choose(self, points_m: F32, far_m: float, n: int, world: Map) -> list[tuple[F64, U16]]:
        """Return pose and depth of at most `n` that have points in view, spread over time, placed by the map.

        Args:
            points_m: The points (M, 3) [m, world].
            far_m: How far witnesses see.
            n: Number of images.
            world: The map that holds their keyframes.
        """
        if not self._all or len(points_m) == 0:
            return []
        sample = np.ascontiguousarray(points_m[:: max(1, len(points_m) // SAMPLES)])
        counts = count_in_view(sample, self._T_cam_world[: len(self._all)], self._lens, *self._size_px, far_m)
        able = np.flatnonzero(counts >= max(1.0, LEAST_SHARE * len(sample)))
        if len(able) > n:
            able = able[np.rint(np.linspace(0, len(able) - 1, n)).astype(np.int64)]
        for i in able:
            pose = world.keyframe_pose(self._all[i].keyframe) @ self._all[i].T_keyframe_cam
            self._T_cam_world[i] = se3.inverse(pose)
        return [(self._T_cam_world[i].copy(), self._all[i].depth) for i in able]


@dataclass(frozen=True)
class CarvingConfig:
    """Carving: what is removed from the map.

    By the rule "evidence" each voxel has a score. A depth image in which it is a surface raises the score by `hit`, one
    whose rays pass through it lowers it by 1, between `lowest` and `highest`. Voxels with a score above 0 are shown,
    and one that is passed at `lowest` is emptied. A voxel that gets its first pixels starts with the score that earlier
    images give it: what appears in free space must be hit several times before it is shown.

    By the rule "kd-tree", OC-SLAM's (2.6), keyframes are fused whole, and then the map points near what moves in them
    are removed, found by Kd-tree; there are no scores, and no ray carves.

    Attributes:
        removal: Whether anything is removed; if not, dynamic pixels are fused like all others.
        rule: evidence or kd-tree; see above.
        radius_m: Voxels nearer than this to dynamic points are emptied, unless the same image shows them as static.
        tolerance_m, tolerance_share: A ray passes a voxel when it ends behind it by more than the larger of the first
            and this share of the depth, with all rays around it.
        hit, lowest, highest: See above.
        n_asked: Earlier images that new voxels are compared with.
        every: Stride in frames. Keyframes count; where no other frames are offered, all keyframes are used.
    """

    removal: bool = True
    rule: str = bounded(EVIDENCE, one_of=(EVIDENCE, KD_TREE))
    radius_m: float = bounded(0.05, least=0)
    tolerance_m: float = bounded(0.05, least=0)
    tolerance_share: float = bounded(0.035, least=0)
    hit: int = bounded(2, least=1)
    lowest: int = bounded(-6, most=0)
    highest: int = bounded(6, least=1)
    n_asked: int = bounded(8, least=1)
    every: int = bounded(8, least=1)

    @property
    def scores(self) -> bool:
        """Whether voxels have scores."""
        return self.removal and self.rule == EVIDENCE

    @property
    def by_tree(self) -> bool:
        """Whether what moves is removed after it was fused, by Kd-tree alone."""
        return self.removal and self.rule == KD_TREE


class Carver:
    """Updates the scores of a map's voxels from depth images."""

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
        # The stride keeps dynamic points no further apart than the radius, up to a typical depth.
        self._thinning = max(1, int(config.radius_m * camera.fx / TYPICAL_DEPTH_M / self._stride))
        self._since_judged = self._since_frame_judged = config.every

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return self._witnesses.n_bytes

    def refresh(self) -> None:
        """Update the poses of earlier images from their keyframes."""
        self._witnesses.refresh(self.world)

    def in_view(self, block_keys: I64, T_world_cam: F64) -> Bool:
        """Return whether a camera at a pose (4, 4) may see into blocks (B,)."""
        centres_m = block_centres_m(block_keys, self.voxels.voxel_m)
        T_cam_world = se3.inverse(T_world_cam)
        return in_frustum(centres_m, self.voxels.block_radius_m, T_cam_world, self._lens, self._size_px, self._far_m)

    def judge_keyframe(self, keyframe: int, image: Image, excluded: Bool | None, T_world_cam: F64, now: int) -> None:
        """Remove from the map what is dynamic in a keyframe, and carve with it if it is due.

        Args:
            keyframe: Its id.
            image: Its image.
            excluded: Dynamic pixels (H, W).
            T_world_cam: Its pose (4, 4).
            now: Time that voided voxels are marked with.
        """
        self._since_judged += 1
        self._since_frame_judged += 1
        depth = small_depth(image.depth_m, excluded, self._stride)
        # Frames between keyframes carve as well: where they are offered, a keyframe seldom needs to.
        if self._since_frame_judged > 2 * self.config.every:
            self._judge(depth, T_world_cam, now)
        if excluded is not None:
            self._remove_moving(depth, T_world_cam, now)
        self._witnesses.remember(keyframe, np.eye(4), T_world_cam, depth)

    def judge_frame(
        self, keyframe: int, T_keyframe_cam: F64, image: Image, excluded: Bool | None, T_world_cam: F64, now: int
    ) -> bool:
        """Carve with a frame if it is due; return whether it was.

        Args:
            keyframe: The keyframe that its pose is relative to …
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
            view = SmallDepthView(T_cam_world, self._lens, views_of(depth))
            judge_rows(rows, positions_m, voxels.rows, view, self._seeing, self._scoring, heard)
        voxels.score[rows[~heard]] = 1  # no earlier image contradicts these

    def remove_near_moving(self, image: Image, excluded: Bool, T_world_cam: F64, now: int) -> None:
        """Empty all voxels near the dynamic pixels (H, W) of a keyframe that was fused whole; other arguments as above.

        OC-SLAM 2.6.
        """
        self._remove_moving(small_depth(image.depth_m, excluded, self._stride), T_world_cam, now, spares=False)

    def _judge(self, depth: U16, T_world_cam: F64, now: int) -> None:
        """Update the scores of what is in view from a subsampled depth image (h, w)."""
        voxels, T_cam_world = self.voxels, se3.inverse(T_world_cam)
        near = voxels.blocks_near(T_cam_world, self._lens, self._size_px, self._far_m)
        view = SmallDepthView(T_cam_world, self._lens, views_of(depth))
        judged = VoxelColumns(voxels.key, voxels.rows, voxels.voxel_m)
        judge_in_view(near, judged, now, view, self._seeing, self._scoring)
        self._since_judged = 0

    def _remove_moving(self, depth: U16, T_world_cam: F64, now: int, spares: bool = True) -> None:
        """Empty voxels near dynamic pixels (h, w); it spares those that the image shows as static or as passed."""
        voxels, config = self.voxels, self.config
        moving = MovingPoints(self._moving_points(depth, T_world_cam))
        close = moving.near(voxels.block_centres_m, config.radius_m + voxels.block_radius_m)
        if not close.any():
            return
        rows = rows_in(close, voxels.rows)
        positions_m = mean_positions(rows, voxels.key, voxels.rows, voxels.voxel_m)
        perhaps = moving.perhaps_near(positions_m, config.radius_m)
        rows, positions_m = rows[perhaps], positions_m[perhaps]
        if spares:
            view = SmallDepthView(se3.inverse(T_world_cam), self._lens, views_of(depth))
            open_to_it = answers(positions_m, view, self._seeing) == NOTHING
            rows, positions_m = rows[open_to_it], positions_m[open_to_it]
        voxels.void(rows[moving.near(positions_m, config.radius_m)], now, config.lowest)

    def _moving_points(self, depth: U16, T_world_cam: F64) -> F64:
        """Return the dynamic points (M, 3) [m, world]."""
        step = self._thinning
        coarse = depth[::step, ::step]
        depth_m = np.multiply(coarse, UNIT_M, dtype=np.float32)
        row, column = np.nonzero((coarse % 2 == 1) & (depth_m <= self._far_m))
        raw_px = np.stack((column, row), axis=1).astype(np.float32) * np.float32(step * self._stride)
        points_cam_m = self.camera.back_project(self.camera.undistort(raw_px), depth_m[row, column])
        return se3.transform(T_world_cam, points_cam_m)
