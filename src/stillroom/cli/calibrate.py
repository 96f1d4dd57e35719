"""`stillroom calibrate`: what a recording says of the camera that took it."""

from typing import Annotated

import typer

from stillroom.cli.arguments import CameraName, ConfigFile, Fps, Frames, Seed, Settings
from stillroom.errors import ConfigError

STATIC = "orb-slam2"
"""The method that rejects nothing: enough for a room in which nothing moves."""

app = typer.Typer(no_args_is_help=True, help="Estimate what a camera file needs from a recording.")


@app.command()
def shutter(
    sequence: Annotated[str, typer.Argument(metavar="SEQUENCE", help="The recording, as for run.")],
    method: Annotated[
        str | None,
        typer.Option(
            "--method", "-m", metavar="NAME", help="What tracks; oc-slam where people walk. \\[default: orb-slam2]"
        ),
    ] = None,
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
    from stillroom.cli.output import STDERR, FrameBar, print_lines, show_log
    from stillroom.cli.warmup import ensure_warm
    from stillroom.data.sensor import Sensor
    from stillroom.datasets.recording import rendered, sensor_of
    from stillroom.pipeline import Source
    from stillroom.pipeline.shutter import calibrate_shutter
    from stillroom.presets.registry import configure

    show_log()
    chosen = configure(method or (STATIC if config is None else None), config, settings or (), seed)
    dataset = Source(sequence, camera, fps, frames).open()
    if sensor_of(dataset) is not Sensor.RGBD:
        raise ConfigError(f"{dataset.name}: has no depth images, from which a readout is told")
    ensure_warm(STDERR, rendered(dataset) is not None)
    bar = FrameBar(STDERR)
    bar.label = "calibrating"
    calibration = calibrate_shutter(dataset, chosen, bar)
    print_lines([dataset.name, *calibration.sentences()])
    typer.echo(calibration.line)
