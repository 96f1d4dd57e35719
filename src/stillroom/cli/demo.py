"""`stillroom demo`: what the package is for, in a few minutes and without any data."""

import time
from pathlib import Path
from typing import Annotated

import typer

from stillroom.cli.output import STDERR, FrameBar, print_lines, print_table, say, show_log
from stillroom.cli.warmup import ensure_warm
from stillroom.config import SlamConfig
from stillroom.evaluation.report import Evaluation, percent
from stillroom.evaluation.trajectory_errors import improvement_percent
from stillroom.pipeline import RunOptions, RunOutcome, Source, run
from stillroom.pipeline.plots import draw_plots
from stillroom.pipeline.results import PICTURES
from stillroom.presets.registry import configure
from stillroom.protocols import Dataset
from stillroom.stopping import INTERRUPTED

ROOM = "synthetic:walking"
BASELINE, METHOD = "orb-slam2", "stillroom"
N_PICTURES = 4
HEADER = ("method", "ATE [m]", "of static-pose ATE", "frames tracked", "improvement")


def demo(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where the results folders are made.", file_okay=False)
    ] = Path("results"),
    frames: Annotated[
        str | None, typer.Option(metavar="A:B", help="Use these of the room's 270 frames only, for a shorter demo.")
    ] = None,
) -> None:
    """Track a camera through a rendered room with people in it, by orb-slam2 and by stillroom, and compare the two.

    Needs no data. The first time it also compiles the kernels, which takes a minute or two.
    """
    start_s = time.monotonic()
    show_log()
    source = Source(ROOM, frames=frames)
    dataset = source.open()
    ensure_warm(STDERR, renderer=True)
    bar = FrameBar(STDERR)
    _render(dataset, bar)
    outcomes = [
        _track(dataset, each, RunOptions(out, None, N_PICTURES, source=source), bar)
        for each in (configure(BASELINE), configure(METHOD))
    ]
    _print_comparison(dataset, *outcomes)
    _print_pictures(_compared(dataset, *outcomes), *outcomes)
    say(f"all in {time.monotonic() - start_s:.0f} s; try the same on your own: stillroom run --help")


def _render(dataset: Dataset, bar: FrameBar) -> None:
    """Render every frame once; the runs then read them from the cache."""
    say(f"rendering {len(dataset)} frames of a room with people in it")
    bar.label = "rendering"
    bar.start(len(dataset))
    try:
        for place in range(len(dataset)):
            dataset.load(place)
            bar.frame(None)
    finally:
        bar.finish()


def _track(dataset: Dataset, config: SlamConfig, options: RunOptions, bar: FrameBar) -> RunOutcome:
    """Run a method, and exit when the user stops it."""
    say(f"tracking the camera with {config.method}")
    bar.label = config.method
    outcome = run(dataset, config, options, bar)
    if outcome.interrupted:
        say(f"stopped; the results so far are in {outcome.folder}")
        raise typer.Exit(INTERRUPTED)
    return outcome


def _print_comparison(dataset: Dataset, baseline: RunOutcome, ours: RunOutcome) -> None:
    rows = [_row(outcome, baseline) for outcome in (baseline, ours)]
    still_m = _still_camera_m(ours.evaluation or baseline.evaluation)
    print_lines(["", f"the camera's path through {dataset.name}"])
    print_table(HEADER, rows)
    if still_m is not None:
        print_lines(
            [f"ATE: RMSE after SE(3) alignment; static-pose baseline (a camera that never moved): {still_m:.4f} m"]
        )


def _row(outcome: RunOutcome, baseline: RunOutcome) -> tuple[str, ...]:
    found, other = outcome.evaluation, baseline.evaluation
    if found is None:
        return (outcome.method, "–", "–", percent(outcome.n_tracked / max(outcome.n_given, 1)), "–")
    ate_m, gain = found.as_given.ate_m.rmse, None
    if other is not None and outcome is not baseline:
        gain = improvement_percent(other.as_given.ate_m.rmse, ate_m)
    share = ate_m / found.as_given.still_camera_m if found.as_given.still_camera_m else None
    improvement = "–" if gain is None else f"{gain:+.1f} %"
    against_still = "–" if share is None else f"{share * 100:.0f} %"
    return (outcome.method, f"{ate_m:.4f}", against_still, percent(found.coverage), improvement)


def _still_camera_m(evaluation: Evaluation | None) -> float | None:
    return None if evaluation is None else evaluation.as_given.still_camera_m


def _compared(dataset: Dataset, baseline: RunOutcome, ours: RunOutcome) -> tuple[Path, ...]:
    """Draw both trajectories into one set of plots, in the place of those of ours alone."""
    truth = dataset.groundtruth
    if truth is None or ours.folder is None or ours.evaluation is None or baseline.evaluation is None:
        return ()
    estimates = {outcome.method: outcome.system.trajectory() for outcome in (ours, baseline)}
    return draw_plots(ours.folder / PICTURES, estimates, truth, f"{ours.method} and {baseline.method}")


def _print_pictures(plots: tuple[Path, ...], baseline: RunOutcome, ours: RunOutcome) -> None:
    frames = [path for outcome in (baseline, ours) for path in outcome.pictures if path.name.startswith("frame_")]
    print_lines(["pictures:", *(f"  {path}" for path in (*plots, *frames))])
