"""The rest mesh of a person: lofted rings round torso, head, limbs and shoes, tied to thirteen bones.

The figure stands with hanging arms, feet on z = 0: x to its right, y forward, z up.
"""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F64, I32, Floats
from stillroom_scenes.scene.people import clothes

PELVIS, CHEST, HEAD = 0, 1, 2
UPPER_ARM, FOREARM, THIGH, CALF, FOOT = 3, 5, 7, 9, 11  # the left one; the right one follows
BONES = 13
JOINTS_M = {  # where each bone turns
    PELVIS: (0.0, 0.0, 0.96),
    CHEST: (0.0, 0.0, 1.06),
    HEAD: (0.0, -0.012, 1.5),
    UPPER_ARM: (0.178, -0.012, 1.41),
    FOREARM: (0.222, -0.018, 1.13),
    THIGH: (0.092, 0.0, 0.92),
    CALF: (0.094, 0.006, 0.5),
    FOOT: (0.096, -0.02, 0.09),
}
SOLES_M = np.array([[0.09, 0.16, 0.0], [0.09, -0.075, 0.0]])  # ball and heel, right side; x mirrored for the left

# Parts are tables of rings: z, centre y, half width, half depth [m], bone, next bone, share of the next bone.
Ring = tuple[float, float, float, float, int, int, float]


@dataclass(frozen=True)
class Mesh:
    """Triangles over V vertices.

    Attributes:
        vertices_m, normals: (V, 3), in the figure's frame at rest.
        uv: Texture coordinates (V, 2).
        bones: The two bones each vertex hangs on (V, 2).
        share: The second bone's share (V,), in [0, 1].
        triangles: Corners (F, 3), anticlockwise from outside.
        texture: Number of each triangle's texture (F,).
    """

    vertices_m: F64
    normals: F64
    uv: F64
    bones: I32
    share: F64
    triangles: I32
    texture: I32


@dataclass(frozen=True)
class Wardrobe:
    """Texture numbers of one person."""

    head: int
    skin: int
    shirt: int
    sleeve: int
    trousers: int
    waist: int
    shoe: int
    short_sleeves: bool = False


def _torso(build: float) -> list[Ring]:
    b = build
    return [
        (1.512, -0.012, 0.058, 0.060, CHEST, HEAD, 0.6),
        (1.497, -0.012, 0.074 * b, 0.068, CHEST, HEAD, 0.1),
        (1.478, -0.014, 0.118 * b, 0.080 * b, CHEST, CHEST, 0),
        (1.450, -0.014, 0.165 * b, 0.094 * b, CHEST, CHEST, 0),
        (1.405, -0.008, 0.186 * b, 0.112 * b, CHEST, CHEST, 0),
        (1.340, 0.000, 0.184 * b, 0.124 * b, CHEST, CHEST, 0),
        (1.260, 0.002, 0.172 * b, 0.124 * b, CHEST, CHEST, 0),
        (1.170, 0.000, 0.160 * b, 0.116 * b, CHEST, PELVIS, 0.2),
        (1.080, 0.000, 0.160 * b, 0.116 * b, CHEST, PELVIS, 0.6),
        (1.000, 0.000, 0.172 * b, 0.124 * b, PELVIS, PELVIS, 0),
        (0.935, 0.000, 0.180 * b, 0.130 * b, PELVIS, PELVIS, 0),
        (0.930, 0.000, 0.150 * b, 0.110 * b, PELVIS, PELVIS, 0),
    ]


def _hips(build: float) -> list[Ring]:
    b = build
    return [
        (1.000, 0.000, 0.150 * b, 0.108 * b, PELVIS, PELVIS, 0),
        (0.940, 0.000, 0.168 * b, 0.118 * b, PELVIS, PELVIS, 0),
        (0.880, -0.006, 0.172 * b, 0.120 * b, PELVIS, PELVIS, 0),
        (0.835, -0.008, 0.140 * b, 0.096 * b, PELVIS, PELVIS, 0),
        (0.800, -0.006, 0.060 * b, 0.060 * b, PELVIS, PELVIS, 0),
    ]


def _leg(build: float) -> list[Ring]:
    b = build
    return [
        (0.950, 0.000, 0.060, 0.070, THIGH, PELVIS, 0.8),
        (0.900, 0.000, 0.086 * b, 0.104 * b, THIGH, PELVIS, 0.45),
        (0.830, 0.002, 0.088 * b, 0.102 * b, THIGH, THIGH, 0),
        (0.640, 0.006, 0.073, 0.082, THIGH, THIGH, 0),
        (0.560, 0.006, 0.065, 0.074, THIGH, CALF, 0.15),
        (0.500, 0.006, 0.062, 0.070, THIGH, CALF, 0.5),
        (0.440, 0.000, 0.060, 0.069, THIGH, CALF, 0.85),
        (0.360, -0.010, 0.061, 0.072, CALF, CALF, 0),
        (0.130, -0.016, 0.054, 0.060, CALF, CALF, 0),
        (0.070, -0.012, 0.058, 0.066, CALF, FOOT, 0.4),
        (0.068, -0.012, 0.040, 0.045, CALF, FOOT, 0.4),
    ]


SHOE: list[Ring] = [
    (0.125, -0.022, 0.038, 0.042, FOOT, FOOT, 0),
    (0.090, -0.010, 0.043, 0.062, FOOT, FOOT, 0),
    (0.066, 0.024, 0.045, 0.104, FOOT, FOOT, 0),
    (0.040, 0.042, 0.047, 0.132, FOOT, FOOT, 0),
    (0.000, 0.044, 0.048, 0.135, FOOT, FOOT, 0),
    (0.000, 0.044, 0.001, 0.001, FOOT, FOOT, 0),
]

SLEEVE: list[Ring] = [
    (1.462, -0.012, 0.012, 0.016, UPPER_ARM, CHEST, 0.7),
    (1.450, -0.012, 0.042, 0.046, UPPER_ARM, CHEST, 0.55),
    (1.415, -0.012, 0.058, 0.064, UPPER_ARM, CHEST, 0.35),
    (1.360, -0.013, 0.057, 0.064, UPPER_ARM, CHEST, 0.1),
    (1.280, -0.015, 0.053, 0.059, UPPER_ARM, UPPER_ARM, 0),
    (1.190, -0.017, 0.049, 0.053, UPPER_ARM, FOREARM, 0.1),
    (1.130, -0.018, 0.046, 0.050, UPPER_ARM, FOREARM, 0.5),
    (1.070, -0.014, 0.045, 0.048, UPPER_ARM, FOREARM, 0.9),
    (0.980, -0.004, 0.041, 0.043, FOREARM, FOREARM, 0),
    (0.900, 0.004, 0.037, 0.040, FOREARM, FOREARM, 0),
    (0.898, 0.004, 0.024, 0.026, FOREARM, FOREARM, 0),
]

HAND: list[Ring] = [
    (0.930, 0.002, 0.024, 0.027, FOREARM, FOREARM, 0),
    (0.880, 0.006, 0.022, 0.029, FOREARM, FOREARM, 0),
    (0.845, 0.012, 0.023, 0.042, FOREARM, FOREARM, 0),
    (0.800, 0.018, 0.023, 0.046, FOREARM, FOREARM, 0),
    (0.760, 0.020, 0.020, 0.040, FOREARM, FOREARM, 0),
    (0.715, 0.020, 0.016, 0.030, FOREARM, FOREARM, 0),
    (0.695, 0.018, 0.002, 0.004, FOREARM, FOREARM, 0),
]

SKULL: list[Ring] = [
    (1.786, -0.012, 0.002, 0.002, HEAD, HEAD, 0),
    (1.782, -0.012, 0.028, 0.034, HEAD, HEAD, 0),
    (1.768, -0.012, 0.051, 0.064, HEAD, HEAD, 0),
    (1.745, -0.010, 0.066, 0.085, HEAD, HEAD, 0),
    (1.715, -0.007, 0.074, 0.096, HEAD, HEAD, 0),
    (1.680, -0.004, 0.076, 0.099, HEAD, HEAD, 0),
    (1.650, 0.000, 0.075, 0.098, HEAD, HEAD, 0),
    (1.620, 0.004, 0.072, 0.095, HEAD, HEAD, 0),
    (1.592, 0.010, 0.067, 0.089, HEAD, HEAD, 0),
    (1.570, 0.016, 0.060, 0.080, HEAD, HEAD, 0),
    (1.553, 0.016, 0.054, 0.068, HEAD, HEAD, 0),
    (1.540, -0.008, 0.055, 0.060, HEAD, HEAD, 0),
    (1.500, -0.014, 0.057, 0.060, CHEST, HEAD, 0.5),
    (1.470, -0.016, 0.064, 0.064, CHEST, CHEST, 0),
]


class _MeshBuilder:
    """Collects lofted tubes."""

    def __init__(self) -> None:
        self._vertices: list[F64] = []
        self._uv: list[F64] = []
        self._bones: list[I32] = []
        self._share: list[F64] = []
        self._triangles: list[I32] = []
        self._texture: list[I32] = []
        self._count = 0

    def tube(
        self,
        rings: list[Ring],
        segments: int,
        texture: int,
        x_m: Floats | float = 0.0,
        power: float = 2.0,
        side: int = 0,
        v_range: tuple[float, float] = (0.0, 1.0),
    ) -> tuple[F64, F64]:
        """Loft a tube through rings, from the top down; return its vertices, free to be moved, and their uv.

        Args:
            rings: From top to bottom.
            segments: Corners of a ring; the seam lies at the back.
            texture: Texture number.
            x_m: Centre of each ring.
            power: Exponent of the superellipse: 2 is an ellipse, larger is boxier.
            side: Added to bone numbers of paired bones: 0 left, 1 right.
            v_range: Part of the texture that the tube takes, top and bottom.
        """
        table = np.array([ring[:4] for ring in rings])
        turn = np.linspace(0, 2 * np.pi, segments + 1) - np.pi / 2  # starts at the back, goes round by the right
        c, s = np.cos(turn), np.sin(turn)
        across = np.sign(c) * np.abs(c) ** (2 / power)
        along = np.sign(s) * np.abs(s) ** (2 / power)
        points = np.empty((len(rings), segments + 1, 3))
        points[..., 0] = np.broadcast_to(x_m, len(rings))[:, None] + table[:, 2:3] * across
        points[..., 1] = table[:, 1:2] + table[:, 3:4] * along
        points[..., 2] = table[:, 0:1]
        steps = np.linalg.norm(np.diff(table[:, :1], axis=0), axis=1) + np.abs(np.diff(table[:, 2])) * 0.5
        v = np.concatenate(([0.0], np.cumsum(steps))) / max(1e-9, steps.sum())
        v = v_range[0] + v * (v_range[1] - v_range[0])
        uv = np.stack(np.meshgrid(np.linspace(0, 1, segments + 1), v), axis=-1)
        bones = np.array([[_paired(ring[4], side), _paired(ring[5], side)] for ring in rings], dtype=np.int32)
        self._add(points, uv, bones, np.array([ring[6] for ring in rings], dtype=np.float64), texture)
        return points, uv

    def _add(self, points: F64, uv: F64, bones: I32, share: F64, texture: int) -> None:
        rows, columns = points.shape[:2]
        self._vertices.append(points.reshape(-1, 3))
        self._uv.append(uv.reshape(-1, 2))
        self._bones.append(np.repeat(bones, columns, axis=0))
        self._share.append(np.repeat(share, columns))
        corner = np.arange(rows * columns).reshape(rows, columns) + self._count
        a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
        triangles = np.stack((np.stack((a, d, c), -1), np.stack((a, c, b), -1)), axis=2).reshape(-1, 3)
        self._triangles.append(triangles.astype(np.int32))
        self._texture.append(np.full(len(triangles), texture, dtype=np.int32))
        self._count += rows * columns

    def build(self) -> Mesh:
        vertices, triangles = np.concatenate(self._vertices), np.concatenate(self._triangles)
        texture = np.concatenate(self._texture)
        p, q, r = (vertices[triangles[:, k]] for k in range(3))
        faces = np.cross(q - p, r - p)
        keep = np.linalg.norm(faces, axis=1) > 1e-9
        normals = _smooth(vertices, triangles, faces)
        return Mesh(
            vertices,
            normals,
            np.concatenate(self._uv),
            np.concatenate(self._bones),
            np.concatenate(self._share),
            np.ascontiguousarray(triangles[keep]),
            texture[keep],
        )


def _smooth(vertices: F64, triangles: I32, faces: F64) -> F64:
    """Average face normals over vertices at one place, so that the seam of a tube does not show."""
    _, place = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    place = place.reshape(-1)
    total = np.zeros((int(place.max()) + 1, 3))
    for k in range(3):
        np.add.at(total, place[triangles[:, k]], faces)
    normals = total[place]
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))


def _paired(bone: int, side: int) -> int:
    return bone + side if bone >= UPPER_ARM else bone


def build_body(wardrobe: Wardrobe, build: float, height_m: float) -> Mesh:
    """Build a person's mesh.

    Args:
        wardrobe: Its textures.
        build: Girth of the trunk, 1 is average.
        height_m: Its height.
    """
    maker = _MeshBuilder()
    maker.tube(_torso(build), 14, wardrobe.shirt, power=2.4)
    maker.tube(_hips(build), 12, wardrobe.waist, power=2.3)
    _add_head(maker, wardrobe)
    arm_x = np.array([0.178, 0.178, 0.180, 0.186, 0.198, 0.212, 0.221, 0.226, 0.232, 0.237, 0.237])
    hand_x = np.array([0.236, 0.238, 0.240, 0.242, 0.243, 0.243, 0.243])
    for side, sign in ((0, -1.0), (1, 1.0)):
        maker.tube(_leg(build), 9, wardrobe.trousers, sign * 0.094, side=side)
        maker.tube(SHOE, 8, wardrobe.shoe, sign * 0.096, 2.6, side=side)
        widened = sign * (arm_x + 0.178 * (build - 1.0))
        if wardrobe.short_sleeves:
            maker.tube(SLEEVE[:6], 8, wardrobe.sleeve, widened[:6], side=side)
            bare: list[Ring] = [(z, y, 0.82 * rx, 0.82 * ry, a, b, w) for z, y, rx, ry, a, b, w in SLEEVE[4:10]]
            maker.tube(bare, 8, wardrobe.skin, widened[4:10], side=side)
        else:
            maker.tube(SLEEVE, 8, wardrobe.sleeve, widened, side=side)
        maker.tube(HAND, 6, wardrobe.skin, sign * (hand_x + 0.178 * (build - 1.0)), side=side)
    mesh = maker.build()
    scale = height_m / SKULL[0][0]
    return Mesh(mesh.vertices_m * scale, mesh.normals, mesh.uv, mesh.bones, mesh.share, mesh.triangles, mesh.texture)


def _add_head(maker: _MeshBuilder, wardrobe: Wardrobe) -> None:
    segments = 14
    grid, uv = maker.tube(SKULL, segments, wardrobe.head, power=2.15)
    hair = clothes.hair_mask(uv[..., 0], uv[..., 1]) & (uv[..., 1] > 0.01)
    outward = grid - np.array([0.0, -0.01, 1.68])
    outward /= np.linalg.norm(outward, axis=2, keepdims=True)
    grid += np.where(hair[..., None], 0.011, 0.0) * outward
    grid[7, segments // 2, 1] += 0.024  # the nose's tip
    grid[6, segments // 2, 1] += 0.010
    ear: list[Ring] = [
        (1.668, 0.0, 0.004, 0.006, HEAD, HEAD, 0),
        (1.662, 0.0, 0.011, 0.018, HEAD, HEAD, 0),
        (1.640, 0.0, 0.012, 0.017, HEAD, HEAD, 0),
        (1.612, 0.004, 0.009, 0.011, HEAD, HEAD, 0),
        (1.606, 0.004, 0.002, 0.003, HEAD, HEAD, 0),
    ]
    for sign in (-1.0, 1.0):
        maker.tube(ear, 5, wardrobe.skin, sign * 0.078)
