"""Figures and handled objects as patches at a moment of time."""

import math
from dataclasses import dataclass

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32
from stillroom_scenes.scene import furniture, pictures
from stillroom_scenes.scene.atlas import AtlasBuilder
from stillroom_scenes.scene.builder import SceneBuilder, Skin, placed
from stillroom_scenes.scene.patches import Patches, moved
from stillroom_scenes.scene.people import body, clothes, gait
from stillroom_scenes.scene.people.choreography import Cast, Handling
from stillroom_scenes.scene.people.script import Place, Script, placed_matrix

FIRST_FIGURE, FIRST_OBJECT = 1, 101
STYLES = ("plaid", "print", "stripes", "knit")
BOX_SIZE_M = (0.38, 0.3, 0.28)
SUN = np.array([0.25, -0.55, 0.8]) / np.linalg.norm([0.25, -0.55, 0.8])  # towards the lamps, behind the camera


@dataclass(frozen=True)
class Figure:
    """A person: a mesh that follows a script."""

    mesh: body.Mesh
    script: Script
    scale: float
    instance: int
    rhythm_rad: float

    def place(self, time_s: float) -> F64:
        """Return `T_world_figure` (4, 4)."""
        return placed_matrix(self.script.at(time_s))

    def posture(self, place: Place, time_s: float) -> gait.Posture:
        """Return what the body does where it is at a time."""
        full = 0.24 + 0.22 * place.speed_m_s
        idle = 1.0 - place.speed_share
        return gait.Posture(
            phase_rad=2 * math.pi * place.walked_m / (self.scale * gait.stride_m(full)),
            swing_rad=full * place.speed_share,
            carry=place.gestures["carry"],
            push=place.gestures["push"],
            sway_rad=0.02 * idle * math.sin(1.9 * time_s + self.rhythm_rad),
            gaze_rad=0.3 * math.sin(0.7 * time_s + self.rhythm_rad),
        )

    def patches(self, time_s: float) -> Patches:
        """Return the figure's triangles in the world."""
        place = self.script.at(time_s)
        motions = placed_matrix(place) @ gait.bone_motions(self.posture(place, time_s), self.scale)
        mesh, count = self.mesh, len(self.mesh.triangles)
        out = Patches(np.empty((count, 9)), np.empty((count, 9)), np.empty((count, 3), dtype=np.int32))
        vertices, light = np.empty_like(mesh.vertices_m), np.empty(len(mesh.vertices_m))
        _pose_vertices(mesh.vertices_m, mesh.normals, mesh.bones, mesh.share, motions, SUN, vertices, light)
        _fill_patches(vertices, light, mesh.uv, mesh.triangles, out.shape_m, out.look)
        out.kind[:, 0], out.kind[:, 1], out.kind[:, 2] = 1, mesh.texture, self.instance
        return out


@njit(nogil=True, cache=True, error_model="numpy")
def _pose_vertices(
    rest_m: F64, normals: F64, bones: I32, share: F64, motions: F64, sun: F64, vertices_m: F64, light: F64
) -> None:
    """Move each vertex with its two bones, and light it: half Lambert, darker from below."""
    for i in range(len(rest_m)):
        n = 0.0
        w = share[i]
        a, b = bones[i, 0], bones[i, 1]
        up = 0.0
        for k in range(3):
            moved_to, turned = 0.0, 0.0
            for j in range(4):
                m = (1.0 - w) * motions[a, k, j] + w * motions[b, k, j]
                moved_to += m * (rest_m[i, j] if j < 3 else 1.0)
                if j < 3:
                    turned += m * normals[i, j]
            vertices_m[i, k] = moved_to
            n += turned * sun[k]
            if k == 2:
                up = turned
        half = 0.5 + 0.5 * n
        light[i] = min(1.0, 0.44 + 0.46 * half * half + 0.1 * n + 0.06 * up)


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_patches(vertices_m: F64, light: F64, uv: F64, triangles: I32, shape_m: F64, look: F64) -> None:
    for i in range(len(triangles)):
        a, b, c = triangles[i, 0], triangles[i, 1], triangles[i, 2]
        for k in range(3):
            shape_m[i, k] = vertices_m[a, k]
            shape_m[i, 3 + k] = vertices_m[b, k] - vertices_m[a, k]
            shape_m[i, 6 + k] = vertices_m[c, k] - vertices_m[a, k]
            at_a = light[a] if k == 2 else uv[a, k]
            look[i, k] = at_a
            look[i, 3 + k] = (light[b] if k == 2 else uv[b, k]) - at_a
            look[i, 6 + k] = (light[c] if k == 2 else uv[c, k]) - at_a


@dataclass(frozen=True)
class HandledObject:
    """A thing that is moved once: rest, hands, rest."""

    rest: Patches
    handling: Handling
    figure: Figure
    instance: int

    @property
    def label(self) -> str:
        """What it is."""
        return self.handling.label

    def is_moving(self, time_s: float) -> bool:
        """Return whether it is being handled."""
        return self.handling.taken_s < time_s < self.handling.left_s

    def place(self, time_s: float) -> F64:
        """Return `T_world_object` (4, 4)."""
        plan = self.handling
        T_world_rest = placed(*plan.rest_m, plan.rest_yaw_rad)
        T_figure_object = se3.inverse(self.figure.place(plan.taken_s)) @ T_world_rest
        if plan.hold_m is not None:
            T_figure_object = placed(*plan.hold_m)
        held_s = float(np.clip(time_s, plan.taken_s, plan.left_s))
        T_world_held = self.figure.place(held_s) @ T_figure_object
        if plan.lift_s > 0 and time_s < plan.taken_s + plan.lift_s:
            return _between(T_world_rest, T_world_held, (time_s - plan.taken_s) / plan.lift_s)
        if plan.put_m is not None and time_s > plan.left_s - plan.lift_s:
            heading = np.arctan2(T_world_held[1, 0], T_world_held[0, 0])
            T_world_put = placed(*plan.put_m, float(heading))
            return _between(T_world_held, T_world_put, (time_s - plan.left_s + plan.lift_s) / plan.lift_s)
        return T_world_held

    def patches(self, time_s: float) -> Patches:
        """Return its faces in the world."""
        return moved(self.rest, self.place(time_s))


def _between(T_world_a: F64, T_world_b: F64, share: float) -> F64:
    """Return an upright pose between two, eased."""
    s = min(max(share, 0.0), 1.0)
    s = s * s * (3 - 2 * s)
    yaw_a, yaw_b = (float(np.arctan2(T[1, 0], T[0, 0])) for T in (T_world_a, T_world_b))
    turn = (yaw_b - yaw_a + np.pi) % (2 * np.pi) - np.pi
    position = (1 - s) * T_world_a[:3, 3] + s * T_world_b[:3, 3]
    return placed(float(position[0]), float(position[1]), float(position[2]), yaw_a + s * turn)


def dress(rng: np.random.Generator, atlas: AtlasBuilder, style: str, taken: set[int]) -> body.Wardrobe:
    """Draw a person's clothes and face into the atlas, in a colour nobody else wears."""
    skin_colour = clothes.SKINS[int(rng.integers(len(clothes.SKINS)))]
    hair = clothes.HAIRS[int(rng.integers(len(clothes.HAIRS)))]
    choice = int(rng.choice([k for k in range(len(clothes.SHIRTS)) if k not in taken] or [0]))
    taken.add(choice)
    colour, jeans = clothes.SHIRTS[choice], clothes.JEANS[int(rng.integers(len(clothes.JEANS)))]
    cloth = clothes.shirt(rng, style, colour)
    sleeve = cloth if style == "plaid" else clothes.shirt(rng, "stripes" if style == "print" else style, colour)
    return body.Wardrobe(
        head=atlas.add(clothes.head(rng, skin_colour, hair, bool(rng.integers(2)))),
        skin=atlas.add(clothes.skin(rng, skin_colour)),
        shirt=atlas.add(cloth),
        sleeve=atlas.add(sleeve),
        trousers=atlas.add(clothes.trousers(rng, jeans)),
        waist=atlas.add(clothes.waist(rng, jeans)),
        shoe=atlas.add(clothes.shoe(rng)),
        short_sleeves=bool(rng.integers(2)),
    )


def build_people(cast: Cast, seed: int, atlas: AtlasBuilder) -> tuple[tuple[Figure, ...], tuple[HandledObject, ...]]:
    """Build all figures and the objects they handle; their textures go into the atlas."""
    rng = np.random.default_rng([seed, 37])
    taken: set[int] = set()
    styles = rng.permutation(STYLES)
    figures = []
    for k, script in enumerate(cast.scripts):
        wardrobe = dress(rng, atlas, str(styles[k % len(styles)]), taken)
        height_m = float(rng.uniform(1.68, 1.86))
        mesh = body.build_body(wardrobe, float(rng.uniform(0.94, 1.1)), height_m)
        rhythm = float(rng.uniform(0, 2 * np.pi))
        figures.append(Figure(mesh, script, height_m / body.SKULL[0][0], FIRST_FIGURE + k, rhythm))
    objects = []
    for k, handling in enumerate(cast.handlings):
        builder = SceneBuilder(atlas)
        if handling.label == "box":
            sides = [atlas.add(pictures.carton(rng)) for _ in range(3)]
            width, depth, _ = BOX_SIZE_M
            builder.box(np.eye(4), (-width / 2, -depth / 2, 0.0), BOX_SIZE_M, Skin(*sides))
            builder.face(np.eye(4), (-width / 2, depth / 2, 0), (width, 0, 0), (0, -depth, 0), sides[2])
        else:
            furniture.chair(builder, rng, np.eye(4), (150, 60, 54))
        instance = FIRST_OBJECT + k
        objects.append(HandledObject(builder.build(instance), handling, figures[handling.figure], instance))
    return tuple(figures), tuple(objects)
