"""Writes pictures of chosen frames during a run."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import U8, Bool, Floats
from stillroom.viz.clusters import draw_clusters, draw_detections
from stillroom.viz.marks import (
    MOVING,
    STATIC,
    draw_box,
    draw_dot,
    draw_label,
    draw_legend,
    draw_outline,
    draw_ring,
    enlarged,
    tint,
)
from stillroom.viz.png import write_png

VERDICT, CLUSTERS, DETECTIONS = "frame", "clusters", "detections"
KINDS = (VERDICT, CLUSTERS, DETECTIONS)


# A frame with its features: dynamic in red, static in green.


def draw_verdict(
    image: U8,
    keypoints_raw_px: Floats,
    is_static: Bool,
    is_matched: Bool,
    semantics: Semantics,
    moving: Bool,
    scale: float = 2.0,
) -> U8:
    """Draw static and dynamic features on an image.

    Moving keypoints are red dots; static ones are green, dots where they have a map point and small rings where
    they have none. Dynamic pixels are tinted, boxes have thin edges and a label, the counts are in the corner.

    Args:
        image: Colours (H, W, 3), RGB, as taken.
        keypoints_raw_px: Keypoints (N, 2) in the image as taken [px].
        is_static: Which of them are static (N,).
        is_matched: Which of them have a map point (N,).
        semantics: What is potentially dynamic.
        moving: Dynamic pixels (H, W).
        scale: How much larger than the image the picture is.

    Returns:
        The picture (H·scale, W·scale, 3), RGB.
    """
    picture = enlarged(image, scale)
    if moving.any():
        tint(picture, moving, MOVING)
        draw_outline(picture, moving, MOVING)
    for box in semantics.boxes:
        draw_box(picture, box, scale)
        draw_label(picture, box, scale)
    # Pixel centres lie at integers in both images, so a point moves by half a pixel when the image grows.
    points_px = (np.asarray(keypoints_raw_px, dtype=np.float64) + 0.5) * scale - 0.5
    for point in points_px[is_static & ~is_matched]:
        draw_ring(picture, point, STATIC, scale)
    for point in points_px[is_static & is_matched]:
        draw_dot(picture, point, STATIC, scale)
    for point in points_px[~is_static]:
        draw_dot(picture, point, MOVING, scale)
    n_static = int(np.count_nonzero(is_static))
    draw_legend(picture, ((f"{n_static} static", STATIC), (f"{len(is_static) - n_static} moving", MOVING)), scale)
    return picture


@dataclass(frozen=True)
class PictureRecorderConfig:
    """Which frames are drawn, and how.

    Attributes:
        every: Stride of the frames that are drawn, by their index; 0 for none.
        frames: Indices of further frames to draw.
        scale: How much larger than the image a picture is.
        kinds: What is drawn of a frame: "frame" (its static and dynamic features), "clusters" (where there are some),
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
        """Store the folder; it is made with the first picture."""
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
