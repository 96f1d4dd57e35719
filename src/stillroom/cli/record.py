"""`stillroom record`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillroom.errors import ConfigError

if TYPE_CHECKING:
    from stillroom.pipeline.recording import RecordingOutcome

ENDED_BY_CAMERA = 1


def record(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="camera:realsense, camera:oak, or camera:replay:….")],
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new folder for the sequence.")],
    frames: Annotated[int | None, typer.Option("--frames", metavar="N", help="End after N images.")] = None,
    seconds: Annotated[float | None, typer.Option("--seconds", metavar="S", help="End after S seconds.")] = None,
) -> None:
    """Keep what a camera sees as a sequence.

    Writes a folder in TUM's layout with the camera's own calibration. Ctrl-C ends the recording; what has come by then
    is whole. 'stillroom run FOLDER' tracks it, as often as you like.

        stillroom record camera:realsense my-room --seconds 60
        stillroom run my-room
    """
    from stillroom.cameras.registry import is_camera, open_camera
    from stillroom.cli.output import STDERR, FrameBar, say, show_log
    from stillroom.data.sensor import Sensor
    from stillroom.datasets.recording import sensor_of
    from stillroom.pipeline import recording

    show_log()
    if not is_camera(camera):
        raise ConfigError(f"{camera}: is no camera; name one like camera:realsense")
    opened = open_camera(camera)
    if sensor_of(opened) is not Sensor.RGBD:
        raise ConfigError(f"{camera}: has no depth images; what is recorded is colour and depth")
    bar = FrameBar(STDERR)
    bar.label = "recording"
    with opened as stream:
        end = "" if frames or seconds else "; Ctrl-C ends it"
        say(f"recording {stream.name} into {folder}; camera: {stream.camera_source}{end}")
        outcome = recording.record(stream, folder, frames, seconds, bar)
    _report(outcome)
    if outcome.is_gone:
        raise typer.Exit(ENDED_BY_CAMERA)


def _report(outcome: "RecordingOutcome") -> None:
    from stillroom.cli.output import print_lines

    lost = {
        "came faster than they could be written": outcome.n_dropped,
        "were not taken after the one before them": outcome.n_not_later,
        "could not be read": outcome.n_unreadable,
    }
    lines = [f"{outcome.n_written} images recorded"]
    lines += [f"not recorded, as they {why}: {n}" for why, n in lost.items() if n]
    print_lines([*lines, f"sequence: {outcome.folder}"])
