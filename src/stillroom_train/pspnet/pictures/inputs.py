"""Pictures as a network sees them: to find out what its values are like, nothing need be known of what they show."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from stillroom.geometry.arrays import F32
from stillroom.semantics.masks.network import color_planes
from stillroom_train.pspnet.networks.steps import Architecture
from stillroom_train.pspnet.pictures.example import images_in, read_rgb, split

LONGER_SIDES_PX = (640, 512, 640, 320)
"""Sizes at which pictures are seen, in turn."""

EVERY = 3
"""Every third picture is enough: half a hundred change little."""


def seen_by(network: Architecture, folders: Iterable[Path]) -> Iterator[F32]:
    """Yield pictures as inputs of a network (1, 3, H, W).

    Args:
        network: Says how inputs are normalised, and what sides they may have.
        folders: Of pictures of people (`images/`, of which those held out are left out), an RGB-D sequence (`rgb/`), or
            of images themselves. Every third of their pictures is taken.

    Raises:
        DatasetError: A folder has no images, or one cannot be read.
    """
    paths = [path for folder in folders for path in _pictures(folder)[::EVERY]]
    for number, path in enumerate(paths):
        rgb = read_rgb(path)
        longer = LONGER_SIDES_PX[number % len(LONGER_SIDES_PX)] / max(rgb.shape[:2])
        rows, columns = (_side(side * longer, network) for side in rgb.shape[:2])
        yield color_planes(rgb, (columns, rows), network.mean, network.std)[None]


def _pictures(folder: Path) -> Sequence[Path]:
    if (folder / "images").is_dir():
        return split(images_in(folder / "images"))[0]
    return images_in(folder / "rgb" if (folder / "rgb").is_dir() else folder)


def _side(wanted_px: float, network: Architecture) -> int:
    over = int(network.corners)
    return max(round((wanted_px - over) / network.stride), 1) * network.stride + over
