"""All kinds of data sets by name: Stillroom's own, and those that installed packages add.

A package adds a kind by an entry point of the group `stillroom.datasets` that names a `DatasetKind`::

    [project.entry-points."stillroom.datasets"]
    my-format = "my_package.my_format:KIND"
"""

from stillroom.datasets import bonn, folder
from stillroom.datasets.kind import Asked, DatasetKind
from stillroom.errors import ConfigError
from stillroom.plugins import PluginGroup
from stillroom.protocols import Dataset

__all__ = ["LAST", "OWN", "SYNTHETIC", "DatasetKind", "all_kinds"]

SYNTHETIC = "synthetic"
PLUGINS: PluginGroup[DatasetKind] = PluginGroup(
    "stillroom.datasets", "kind of data set", "a DatasetKind", lambda offered: isinstance(offered, DatasetKind)
)


def _open_synthetic(asked: Asked, camera: str | None, fps: float | None) -> Dataset:
    if camera is not None or fps is not None:
        raise ConfigError(
            f"{asked.text}: a rendered sequence brings its own camera and times; leave camera and fps out"
        )
    from stillroom.datasets.synthetic import open_synthetic

    return open_synthetic(asked.text)


OWN = (
    DatasetKind(
        SYNTHETIC,
        "a room with people, rendered: synthetic:walking,frames=300",
        lambda asked: asked.prefix == SYNTHETIC,
        _open_synthetic,
    ),
    bonn.KIND,
)
LAST = folder.KIND
"""Asked after all others: a folder with `rgb/` may well be of a more special kind."""


def all_kinds() -> dict[str, DatasetKind]:
    """Return every kind by name, in the order in which they are asked.

    Raises:
        ConfigError: What an installed package offers cannot be imported, is no kind of data set, or has a name that is
            taken.
    """
    kinds = PLUGINS.all_with((*OWN, LAST), lambda kind: kind.name)
    return {name: kind for name, kind in kinds.items() if kind is not LAST} | {LAST.name: LAST}
