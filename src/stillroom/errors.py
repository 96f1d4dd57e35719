"""The errors that Stillroom raises on purpose. The command line prints each as one line.

::

    StillroomError
    ├── ConfigError            a key, a value or a combination of options that is not valid
    ├── CalibrationError       a camera that is unknown, incomplete or impossible
    ├── DatasetError           a sequence that cannot be opened
    │   └── FrameError         one frame of it that cannot be read; a run continues without it
    ├── CameraError            a live camera that does not start, or has gone
    ├── TrajectoryError        a trajectory or ground truth that cannot be read or compared
    ├── MapError               a map that cannot be read, written or exported
    ├── WeightsError           a network's weights that are absent or not what they claim to be
    ├── VocabularyError        a vocabulary of places that is absent or not what it claims to be
    ├── DownloadError          a file that could not be fetched, or came with the wrong checksum
    └── MissingExtraError      an optional library that is not installed

Each message says what is wrong, where, and what to do about it.
"""

import errno


class StillroomError(Exception):
    """Base of every error that Stillroom raises on purpose."""


NO_MEMORY = (
    "there was not enough memory; close other programs, or give less at a time [see troubleshooting: out-of-memory]"
)


def is_of_memory(error: BaseException) -> bool:
    """Return whether an error, or one that it came of, is a library's word for memory that could not be had.

    Python and numba say `MemoryError`, the system ENOMEM, OpenCV its own error with the code -4 or C++'s `bad_alloc`.
    """
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, MemoryError) or (isinstance(seen, OSError) and seen.errno == errno.ENOMEM):
            return True
        if type(seen).__module__ == "cv2" and (getattr(seen, "code", 0) == -4 or "bad_alloc" in str(seen)):
            return True
        seen = seen.__cause__ or seen.__context__
    return False


class ConfigError(StillroomError):
    """A configuration key, value or combination of options is wrong."""


class CalibrationError(StillroomError):
    """A camera is unknown, incomplete or impossible."""


class DatasetError(StillroomError):
    """A sequence cannot be opened."""


class FrameError(DatasetError):
    """One frame of a sequence cannot be read; the others may be fine."""


class CameraError(StillroomError):
    """A live camera does not start, or has gone."""


class TrajectoryError(StillroomError):
    """A trajectory cannot be read, or two of them cannot be compared."""


class MapError(StillroomError):
    """A map cannot be read, written or exported."""


class WeightsError(StillroomError):
    """A network's weights are absent or not what they claim to be."""


class VocabularyError(StillroomError):
    """A vocabulary of places is absent or not what it claims to be."""


class DownloadError(StillroomError):
    """A file could not be fetched, or came with the wrong checksum."""


class MissingExtraError(StillroomError):
    """An optional library is not installed."""

    def __init__(self, library: str, extra: str) -> None:
        """Name the missing library and the command that installs it."""
        super().__init__(f"{library} is not installed: pip install 'stillroom[{extra}]'")
