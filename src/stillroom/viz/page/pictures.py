"""Pictures inside a page, at a sensible size."""

from base64 import b64encode
from html import escape
from pathlib import Path

import cv2
import numpy as np

from stillroom.geometry.arrays import U8

ROOM_BYTES = 9_000_000
"""What all pictures of a page may take; with the plotting library and the curves it stays well below 15 MB."""

LONGEST_PX = 960
"""Longer pictures are made smaller."""

SMALL_BYTES = 300_000
"""A PNG file below this is taken as it is: plots, which JPEG blurs."""

JPEG_QUALITY = 82


class Album:
    """Takes the pictures of one page.

    Attributes:
        n_taken: Pictures that are in the page.
        n_left_out: Pictures that are not, as there was no room for them or they could not be read.
    """

    def __init__(self, room_bytes: int = ROOM_BYTES) -> None:
        """Begin with room for so many bytes of text."""
        self._room_bytes = room_bytes
        self.n_taken, self.n_left_out = 0, 0

    def figure(self, path: Path, caption: str) -> str:
        """Return a PNG file as a figure with everything in it; nothing where there is no room, or no such picture."""
        source = data_uri(path)
        if source is None or len(source) > self._room_bytes:
            self.n_left_out += 1
            return ""
        self._room_bytes -= len(source)
        self.n_taken += 1
        text = escape(caption)
        return f'<figure><img src="{source}" alt="{text}"><figcaption>{text}</figcaption></figure>\n'


def data_uri(path: Path, longest_px: int = LONGEST_PX) -> str | None:
    """Return a picture as a `data:` address: a small PNG as it is, a larger one as JPEG; None where it is none."""
    try:
        encoded = path.read_bytes()
    except OSError:
        return None
    picture = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR) if encoded else None
    if picture is None:
        return None
    if len(encoded) <= SMALL_BYTES:
        return f"data:image/png;base64,{b64encode(encoded).decode('ascii')}"
    return f"data:image/jpeg;base64,{b64encode(_jpeg(np.asarray(picture, np.uint8), longest_px)).decode('ascii')}"


def evenly(paths: list[Path], at_most: int) -> list[Path]:
    """Return at most so many of some files, spread evenly, the first and the last among them."""
    if len(paths) <= at_most:
        return paths
    return [paths[place] for place in np.linspace(0, len(paths) - 1, at_most).round().astype(int)]


def _jpeg(picture: U8, longest_px: int) -> bytes:
    scale = longest_px / max(picture.shape[:2])
    if scale < 1:
        height, width = (max(1, round(side * scale)) for side in picture.shape[:2])
        picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    _, encoded = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
    return encoded.tobytes()
