"""The kernels that colour what is seen: mipmapped textures, bilinear, scaled by light."""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32, I64, U8
from stillroom_scenes.raster import NOTHING

SEGMENT_PX = 32  # one mipmap level for so many neighbours in a row
GROUP_PX = 8  # what a register holds
U32: TypeAlias = NDArray[np.uint32]


@njit(nogil=True, cache=True, error_model="numpy")
def shade(planes: F64, kind: I32, patch: I32, texels: U32, levels: I64, rgba: U32, instance: U8) -> None:
    """Colour each pixel with the texture and the light of its patch.

    Args:
        planes: Of `raster.planes_of` (N, 12).
        kind: Of the patches (N, 3).
        patch: The patch at each pixel (H, W); pixels without one become black.
        texels: Of the atlas.
        levels: Of the atlas (T, L, 3).
        rgba: Out: colours 0x00BBGGRR (H, W) uint32.
        instance: Out: instance of each pixel (H, W) uint8.
    """
    height, width = patch.shape
    level_of = np.full(len(planes), -1, np.int32)  # triangles are small: each has one mipmap level
    instance_of = np.zeros(len(planes) + 1, np.uint8)  # the last, which NOTHING finds too, is 0
    instance_of[:-1] = kind[:, 2]
    # Of each pixel of a row: its upper left texel, the one below, and packed weights (across, down, light).
    # Whole groups of pixels are computed, so a row may end with some too many.
    room = width + GROUP_PX
    texel_at, below, weights = np.zeros(room, np.uint32), np.zeros(room, np.uint32), np.zeros(room, np.uint32)
    corners = np.empty((4, width), np.uint32)
    for y in range(height):
        x = 0
        while x < width:
            i = patch[y, x]
            end = x + 1
            while end < width and end - x < SEGMENT_PX and patch[y, end] == i:
                end += 1
            if i == NOTHING:
                for k in range(x, end):
                    texel_at[k], below[k], weights[k] = 0, 0, 0
            else:
                level = level_of[i]
                if level < 0:
                    level = _level_of(planes, i, levels, kind[i, 1], 0.5 * (x + end - 1), y)
                    level_of[i] = level if kind[i, 0] == 1 else -1
                _aim(planes, i, levels, kind[i, 1], level, y, x, end, texel_at, below, weights)
            x = end
        for x in range(width):
            instance[y, x] = instance_of[patch[y, x]]
        _mix(texels, texel_at, below, weights, corners, rgba, y)


@njit(nogil=True, cache=True, error_model="numpy")
def _level_of(planes: F64, i: int, levels: I64, texture: int, x: float, y: float) -> int:
    """Choose the mipmap whose texels come closest to a pixel's size at (x, y)."""
    width, height = levels[texture, 0, 1], levels[texture, 0, 2]
    z = 1.0 / (planes[i, 0] * x + planes[i, 1] * y + planes[i, 2])
    u = (planes[i, 3] * x + planes[i, 4] * y + planes[i, 5]) * z
    v = (planes[i, 6] * x + planes[i, 7] * y + planes[i, 8]) * z
    ux, uy = (planes[i, 3] - u * planes[i, 0]) * width, (planes[i, 4] - u * planes[i, 1]) * width
    vx, vy = (planes[i, 6] - v * planes[i, 0]) * height, (planes[i, 7] - v * planes[i, 1]) * height
    texels_per_pixel = 0.5 * z * (math.sqrt(ux * ux + vx * vx) + math.sqrt(uy * uy + vy * vy))
    level, step = 0, 1.4142
    while texels_per_pixel > step and level < levels.shape[1] - 1:
        level, step = level + 1, step * 2.0
    return level


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _aim(
    planes: F64,
    i: int,
    levels: I64,
    texture: int,
    level: int,
    y: int,
    start: int,
    end: int,
    texel_at: U32,
    below: U32,
    weights: U32,
) -> None:
    """Find texels and weights of the pixels start … end − 1 of row y, and of some after them to fill a group.

    The functions are taken at `start` in double precision and continued in single, of which a register holds eight;
    unsigned indices spare the test for negative ones.
    """
    offset, width = np.int32(levels[texture, level, 0]), np.int32(levels[texture, level, 1])
    height = levels[texture, level, 2]
    f = np.float32
    wide, high, last_u = f(width), f(height), f(width - 1.001)
    last_v, half, none, full = f(height - 1.001), f(0.5), f(0.0), f(256.0)
    iz, iz_x = f(planes[i, 0] * start + planes[i, 1] * y + planes[i, 2]), f(planes[i, 0])
    uz, uz_x = f(planes[i, 3] * start + planes[i, 4] * y + planes[i, 5]), f(planes[i, 3])
    vz, vz_x = f(planes[i, 6] * start + planes[i, 7] * y + planes[i, 8]), f(planes[i, 6])
    lz, lz_x = f(planes[i, 9] * start + planes[i, 10] * y + planes[i, 11]), f(planes[i, 9])
    begin = np.uint64(start)
    for k in range(np.int32((end - start + GROUP_PX - 1) // GROUP_PX * GROUP_PX)):
        step = f(k)
        z = f(1.0) / (iz + step * iz_x)
        u = (uz + step * uz_x) * z * wide - half
        v = (vz + step * vz_x) * z * high - half
        light = (lz + step * lz_x) * z * full
        u = u if u > none else none
        u = u if u < last_u else last_u
        v = v if v > none else none
        v = v if v < last_v else last_v
        light = light if light > none else none
        light = light if light < full else full
        column, row = np.int32(u), np.int32(v)
        at = offset + row * width + column
        x = begin + np.uint64(k)
        texel_at[x] = np.uint32(at)
        below[x] = np.uint32(at + width)
        across, down = np.int32((u - f(column)) * full), np.int32((v - f(row)) * full)
        weights[x] = np.uint32(across | down << np.int32(8) | np.int32(light) << np.int32(16))


@njit(nogil=True, cache=True, error_model="numpy")
def _mix(texels: U32, texel_at: U32, below: U32, weights: U32, corners: U32, rgba: U32, y: int) -> None:
    """Interpolate between four texels and scale by light; red and blue go together, green alone.

    The casts keep numba from widening to 64 bits, the two loops keep the second free of scattered reads.
    """
    u = np.uint32
    one, eight, sixteen, byte, full = u(1), u(8), u(16), u(0xFF), u(256)
    red_blue, green, row, count = u(0xFF00FF), u(0xFF00), np.uint64(y), np.int32(corners.shape[1])
    for k in range(count):
        x = np.uint64(k)
        corners[0, x], corners[1, x] = texels[texel_at[x]], texels[u(texel_at[x] + one)]
        corners[2, x], corners[3, x] = texels[below[x]], texels[u(below[x] + one)]
    for k in range(count):
        x = np.uint64(k)
        a, b, c, d, weight = corners[0, x], corners[1, x], corners[2, x], corners[3, x], weights[x]
        across, down, light = u(weight & byte), u(u(weight >> eight) & byte), u(weight >> sixteen)
        back, up = u(full - across), u(full - down)
        top = _blend(u(a & red_blue), u(b & red_blue), back, across, red_blue)
        low = _blend(u(c & red_blue), u(d & red_blue), back, across, red_blue)
        both = _blend(top, low, up, down, red_blue)
        top = _blend(u(u(a >> eight) & byte), u(u(b >> eight) & byte), back, across, byte)
        low = _blend(u(u(c >> eight) & byte), u(u(d >> eight) & byte), back, across, byte)
        alone = _blend(top, low, up, down, byte)
        rgba[row, x] = u(u(u(u(both * light) >> eight) & red_blue) | u(u(alone * light) & green))


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _blend(p: np.uint32, q: np.uint32, p_share: np.uint32, q_share: np.uint32, mask: np.uint32) -> np.uint32:
    return np.uint32(np.uint32(np.uint32(np.uint32(p * p_share) + np.uint32(q * q_share)) >> np.uint32(8)) & mask)
