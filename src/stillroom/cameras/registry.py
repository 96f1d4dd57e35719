"""All kinds of cameras by name: Stillroom's own, and those that installed packages add.

A package adds a kind by an entry point of the group `stillroom.cameras` that names a `CameraKind`::

    [project.entry-points."stillroom.cameras"]
    my-camera = "my_package.my_camera:KIND"
"""

from stillroom.cameras import oak, realsense, replay
from stillroom.cameras.kind import CameraKind
from stillroom.errors import ConfigError
from stillroom.plugins import PluginGroup
from stillroom.protocols import CameraStream

__all__ = ["OWN", "CameraKind", "all_kinds", "is_camera", "kind_of", "open_camera"]

PREFIX = "camera:"
PLUGINS: PluginGroup[CameraKind] = PluginGroup(
    "stillroom.cameras", "kind of camera", "a CameraKind", lambda offered: isinstance(offered, CameraKind)
)
OWN = (replay.KIND, realsense.KIND, oak.KIND)


def all_kinds() -> dict[str, CameraKind]:
    """Return every kind by name, Stillroom's own first.

    Raises:
        ConfigError: What an installed package offers cannot be imported, is no kind of camera, or has a name that is
            taken.
    """
    return PLUGINS.all_with(OWN, lambda kind: kind.name)


def is_camera(text: str) -> bool:
    """Return whether a camera is asked for, and not a recorded sequence."""
    return text.startswith(PREFIX)


def kind_of(text: str) -> CameraKind:
    """Return the kind of the camera that is asked for.

    Args:
        text: As given on the command line: `camera:NAME` or `camera:NAME:…`.

    Raises:
        ConfigError: There is none of this name.
    """
    name = text.removeprefix(PREFIX).partition(":")[0].partition("?")[0]
    known = all_kinds()
    if not is_camera(text) or name not in known:
        there_is = ", ".join(kind.usage for kind in known.values())
        raise ConfigError(f"{text}: no camera is called '{name}'; there is: {there_is}")
    return known[name]


def open_camera(text: str) -> CameraStream:
    """Return a camera; it starts when it is entered.

    Args:
        text: As given on the command line: `camera:replay:FOLDER`, `camera:realsense`, `camera:oak:ID` …

    Raises:
        ConfigError: There is no kind of this name, or what stands after it is malformed.
        MissingExtraError: The library of the camera is not installed.
        DatasetError, CalibrationError: The folder to replay cannot be opened.
    """
    kind = kind_of(text)
    return kind.open(text.removeprefix(PREFIX + kind.name).removeprefix(":"))
