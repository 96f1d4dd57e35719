"""Find the floor in a cloud whose vertical is unknown."""

from dataclasses import dataclass

import numpy as np

from stillroom.data.dense_cloud import DenseCloud
from stillroom.errors import MapError
from stillroom.geometry.arrays import F32, F64, I64, Bool
from stillroom.geometry.se3 import from_rotation_translation

CAMERA_UP = np.array([0.0, -1.0, 0.0])
"""The world is the first camera's frame: y points down, as far as the camera was held upright."""

CAMERA_FORWARD = np.array([0.0, 0.0, 1.0])
N_POINTS, N_SAMPLES, N_TRIALS, N_ROUNDS = 100_000, 20_000, 200, 6
"""Points that the search looks at; normals that directions are the means of; directions tried; steps to the mean."""

SAME_DIRECTION_DEG = 8.0
LOWER_M, LOWER_SHARE = 0.15, 0.2
"""A parallel plane so far below the best is the floor if it has this share of its area."""


@dataclass(frozen=True)
class FloorConfig:
    """Which planes count as a floor.

    Attributes:
        max_tilt_deg: How far from the first camera's upward direction the floor's may lie [°]. At 180 any wall will do
            that has most points before it, so this is what tells a floor from a wall.
        min_area_m2: Least area seen of it [m²].
        min_above: Least share of the map's points that lie on or above it.
        tolerance_m: How far its points may lie off the plane [m]; at least one and a half voxels.
        normal_tolerance_deg: How far their normals may lean [°].
        seed: Seed of the random sample of points.
    """

    max_tilt_deg: float = 60.0
    min_area_m2: float = 0.25
    min_above: float = 0.95
    tolerance_m: float = 0.03
    normal_tolerance_deg: float = 25.0
    seed: int = 0


@dataclass(frozen=True)
class Floor:
    """The plane that a robot would drive on.

    Attributes:
        T_map_world: (4, 4): into the frame of the floor plan, z up, its origin on the floor below the first camera, x
            where that camera looked.
        area_m2: How much of it was seen [m²].
        tilt_deg: Angle between its normal and the first camera's upward direction [°].
        above: Share of the map's points on or above it.
    """

    T_map_world: F64
    area_m2: float
    tilt_deg: float
    above: float


def find_floor(cloud: DenseCloud, config: FloorConfig) -> Floor:
    """Find the largest plane that nearly everything else lies above and that the first camera could stand on.

    Directions first: normals of points sampled at random, each moved to the mean of the normals near it. Then, for
    each,
    the heights at which many points share it: peaks of a histogram, refined by least squares. A table top, however
    large, has the floor and the legs below it.

    Raises:
        MapError: There is none.
    """
    random = np.random.default_rng(config.seed)
    area_m2 = len(cloud) * cloud.voxel_m**2
    drawn = slice(None) if len(cloud) <= N_POINTS else np.sort(random.choice(len(cloud), N_POINTS, replace=False))
    sketch = _Search(cloud.positions_m[drawn], cloud.normals[drawn], area_m2, cloud.voxel_m, config)
    candidates = [plane for up in sketch.directions(random) for plane in sketch.planes(up)]
    whole = _Search(cloud.positions_m, cloud.normals, area_m2, cloud.voxel_m, config)
    floor = whole.accepted(_lowest(candidates)) if candidates else None
    if floor is None:
        raise MapError(
            f"no floor found: no plane of at least {config.min_area_m2:g} m² within {config.max_tilt_deg:g}° of the "
            f"first camera's upright lies below {100 * config.min_above:g} % of the map; was it seen? "
            "(occupancy.floor.max_tilt_deg, min_area_m2 and min_above loosen this)"
        )
    tilt_deg = float(np.degrees(np.arccos(np.clip(floor.plane[:3] @ CAMERA_UP, -1, 1))))
    return Floor(frame_on(floor.plane), floor.area_m2, tilt_deg, floor.above)


def frame_on(plane: F64) -> F64:
    """Return `T_map_world` (4, 4) of a plane (4,), n·p + d = 0 with n upwards [m, world]."""
    up, offset_m = plane[:3], float(plane[3])
    forward = next(axis for axis in (CAMERA_FORWARD, CAMERA_UP) if abs(axis @ up) < 0.9)
    x = forward - (forward @ up) * up
    x /= np.linalg.norm(x)
    R_map_world = np.stack((x, np.cross(up, x), up))
    return from_rotation_translation(R_map_world, np.array([0.0, 0.0, offset_m]))


@dataclass(frozen=True)
class _Candidate:
    """A plane (4,) that may be a floor, the middle of its points, its area, and the share of points on or above it."""

    plane: F64
    center_m: F64
    area_m2: float
    above: float

    @property
    def score(self) -> float:
        """The area; less where the first camera would have leaned."""
        return self.area_m2 * max(float(self.plane[:3] @ CAMERA_UP), 0.05)


def _lowest(candidates: list[_Candidate]) -> _Candidate:
    """Return the best, or what lies well below it: where little floor is seen past a table, the table is larger."""
    best = max(candidates, key=lambda candidate: candidate.score)

    def depth_m(other: _Candidate) -> float:
        """Height of the best plane's middle above another."""
        return float(other.plane[:3] @ best.center_m + other.plane[3])

    below = [
        other
        for other in candidates
        if depth_m(other) > LOWER_M
        and other.plane[:3] @ best.plane[:3] > np.cos(np.radians(SAME_DIRECTION_DEG))
        and other.area_m2 >= LOWER_SHARE * best.area_m2
    ]
    return max(below, key=depth_m, default=best)


class _Search:
    """The search for planes among the points."""

    def __init__(self, points: F32, normals: F32, area_m2: float, voxel_m: float, config: FloorConfig) -> None:
        self._points, self._normals, self._config = points.astype(np.float64), normals.astype(np.float64), config
        self._point_area_m2 = area_m2 / max(len(points), 1)
        self._tolerance_m = max(config.tolerance_m, 1.5 * voxel_m)
        self._cos_normal = np.cos(np.radians(config.normal_tolerance_deg))
        self._cos_tilt = np.cos(np.radians(config.max_tilt_deg))

    def directions(self, random: np.random.Generator) -> list[F64]:
        """Return directions (3,) that many normals share, those shared by most first."""
        # Leaning normals may belong to a floor that leans less.
        slack = np.cos(np.radians(min(180.0, self._config.max_tilt_deg + self._config.normal_tolerance_deg)))
        upright = np.flatnonzero(self._normals @ CAMERA_UP >= slack)
        if len(upright) == 0:
            return []
        sample = self._normals[_drawn(upright, N_SAMPLES, random)]
        trial = self._normals[_drawn(upright, N_TRIALS, random)]
        for _ in range(N_ROUNDS):
            shares = (trial @ sample.T >= self._cos_normal).astype(np.float64)
            trial = shares @ sample
            trial /= np.maximum(np.linalg.norm(trial, axis=1, keepdims=True), 1e-12)
        order = np.argsort(-shares.sum(axis=1), kind="stable")
        found: list[F64] = []
        for up in trial[order]:
            if all(up @ other < np.cos(np.radians(SAME_DIRECTION_DEG)) for other in found):
                found.append(up)
        return found

    def planes(self, up: F64) -> list[_Candidate]:
        """Return the planes across a direction that may be floors."""
        level = self._normals @ up >= self._cos_normal
        height_m = self._points[level] @ up
        if len(height_m) * self._point_area_m2 < self._config.min_area_m2:
            return []
        bin_m = self._tolerance_m
        lowest_m = float(height_m.min())
        counts = np.bincount(((height_m - lowest_m) / bin_m).astype(np.int64))
        around = np.convolve(counts, [1, 1, 1], mode="same")
        # A floor that leans against the direction by a degree spreads over several bins: least squares gathers it.
        many = np.flatnonzero(around * self._point_area_m2 >= 0.25 * self._config.min_area_m2)
        peaks = [place for place in many if around[place] == around[max(place - 1, 0) : place + 2].max()]
        found = [self._refined(np.r_[up, -(lowest_m + (place + 0.5) * bin_m)]) for place in peaks]
        judged = [self._judged(plane) for plane in found if plane is not None]
        return [candidate for candidate in judged if candidate is not None]

    def accepted(self, candidate: _Candidate) -> _Candidate | None:
        """Return a candidate from a subsample, refined and evaluated on these points."""
        plane = self._refined(candidate.plane, (1.0, 1.0))
        return None if plane is None else self._judged(plane)

    def _refined(self, plane: F64, rounds: tuple[float, ...] = (4.0, 3.0, 2.0, 1.5, 1.0, 1.0)) -> F64 | None:
        """Return the least-squares plane of the points at a plane, found in rounds; None where there are too few."""
        for reach in rounds:
            on = self._on(plane, reach * self._tolerance_m)
            if np.count_nonzero(on) < 10:
                return None
            points = self._points[on]
            center = points.mean(axis=0)
            normal = np.linalg.eigh(np.cov((points - center).T))[1][:, 0]
            normal *= 1.0 if normal @ plane[:3] >= 0 else -1.0
            plane = np.r_[normal, -(normal @ center)]
        return plane

    def _judged(self, plane: F64) -> _Candidate | None:
        """Return area and share of points above, where the plane may be a floor."""
        on = self._on(plane, self._tolerance_m)
        area_m2 = float(np.count_nonzero(on)) * self._point_area_m2
        above = float(np.mean(self._points @ plane[:3] + plane[3] >= -2.0 * self._tolerance_m))
        upright = float(plane[:3] @ CAMERA_UP) >= self._cos_tilt
        if area_m2 < self._config.min_area_m2 or above < self._config.min_above or not upright:
            return None
        return _Candidate(plane, self._points[on].mean(axis=0), area_m2, above)

    def _on(self, plane: F64, reach_m: float) -> Bool:
        near = np.abs(self._points @ plane[:3] + plane[3]) <= reach_m
        return np.asarray(near & (self._normals @ plane[:3] >= self._cos_normal), dtype=bool)


def _drawn(numbers: I64, n: int, random: np.random.Generator) -> I64:
    return numbers if len(numbers) <= n else random.choice(numbers, n, replace=False)
