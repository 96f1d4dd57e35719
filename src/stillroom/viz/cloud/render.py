"""A picture of a dense cloud."""

from dataclasses import dataclass

import cv2
import numpy as np

from stillroom.bounds import bounded, check
from stillroom.data.cloud.dense_cloud import DenseCloud
from stillroom.geometry.arrays import F32, U8
from stillroom.geometry.camera import Camera
from stillroom.viz.cloud.shading import fill_gaps, shade
from stillroom.viz.cloud.splat import splat
from stillroom.viz.cloud.view import View


@dataclass(frozen=True)
class CloudRendererConfig:
    """How clouds look.

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
        """Take note of the looks."""
        self._config = config or CloudRendererConfig()

    def render(self, cloud: DenseCloud, view: View) -> U8:
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
