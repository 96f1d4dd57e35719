"""What is wrong with a map file."""

from pathlib import Path

from stillroom.errors import MapError
from stillroom.storage.integrity import problems_of
from stillroom.storage.opening import reading
from stillroom.storage.reader import load_map


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
    return list(problems_of(stored))
