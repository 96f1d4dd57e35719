"""`stillroom run`."""

from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stillroom.cli.arguments import (
    MAX_GAP_S,
    PLOT_FORMATS,
    CameraName,
    ConfigFile,
    DepthOffset,
    Formats,
    Fps,
    Frames,
    MaxGap,
    Method,
    Out,
    PairBy,
    Seed,
    SensorName,
    Settings,
    TimeUnit,
    chosen_of,
)
from stillroom.errors import ConfigError
from stillroom.stopping import INTERRUPTED

if TYPE_CHECKING:
    from stillroom.config import SlamConfig
    from stillroom.datasets.pairing import Pairing
    from stillroom.pipeline import RunOptions, RunOutcome, Source
    from stillroom.session.map_file import MapFile

NOTHING_TRACKED = 3
"""Exit code of a run that went through and found no pose: what comes after it in a script would have nothing."""

Map = Annotated[
    Path | None,
    typer.Option("--map", metavar="FILE", help="Keep the map in this new file, such as room.stillmap, as it grows."),
]
Continue = Annotated[bool, typer.Option("--continue", help="Extend the map of --map; relocalize in it first.")]
Localize = Annotated[bool, typer.Option("--localize", help="Localize in the map of --map, which stays unchanged.")]

Drop = Annotated[list[str] | None, typer.Option(metavar="A:B", help="Drop these frames from the sequence; repeatable.")]
Blackout = Annotated[
    list[str] | None, typer.Option(metavar="A:B", help="Turn these frames black, without depth; repeatable.")
]
DetectorOff = Annotated[
    list[str] | None, typer.Option(metavar="A:B", help="Disable the detector in these frames; repeatable.")
]
ExportMasks = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Write each frame's moving pixels here, as a PNG named like its colour image."),
]
ScheduleOption = Annotated[
    str,
    typer.Option(
        metavar="NAME", help="in-order: repeatable, on one thread; live: on worker threads, at a camera's pace."
    ),
]
Speed = Annotated[
    float | None,
    typer.Option(
        min=0, metavar="F", help="Live: how fast a recording is played; 1 by default; 0: no image is dropped."
    ),
]
View = Annotated[bool, typer.Option("--view", help="Show the run in rerun's window while it goes on.")]
Rerun = Annotated[
    Path | None,
    typer.Option(metavar="FILE.rrd", help="Write what --view shows into this file; needs no display."),
]
Images = Annotated[
    str,
    typer.Argument(
        metavar="SEQUENCE", help="A folder, an archive, a known name, synthetic:walking, or camera:realsense."
    ),
]


def run(
    sequence: Images,
    method: Method = None,
    frames: Frames = None,
    drop: Drop = None,
    blackout: Blackout = None,
    detector_off: DetectorOff = None,
    reverse: Annotated[bool, typer.Option("--reverse", help="Play the remaining frames backwards.")] = False,
    map_: Map = None,
    continue_: Continue = False,
    localize: Localize = False,
    seed: Seed = None,
    camera: CameraName = None,
    fps: Fps = None,
    time_unit: TimeUnit = None,
    pair_by: PairBy = None,
    max_gap: MaxGap = MAX_GAP_S,
    depth_offset: DepthOffset = 0.0,
    sensor: SensorName = None,
    out: Out = None,
    settings: Settings = None,
    config: ConfigFile = None,
    export_masks: ExportMasks = None,
    schedule: ScheduleOption = "in-order",
    speed: Speed = None,
    view: View = False,
    rerun: Rerun = None,
    pictures: Annotated[int, typer.Option(min=0, metavar="N", help="How many frames to draw; 0: no pictures.")] = 8,
    formats: Formats = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Do not write report.html.")] = False,
) -> None:
    """Track the camera through a sequence.

    Or a camera that is plugged in, until it is stopped; 'stillroom record' keeps what it sees. Writes trajectory,
    figures, pictures and report.html into a folder in results/; Ctrl-C ends a run early and keeps the results so far.
    Exit code 3 says that nothing was tracked. An archive is unpacked once into the user's cache and stays there until
    you delete it.

        stillroom run rgbd_bonn_crowd --method oc-slam
        stillroom run rgbd_bonn_crowd --frames 200: --map room.stillmap --localize
        stillroom run camera:realsense --schedule live --view
    """
    from stillroom.pipeline import RunOptions, Source
    from stillroom.presets.registry import configure

    chosen = configure(method, config, settings or (), seed)
    pairing = _pairing(time_unit, pair_by, max_gap, depth_offset)
    source = Source(sequence, camera, fps, frames, tuple(drop or ()), tuple(blackout or ()), reverse, pairing, sensor)
    map_file = _map_file(map_, continue_, localize)
    options = RunOptions(
        folder=out,
        pictures=pictures,
        source=source,
        asked=map_file.described() if map_file else {},
        map=map_file,
        masks=export_masks,
        **_pace(schedule, speed),
        **_looked_at(view, rerun, formats, no_report),
    )
    _track(chosen, source, options, tuple(detector_off or ()))


def _pairing(time_unit: str | None, pair_by: str | None, max_gap_s: float, depth_offset_s: float) -> "Pairing":
    from stillroom.datasets.pairing import Pairing

    return Pairing(time_unit, pair_by, max_gap_s, depth_offset_s)


def _looked_at(view: bool, rerun: Path | None, formats: list[str] | None, no_report: bool) -> dict[str, Any]:
    """Return where a run is shown, in which formats its plots are drawn, and whether there is a report."""
    from stillroom.cli.view import destinations

    return {
        "viewers": destinations(view, rerun),
        "formats": chosen_of("--format", formats, PLOT_FORMATS),
        "report": not no_report,
    }


def _pace(schedule: str, speed: float | None) -> dict[str, Any]:
    """Return schedule and speed of a run; a speed that is asked for without a live schedule is refused."""
    from stillroom.schedule import schedule_of

    chosen = schedule_of(schedule)
    if speed is None:
        return {"schedule": chosen}
    if schedule != "live":
        raise ConfigError("--speed plays a recording at a camera's pace; it needs --schedule live")
    if not isfinite(speed):
        raise ConfigError(f"--speed is {speed}; it must be a number, such as 1, or 0 for no pace at all")
    return {"schedule": chosen, "speed": speed}


def _map_file(path: Path | None, continue_: bool, localize: bool) -> "MapFile | None":
    """Return the map file and its mode; an unusable one is reported now."""
    from stillroom.session.map_file import MapFile, MapUse

    if path is None:
        if continue_ or localize:
            flag = "--continue" if continue_ else "--localize"
            raise ConfigError(f"{flag} needs a map: name its file with --map")
        return None
    if continue_ and localize:
        raise ConfigError("--continue extends a map and --localize leaves it unchanged; leave one of them out")
    map_file = MapFile(path, MapUse.CONTINUE if continue_ else MapUse.LOCALIZE if localize else MapUse.NEW)
    map_file.require_usable()
    return map_file


def _track(chosen: "SlamConfig", source: "Source", options: "RunOptions", detector_off: tuple[str, ...]) -> None:
    from stillroom.cli.output import STDERR, RunBar, print_error, say, show_log
    from stillroom.cli.warmup import ensure_warm
    from stillroom.config.sensors import fit_to_sensor
    from stillroom.datasets.recording import rendered, sensor_of
    from stillroom.pipeline import Recorded, Streamed
    from stillroom.pipeline import run as run_pipeline
    from stillroom.pipeline.options import detector_ranges
    from stillroom.pipeline.results import chosen_folder
    from stillroom.pipeline.warned import kept_warnings
    from stillroom.schedule import LiveSchedule
    from stillroom.system import segmenter_of

    show_log()
    is_paced = isinstance(options.schedule, LiveSchedule) and options.speed > 0
    warned: list[str] = []
    with kept_warnings(warned):
        intake = source.intake()
    options = replace(options, warned=tuple(warned))
    if isinstance(intake, Streamed):
        if detector_off:
            raise ConfigError("--detector-off names images of a recorded sequence; leave it out")
        ensure_warm(STDERR, loaded=is_paced)  # now: images of a camera that is started do not wait
    with intake.started():
        origin, kind = intake.origin, sensor_of(intake.origin)
        fit_to_sensor(chosen, kind)  # now: a method of which nothing works here is refused before kernels are compiled
        options = replace(
            options,
            folder=chosen_folder(options.folder) if options.folder is not None else None,
            detector_off=detector_ranges(detector_off, intake.origin) if isinstance(intake, Recorded) else (),
            # Now: a missing file is reported before kernels are compiled.
            segmenter=segmenter_of(chosen, origin.camera, options.schedule, kind),
        )
        n_images = "" if intake.n_images is None else f"{intake.n_images} images; "
        say(f"{chosen.method} on {origin.name}: {kind.words}; {n_images}camera: {origin.camera_source}")
        if isinstance(intake, Recorded):
            ensure_warm(STDERR, rendered(intake.origin) is not None, loaded=is_paced)
        outcome = run_pipeline(intake, chosen, options, RunBar(STDERR))
    _report(outcome)
    if outcome.interrupted:
        raise typer.Exit(INTERRUPTED)
    if outcome.why_untracked is not None:
        print_error(f"nothing was tracked: {outcome.why_untracked} [see troubleshooting: nothing-tracked]")
        raise typer.Exit(NOTHING_TRACKED)


def _report(outcome: "RunOutcome") -> None:
    from stillroom.cli.output import print_evaluation, print_lines
    from stillroom.pipeline import summary

    if outcome.evaluation is not None:
        print_evaluation(outcome.evaluation)
    else:
        why = summary.TOO_LITTLE if outcome.has_groundtruth else summary.NO_TRUTH
        print_lines([summary.coverage(outcome.n_tracked, outcome.n_recorded, why)])
    print_lines(_sentences(outcome))


def _sentences(outcome: "RunOutcome") -> list[str]:
    from stillroom.pipeline import summary
    from stillroom.pipeline.results import run_figures

    has_segmenter = outcome.live is not None and outcome.live.has_segmenter
    sentences = summary.sentences(run_figures(outcome), outcome.n_given, has_segmenter)
    places = {
        "map file": outcome.map_file,
        "masks": outcome.masks,
        "report": outcome.report,
        "results": outcome.folder,  # the last line, which scripts read
    }
    return sentences + [f"{what}: {place}" for what, place in places.items() if place is not None]
