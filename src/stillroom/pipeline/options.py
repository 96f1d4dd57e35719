"""The options of a run: its images, and what it does in addition to tracking. And its outcome."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stillroom.cameras.registry import is_camera, open_camera
from stillroom.data.map import submaps
from stillroom.data.sensor import Sensor
from stillroom.datasets.open import open_dataset
from stillroom.datasets.pairing import Pairing
from stillroom.datasets.selection import parse_range, select
from stillroom.errors import ConfigError
from stillroom.evaluation.report import Evaluation
from stillroom.evaluation.timing import StageClock
from stillroom.pipeline.intake import Intake, Recorded, Streamed
from stillroom.pipeline.live import LiveFigures
from stillroom.pipeline.ornaments import Ornaments
from stillroom.pipeline.untracked import Seen, likely_reason
from stillroom.protocols import Dataset, RunObserver, Schedule, Segmenter
from stillroom.schedule import InOrder
from stillroom.session.map_file import MapFile
from stillroom.session.plausibility import Doubt
from stillroom.system import System
from stillroom.viz.viewer.recording import Destination

OF_SEQUENCES = ("camera", "fps", "frames", "drop", "blackout", "reverse", "pairing", "sensor")
"""What can be asked of a recorded sequence only."""


# What a run came to.


@dataclass
class RunOutcome:
    """What a run came to.

    Attributes:
        method: Its name.
        folder: Where its results lie; None where nothing was to be written.
        system: As it is after the last frame: trajectories, results of all frames, the map.
        clock: Times of the stages.
        sensor: What kind of camera took the images.
        left_out: What of the method does not work with it and was left out.
        evaluation: Its figures; None without ground truth, or with a trajectory that cannot be compared to it.
        has_groundtruth: Whether the sequence came with a ground truth, be it one that cannot be used.
        n_given: Images that the run was given, those that cannot be read among them.
        n_unpaired: Images of the same stretch that were recorded, but left out for want of a depth image.
        interrupted: Whether it was stopped before the last image, or the camera was gone.
        bad: Number and time [s] of each image that cannot be read; the time is NaN where nobody knows it.
        pictures: What was drawn.
        ornaments: Counts the pictures that could not be drawn.
        map_file: Where the map was written; None if it was not.
        localized_in: The map of earlier runs in which it began; None where the run made a map of its own.
        masks: The folder of the masks of dynamic pixels of each frame; None if none were written.
        doubts: What is probably wrong with calibration, depth or times; each was said in the log.
        seen: What the images were like.
        live: Delays, dropped images and workers of a live run; None of one in order.
        warnings: What was warned of in the log.
        report: Where the report was written; None if it was not.
    """

    method: str
    folder: Path | None
    system: System
    clock: StageClock
    sensor: Sensor = Sensor.RGBD
    left_out: tuple[str, ...] = ()
    evaluation: Evaluation | None = None
    has_groundtruth: bool = False
    n_given: int = 0
    n_unpaired: int = 0
    interrupted: bool = False
    bad: list[tuple[int, float]] = field(default_factory=list)
    pictures: tuple[Path, ...] = ()
    ornaments: Ornaments = field(default_factory=Ornaments)
    map_file: Path | None = None
    localized_in: Path | None = None
    masks: Path | None = None
    doubts: list[Doubt] = field(default_factory=list)
    seen: Seen = field(default_factory=Seen)
    live: LiveFigures | None = None
    warnings: list[str] = field(default_factory=list)
    report: Path | None = None

    @property
    def n_bad(self) -> int:
        """Images that cannot be read."""
        return len(self.bad)

    @property
    def n_recorded(self) -> int:
        """Images that were recorded, which the coverage is a share of: those given, and those left out before."""
        return self.n_given + self.n_unpaired

    @property
    def n_tracked(self) -> int:
        """Images that have a pose; those in sub-maps that were never merged have none in the trajectory."""
        return sum(result.T_world_cam is not None for result in self.system.results) - self.n_apart

    @property
    def why_untracked(self) -> str | None:
        """The likely reason, in one line, for which no image has a pose; None where one has, or none was given."""
        had_pose = any(result.T_world_cam is not None for result in self.system.results)
        if self.n_given == 0 or (had_pose and not self.system.map.is_empty):
            return None
        if had_pose:
            return (
                "every map that was begun was lost soon after, and dropped; does the camera move slowly and steadily?"
            )
        return likely_reason(self.seen, self.system.results, self.localized_in, self.sensor)

    @property
    def n_apart(self) -> int:
        """Images that were tracked in sub-maps that were never merged with the main one, or were dropped."""
        return len(self.system.apart())

    @property
    def n_dropped(self) -> int:
        """Images that were tracked in maps that were dropped."""
        world = self.system.map
        kept = submaps.unjoined(world)
        return sum(world.keyframes.submap[result.reference_keyframe] not in kept for result in self.system.apart())


@dataclass(frozen=True)
class Source:
    """A sequence, and the part of it that a run sees. Ranges are `a:b` as Python slices.

    Attributes:
        sequence: A folder, an archive, a known name, or `synthetic:…`; for a run, `camera:…` as well.
        camera: The calibration to use, a name or a file; by default the sequence's own.
        fps: Frames per second [1/s] of a folder whose file names or lists have no times.
        frames: Images to keep; all by default.
        drop: Images to leave out.
        blackout: Images that arrive black, without depth.
        reverse: Whether what is left is played backwards.
        pairing: How times are read and images are paired.
        sensor: As what kind of camera's the images are used: rgbd, stereo or monocular; by default what they are.
    """

    sequence: str
    camera: str | None = None
    fps: float | None = None
    frames: str | None = None
    drop: tuple[str, ...] = ()
    blackout: tuple[str, ...] = ()
    reverse: bool = False
    pairing: Pairing = field(default_factory=Pairing)
    sensor: str | None = None

    def open(self) -> Dataset:
        """Open it.

        Raises:
            DatasetError, CalibrationError, TrajectoryError, ConfigError: It cannot be opened; see `open_dataset`
                and `select`.
        """
        if is_camera(self.sequence):
            raise ConfigError(
                f"{self.sequence}: is a camera, and this needs a sequence; make one of it with 'stillroom record'"
            )
        whole = open_dataset(self.sequence, self.camera, self.fps, self.pairing, self.sensor)
        return select(whole, self.frames, self.drop, self.blackout, self.reverse)

    def intake(self) -> Intake:
        """Open it, be it a sequence or a camera, which is not started yet.

        Raises:
            StillroomError: It cannot be opened; see `open` and `open_camera`.
            ConfigError: An option needs a sequence that is known from end to end.
        """
        if not is_camera(self.sequence):
            return Recorded(self.open())
        odd = [name for name in OF_SEQUENCES if getattr(self, name) != getattr(Source(self.sequence), name)]
        if odd:
            asked = ", ".join("how images are paired" if name == "pairing" else f"--{name}" for name in odd)
            raise ConfigError(
                f"{self.sequence}: {asked}: for recorded sequences only; leave it out, or record one first, "
                "with 'stillroom record'"
            )
        return Streamed(open_camera(self.sequence))


@dataclass(frozen=True)
class RunOptions:
    """What a run does in addition to tracking. Only `detector_off` and `segmenter` change poses.

    Attributes:
        root: Where a folder `<date>_<method>_<sequence>` is made; None to write nothing.
        folder: The folder to write into instead; it must be new or empty.
        pictures: How many frames are drawn, spread evenly; 0 for none, and no plots either.
        detector_off: Ranges of image numbers, first and one past the last, in which the detector finds nothing.
        segmenter: Used instead of the config's, if it was built already.
        observe: Makes an observer of the system that is run.
        source: Where the images come from; noted in config.toml.
        asked: Further entries to note there.
        map: The map file to make, to extend, or to localize in.
        masks: The folder into which the mask of dynamic pixels of each frame is written; None to write none.
        schedule: When work runs; that of `segmenter` too. A live one plays the images at their own times.
        speed: Under a live schedule, seconds of a recording that are played in one; 0: one image after the other.
        viewers: Where the run is shown while it goes on.
        report: Whether `report.html` is written at the end.
        formats: In which plots are drawn beside PNG: "svg", "pdf".
        warned: What was warned of before the run, for its report.
    """

    root: Path | None = Path("results")
    folder: Path | None = None
    pictures: int = 8
    detector_off: tuple[tuple[int, int], ...] = ()
    segmenter: Segmenter | None = None
    observe: Callable[[System], RunObserver] | None = None
    source: Source | None = None
    asked: dict[str, Any] = field(default_factory=dict)
    map: MapFile | None = None
    masks: Path | None = None
    schedule: Schedule = field(default_factory=InOrder)
    speed: float = 1.0
    viewers: tuple[Destination, ...] = ()
    report: bool = True
    formats: tuple[str, ...] = ()
    warned: tuple[str, ...] = ()


def detector_ranges(texts: Iterable[str], dataset: Dataset) -> tuple[tuple[int, int], ...]:
    """Read the ranges `a:b` in which the detector is to find nothing: image numbers, first and one past the last.

    They are read in numbers of the original, and returned in those of the sequence as it is played.

    Raises:
        ConfigError: A range is malformed or empty.
    """
    length = dataset.original_length
    ranges = []
    for text in texts:
        first, end, step = parse_range(text).indices(length)
        if step != 1 or first >= end:
            raise ConfigError(
                f"detector-off {text}: no such range of images; there are {length}, write it like 300:330"
            )
        # Images of a sequence that is played backwards are numbered from its end.
        ranges.append((length - end, length - first) if dataset.is_reversed else (first, end))
    return tuple(ranges)
