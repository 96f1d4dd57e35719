"""`stillroom calibrate`: what a recording says of the camera that took it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillroom.cli.arguments import CameraName, ConfigFile, Fps, Frames, Seed, Settings
from stillroom.errors import ConfigError

if TYPE_CHECKING:
    from stillroom.cli.output import FrameBar
    from stillroom.config import SlamConfig
    from stillroom.protocols import Dataset

STATIC = "orb-slam2"
"""The method that rejects nothing: enough for a room in which nothing moves."""

app = typer.Typer(no_args_is_help=True, help="Estimate what a camera file needs from a recording.")


Method = Annotated[
    str | None,
    typer.Option(
        "--method", "-m", metavar="NAME", help="What tracks; oc-slam where people walk. \\[default: orb-slam2]"
    ),
]
Recorded = Annotated[str, typer.Argument(metavar="SEQUENCE", help="The recording, as for run.")]


@app.command()
def shutter(
    sequence: Recorded,
    method: Method = None,
    config: ConfigFile = None,
    frames: Frames = None,
    fps: Fps = None,
    camera: CameraName = None,
    settings: Settings = None,
    seed: Seed = None,
) -> None:
    """Estimate the readout of a rolling shutter: the time from the first row of a colour image to the last.

    No ground truth is needed, but a camera that turns back and forth in a room; a camera at rest is refused. Prints the
    line for the camera file. Its own readout does not count; depth is taken to be of the middle of each image.

        stillroom calibrate shutter my-room
        stillroom calibrate shutter synthetic:empty,path=rpy,frames=120,readout_ms=25
    """
    from stillroom.pipeline.shutter import calibrate_shutter

    dataset, chosen, bar = _opened(sequence, method, config, frames, fps, camera, settings, seed)
    calibration = calibrate_shutter(dataset, chosen, bar)
    _print(dataset, calibration.sentences(), [calibration.line])


@app.command()
def depth(
    sequence: Recorded,
    method: Method = None,
    config: ConfigFile = None,
    frames: Frames = None,
    fps: Fps = None,
    camera: CameraName = None,
    settings: Settings = None,
    seed: Seed = None,
) -> None:
    """Estimate the scale of depth, and the offset between the clocks of colour and depth.

    The offset needs no ground truth, but a camera that moves to and fro in a room. The scale needs it: images of a room
    twice as large, from twice as far, are the same. Prints lines for the camera file, which change nothing until they
    are in it.

        stillroom calibrate depth my-room
        stillroom calibrate depth synthetic:empty,frames=150,depth_late_ms=15
    """
    from stillroom.pipeline.depth import calibrate_depth

    dataset, chosen, bar = _opened(sequence, method, config, frames, fps, camera, settings, seed)
    calibration = calibrate_depth(dataset, chosen, bar)
    _print(dataset, calibration.sentences(), calibration.lines())


def _opened(
    sequence: str,
    method: str | None,
    config: Path | None,
    frames: str | None,
    fps: float | None,
    camera: str | None,
    settings: list[str] | None,
    seed: int | None,
) -> tuple["Dataset", "SlamConfig", "FrameBar"]:
    """Return the recording, what tracks it, and a bar that says how far it is."""
    from stillroom.cli.output import STDERR, FrameBar, show_log
    from stillroom.cli.warmup import ensure_warm
    from stillroom.data.sensor import Sensor
    from stillroom.datasets.recording import rendered, sensor_of
    from stillroom.pipeline import Source
    from stillroom.presets.registry import configure

    show_log()
    chosen = configure(method or (STATIC if config is None else None), config, settings or (), seed)
    dataset = Source(sequence, camera, fps, frames).open()
    if sensor_of(dataset) is not Sensor.RGBD:
        raise ConfigError(f"{dataset.name}: has no depth images, and what calibrates a camera reads them")
    ensure_warm(STDERR, rendered(dataset) is not None)
    bar = FrameBar(STDERR)
    bar.label = "calibrating"
    return dataset, chosen, bar


def _print(dataset: "Dataset", sentences: list[str], lines: list[str]) -> None:
    """Say what was found, and print the lines for a camera file."""
    from stillroom.cli.output import print_lines

    print_lines([dataset.name, *sentences])
    for line in lines:
        typer.echo(line)
