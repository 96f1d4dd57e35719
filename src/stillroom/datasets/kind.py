"""What a kind of data set is: how it is recognised, and how it is opened."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from stillroom.data.sensor import Sensor
from stillroom.datasets.pairing import Pairing
from stillroom.protocols import Dataset


@dataclass(frozen=True)
class SequenceRequest:
    """What the user asked for.

    Attributes:
        text: As given on the command line: a path, a bare name, or `kind:…`.
        path: The file or folder that it leads to; that of an unpacked archive is a folder in the cache. None before it
            is looked up: `recognises` is called with the text alone first.
        name: What the sequence is to be called: the name of the folder, or of the archive where that has none; empty
            while there is no path.
        pairing: How times are to be read and images to be paired; for kinds with `takes_pairing`.
        sensor: As what kind of camera's its images are to be used; None for what they are. A kind need not heed it: of
            a sequence of another sensor, `open_dataset` drops what a single camera has not, and refuses the rest.
    """

    text: str
    path: Path | None = None
    name: str = ""
    pairing: Pairing = field(default_factory=Pairing)
    sensor: Sensor | None = None

    @property
    def prefix(self) -> str:
        """What stands before the first colon: "synthetic" in `synthetic:walking`."""
        return self.text.partition(":")[0]

    @property
    def folder(self) -> Path | None:
        """The path, where it is that of a folder."""
        return self.path if self.path is not None and self.path.is_dir() else None


@dataclass(frozen=True)
class DatasetKind:
    """A kind of data set.

    Attributes:
        name: What the kind is called; where it is recognised by a prefix, the same word.
        summary: One line: what is read.
        recognises: Whether this kind opens what is asked for. Called with the text alone first, then with the file or
            folder that it leads to; reads file names only.
        open: Opens it. Given what is asked for; the calibration asked for, a name or a file, if any; and the frames
            per second [1/s], if given. It raises `DatasetError`, `CalibrationError` or `TrajectoryError` where the
            sequence cannot be opened, and `ConfigError` where an option does not go with this kind.
        takes_pairing: Whether `SequenceRequest.pairing` is heeded. Where it is not, asking for any is an error.
    """

    name: str
    summary: str
    recognises: Callable[[SequenceRequest], bool]
    open: Callable[[SequenceRequest, str | None, float | None], Dataset]
    takes_pairing: bool = False
