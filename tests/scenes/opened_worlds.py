"""The worlds under test, each opened once; nothing of them is kept on disk."""

from functools import lru_cache

from stillroom_scenes.config import open_synthetic
from stillroom_scenes.room import SyntheticRoom
from stillroom_scenes.worlds.building import BuildingScene


@lru_cache
def world(spec: str) -> SyntheticRoom:
    """Return the sequence of a spec without `synthetic:`."""
    return open_synthetic(f"synthetic:{spec},cache=off")


def scene_of(room: SyntheticRoom) -> BuildingScene:
    """Return the building."""
    assert isinstance(room.scene, BuildingScene)
    return room.scene
