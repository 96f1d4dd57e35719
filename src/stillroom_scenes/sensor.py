"""The model of a Kinect-like sensor: noise on perfect colours and depths, from tables of random numbers."""

import numpy as np
from numpy.typing import NDArray

from stillroom.compiled import njit
from stillroom.geometry.arrays import F32, I64, U8, U16

COLOUR_SIGMA = 2.2
PROJECTOR_PX_M = 43.5  # focal length times baseline of the infrared pair: disparity = this / depth
DISPARITY_STEPS = 8.0  # the Kinect matches to an eighth of a pixel
RANGE_M = (0.4, 8.0)
STEEPEST = 0.02  # relative change of depth from pixel to pixel where the pattern is lost (about 84° of grazing)
TABLE_SIZE = 1 << 20


class NoiseTables:
    """Normal numbers drawn once; a frame reads them from places that only its seed and index decide."""

    def __init__(self, seed: int) -> None:
        """Fill the tables."""
        rng = np.random.default_rng([seed, 71])
        self._seed = seed
        self.normal = rng.standard_normal(TABLE_SIZE, dtype=np.float32)
        self.colour = np.rint(COLOUR_SIGMA * rng.standard_normal(TABLE_SIZE)).astype(np.int8)

    def places(self, index: int, height: int, width: int, camera: int = 0) -> I64:
        """Return where each row (3, H) starts to read: for colour, depth and holes; for the first camera or another."""
        rng = np.random.default_rng([self._seed, 73 + camera, index])
        return np.asarray(rng.integers(0, TABLE_SIZE - 3 * width, (3, height)), dtype=np.int64)


@njit(nogil=True, cache=True, error_model="numpy")
def add_colour_noise(rgb: U8, table: NDArray[np.int8], places: I64) -> None:
    """Add noise to colours (H, W, 3) in place."""
    for y in range(rgb.shape[0]):
        row = rgb[y].reshape(-1)
        noise = table[places[y] : places[y] + len(row)]
        for k in range(len(row)):
            value = np.int16(row[k]) + np.int16(noise[k])
            row[k] = min(np.int16(255), max(np.int16(0), value))


def sigma_m(depth_m: float) -> float:
    """Return the deviation of measured depth [m] (Nguyen, Izadi and Lovell 2012, axial noise)."""
    return float(0.0012 + 0.0019 * (depth_m - 0.4) ** 2)


@njit(nogil=True, cache=True, error_model="numpy")
def clean_units(inverse_depth: F32, depth_factor: float, units: U16) -> None:
    """Write exact depths (H, W) in the sensor's units, from 1/z [1/m]; 0 where nothing is."""
    f = np.float32
    for y in range(units.shape[0]):
        for x in range(units.shape[1]):
            inverse = inverse_depth[y, x]
            units[y, x] = np.uint16(f(depth_factor) / inverse + f(0.5)) if inverse > f(0.0) else 0


@njit(nogil=True, cache=True, error_model="numpy")
def measured_units(inverse_depth: F32, table: F32, places: I64, depth_factor: float, units: U16) -> None:
    """Write depths (H, W) as the sensor would give them, in its units; 0 where it would not.

    Noise grows with the square of depth, disparity comes in steps, steep surfaces and edges lose the pattern,
    what the projector does not reach (it stands to the camera's right) has no depth, nor what is too near or too far.

    Args:
        inverse_depth: Exact 1/z (H, W) [1/m]; 0 where nothing is.
        table: Normal numbers.
        places: Where each row reads the table, for depth and for holes (2, H).
        depth_factor: Units per metre.
        units: Out (H, W).
    """
    height, width = inverse_depth.shape
    first, last = np.uint64(1), np.uint64(width - 1)
    for y in range(height):
        row, out = inverse_depth[y], units[y]
        above, below = inverse_depth[max(0, y - 1)], inverse_depth[min(height - 1, y + 1)]
        noise, chance = table[places[0, y] : places[0, y] + width], table[places[1, y] : places[1, y] + width]
        _measure_row(row, above, below, noise, chance, np.float32(depth_factor), first, last, out)
        out[0] = out[width - 1] = 0  # without a neighbour the pattern is not matched
        _shadow(row, out)


@njit(nogil=True, cache=True, error_model="numpy")
def _measure_row(
    row: F32,
    above: F32,
    below: F32,
    noise: F32,
    chance: F32,
    factor: np.float32,
    first: np.uint64,
    last: np.uint64,
    out: U16,
) -> None:
    f, one = np.float32, np.uint64(1)
    steps, half = f(DISPARITY_STEPS * PROJECTOR_PX_M), f(0.5)
    near, far, steepest = f(RANGE_M[0]), f(RANGE_M[1]), f(STEEPEST)
    for k in range(first, last):
        x = np.uint64(k)
        inverse = row[x]
        across = max(abs(row[x - one] - inverse), abs(row[x + one] - inverse))
        change = max(across, max(abs(above[x] - inverse), abs(below[x] - inverse)))
        z = f(1.0) / (inverse + f(1e-9))
        off = z - f(0.4)
        z += (f(0.0012) + f(0.0019) * off * off) * noise[x]
        z = steps / f(np.floor(steps / z + half))
        lost = (change > steepest * inverse) & (chance[x] > f(-0.5)) | (chance[x] > f(3.0))
        lost |= (z < near) | (z > far)
        out[x] = np.uint16(f(0.0) if lost else z * factor + half)


@njit(nogil=True, cache=True, error_model="numpy")
def _shadow(row: F32, out: U16) -> None:
    """Clear what the projector does not see: from right to left, its columns must go down."""
    f = np.float32
    reached = f(1e9)
    for back in range(len(row)):
        x = len(row) - 1 - back
        column = f(x) - f(PROJECTOR_PX_M) * row[x]
        out[x] = np.uint16(0) if column > reached + f(1.0) else out[x]
        reached = min(reached, column)
