"""Masks of dynamic pixels, as files for other programs."""

from pathlib import Path

import numpy as np

from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.errors import StillroomError
from stillroom.viz.png import write_png

MOVING = 255


class MaskWriter:
    """Writes a mask for each frame, `<name of the colour image>.png`: 8 bits, 255 where dynamic, else 0.

    An image that never was a file is called by its number, `000012.png`. `semantics.kind=mask-files` reads such masks.
    """

    def __init__(self, folder: Path) -> None:
        """Take the folder; it is made with the first mask."""
        self._folder = folder

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Write the mask of a frame.

        Raises:
            StillroomError: It cannot be written, or the image's name leads to another folder.
        """
        name = tracked.frame.image.name or f"{result.index:06d}"
        if Path(name).name != name:  # a data set of another package may give any
            raise StillroomError(f"{self._folder}: an image is called '{name}', which is no name of a file in it")
        write_png(self._folder / f"{name}.png", np.where(result.motion.moving, MOVING, 0).astype(np.uint8))
