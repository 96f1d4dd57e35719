"""Keep what a camera sees as a sequence."""

import logging
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from stillroom.cameras.recorder import TumRecorder
from stillroom.errors import CameraError, ConfigError, FrameError, StillroomError
from stillroom.pipeline.results import chosen_folder
from stillroom.pipeline.run import SILENT, RunProgress
from stillroom.pipeline.stop_request import StopRequest
from stillroom.protocols import CameraStream

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RecordingOutcome:
    """What a recording came to.

    Attributes:
        folder: Where it lies.
        n_written: Images in it.
        n_dropped: Images that came faster than they could be written.
        n_not_later: Images whose time was not after that of the image before.
        n_unreadable: Images that the camera could not deliver.
        is_gone: Whether the camera ended it.
    """

    folder: Path
    n_written: int
    n_dropped: int
    n_not_later: int
    n_unreadable: int
    is_gone: bool


def record(
    camera: CameraStream,
    folder: Path,
    n_frames: int | None = None,
    seconds: float | None = None,
    progress: RunProgress = SILENT,
) -> RecordingOutcome:
    """Keep the images of a camera as a folder in TUM's layout, with its calibration.

    Ctrl-C ends it, and so does a camera that is gone; what has come by then is written all the same.

    Args:
        camera: The camera, entered.
        folder: A new or empty folder.
        n_frames: End after so many images.
        seconds: End with the first image that was taken so long after the first one [s].
        progress: Receives the progress.

    Raises:
        ConfigError: The folder is not empty, or a limit is impossible.
        StillroomError: Something cannot be written, or no image came at all.
    """
    if n_frames is not None and n_frames < 1:
        raise ConfigError(f"frames is {n_frames}; at least one image must be recorded")
    if seconds is not None and not seconds > 0:
        raise ConfigError(f"seconds is {seconds}; it must be a positive number")
    session = _Session(n_frames, seconds)
    with StopRequest() as stop, TumRecorder(chosen_folder(folder), camera) as recorder, ExitStack() as shown:
        progress.start(n_frames)
        shown.callback(progress.finish)
        while not stop.asked and session.next(camera, recorder):
            progress.frame(None)
        stop.hold()
    if recorder.n_written == 0:
        raise StillroomError(f"{folder}: the camera delivered no image, so there is no sequence")
    return RecordingOutcome(
        folder, recorder.n_written, recorder.n_dropped, recorder.n_not_later, session.n_unreadable, session.is_gone
    )


class _Session:
    """Passes images from a camera to a recorder, until a limit is reached or nothing comes any more."""

    def __init__(self, n_frames: int | None, seconds: float | None) -> None:
        self._n_frames, self._seconds = n_frames, seconds
        self._n_kept, self._first_s = 0, 0.0
        self.n_unreadable, self.is_gone = 0, False

    def next(self, camera: CameraStream, recorder: TumRecorder) -> bool:
        """Pass one on; return whether there may be another."""
        try:
            image = camera.next()
            if image is None:
                return False
            if self._n_kept == 0:
                self._first_s = image.timestamp_s
            if self._seconds is not None and image.timestamp_s - self._first_s >= self._seconds:
                return False
            self._n_kept += recorder.keep(image)
        except FrameError as error:
            self.n_unreadable += 1
            log.warning("an image is left out: %s", error)
        except CameraError as error:
            self.is_gone = True
            log.error("%s; the recording ends here [see troubleshooting: camera]", error)
        return not self.is_gone and self._n_kept != self._n_frames
