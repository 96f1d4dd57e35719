"""OctoMap's binary tree (`.bt`): the occupied voxels of a cloud, and the free ones of a map that knows them.

Hornung et al., OctoMap, Autonomous Robots 2013, section 4.2: an inner node is two bytes, two bits for each of its eight
children (occupied or free leaf, inner node, or unknown); nodes come depth first. All leaves are of the lowest level.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.ply import WORLD
from stillroom.data.replacing import replacing
from stillroom.errors import MapError
from stillroom.geometry.arrays import I64, U8, U64, Bool

DEPTH = 16
FREE, OCCUPIED, INNER = 0b01, 0b10, 0b11
"""A child's two bits, the first one the lower."""


def write_octomap(cloud: DenseCloud, path: Path) -> int:
    """Write the voxels that hold points as occupied leaves, and free ones as free; return how many are occupied.

    Raises:
        MapError: There are no points, or the map is too large for the tree's 2^16 voxels along an axis.
        StillroomError: It cannot be written.
    """
    if len(cloud) == 0:
        raise MapError("an octree without a voxel cannot be written: the cloud has no points")
    occupied = np.floor(cloud.positions_m.astype(np.float64) * (1.0 / cloud.voxel_m)).astype(np.int64)
    codes = np.sort(_voxel_codes(occupied, cloud.voxel_m))
    codes = codes[_is_new(codes)]
    free = np.setdiff1d(_voxel_codes(cloud.free.astype(np.int64), cloud.voxel_m), codes)  # a point has priority
    nodes, n_nodes = _tree(codes, free)
    header = [
        "# Octomap OcTree binary file",
        f"# Stillroom; {WORLD}",
        "id OcTree",
        f"size {n_nodes}",
        f"res {float(cloud.voxel_m)!r}",
        "data",
        "",
    ]
    with replacing(path) as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(nodes.tobytes())
    return len(codes)


def _voxel_codes(indices: I64, voxel_m: float) -> U64:
    """Return the Morton codes (N,) of voxels with indices (N, 3): the path from the root, three bits a level."""
    keys = indices + (1 << (DEPTH - 1))
    if len(keys) and (keys.min() < 0 or keys.max() >= 1 << DEPTH):
        raise MapError(
            f"an octree holds {2**DEPTH} voxels along an axis, which at {voxel_m:g} m is less than this map needs"
        )
    codes = np.zeros(len(keys), dtype=np.uint64)
    for axis in range(3):
        codes |= _every_third_bit(keys[:, axis].astype(np.uint64)) << np.uint64(axis)
    return codes


def _every_third_bit(numbers: U64) -> U64:
    """Return 16-bit numbers (N,) with two zeros between their bits."""
    spread = numbers
    for shift, mask in (
        (32, 0xFFFF00000000FFFF),
        (16, 0x00FF0000FF0000FF),
        (8, 0xF00F00F00F00F00F),
        (4, 0x30C30C30C30C30C3),
        (2, 0x9249249249249249),
    ):
        spread = (spread | spread << np.uint64(shift)) & np.uint64(mask)
    return spread


def _is_new(ascending: U64) -> Bool:
    """Return which numbers (N,) differ from the one before."""
    return np.concatenate((np.ones(1, dtype=bool), ascending[1:] != ascending[:-1]))


def _tree(occupied: U64, free: U64) -> tuple[NDArray[np.uint16], int]:
    """Return the bytes of the inner nodes (M,), depth first, and the number of all nodes.

    Args:
        occupied, free: Morton codes of the leaves, (N,) and (F,), each ascending and without repetition; none in both.
    """
    codes = np.concatenate((occupied, free))
    ascending = np.argsort(codes)
    codes, of_leaf = codes[ascending], np.where(ascending < len(occupied), OCCUPIED, FREE).astype(np.uint64)
    starts: list[U64] = []
    bits: list[NDArray[np.uint16]] = []
    levels: list[U8] = []
    below, n_nodes = codes, len(codes)
    for level in reversed(range(DEPTH)):
        prefix = below >> np.uint64(3)
        first = np.flatnonzero(_is_new(prefix))
        value = of_leaf if level == DEPTH - 1 else np.uint64(INNER)
        child = (value << (below & np.uint64(7)) * np.uint64(2)).astype(np.uint16)
        below = prefix[first]
        bits.append(np.bitwise_or.reduceat(child, first))
        starts.append(below << np.uint64(3 * (DEPTH - level)))
        levels.append(np.full(len(below), level, dtype=np.uint8))
        n_nodes += len(below)
    order = np.lexsort((np.concatenate(levels), np.concatenate(starts)))  # An inner node comes before its first child.
    return np.concatenate(bits)[order].astype("<u2"), n_nodes
