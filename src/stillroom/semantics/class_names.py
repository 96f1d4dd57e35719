"""Class names of networks."""

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

from stillroom.data.text import read_text
from stillroom.errors import ConfigError

VOC_CLASSES = (
    "background", "aeroplane", "bicycle", "bird", "boat", "bottle", "bus", "car", "cat", "chair", "cow",
    "diningtable", "dog", "horse", "motorbike", "person", "pottedplant", "sheep", "sofa", "train", "tvmonitor",
)  # fmt: skip
"""The 21 classes of PASCAL VOC 2012 in the order of the networks' channels."""

COCO_CLASSES = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog", "horse", "sheep", "cow", "elephant",
    "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard",
    "sports ball", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle",
    "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich", "orange", "broccoli",
    "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch", "potted plant", "bed", "dining table", "toilet",
    "tv", "laptop", "mouse", "remote", "keyboard", "cell phone", "microwave", "oven", "toaster", "sink",
    "refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier", "toothbrush",
)  # fmt: skip
"""The 80 classes of COCO in the order of YOLO networks' channels."""


def read_class_names(path: Path) -> tuple[str, ...]:
    """Return the names in a file, one a line; empty lines at its end do not count.

    Raises:
        ConfigError: It cannot be read, or names nothing.
    """
    try:
        names = read_text(path).rstrip().splitlines()
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"{path}: cannot be read as text ({error})") from error
    if not names:
        raise ConfigError(f"{path}: empty; write the network's class names, one a line")
    return tuple(name.strip() for name in names)


def channels_of(movable: Sequence[str], classes: Sequence[str]) -> list[int]:
    """Return the channels of some classes.

    Args:
        movable: Names of the wanted classes.
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
