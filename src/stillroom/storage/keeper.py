"""Writing the map of a run to disk while it grows."""

from collections import deque
from dataclasses import dataclass

from stillroom.data.image import Image
from stillroom.data.result import FrameSummary
from stillroom.errors import MapError
from stillroom.geometry.arrays import Bool
from stillroom.geometry.camera import Camera
from stillroom.protocols import Parts
from stillroom.storage.pictures import compress
from stillroom.storage.schema import FrameNote
from stillroom.storage.writer import MapWriter


@dataclass(frozen=True)
class MapKeeperConfig:
    """What a map file keeps in addition to the map.

    Attributes:
        images: Whether depth and colours of keyframes are kept, for dense maps made later; about 0.3 MB a keyframe.
    """

    images: bool = False

    def build(self, parts: Parts, writer: MapWriter, session: int) -> "MapKeeper":
        """Return the keeper of a session's map, by the session's number."""
        return MapKeeper(self, writer, session, parts.camera)


class MapKeeper:
    """Writes a map as it grows: a commit for each keyframe, with the frames that were tracked since the last one."""

    def __init__(self, config: MapKeeperConfig, writer: MapWriter, session: int, camera: Camera) -> None:
        """Start before the first frame."""
        self.config = config
        self._writer, self._session, self._camera = writer, session, camera
        self._frames: deque[FrameNote] = deque()

    def keep(self, keyframe: int, image: Image, moving: Bool) -> None:
        """Write a new keyframe, and all that it changed.

        Args:
            keyframe: Its id.
            image: Its image.
            moving: Dynamic pixels (H, W).

        Raises:
            MapError: The disk is full, or the like.
        """
        wanted = self.config.images and image.has_depth_image
        pictures = compress(keyframe, image, moving, self._camera.depth_factor) if wanted else None
        frames = self._taken_frames()
        try:
            self._writer.commit(frames, pictures)
        except MapError:
            self._frames.extendleft(reversed(frames))  # for the next commit, should there be room by then
            raise

    def note(self, result: FrameSummary) -> None:
        """Store the pose of a frame, until it is written."""
        frame = FrameNote.of(result, self._session)
        if frame is not None:
            self._frames.append(frame)

    def close(self) -> None:
        """Write what is left, and leave one file.

        Raises:
            MapError: The disk is full, or the like.
        """
        self._writer.close(self._taken_frames())

    def _taken_frames(self) -> list[FrameNote]:
        """Return the frames stored so far, once; another thread may add more meanwhile."""
        return [self._frames.popleft() for _ in range(len(self._frames))]


class NoKeeper:
    """The null object: writes nothing, so that no caller has to check whether there is a file."""

    def keep(self, keyframe: int, image: Image, moving: Bool) -> None:
        """Do nothing."""

    def note(self, result: FrameSummary) -> None:
        """Do nothing."""
