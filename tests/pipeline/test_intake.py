"""What delivers the images of a run, and a run whose images come from a camera."""

import csv
import math
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import pytest

from stillroom.config import SlamConfig
from stillroom.data.image import RgbdImage
from stillroom.data.trajectory import read_tum
from stillroom.datasets.selection import select
from stillroom.errors import CameraError, FrameError, StillroomError
from stillroom.pipeline import Recorded, RunOptions, Streamed, run
from stillroom.pipeline.intake import intake_of
from stillroom.protocols import Dataset
from stillroom.semantics.truth import TrueSemanticsConfig

CONFIG = SlamConfig(semantics=TrueSemanticsConfig())
BAD, GONE = FrameError("depth came without colour"), CameraError("the camera: has sent nothing for 5 s")


class Scripted:
    """A camera that delivers what a script says: images, and errors in their place."""

    groundtruth = groundtruth_at_camera = None
    comes_in_time = False

    def __init__(self, dataset: Dataset, script: Iterable[int | StillroomError]) -> None:
        self.name, self.camera, self.camera_source = "scripted", dataset.camera, "the script"
        self._dataset, self._script = dataset, iter(script)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        pass

    def next(self) -> RgbdImage | None:
        step = next(self._script, None)
        if isinstance(step, StillroomError):
            raise step
        return None if step is None else self._dataset.load(step)


class Counted:
    """Remembers what a run says of its progress."""

    def __init__(self) -> None:
        self.n_frames: list[int | None] = []
        self.n_done = 0

    def start(self, n_frames: int | None) -> None:
        self.n_frames.append(n_frames)

    def frame(self, result: object) -> None:
        self.n_done += 1

    def finish(self) -> None:
        self.n_frames.append(-1)


def test_a_recording_is_read_one_image_at_a_time(room: Dataset) -> None:
    intake = intake_of(select(room, "10:40:3"))
    assert isinstance(intake, Recorded)
    assert intake_of(intake) is intake
    assert intake.n_images == 10
    arrivals = list(intake.arrivals())
    assert [arrival.number for arrival in arrivals] == list(range(10, 40, 3))
    assert [arrival.time_s for arrival in arrivals] == [room.timestamps_s[k] for k in range(10, 40, 3)]
    last = arrivals[-1].load()
    assert (last.index, last.timestamp_s) == (37, arrivals[-1].time_s)
    assert intake.spread(2) == (16, 31)


def test_a_camera_delivers_until_it_ends(room: Dataset) -> None:
    intake = Streamed(Scripted(room, [0, BAD, 2]))
    first, bad, last = intake.arrivals()
    assert (intake.n_images, intake.n_unpaired(3), intake.spread(3)) == (None, 0, (30, 60, 120))
    assert (first.number, first.time_s, first.load().index) == (0, room.timestamps_s[0], 0)
    assert bad.number == 1
    assert math.isnan(bad.time_s)
    with pytest.raises(FrameError, match="without colour"):
        bad.load()
    assert (last.number, last.load().index) == (2, 2)


def test_a_run_from_a_camera_is_that_of_its_images(room: Dataset, tmp_path: Path) -> None:
    progress = Counted()
    folders = [tmp_path / name for name in ("recorded", "streamed")]
    run(select(room, ":20"), CONFIG, RunOptions(folder=folders[0], pictures=0))
    outcome = run(Streamed(Scripted(room, range(20))), CONFIG, RunOptions(folder=folders[1], pictures=0), progress)
    assert (outcome.n_given, outcome.n_tracked, outcome.interrupted) == (20, 20, False)
    assert (progress.n_frames, progress.n_done) == ([None, -1], 20)
    assert len({(folder / "trajectory.tum").read_bytes() for folder in folders}) == 1
    assert 'name = "scripted"' in (folders[1] / "config.toml").read_text(encoding="utf-8")


def test_a_camera_that_is_gone_ends_the_run_as_ctrl_c_does(
    room: Dataset, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "out"
    camera = Scripted(room, [*range(9), BAD, *range(10, 15), GONE])
    outcome = run(Streamed(camera), CONFIG, RunOptions(folder=folder, pictures=0))
    assert outcome.interrupted
    assert (outcome.n_given, outcome.n_bad, outcome.n_tracked) == (15, 1, 14)
    assert caplog.messages == [
        "image 9 is left out: depth came without colour",
        "the camera: has sent nothing for 5 s; the run ends here [see troubleshooting: camera]",
    ]
    assert len(read_tum(folder / "trajectory.tum")) == 14
    with (folder / "frames.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == ["unreadable" if k == 9 else "ok" for k in range(15)]
    assert rows[9]["timestamp_s"] == ""
    assert np.allclose([float(row["timestamp_s"]) for row in rows[10:]], room.timestamps_s[10:15], atol=1e-6)
