"""The hashed voxel map: rows of sums, found by key."""

from dataclasses import dataclass

import numpy as np

from stillroom.dense.keyframe_cloud import I8, UNIT_M, KeyframeCloud
from stillroom.dense.voxels.fusing_kernels import (
    BLOCK,
    N_COLUMNS,
    SCORE,
    VOIDED_AT,
    WEIGHT,
    HashTable,
    Pixels,
    add_pixels,
    locate,
    pixel_weights,
    subtract_pixels,
    turn_normals,
)
from stillroom.dense.voxels.hash_kernels import EMPTY, enter_rows, find_rows, unpack
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, Bool, Ints
from stillroom.geometry.camera import Lens

BLOCK_BITS = 4
"""A block is a cube of 16 voxels each way: the unit of culling and swapping."""

MAX_LOAD = 0.6
FIRST_ROWS, FIRST_SLOTS = 1 << 14, 1 << 16
GROWTH = 1.25
NEVER = -1


@dataclass(frozen=True)
class Placed:
    """A keyframe's pixels (h, w), to be added to or subtracted from the map: keys, positions, normals."""

    cloud: KeyframeCloud
    keys: I64
    fine: U8
    normals: I8
    weights: I32

    @property
    def pixels(self) -> Pixels:
        """The pixels as kernels take them."""
        return Pixels(self.keys, self.fine, self.cloud.rgb, self.normals, self.weights, self.cloud.usable)


class VoxelMap:
    """Voxels as rows of a growing array; a row is never removed but by `keep_rows`.

    Attributes:
        voxel_m: Edge of a voxel [m].
        n_rows: Rows in use.
    """

    def __init__(self, voxel_m: float) -> None:
        """Start empty."""
        self.voxel_m = voxel_m
        self.n_rows = 0
        self._key = np.zeros(FIRST_ROWS, dtype=np.int64)
        self._rows = _fresh_rows(FIRST_ROWS)
        self._slot_key = np.full(FIRST_SLOTS, EMPTY, dtype=np.int64)
        self._slot_row = np.zeros(FIRST_SLOTS, dtype=np.int32)
        self._block_numbers: dict[int, int] = {}
        self._block_centres_m = np.zeros((0, 3))

    @property
    def key(self) -> I64:
        """Packed index of each voxel (N,)."""
        return self._key[: self.n_rows]

    @property
    def rows(self) -> I32:
        """Columns of each voxel (N, 13); see `fusing_kernels`."""
        return self._rows[: self.n_rows]

    @property
    def weight(self) -> I32:
        """Sum of weights (N,); 0 for a voxel that is empty now."""
        return self.rows[:, WEIGHT]

    @property
    def score(self) -> I32:
        """Balance of hits and passes (N,)."""
        return self.rows[:, SCORE]

    @property
    def block(self) -> I32:
        """Number of the block that each voxel lies in (N,)."""
        return self.rows[:, BLOCK]

    @property
    def block_keys(self) -> I64:
        """Keys (B,) of the blocks, by number."""
        return np.fromiter(self._block_numbers, dtype=np.int64, count=len(self._block_numbers))

    @property
    def slots(self) -> tuple[I64, I32]:
        """The hash table: the keys and the rows of its slots."""
        return self._slot_key, self._slot_row

    @property
    def n_bytes(self) -> int:
        """Memory that is held."""
        return sum(array.nbytes for array in (self._key, self._rows, self._slot_key, self._slot_row))

    def rows_of(self, keys: I64) -> I32:
        """Return the rows (N,) of voxels with keys (N,), −1 for those that there are none of."""
        rows: I32 = find_rows(keys, self._slot_key, self._slot_row)
        return rows

    def place(self, cloud: KeyframeCloud, rays: F32, normals: I8, T_world_cam: F64) -> Placed:
        """Compute the voxels of a cloud's pixels at a pose (4, 4).

        Args:
            cloud: The pixels (h, w).
            rays: x/z and y/z of each (h, w, 2).
            normals: Of each in the camera's frame (h, w, 3).
            T_world_cam: The pose.
        """
        unit_m = float(UNIT_M)
        keys, fine = locate(cloud.depth, cloud.usable, rays, unit_m, T_world_cam, self.voxel_m)
        turned = turn_normals(normals, cloud.usable, np.ascontiguousarray(T_world_cam[:3, :3]))
        return Placed(cloud, keys, fine, turned, pixel_weights(cloud.depth, unit_m))

    def add(self, placed: Placed) -> I32:
        """Add pixels; return the rows (M,) that had no weight before."""
        n_usable = int(np.count_nonzero(placed.cloud.usable))
        self._reserve(self.n_rows + n_usable)
        newborn = np.empty(n_usable, dtype=np.int32)
        before = self.n_rows
        self.n_rows, n_newborn = add_pixels(
            placed.pixels, HashTable(self._slot_key, self._slot_row), self._key, self._rows, before, newborn
        )
        self._number_blocks(before)
        return newborn[:n_newborn].copy()

    def subtract(self, placed: Placed, added_at: int) -> None:
        """Subtract pixels that were added at the time `added_at`; those voided since are cleared in `usable`."""
        subtract_pixels(placed.pixels, HashTable(self._slot_key, self._slot_row), self._rows, added_at)

    def void(self, rows: Ints, now: int, score: int) -> None:
        """Empty voxels (M,) permanently: what was added before `now` is never restored."""
        self.rows[rows, :SCORE] = 0
        self.rows[rows, SCORE] = score
        self.rows[rows, VOIDED_AT] = now

    def blocks_near(self, T_cam_world: F64, lens: Lens, size_px: tuple[int, int], far_m: float) -> Bool:
        """Return for each block (B,) whether a camera may see into it, nearer than `far_m`."""
        return in_frustum(self._block_centres_m, self.block_radius_m, T_cam_world, lens, size_px, far_m)

    @property
    def block_centres_m(self) -> F64:
        """Centres (B, 3) of the blocks [m, world]."""
        return self._block_centres_m

    @property
    def block_radius_m(self) -> float:
        """Half the diagonal of a block [m]."""
        return float(np.sqrt(3.0) / 2.0 * self.voxel_m * (1 << BLOCK_BITS))

    def append_rows(self, key: I64, rows: I32) -> None:
        """Add whole rows (M, 13) with keys (M,), none of which is there yet."""
        before = self.n_rows
        self._reserve(before + len(key))
        self.n_rows += len(key)
        self.key[before:] = key
        self.rows[before:] = rows
        self._number_blocks(before)
        enter_rows(self.key, before, self._slot_key, self._slot_row)

    def keep_rows(self, kept: Bool) -> None:
        """Remove all rows but those to keep (N,), and give back the memory."""
        key, rows = self.key[kept], self.rows[kept]
        self.n_rows = 0
        capacity = max(FIRST_ROWS, int(GROWTH * len(key)))
        self._key, self._rows = np.zeros(capacity, dtype=np.int64), _fresh_rows(capacity)
        self._slot_key = np.full(_slots_for(capacity), EMPTY, dtype=np.int64)
        self._block_numbers, self._block_centres_m = {}, np.zeros((0, 3))
        self.append_rows(key, rows)

    def _reserve(self, n_rows: int) -> None:
        capacity = len(self._key)
        if n_rows > capacity:
            self._grow(max(n_rows, int(GROWTH * capacity)))
        if n_rows > MAX_LOAD * len(self._slot_key):
            self._rehash(_slots_for(n_rows))

    def _grow(self, capacity: int) -> None:
        """Reserve room for rows, in place if there is no view of them, which saves a copy."""
        before = len(self._rows)
        try:
            self._rows.resize((capacity, N_COLUMNS))
            self._key.resize(capacity)
        except ValueError:
            self._key = np.concatenate((self.key, np.zeros(capacity - self.n_rows, dtype=np.int64)))
            self._rows = np.concatenate((self._rows[:before], np.zeros((capacity - before, N_COLUMNS), dtype=np.int32)))
        self._rows[before:, VOIDED_AT] = NEVER

    def _rehash(self, n_slots: int) -> None:
        self._slot_key = np.full(n_slots, EMPTY, dtype=np.int64)
        self._slot_row = np.zeros(n_slots, dtype=np.int32)
        enter_rows(self.key, 0, self._slot_key, self._slot_row)

    def _number_blocks(self, first_row: int) -> None:
        """Assign blocks, numbered in order of arrival, to the rows from `first_row` on."""
        if first_row == self.n_rows:
            return
        keys, inverse = np.unique(block_keys_of(self.key[first_row:]), return_inverse=True)
        numbers = self._block_numbers
        n_before = len(numbers)
        assigned = [numbers.setdefault(key, len(numbers)) for key in keys.tolist()]
        self.block[first_row:] = np.array(assigned, dtype=np.int32)[inverse.reshape(-1)]
        if len(numbers) > n_before:
            centres_m = block_centres_m(self.block_keys[n_before:], self.voxel_m)
            self._block_centres_m = np.concatenate((self._block_centres_m, centres_m))


def block_keys_of(voxel_keys: I64) -> I64:
    """Return the key of the first voxel of the block that each voxel (N,) lies in."""
    low = (1 << BLOCK_BITS) - 1
    mask = ~np.int64((low << 42) | (low << 21) | low)
    return voxel_keys & mask


def block_centres_m(block_keys: I64, voxel_m: float) -> F64:
    """Return the centres (B, 3) [m, world] of blocks."""
    return np.asarray((unpack(block_keys) + (1 << BLOCK_BITS) / 2.0) * voxel_m, dtype=np.float64)


def in_frustum(
    centres_m: F64, radius_m: float, T_cam_world: F64, lens: Lens, size_px: tuple[int, int], far_m: float
) -> Bool:
    """Return for spheres (B,) whether a camera may see into them.

    Args:
        centres_m: Their centres (B, 3) [world].
        radius_m: Their radius.
        T_cam_world: Pose (4, 4).
        lens: Of the camera.
        size_px: Width and height of its image.
        far_m: How far it sees.
    """
    x, y, z = se3.transform(T_cam_world, centres_m).T
    # The image is widened by a tenth to allow for distortion.
    half_x = 1.1 * max(lens.cx, size_px[0] - lens.cx) / lens.fx
    half_y = 1.1 * max(lens.cy, size_px[1] - lens.cy) / lens.fy
    aside_x = np.abs(x) - half_x * z <= radius_m * np.hypot(1.0, half_x)
    aside_y = np.abs(y) - half_y * z <= radius_m * np.hypot(1.0, half_y)
    seen: Bool = (z > -radius_m) & (z < far_m + radius_m) & aside_x & aside_y
    return seen


def _fresh_rows(n: int) -> I32:
    rows = np.zeros((n, N_COLUMNS), dtype=np.int32)
    rows[:, VOIDED_AT] = NEVER
    return rows


def _slots_for(n_rows: int) -> int:
    return max(FIRST_SLOTS, 1 << int(np.ceil(np.log2(n_rows / MAX_LOAD))))
