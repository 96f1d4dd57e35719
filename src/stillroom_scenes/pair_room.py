"""A rendered room that a pair of cameras sees."""

from dataclasses import replace

import cv2
import numpy as np

from stillroom.data.image import StereoImage
from stillroom.data.semantics import Semantics
from stillroom.data.sensor import Sensor
from stillroom.geometry.arrays import U8
from stillroom_scenes import sensor
from stillroom_scenes.cache import StoredFrame
from stillroom_scenes.eyes import Eyes, Mounted
from stillroom_scenes.render import World
from stillroom_scenes.room import SyntheticRoom

RIGHT = 1


class PairRoom(SyntheticRoom):
    """A rendered sequence of pairs. Poses, `truth`, boxes and masks are those of the rectified left camera.

    Images have noise as taken, before they are rectified.
    """

    sensor = Sensor.STEREO

    def __init__(
        self,
        name: str,
        world: World,
        eyes: Eyes,
        n_frames: int,
        fps: float,
        seed: int,
        noise: bool,
        cache_spec: str | None,
    ) -> None:
        """Take pictures of a world with two cameras.

        Args:
            name: Name in results.
            world: The scene, and the path of the left camera as it takes its images.
            eyes: The cameras.
            n_frames: How many frames.
            fps: Frames per second [1/s].
            seed: Chooses the noise.
            noise: Whether the images have any.
            cache_spec: All that decides what frames look like, to find those kept on disk; None to keep none.
        """
        self._eyes, self._left_way = eyes, world.way
        turned = (
            world
            if eyes.rectification is None
            else replace(world, way=Mounted(world.way, eyes.rectification.T_left_rectified))
        )
        super().__init__(name, turned, n_frames, fps, seed, noise, cache_spec, camera=eyes.camera)
        how = "rectified" if eyes.rectification is None else "distorted and turned by 1°, rectified"
        self.camera_source = f"the renderer's own pair of cameras, {how}"

    def _image(self, stored: StoredFrame, index: int, time_s: float, truth: Semantics) -> StereoImage:
        return StereoImage(time_s, stored.rgb, stored.measured.astype(np.uint8), index, truth=truth)

    def _taken(self, index: int) -> StoredFrame:
        """Render both images of frame `index` as taken, apply the sensor model, and rectify them."""
        time_s = float(self.timestamps_s[index])
        T_world_left = self._left_way.poses(np.array([time_s]))[0]
        left, right = (eye.see(self.scene, T_world_left, time_s) for eye in (self._eyes.left, self._eyes.right))
        if self._noise is not None:
            height, width = left.shape[:2]
            for image, places in (
                (left, self._noise.places(index, height, width)),
                (right, self._noise.places(index, height, width, RIGHT)),
            ):
                sensor.add_colour_noise(image, self._noise.colour, places[0])
        gray: U8 = np.asarray(cv2.cvtColor(right, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        rectification = self._eyes.rectification
        if rectification is not None:
            left, gray = rectification.left(left), rectification.right(gray)
        return StoredFrame(left, gray.astype(np.uint16), self._rendered(index).instance)
