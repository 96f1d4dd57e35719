"""What is wrong with a map file."""

import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stillroom.errors import MapError
from stillroom.storage.integrity import are_rigid, problems_of_map
from stillroom.storage.opening import reading
from stillroom.storage.reader import load_map
from stillroom.storage.schema import StoredMap


def check_map(path: Path) -> list[str]:
    """Return what is wrong with a map file, a line each; none for a sound one.

    Raises:
        MapError: There is no such file, it is no map, of a newer version, or cut short.
    """
    with reading(path) as database:
        said = [line for row in database.execute("PRAGMA integrity_check") for line in str(row[0]).splitlines()]
    if said != ["ok"]:
        return [f"SQLite: {line}" for line in said]
    try:
        stored = load_map(path, whole=False)
    except MapError as error:
        return [str(error).removeprefix(f"{path}: ")]
    return [*problems_of_map(stored.world), *_problems_of_rest(stored)]


def _problems_of_rest(stored: StoredMap) -> Iterator[str]:
    n_keyframes, first = len(stored.world.keyframes), 0
    for number, session in enumerate(stored.sessions):
        if not first <= session.first_keyframe <= n_keyframes:
            yield f"session {number} begins at keyframe {session.first_keyframe}, out of order"
        first = session.first_keyframe
        try:
            tomllib.loads(session.config)
        except tomllib.TOMLDecodeError as error:
            yield f"the config of session {number} is no TOML: {error}"
    for frame in stored.frames:
        where = f"frame {frame.image_index} of session {frame.session}"
        if not 0 <= frame.session < len(stored.sessions):
            yield f"{where} belongs to no session"
        if not 0 <= frame.reference_keyframe < n_keyframes:
            yield f"{where} refers to keyframe {frame.reference_keyframe}, which does not exist"
    poses = np.array([frame.T_reference_cam for frame in stored.frames]).reshape(-1, 4, 4)
    yield from (
        f"the pose of frame {stored.frames[i].image_index} is not rigid" for i in np.flatnonzero(~are_rigid(poses))
    )
