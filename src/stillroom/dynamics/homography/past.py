"""The earlier images that the present one is compared with."""

import itertools
from dataclasses import dataclass, field, replace

from stillroom.data.frame import Frame
from stillroom.data.image import Image
from stillroom.dynamics.homography.point_motion import SHRINK, ImageView
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.geometry.pixels import in_pixels, pixel_scale

TOO_OLD_S = 1.0
"""Images older than this show too little of what the present one shows."""


@dataclass(frozen=True)
class EarlierImage:
    """An image with its pose.

    Attributes:
        index, timestamp_s: Place and time of the image in its sequence.
        view: The image as the point test reads it.
        T_cam_world: Its pose as tracked (4, 4).
    """

    index: int
    timestamp_s: float
    view: ImageView = field(repr=False)
    T_cam_world: F64


def view_of(image: Image) -> ImageView:
    """Return an image as the point test reads it."""
    times = in_pixels(SHRINK, pixel_scale(image.width, image.height))
    return ImageView(image.shrunk(times), image.shrunk(2 * times), image.known_depth_m)


class Past:
    """The last images, back to one that is old enough."""

    def __init__(self, age_s: float) -> None:
        """Start without images.

        Args:
            age_s: How old the image should be that the present one is compared with [s].
        """
        self._age_s = age_s
        self._images: list[EarlierImage] = []

    def before(self, frame: Frame) -> list[EarlierImage]:
        """Return the images to try, at most two: the youngest that is old enough, else the oldest; and the youngest."""
        now_s = frame.timestamp_s
        earlier = [image for image in self._images if now_s - TOO_OLD_S <= image.timestamp_s < now_s]
        if not earlier:
            return []
        # A tenth less: frames are sometimes slightly early.
        old = [image for image in earlier if now_s - image.timestamp_s >= 0.9 * self._age_s]
        first = old[-1] if old else earlier[0]
        return [first] if first is earlier[-1] else [first, earlier[-1]]

    def turn_rad_s(self, frame: Frame, T_cam_world: F64) -> float:
        """Return how fast the camera turned at most, from image to image, since the oldest that is kept [rad/s]."""
        poses = [
            (image.timestamp_s, image.T_cam_world) for image in self._images if image.timestamp_s < frame.timestamp_s
        ]
        poses.append((frame.timestamp_s, T_cam_world))
        turns = [
            float(se3.angle_rad(T @ se3.inverse(before))) / (time_s - before_s)
            for (before_s, before), (time_s, T) in itertools.pairwise(poses)
        ]
        return max(turns, default=0.0)

    def follow(self, T_new_old: F64) -> None:
        """Move the stored poses by a motion (4, 4) of the world's coordinates."""
        T_old_new = se3.inverse(T_new_old)
        self._images = [replace(image, T_cam_world=image.T_cam_world @ T_old_new) for image in self._images]

    def remember(self, frame: Frame, view: ImageView, T_cam_world: F64) -> None:
        """Store an image, once; drop those that no later one will be compared with."""
        oldest_s = min((image.timestamp_s for image in self.before(frame)), default=frame.timestamp_s)
        kept = [image for image in self._images if oldest_s <= image.timestamp_s < frame.timestamp_s]
        self._images = [*kept, EarlierImage(frame.image.index, frame.timestamp_s, view, T_cam_world.copy())]
