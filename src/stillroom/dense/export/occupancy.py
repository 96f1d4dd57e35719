"""A floor plan for robots: `map.pgm` and `map.yaml` as ROS's map_server and nav2 read them.

The picture shows the floor from above, x to the right and y up, a pixel a cell: black is occupied, nearly white free,
205 unknown. With the thresholds in the YAML file a reader in trinary mode gets these three classes.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.replacing import replacing
from stillroom.dense.export.floor import Floor, FloorConfig, find_floor
from stillroom.errors import MapError
from stillroom.geometry.arrays import F64, I64, U8, Bool
from stillroom.geometry.se3 import transform

OCCUPIED, FREE, UNKNOWN = 0, 254, 205
MAX_CELLS = 100_000_000
MARGIN_CELLS = 2


@dataclass(frozen=True)
class OccupancyConfig:
    """How a floor plan is made.

    Attributes:
        resolution_m: Edge of a cell [m]; at least one and a half voxels, or seen floor would be full of holes.
        obstacle_from_m: What lies lower above the floor than this can be driven over, and is floor [m].
        obstacle_to_m: What lies higher can be driven under [m].
        min_points: Points that make a cell occupied.
        floor: How the floor is found.
    """

    resolution_m: float = bounded(0.05, above=0)
    obstacle_from_m: float = bounded(0.10, above=0)
    obstacle_to_m: float = bounded(1.80, above=0)
    min_points: int = bounded(2, least=1)
    floor: FloorConfig = field(default_factory=FloorConfig)

    def contradiction(self) -> tuple[str, str] | None:
        """Return that obstacles do not begin below where they end."""
        fits = self.obstacle_from_m < self.obstacle_to_m
        return None if fits else ("obstacle_to_m", "obstacle_from_m")

    def build(self) -> "FloorPlanner":
        """Return the planner.

        Raises:
            ConfigError: The values contradict each other.
        """
        check(self, "occupancy")
        return FloorPlanner(self)


@dataclass(frozen=True)
class FloorPlan:
    """An occupancy grid.

    Attributes:
        cells: `OCCUPIED`, `FREE` or `UNKNOWN` (H, W) uint8: row 0 has the largest y, column 0 the smallest x.
        resolution_m: Edge of a cell [m].
        origin_m: Lower left corner of the lower left cell, x and y [m, map].
        floor: The floor that was found.
    """

    cells: U8
    resolution_m: float
    origin_m: tuple[float, float]
    floor: Floor

    def write(self, folder: Path, stem: str = "map") -> tuple[Path, Path, Path]:
        """Write picture, description and transform; return where they are.

        Raises:
            StillroomError: One cannot be written.
        """
        picture, description, frame = (folder / f"{stem}{end}" for end in (".pgm", ".yaml", "_frame.json"))
        height, width = self.cells.shape
        with replacing(picture) as file:
            file.write(f"P5\n# Stillroom {self.resolution_m:g} m/cell\n{width} {height}\n255\n".encode("ascii"))
            file.write(np.ascontiguousarray(self.cells).tobytes())
        with replacing(frame) as file:
            file.write((json.dumps(self._figures(), indent=2) + "\n").encode("ascii"))
        with replacing(description) as file:
            file.write(self._yaml(picture.name).encode("ascii"))
        return picture, description, frame

    def _figures(self) -> dict[str, object]:
        return {
            "T_map_world": self.floor.T_map_world.tolist(),
            "floor_area_m2": self.floor.area_m2,
            "floor_tilt_deg": self.floor.tilt_deg,
            "share_above_floor": self.floor.above,
        }

    def _yaml(self, picture: str) -> str:
        rows = "".join(f"#   [{', '.join(f'{value:.9f}' for value in row)}]\n" for row in self.floor.T_map_world)
        return (
            "# The map frame stands on the floor below the first camera: z up, x where that camera looked. Metres.\n"
            f"# p_map = T_map_world * p_world, where world is the frame of the other exported files:\n{rows}"
            f"image: {picture}\n"
            "mode: trinary\n"
            f"resolution: {self.resolution_m:.6f}\n"
            f"origin: [{self.origin_m[0]:.6f}, {self.origin_m[1]:.6f}, 0.0]\n"
            "negate: 0\n"
            "occupied_thresh: 0.65\n"
            "free_thresh: 0.196\n"
        )


class FloorPlanner:
    """Draws floor plans of clouds."""

    def __init__(self, config: OccupancyConfig) -> None:
        self._config = config

    def __call__(self, cloud: DenseCloud) -> FloorPlan:
        """Find the floor and draw what stands on it.

        A cell is occupied where enough points lie at obstacle height, free where floor was seen and they do not, and
        unknown otherwise.

        Raises:
            MapError: There is no floor, or the plan would be too large.
        """
        config = self._config
        floor = find_floor(cloud, config.floor)
        resolution_m = max(config.resolution_m, 1.5 * cloud.voxel_m)
        points_m = transform(floor.T_map_world, cloud.positions_m.astype(np.float64))
        up = cloud.normals @ floor.T_map_world[2, :3]
        is_obstacle = (points_m[:, 2] >= config.obstacle_from_m) & (points_m[:, 2] <= config.obstacle_to_m)
        is_floor = (np.abs(points_m[:, 2]) < config.obstacle_from_m) & (up > np.cos(np.radians(45.0)))
        first, shape = _extent(points_m[is_obstacle | is_floor], resolution_m)
        is_occupied = _counts(points_m[is_obstacle], resolution_m, first, shape) >= config.min_points
        is_seen = _counts(points_m[is_floor], resolution_m, first, shape) > 0
        cells = _cells(is_occupied, is_seen)
        return FloorPlan(cells, resolution_m, (float(first[0] * resolution_m), float(first[1] * resolution_m)), floor)


def _extent(points_m: F64, resolution_m: float) -> tuple[I64, tuple[int, int]]:
    """Return the first cell (x, y) of the plan and its height and width in cells."""
    cell = np.floor(points_m[:, :2] / resolution_m)
    first = cell.min(axis=0).astype(np.int64) - MARGIN_CELLS
    width, height = (int(n) for n in cell.max(axis=0).astype(np.int64) - first + 1 + MARGIN_CELLS)
    if width * height > MAX_CELLS:
        raise MapError(f"the floor plan would have {width} × {height} cells; set a larger occupancy.resolution_m")
    return first, (height, width)


def _counts(points_m: F64, resolution_m: float, first: I64, shape: tuple[int, int]) -> I64:
    """Return how many points lie in each cell (H, W), row 0 with the smallest y."""
    column, row = (np.floor(points_m[:, :2] / resolution_m).astype(np.int64) - first).T
    return np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1]).reshape(shape)


def _cells(is_occupied: Bool, is_seen: Bool) -> U8:
    """Return the picture (H, W), row 0 with the largest y."""
    cells = np.where(is_occupied, OCCUPIED, np.where(is_seen, FREE, UNKNOWN))
    return np.ascontiguousarray(cells[::-1], dtype=np.uint8)
