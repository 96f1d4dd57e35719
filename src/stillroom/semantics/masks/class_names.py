"""What the channels of a segmentation network are called."""

from collections.abc import Sequence
from difflib import get_close_matches

from stillroom.errors import ConfigError

VOC_CLASSES = (
    "background", "aeroplane", "bicycle", "bird", "boat", "bottle", "bus", "car", "cat", "chair", "cow",
    "diningtable", "dog", "horse", "motorbike", "person", "pottedplant", "sheep", "sofa", "train", "tvmonitor",
)  # fmt: skip
"""The 21 classes of PASCAL VOC 2012 in the order in which networks tell them."""


def channels_of(movable: Sequence[str], classes: Sequence[str]) -> list[int]:
    """Return the channels of some classes.

    Args:
        movable: Names of the classes that are wanted.
        classes: Names of all channels, in order.

    Raises:
        ConfigError: A name is not among the classes (the message has the nearest), comes twice, or there is none.
    """
    if not movable:
        raise ConfigError("movable names no class; name at least one, such as person, or use kind 'nothing'")
    for name in movable:
        if name not in classes:
            nearest = get_close_matches(name.lower(), classes, n=1, cutoff=0.0) or ["–"]
            raise ConfigError(
                f"movable class '{name}' is not one of the network's; did you mean '{nearest[0]}'? "
                f"known: {', '.join(classes)}"
            )
        if movable.count(name) > 1:
            raise ConfigError(f"movable class '{name}' comes twice; name it once")
    return [classes.index(name) for name in movable]
