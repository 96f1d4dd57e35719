"""One room, in which the camera stays."""

from functools import lru_cache

from stillroom_scenes.camera_path import CameraPath
from stillroom_scenes.render import Scene, World
from stillroom_scenes.scene.atlas import AtlasBuilder
from stillroom_scenes.scene.layout import build_room
from stillroom_scenes.scene.people.choreography import Stage, cast_for
from stillroom_scenes.scene.people.figures import FIRST_OBJECT, build_people


def single_room(room: str, path: str, figures: str, seed: int, duration_s: float) -> World:
    """Return a room of `layout.ROOMS`, a path of `PATHS` and figures of `FIGURES` in it."""
    return World(scene_of(room, figures, seed, stage_for(path)), CameraPath(path, seed, duration_s))


def stage_for(path: str) -> Stage:
    """Return the floor that figures may take: a smaller one where the camera goes round them."""
    return Stage(scale=0.6, middle_y_m=0.05) if path == "loop" else Stage()


@lru_cache(maxsize=4)
def scene_of(room: str, figures: str, seed: int, stage: Stage) -> Scene:
    """Build a scene, or take it from a moment ago: it is never changed."""
    atlas = AtlasBuilder()
    cast = cast_for(figures, seed, stage)
    still = build_room(room, seed, cast.tables, atlas)
    people, objects = build_people(cast, seed, atlas)
    assert len(people) < FIRST_OBJECT
    return Scene(atlas.build(), still.patches, people, objects)
