"""Observes a run and inpaints what moves."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.datasets.recording import rendered
from stillroom.dense.inpainting import BackgroundPainter, InpaintingConfig
from stillroom.errors import ConfigError
from stillroom.geometry.arrays import U8, Bool
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset
from stillroom.system import System
from stillroom.viz.film import VideoFile, contact_sheet
from stillroom.viz.png import write_png

EVERY = 5
"""Stride of the frames whose error is measured: the empty room must be rendered for them."""
BRIGHTEST = 255.0
IMAGES = "inpainted"
SHEET = "inpainting.png"


# The error of an inpainted sequence against the same rendered room without people.


@dataclass
class PaintedError:
    """The error of inpainted pixels, where the background had been seen.

    Attributes:
        empty: The sequence without people.
        n_frames, n_pixels: How many were compared.
        squared: Sum of the squared errors of their red, green and blue.
    """

    empty: Dataset
    n_frames: int = 0
    n_pixels: int = 0
    squared: float = 0.0

    def add(self, index: int, rgb: U8, is_filled: Bool) -> None:
        """Compare the inpainted pixels (H, W) of an image (H, W, 3), if it is at the stride."""
        if index % EVERY != 0 or not is_filled.any():
            return
        true = self.empty.load(index).rgb
        self.n_frames += 1
        self.n_pixels += int(np.count_nonzero(is_filled))
        self.squared += float(np.sum((rgb[is_filled].astype(np.float64) - true[is_filled]) ** 2))

    @property
    def psnr_db(self) -> float | None:
        """Peak signal-to-noise ratio over all of them [dB]; None where nothing was compared, infinite without error."""
        if self.n_pixels == 0:
            return None
        mean = self.squared / (3 * self.n_pixels)
        return float(10.0 * np.log10(BRIGHTEST**2 / mean)) if mean > 0 else float("inf")


def painted_error(dataset: Dataset) -> PaintedError | None:
    """Return the error measure of an inpainted sequence; None where the background behind people is unknown."""
    room = rendered(dataset)
    empty = None if room is None else room.without_people()
    return None if empty is None else PaintedError(empty)


@dataclass(frozen=True)
class InpaintingRecorderConfig:
    """What is written of a run's painted frames.

    Attributes:
        painting: How they are painted.
        every: Stride of the frames that are written as images, by their numbers; 0 for none.
        video: Name of the video; "" for none.
        on_sheet: How many frames the contact sheet shows.
        map_every: Stride in frames at which the dense map is extracted again, to fill what no keyframe saw; 0 for
            never.
    """

    painting: InpaintingConfig = field(default_factory=InpaintingConfig)
    every: int = 1
    video: str = "inpainted.mp4"
    on_sheet: int = 8
    map_every: int = 0

    def build(
        self,
        folder: Path,
        camera: Camera,
        system: System,
        sheet_frames: Iterable[int],
        fps: float,
        error: PaintedError | None = None,
    ) -> "InpaintingRecorder":
        """Return a recorder that writes into a folder.

        Args:
            folder: The folder.
            camera: The calibration.
            system: The system that is observed.
            sheet_frames: Numbers of the frames for the contact sheet.
            fps: Frames per second of the video [1/s].
            error: The error measure; None where the truth is not known.

        Raises:
            ConfigError: A value is impossible.
        """
        for name in ("every", "on_sheet", "map_every"):
            if getattr(self, name) < 0:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be 0 (none) or more")
        video = VideoFile(folder / self.video, fps) if self.video else None
        return InpaintingRecorder(
            self, folder, self.painting.build(camera), system, video, frozenset(sheet_frames), error
        )


@dataclass
class Share:
    """Counts of pixels that were to be painted: those that were, and all."""

    n_filled: int = 0
    n_wanted: int = 0

    @property
    def filled(self) -> float | None:
        """Share of them that was painted; None where nothing moved."""
        return self.n_filled / self.n_wanted if self.n_wanted else None


class InpaintingRecorder:
    """Writes `inpainted/inpainted_00042.png`, the video, and in the end a contact sheet of pairs."""

    def __init__(
        self,
        config: InpaintingRecorderConfig,
        folder: Path,
        painter: BackgroundPainter,
        system: System,
        video: VideoFile | None,
        sheet_frames: frozenset[int],
        error: PaintedError | None = None,
    ) -> None:
        """Store the settings; files are made with the first frame."""
        self.config, self.share, self.error, self.n_frames = config, Share(), error, 0
        self._folder, self._painter, self._system, self._video = folder, painter, system, video
        self._sheet_frames = sheet_frames
        self._pairs: list[tuple[str, tuple[U8, U8]]] = []
        self._cloud: DenseCloud | None = None

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Inpaint the frame and write it; one without a pose stays as it is.

        Raises:
            StillroomError: A file cannot be written.
        """
        image, moving = tracked.frame.image, tracked.motion.moving
        rgb = image.rgb
        if tracked.T_world_cam is not None:
            world = self._system.map
            painted = self._painter.paint(image, tracked.T_world_cam, moving, world, self._map())
            rgb = painted.rgb
            n_filled = int(np.count_nonzero(painted.is_filled))
            self.share.n_filled += n_filled
            self.share.n_wanted += n_filled + int(np.count_nonzero(painted.is_hole))
            if self.error is not None:
                self.error.add(image.index, rgb, painted.is_filled)
        if result.is_keyframe:
            self._painter.remember(result.reference_keyframe, image, moving)
        self._write(image.index, image.rgb, rgb)
        self.n_frames += 1

    def close(self) -> None:
        """Finish the video and write the contact sheet.

        Raises:
            StillroomError: The sheet cannot be written.
        """
        if self._video is not None:
            self._video.close()
        if self._pairs:
            write_png(self._folder / SHEET, contact_sheet(self._pairs))
            self._pairs = []

    def _write(self, index: int, before: U8, after: U8) -> None:
        if self.config.every > 0 and index % self.config.every == 0:
            write_png(self._folder / IMAGES / f"inpainted_{index:05d}.png", after)
        if self._video is not None:
            self._video.add(after)
        if index in self._sheet_frames:
            self._pairs.append((f"frame {index}", (before, after)))

    def _map(self) -> DenseCloud | None:
        """Return the dense map, not older than the config allows."""
        if self.config.map_every > 0 and self.n_frames % self.config.map_every == 0:
            self._cloud = self._system.dense_mapper.cloud()
        return self._cloud
