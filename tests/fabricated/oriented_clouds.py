"""Dense clouds of surfaces that are known exactly."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stillroom.data.dense_cloud import DenseCloud
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64

GRAY = (128, 128, 128)


@dataclass
class Surfaces:
    """Samples of surfaces; `cloud` gathers them in voxels, as the dense map does."""

    seed: int = 0
    density_per_m2: float = 40_000.0
    points: list[F64] = field(default_factory=list)
    normals: list[F64] = field(default_factory=list)
    rgb: list[NDArray[np.float64]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)

    def add(self, points: F64, normals: F64, rgb: tuple[int, int, int] = GRAY) -> "Surfaces":
        self.points.append(points)
        self.normals.append(normals)
        self.rgb.append(np.tile(np.array(rgb, dtype=np.float64), (len(points), 1)))
        return self

    def without(self, low: tuple[float, ...], high: tuple[float, ...]) -> "Surfaces":
        """What there is so far, but for what lies inside a box."""
        for place, points in enumerate(self.points):
            outside = ~((points > low) & (points < high)).all(axis=1)
            for column in (self.points, self.normals, self.rgb):
                column[place] = column[place][outside]
        return self

    def rectangle(
        self, corner: tuple[float, ...], a: tuple[float, ...], b: tuple[float, ...], rgb: tuple[int, int, int] = GRAY
    ) -> "Surfaces":
        """A rectangle from a corner along two edges; its normal is a × b."""
        edges = np.array([a, b], dtype=np.float64)
        normal = np.cross(*edges)
        area_m2 = float(np.linalg.norm(normal))
        where = self.random.uniform(0, 1, (int(area_m2 * self.density_per_m2), 2)) @ edges + corner
        return self.add(where, np.tile(normal / area_m2, (len(where), 1)), rgb)

    def box(self, low: tuple[float, ...], high: tuple[float, ...], rgb: tuple[int, int, int] = GRAY) -> "Surfaces":
        """A closed box, normals outwards."""
        size = np.subtract(high, low)
        for axis in range(3):
            a, b = np.zeros((2, 3))
            a[(axis + 1) % 3], b[(axis + 2) % 3] = size[(axis + 1) % 3], size[(axis + 2) % 3]
            top = np.array(low, dtype=np.float64)
            top[axis] = high[axis]
            self.rectangle(tuple(top), tuple(a), tuple(b), rgb)
            self.rectangle(low, tuple(b), tuple(a), rgb)
        return self

    def sphere(self, center: tuple[float, ...], radius_m: float, rgb: tuple[int, int, int] = GRAY) -> "Surfaces":
        """A sphere, normals outwards."""
        normals = self.random.normal(size=(int(4 * np.pi * radius_m**2 * self.density_per_m2), 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return self.add(normals * radius_m + center, normals, rgb)

    def cloud(self, voxel_m: float, T_world_here: F64 | None = None, noise_m: float = 0.0) -> DenseCloud:
        """Mean position, normal and colour of the samples in each voxel."""
        T = np.eye(4) if T_world_here is None else T_world_here
        points = se3.transform(T, np.concatenate(self.points)) + 0.0
        points += self.random.normal(0, noise_m, points.shape) if noise_m else 0.0
        normals, rgb = np.concatenate(self.normals) @ T[:3, :3].T, np.concatenate(self.rgb)
        keys = np.floor(points / voxel_m).astype(np.int64) + 2**20
        order = np.argsort(keys[:, 0] << 42 | keys[:, 1] << 21 | keys[:, 2], kind="stable")
        starts = np.flatnonzero(np.r_[True, (np.diff(keys[order], axis=0) != 0).any(axis=1)])
        count = np.diff(np.r_[starts, len(order)])

        def mean(values: F64) -> F64:
            return np.add.reduceat(values[order], starts, axis=0) / count[:, None]

        normal = mean(normals)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        return DenseCloud(
            mean(points).astype(np.float32),
            normal.astype(np.float32),
            np.rint(mean(rgb)).astype(np.uint8),
            count.astype(np.float32),
            voxel_m,
        )


def random_cloud(n_points: int, seed: int = 0, voxel_m: float = 0.02) -> DenseCloud:
    """Points anywhere, of any colour."""
    random = np.random.default_rng(seed)
    normals = random.normal(size=(n_points, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return DenseCloud(
        random.uniform(-3, 3, (n_points, 3)).astype(np.float32),
        normals.astype(np.float32),
        random.integers(0, 256, (n_points, 3), dtype=np.uint8),
        random.uniform(1, 50, n_points).astype(np.float32),
        voxel_m,
    )
