"""Pictures as PNG files."""

from pathlib import Path

import cv2

from stillroom.data.replacing import cannot_be_written, replacing
from stillroom.geometry.arrays import U8


def write_png(path: Path, picture: U8) -> None:
    """Write a picture, RGB (H, W, 3) or grey (H, W); its folder is made.

    Raises:
        StillroomError: The file cannot be written.
    """
    _, png = cv2.imencode(".png", picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_be_written(path, error) from error
    with replacing(path, durable=False) as file:
        file.write(png.tobytes())
