"""A picture of a dense cloud."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.dense_cloud import DenseCloud
from stillroom.geometry.arrays import F32, F64, U8, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.pixels import Shape, element
from stillroom.viz.cloud.splat import Splats, splat
from stillroom.viz.cloud.view import Viewpoint, default_view
from stillroom.viz.style import DPI, INK, QUIET, format_of, picture

HEADLIGHT = 0.25
"""Share of the light from the viewpoint; the rest is ambient."""
CREASES = 0.55
"""How much darker the deepest crease is than open ground."""
DEEP = 0.012
"""A step back by this share of the depth is as deep as a crease gets."""
NOISE = 0.0012
"""Steps below this share of the depth are the sensor's noise, not a crease."""
STRIP = 0.10
"""Share of a picture's height that is kept free for the caption."""
GAP_PX = 12
"""Between the two pictures."""
CAPTIONS = ("everything fused", "people removed")


# Light on a splatted cloud: surfaces that face the viewpoint are bright, corners and edges darker.


def fill_gaps(splats: Splats, gap_px: int) -> tuple[Splats, Bool]:
    """Fill gaps so narrow that discs of twice the diameter would cover them.

    Args:
        splats: What the view sees.
        gap_px: Width of the widest gap that is filled.

    Returns:
        The splats without gaps, in which `nearest` still says −1 there, and where anything is now (H, W).
    """
    covered = (splats.nearest >= 0).astype(np.uint8)
    if gap_px < 1:
        return splats, covered.astype(np.bool_)
    kernel = element(gap_px // 2, Shape.ELLIPSE)
    closed = np.asarray(cv2.morphologyEx(covered, cv2.MORPH_CLOSE, kernel), dtype=np.bool_)
    gaps = closed & (covered == 0)
    sigma = gap_px / 2.0
    share = cv2.GaussianBlur(covered.astype(np.float32), (0, 0), sigma)[gaps]

    def filled(values: F32) -> F32:
        blurred = cv2.GaussianBlur(values, (0, 0), sigma)[gaps]
        result = values.copy()
        result[gaps] = blurred / np.maximum(share if values.ndim == 2 else share[:, None], 1e-6)
        return result

    whole = Splats(splats.nearest, filled(splats.depth_m), filled(splats.normals), filled(splats.rgb))
    return whole, closed


def shade(splats: Splats, covered: Bool, rays: F32, reach_px: float) -> F32:
    """Return the brightness (H, W) in 0 … 1 of what a view sees.

    Args:
        splats: What it sees.
        covered: Where it sees anything (H, W).
        rays: Unit vectors towards the eye (H, W, 3) [view frame].
        reach_px: Over how many pixels creases are looked for, at most.
    """
    length = np.linalg.norm(splats.normals, axis=2)
    facing = np.einsum("ijk,ijk->ij", splats.normals, rays) / np.maximum(length, 1e-6)
    lit = 1.0 - HEADLIGHT + HEADLIGHT * np.clip(facing, 0.0, 1.0)
    dark = np.zeros(covered.shape, dtype=np.float32)
    reaches = (1.0, 0.4, 0.15)
    for reach in reaches:
        dark += creases(splats.depth_m, covered, max(1, round(reach * reach_px))) / len(reaches)
    return np.asarray(lit * (1.0 - CREASES * dark), dtype=np.float32)


def creases(depth_m: F32, covered: Bool, reach_px: int) -> F32:
    """Return how deep each pixel lies behind its surroundings (H, W), 0 … 1: eye-dome lighting that spares planes.

    (Boucheny, 2009, compares depths with each neighbour, which darkens every plane that is seen at a slant. Inverse
    depth of a plane is linear in the image, so the mean of two opposite neighbours is compared here.)

    Args:
        depth_m: Depth (H, W) [m].
        covered: Where it is known (H, W).
        reach_px: Distance of the neighbours.
    """
    inverse = np.where(covered, 1.0 / np.maximum(depth_m, 1e-6), 0.0).astype(np.float32)
    known = covered.astype(np.float32)
    sigma = 0.35 * reach_px + 0.5
    share = np.asarray(cv2.GaussianBlur(known, (0, 0), sigma), dtype=np.float32)
    blurred = np.asarray(cv2.GaussianBlur(inverse, (0, 0), sigma), dtype=np.float32)
    inverse = np.where(share > 0.05, blurred / np.maximum(share, 0.05), np.float32(0.0))
    r, s = reach_px, max(1, round(reach_px * 0.7071))
    padded = cv2.copyMakeBorder(inverse, r, r, r, r, cv2.BORDER_CONSTANT, value=0.0)
    height, width = depth_m.shape

    def moved(dx: int, dy: int) -> F32:
        there = padded[r + dy : r + dy + height, r + dx : r + dx + width]
        # Unknown there: treated as no occlusion of this pixel.
        return np.where(there > 0.0, there, inverse)

    deep = np.zeros_like(inverse)
    for dx, dy in ((r, 0), (0, r), (s, s), (s, -s)):
        step = (0.5 * (moved(dx, dy) + moved(-dx, -dy)) - inverse) / np.maximum(inverse, 1e-6)
        deep += np.clip((step - NOISE) / DEEP, 0.0, 1.0)
    return np.where(covered, deep / 4.0, 0.0).astype(np.float32)


@dataclass(frozen=True)
class CloudRendererConfig:
    """The appearance of clouds.

    Attributes:
        supersampling: Each pixel is the mean of this many by this many.
        disc_voxels: Radius of a point's disc, in voxels; from 0.87 on, discs of neighbours close a plane.
        gap_px: Gaps up to this wide are filled [px of the picture].
        exposure: Factor on the clouds' colours.
        two_sided: Whether surfaces are drawn that are seen from behind.
        background_top, background_bottom: tuple[int, int, int] = (228, 233, 239)
    """

    supersampling: int = bounded(2, least=1)
    disc_voxels: float = bounded(1.25, above=0)
    gap_px: float = 3.0
    exposure: float = 1.15
    two_sided: bool = False
    background_top: tuple[int, int, int] = (205, 213, 223)
    background_bottom: tuple[int, int, int] = (228, 233, 239)

    def build(self) -> "CloudRenderer":
        """Return the renderer.

        Raises:
            ConfigError: A value is impossible.
        """
        check(self, "renderer")
        return CloudRenderer(self)


class CloudRenderer:
    """Draws clouds: the same cloud and view give the same picture, byte for byte."""

    def __init__(self, config: CloudRendererConfig | None = None) -> None:
        """Store the appearance."""
        self._config = config or CloudRendererConfig()

    def render(self, cloud: DenseCloud, view: Viewpoint) -> U8:
        """Draw a cloud.

        Args:
            cloud: The points.
            view: From where, and how large.

        Returns:
            The picture (H, W, 3), RGB, of the size of the view's camera.
        """
        config = self._config
        large = view.scaled(config.supersampling)
        splats = splat(cloud, large, config.disc_voxels * cloud.voxel_m, config.two_sided)
        splats, covered = fill_gaps(splats, round(config.gap_px * config.supersampling))
        c = large.camera
        brightness = shade(splats, covered, _towards_eye(c), c.width / 55.0)
        lit = np.minimum(config.exposure * splats.rgb * brightness[..., None], 255.0)
        picture = np.where(covered[..., None], lit, self._background(c))
        size = (view.camera.width, view.camera.height)
        small = cv2.resize(picture.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        return np.clip(np.rint(small), 0, 255).astype(np.uint8)

    def _background(self, camera: Camera) -> F32:
        """Return a gradient (H, W, 3)."""
        top, bottom = (
            np.array(color, dtype=np.float32) for color in (self._config.background_top, self._config.background_bottom)
        )
        share = np.linspace(0.0, 1.0, camera.height, dtype=np.float32)[:, None, None]
        return np.broadcast_to(top + share * (bottom - top), (camera.height, camera.width, 3)).astype(np.float32)


def _towards_eye(camera: Camera) -> F32:
    """Return the unit vectors (H, W, 3) from what is seen in each pixel to the eye [view frame]."""
    x = (np.arange(camera.width, dtype=np.float32) - camera.cx) / camera.fx
    y = (np.arange(camera.height, dtype=np.float32) - camera.cy) / camera.fy
    rays = np.empty((camera.height, camera.width, 3), dtype=np.float32)
    rays[..., 0], rays[..., 1], rays[..., 2] = -x[None, :], -y[:, None], -1.0
    return np.asarray(rays / np.linalg.norm(rays, axis=2, keepdims=True), dtype=np.float32)


# The dense map with the people and without them, side by side.


def draw_dense_pair(
    path: Path,
    without: DenseCloud,
    with_: DenseCloud,
    T_world_cam: F64,
    size_px: tuple[int, int] = (960, 640),
    view: Viewpoint | None = None,
) -> None:
    """Draw two maps from the same place: what OC-SLAM's Figures 9, 11 and 12 show.

    Args:
        path: The file to write, PNG, or SVG or PDF by its suffix, as wide as two pictures and a gap.
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
    """Write pictures of one size side by side, in a PNG pixel for pixel, each with its caption in a corner.

    Raises:
        StillroomError: The file cannot be written.
    """
    height, width = panels[0].shape[:2]
    total = len(panels) * (width + GAP_PX) - GAP_PX
    with picture(path, total / DPI, height / DPI) as figure:
        for place, (panel, caption, note) in enumerate(zip(panels, captions, notes, strict=True)):
            left = place * (width + GAP_PX)
            if format_of(path) == "png":
                # Flipped by us, for figimage's origin is the lower left corner.
                figure.figimage(np.ascontiguousarray(panel[::-1]), xo=left, yo=0, origin="lower")
            else:  # where pixels have no size, figimage takes them for points
                _fill(figure, panel, left / total, width / total)
            x, y = (left + 0.03 * width) / total, 0.045
            size = 0.038 * height * 72 / DPI
            label = figure.text(x, y, caption, fontsize=size, color=INK, weight="bold", va="baseline")
            label.set_in_layout(False)
            x_note = (left + 0.97 * width) / total
            small = figure.text(x_note, y, note, fontsize=0.62 * size, color=QUIET, ha="right", va="baseline")
            small.set_in_layout(False)


def _fill(figure: Any, panel: U8, left: float, width: float) -> None:
    """Put a picture into a part of a figure, as high as the figure; left and width are shares of the figure's."""
    figure.set_layout_engine("none")
    axes = figure.add_axes((left, 0.0, width, 1.0))
    axes.set_axis_off()
    axes.imshow(panel, aspect="auto", interpolation="none")
