"""Keeps pictures of chosen frames while a run goes on."""

from dataclasses import dataclass
from pathlib import Path

from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.errors import ConfigError
from stillroom.viz.overlay import draw_verdict
from stillroom.viz.png import write_png


@dataclass(frozen=True)
class PictureRecorderConfig:
    """Which frames are drawn, and how large.

    Attributes:
        every: Every how many frames of the sequence one is drawn, counted by its index; 0 for none.
        frames: Indices of further frames to draw.
        scale: How much larger than the image a picture is.
    """

    every: int = 30
    frames: tuple[int, ...] = ()
    scale: float = 2.0

    def build(self, folder: Path) -> "PictureRecorder":
        """Return a recorder that writes into a folder.

        Raises:
            ConfigError: A value is impossible.
        """
        if self.every < 0:
            raise ConfigError(f"every is {self.every}; it must be 0 (none) or more")
        if self.scale <= 0:
            raise ConfigError(f"scale is {self.scale}; it must be positive")
        return PictureRecorder(self, folder)


class PictureRecorder:
    """Writes `frame_00042.png`, a frame with its verdict on it, for the chosen frames of a run."""

    def __init__(self, config: PictureRecorderConfig, folder: Path) -> None:
        """Take note of the folder; it is made when the first picture is."""
        self._config = config
        self._folder = folder
        self._frames = frozenset(config.frames)

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Draw the frame, if it is one of the chosen.

        Raises:
            StillroomError: The picture cannot be written.
        """
        if not self._wants(result.index):
            return
        frame = tracked.frame
        picture = draw_verdict(
            frame.image.rgb,
            frame.keypoints.raw_px,
            frame.is_static & tracked.motion.is_static,
            tracked.is_matched,
            semantics,
            tracked.motion.moving,
            self._config.scale,
        )
        write_png(self._folder / f"frame_{result.index:05d}.png", picture)

    def _wants(self, index: int) -> bool:
        return index in self._frames or (self._config.every > 0 and index % self._config.every == 0)
