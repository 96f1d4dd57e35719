"""The dense map with the people and without them, side by side."""

from pathlib import Path

import numpy as np

from stillroom.data.cloud.dense_cloud import DenseCloud
from stillroom.geometry.arrays import F64, U8
from stillroom.viz.cloud.render import CloudRendererConfig
from stillroom.viz.cloud.view import View, default_view
from stillroom.viz.style import DPI, INK, QUIET, picture

STRIP = 0.10
"""Share of a picture's height that is kept free for the caption."""

GAP_PX = 12
"""Between the two pictures."""

CAPTIONS = ("everything fused", "people removed")


def draw_dense_pair(
    path: Path,
    without: DenseCloud,
    with_: DenseCloud,
    T_world_cam: F64,
    size_px: tuple[int, int] = (960, 640),
    view: View | None = None,
) -> None:
    """Draw two maps from the same place: what OC-SLAM's Figures 9, 11 and 12 show.

    Args:
        path: The PNG to write, as wide as two pictures and a gap.
        without: The map without removal of what moves.
        with_: The map with it; the view is chosen to show this one whole.
        T_world_cam: Poses of the camera (M, 4, 4), at least one.
        size_px: Width and height of one picture; not used where a view is given.
        view: From where to look, in place of the default view.

    Raises:
        StillroomError: The file cannot be written.
    """
    if view is None:
        width, height = size_px
        strip = round(STRIP * height)
        view = default_view(with_, T_world_cam, width, height - strip).with_strip_below(strip)
    renderer = CloudRendererConfig().build()
    panels = [renderer.render(cloud, view) for cloud in (without, with_)]
    notes = [f"{len(cloud):,} points".replace(",", "\u202f") for cloud in (without, with_)]
    write_panels(path, panels, CAPTIONS, notes)


def write_panels(path: Path, panels: list[U8], captions: tuple[str, ...], notes: list[str]) -> None:
    """Write pictures of one size beside each other as one PNG, pixel for pixel, each with its caption in a corner.

    Raises:
        StillroomError: The file cannot be written.
    """
    height, width = panels[0].shape[:2]
    total = len(panels) * (width + GAP_PX) - GAP_PX
    with picture(path, total / DPI, height / DPI) as figure:
        for place, (panel, caption, note) in enumerate(zip(panels, captions, notes, strict=True)):
            left = place * (width + GAP_PX)
            # Flipped by us, for figimage's origin is the lower left corner.
            figure.figimage(np.ascontiguousarray(panel[::-1]), xo=left, yo=0, origin="lower")
            x, y = (left + 0.03 * width) / total, 0.045
            size = 0.038 * height * 72 / DPI
            label = figure.text(x, y, caption, fontsize=size, color=INK, weight="bold", va="baseline")
            label.set_in_layout(False)
            x_note = (left + 0.97 * width) / total
            small = figure.text(x_note, y, note, fontsize=0.62 * size, color=QUIET, ha="right", va="baseline")
            small.set_in_layout(False)
