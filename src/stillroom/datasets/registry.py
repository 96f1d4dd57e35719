"""All kinds of data sets by name: Stillroom's own, and those that installed packages add.

A package adds a kind by an entry point of the group `stillroom.datasets` that names a `DatasetKind`::

    [project.entry-points."stillroom.datasets"]
    my-format = "my_package.my_format:KIND"

So does `stillroom_scenes`, in this very distribution, with its rendered rooms.
"""

from stillroom.datasets import bonn, euroc, folder, kitti
from stillroom.datasets.kind import DatasetKind
from stillroom.plugins import PluginGroup

__all__ = ["LAST", "OWN", "DatasetKind", "all_kinds"]

PLUGINS: PluginGroup[DatasetKind] = PluginGroup(
    "stillroom.datasets", "kind of data set", "a DatasetKind", lambda offered: isinstance(offered, DatasetKind)
)


OWN = (bonn.KIND, euroc.KIND, kitti.KIND)
LAST = folder.KIND
"""Tried after all others: a folder with `rgb/` may well be of a more special kind."""


def all_kinds() -> dict[str, DatasetKind]:
    """Return every kind by name, in the order in which they are tried.

    Raises:
        ConfigError: What an installed package offers cannot be imported, is no kind of data set, or has a name that is
            taken.
    """
    kinds = PLUGINS.all_with((*OWN, LAST), lambda kind: kind.name)
    return {name: kind for name, kind in kinds.items() if kind is not LAST} | {LAST.name: LAST}
