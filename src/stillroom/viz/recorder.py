"""Keeps pictures of chosen frames while a run goes on."""

from dataclasses import dataclass
from pathlib import Path

from stillroom.bounds import bounded, check
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import U8
from stillroom.viz.clusters import draw_clusters, draw_detections
from stillroom.viz.overlay import draw_verdict
from stillroom.viz.png import write_png

VERDICT, CLUSTERS, DETECTIONS = "frame", "clusters", "detections"
KINDS = (VERDICT, CLUSTERS, DETECTIONS)


@dataclass(frozen=True)
class PictureRecorderConfig:
    """Which frames are drawn, and how.

    Attributes:
        every: Every how many frames of the sequence one is drawn, counted by its index; 0 for none.
        frames: Indices of further frames to draw.
        scale: How much larger than the image a picture is.
        kinds: What is drawn of a frame: "frame" (the verdict on it), "clusters" (where somebody looked for some),
            "detections".
    """

    every: int = bounded(30, least=0)
    frames: tuple[int, ...] = ()
    scale: float = bounded(2.0, above=0)
    kinds: tuple[str, ...] = bounded((VERDICT, CLUSTERS), one_of=KINDS)

    def build(self, folder: Path) -> "PictureRecorder":
        """Return a recorder that writes into a folder.

        Raises:
            ConfigError: A value is impossible.
        """
        check(self, "pictures")
        return PictureRecorder(self, folder)


class PictureRecorder:
    """Writes `frame_00042.png`, `clusters_00042.png` and so on for the chosen frames of a run."""

    def __init__(self, config: PictureRecorderConfig, folder: Path) -> None:
        """Take note of the folder; it is made when the first picture is."""
        self._config = config
        self._folder = folder
        self._frames = frozenset(config.frames)

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Draw the frame, if it is one of the chosen.

        Raises:
            StillroomError: A picture cannot be written.
        """
        if not self._wants(result.index):
            return
        for kind in self._config.kinds:
            picture = self._draw(kind, tracked, semantics)
            if picture is not None:
                write_png(self._folder / f"{kind}_{result.index:05d}.png", picture)

    def _draw(self, kind: str, tracked: Tracked, semantics: Semantics) -> U8 | None:
        """Return a picture of a frame; None where there is nothing of the kind to draw."""
        frame, motion, scale = tracked.frame, tracked.motion, self._config.scale
        rgb = frame.image.rgb
        if kind == DETECTIONS:
            return draw_detections(rgb, semantics, scale)
        if kind == CLUSTERS:
            clusters = semantics.clusters
            return None if clusters is None else draw_clusters(rgb, clusters, semantics, motion.moving, scale)
        raw_px, is_matched = frame.keypoints.raw_px, tracked.is_matched
        return draw_verdict(rgb, raw_px, tracked.is_static, is_matched, semantics, motion.moving, scale)

    def _wants(self, index: int) -> bool:
        return index in self._frames or (self._config.every > 0 and index % self._config.every == 0)
