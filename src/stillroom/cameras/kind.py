"""What a kind of camera is: its name, and how one is opened."""

from collections.abc import Callable
from dataclasses import dataclass

from stillroom.protocols import CameraStream


@dataclass(frozen=True)
class CameraKind:
    """A kind of camera.

    Attributes:
        name: The word after `camera:`.
        usage: How it is asked for, such as "camera:realsense[:SERIAL]".
        summary: One line: what it is.
        open: Returns a camera, not started yet. Given what stands after the name, without the colon; "" where nothing
            does. It raises `MissingExtraError` where its library is absent, and `ConfigError` or `DatasetError` where
            it cannot be what is asked for.
    """

    name: str
    usage: str
    summary: str
    open: Callable[[str], CameraStream]
