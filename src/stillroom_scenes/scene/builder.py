"""Collects the still room's patches: faces and boxes, each with its texture and its light."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, U8, Floats
from stillroom_scenes.scene.atlas import AtlasBuilder
from stillroom_scenes.scene.patches import Patches

LAMPS_WORLD_M = np.array([[-1.3, -0.6, 2.65], [1.4, 0.7, 2.65]])
AMBIENT = 0.52

Vector: TypeAlias = Sequence[float] | Floats


@dataclass(frozen=True)
class Footprint:
    """An axis-aligned rectangle of the floor that something stands on, world [m]."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float


@dataclass(frozen=True)
class Skin:
    """The textures of a box: the face towards local −y, the sides and back, top and bottom."""

    front: int
    side: int
    top: int


def light_at(points_m: Floats, normals: Floats) -> F64:
    """Return the share of a surface's colour seen at points (N, 3) with normals (N, 3): Lambert and a soft ambient."""
    total = np.full(len(points_m), AMBIENT)
    for lamp in LAMPS_WORLD_M:
        towards = lamp - points_m
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        facing = np.sum(towards * normals, axis=1)
        total += 0.26 * np.maximum(0.0, 0.15 + 0.85 * facing)
    return np.asarray(np.minimum(total, 1.0))


def placed(x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0) -> F64:
    """Return `T_world_local` (4, 4) of something upright."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return se3.from_rotation_translation(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.array([x_m, y_m, z_m]))


class SceneBuilder:
    """Collects patches, textures and footprints."""

    def __init__(self, atlas: AtlasBuilder) -> None:
        self.atlas = atlas
        self.footprints: list[Footprint] = []
        self._rows: list[tuple[F64, F64, int]] = []

    def texture(self, picture: U8) -> int:
        """Add a texture and return its number."""
        return self.atlas.add(picture)

    def face(
        self,
        T_world_local: F64,
        corner_m: Vector,
        right_m: Vector,
        up_m: Vector,
        texture: int,
        window: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0),
    ) -> None:
        """Add a rectangle by its lower left corner and its edges, as its viewer sees it, in a local frame.

        Args:
            T_world_local: The local frame (4, 4).
            corner_m: Its lower left corner.
            right_m: Its lower edge.
            up_m: Its left edge.
            texture: What it shows.
            window: The part of the texture that it shows: left, top, right, bottom, in [0, 1].
        """
        R = T_world_local[:3, :3]
        corner = R @ np.asarray(corner_m, dtype=np.float64) + T_world_local[:3, 3]
        right, up = R @ np.asarray(right_m, dtype=np.float64), R @ np.asarray(up_m, dtype=np.float64)
        normal = np.cross(right, up)
        normal /= np.linalg.norm(normal)
        light = light_at(np.stack((corner, corner + right, corner + up)), np.tile(normal, (3, 1)))
        left, top, wide, high = window[0], window[1], window[2] - window[0], window[3] - window[1]
        look = np.array([left, top + high, light[0], wide, 0, light[1] - light[0], 0, -high, light[2] - light[0]])
        self._rows.append((np.concatenate((corner, right, up)), look, texture))

    def box(self, T_world_local: F64, low_m: Vector, size_m: Vector, skin: Skin, stands: bool = False) -> None:
        """Add a box by its lowest corner and its size, in a local frame whose viewer stands towards −y."""
        x, y, z = (float(v) for v in low_m)
        w, d, h = (float(v) for v in size_m)
        across, deep, up = np.array([w, 0, 0]), np.array([0, d, 0]), np.array([0, 0, h])
        self.face(T_world_local, (x, y, z), across, up, skin.front)
        self.face(T_world_local, (x + w, y + d, z), -across, up, skin.side)
        self.face(T_world_local, (x + w, y, z), deep, up, skin.side)
        self.face(T_world_local, (x, y + d, z), -deep, up, skin.side)
        self.face(T_world_local, (x, y, z + h), across, deep, skin.top)
        if z > 0.02:
            self.face(T_world_local, (x, y + d, z), across, -deep, skin.side)
        if stands:
            self.occupy(T_world_local, (x, y), (x + w, y + d))

    def occupy(self, T_world_local: F64, low_m: tuple[float, float], high_m: tuple[float, float]) -> None:
        """Mark a rectangle of the floor, given by two corners in a local frame, as taken."""
        corners = se3.transform(T_world_local, np.array([[*low_m, 0.0], [*high_m, 0.0]]))
        low, high = corners.min(axis=0), corners.max(axis=0)
        self.footprints.append(Footprint(low[0], low[1], high[0], high[1]))

    def build(self, instance: int = 0) -> Patches:
        """Return what was added, as one instance."""
        kind = np.array([[0, texture, instance] for _, _, texture in self._rows], dtype=np.int32)
        shape_m = np.stack([shape for shape, _, _ in self._rows])
        return Patches(shape_m, np.stack([look for _, look, _ in self._rows]), kind)
