"""`stillroom inpaint`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillroom.cli.arguments import (
    MAX_GAP_S,
    CameraName,
    ConfigFile,
    DepthOffset,
    Fps,
    Frames,
    MaxGap,
    Method,
    Out,
    PairBy,
    Seed,
    Settings,
    TimeUnit,
)
from stillroom.errors import ConfigError
from stillroom.stopping import INTERRUPTED

if TYPE_CHECKING:
    from stillroom.config import SlamConfig
    from stillroom.pipeline import RunOutcome, Source
    from stillroom.pipeline.inpainted_sequence import InpaintingRecorder, InpaintingRecorderConfig
    from stillroom.protocols import Dataset
    from stillroom.system import System

MAP_EVERY = 30


def inpaint(
    sequence: Annotated[
        str, typer.Argument(metavar="SEQUENCE", help="A folder, an archive, a known name, or synthetic:walking.")
    ],
    method: Method = None,
    frames: Frames = None,
    every: Annotated[
        int, typer.Option(min=0, metavar="N", help="Write every N-th frame as an image; 0: none, the video only.")
    ] = 1,
    video: Annotated[
        str, typer.Option(metavar="NAME", help="Name of the video, .mp4 or .avi; '' for none.")
    ] = "inpainted.mp4",
    from_map: Annotated[
        bool, typer.Option("--from-map", help="Fill what no keyframe saw from the dense map, if the method makes one.")
    ] = False,
    seed: Seed = None,
    camera: CameraName = None,
    fps: Fps = None,
    time_unit: TimeUnit = None,
    pair_by: PairBy = None,
    max_gap: MaxGap = MAX_GAP_S,
    depth_offset: DepthOffset = 0.0,
    out: Out = None,
    settings: Settings = None,
    config: ConfigFile = None,
) -> None:
    """Remove what moves from the images, painted over by what the last keyframes saw behind it.

    Tracks the camera as 'run' does. Writes inpainted/inpainted_00042.png and so on, a video, and inpainting.png, which
    shows some frames before and after. Pixels that no keyframe had seen by then stay black. On rendered people it
    reports the PSNR against the room without them.

        stillroom inpaint rgbd_bonn_crowd --frames 200:560
        stillroom inpaint synthetic:walking --set semantics.kind=truth --every 10
    """
    from stillroom.datasets.pairing import Pairing
    from stillroom.pipeline import Source
    from stillroom.pipeline.inpainted_sequence import InpaintingRecorderConfig
    from stillroom.presets.registry import configure

    chosen = configure(method, config, settings or (), seed)
    wanted = InpaintingRecorderConfig(every=every, video=video, map_every=MAP_EVERY if from_map else 0)
    pairing = Pairing(time_unit, pair_by, max_gap, depth_offset)
    _paint(chosen, Source(sequence, camera, fps, frames, pairing=pairing), wanted, out)


def _paint(chosen: "SlamConfig", source: "Source", wanted: "InpaintingRecorderConfig", out: Path | None) -> None:
    from stillroom.cli.output import STDERR, RunBar, say, show_log
    from stillroom.cli.warmup import ensure_warm
    from stillroom.config.sensors import NO_DEPTH_IMAGE, has_depth_image
    from stillroom.datasets.recording import rendered, sensor_of
    from stillroom.pipeline import RunOptions, run
    from stillroom.pipeline.results import chosen_folder, new_folder
    from stillroom.system import segmenter_of

    show_log()
    dataset = source.open()
    kind = sensor_of(dataset)
    if not has_depth_image(chosen, kind):
        why = NO_DEPTH_IMAGE[kind]
        raise ConfigError(f"{dataset.name}: painting over what moves needs depth images, and {why}")
    # Now: a missing file is reported before kernels are compiled.
    segmenter = segmenter_of(chosen, dataset.camera, sensor=kind)
    folder = chosen_folder(out) if out is not None else new_folder(Path("results"), chosen.method, dataset.name)
    say(f"{chosen.method} on {dataset.name}: {len(dataset)} images; camera: {dataset.camera_source}")
    ensure_warm(STDERR, rendered(dataset) is not None)
    made: list[InpaintingRecorder] = []

    def observe(system: "System") -> "InpaintingRecorder":
        made.append(_recorder(wanted, folder, dataset, system))
        return made[0]

    options = RunOptions(folder=folder, pictures=0, segmenter=segmenter, observe=observe, source=source)
    try:
        outcome = run(dataset, chosen, options, RunBar(STDERR))
    finally:
        for recorder in made:
            recorder.close()
    _report(outcome, made[0])
    if outcome.interrupted:
        raise typer.Exit(INTERRUPTED)


def _recorder(
    wanted: "InpaintingRecorderConfig", folder: Path, dataset: "Dataset", system: "System"
) -> "InpaintingRecorder":
    """Return a recorder with frames for its sheet from all over the sequence, at the pace of its images."""
    import numpy as np

    from stillroom.pipeline.inpainted_sequence import painted_error

    numbers, stamps_s = dataset.numbers, dataset.timestamps_s
    places = (np.arange(wanted.on_sheet) + 0.9) * len(numbers) / max(1, wanted.on_sheet)
    chosen = [int(number) for number in numbers[np.unique(places.astype(np.int64))]]
    pace_hz = 1.0 / float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 30.0
    return wanted.build(folder, dataset.camera, system, chosen, pace_hz, painted_error(dataset))


def _report(outcome: "RunOutcome", recorder: "InpaintingRecorder") -> None:
    from stillroom.cli.output import print_lines
    from stillroom.evaluation.report import percent

    filled = recorder.share.filled
    lines = [f"{outcome.n_tracked} of {outcome.n_given} frames tracked, {recorder.n_frames} painted"]
    if outcome.interrupted:
        lines.append(f"stopped after {outcome.n_given} images")
    lines.append("nothing moved" if filled is None else f"{percent(filled)} of what moved could be painted over")
    error = recorder.error
    if error is not None and error.psnr_db is not None:
        lines.append(
            f"PSNR {error.psnr_db:.1f} dB against the room without people, over the {error.n_pixels} painted pixels of "
            f"{error.n_frames} frames"
        )
    lines.append(f"results: {outcome.folder}")
    print_lines(lines)
