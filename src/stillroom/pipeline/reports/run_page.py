"""The page of one run: `report.html` of its folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stillroom.evaluation.report import lines, percent
from stillroom.evaluation.trajectory_errors import Alignment
from stillroom.pipeline import results, summary
from stillroom.pipeline.reading import unless_missing
from stillroom.pipeline.reports.blocks import (
    errors_table,
    frame_pictures,
    map_pictures,
    path_of,
    stage_bars,
    truth_of,
)
from stillroom.pipeline.reports.finished import Finished, read_finished
from stillroom.viz.page import charts
from stillroom.viz.page.markup import Number, cards, folded, gallery, heading, paragraphs, table, warnings
from stillroom.viz.page.page import Section, write_page
from stillroom.viz.page.pictures import Album

CHART_NOTE = "Drag to zoom; the arrow at the right goes back; a click on a name hides its line."
STAGES_NOTE = (
    "Bar: median; line: up to the 95th percentile; over the frames in which a stage ran. A stage includes those "
)
STAGES_NOTE += "that it calls: tracking includes dynamics, the frame all. Wall time; the costliest in all come first."


def write_run_page(path: Path, out: Path | None = None) -> Path:
    """Write the page of a run from what its folder holds; what is missing is said on it.

    Args:
        path: The results folder; `latest` may stand for one.
        out: The file to write; `report.html` of the folder by default.

    Returns:
        The file.

    Raises:
        StillroomError: It is no results folder, or the page cannot be written.
    """
    run = read_finished(path)
    file, album = out or run.folder / results.REPORT, Album()
    maps = map_pictures(run, album)  # before the frames: these may be left out
    frames, note = frame_pictures(run, album)
    figures, missing = _figures(run)
    under = [line for line in (str(run.how.get("date", "")).replace("T", " "), str(run.how.get("command", ""))) if line]
    sections = [
        Section("", [cards(_most_wanted(run)), warnings(_warnings(run))]),
        Section("Figures", figures),
        Section("Trajectory", _trajectory(run)),
        Section("Time of each stage", _stages(run)),
        Section("Maps", maps),
        Section("Frames", [gallery(frames), paragraphs([note] if note else [], "note")]),
        Section("Configuration", [folded(f"{results.CONFIG}, {run.method}", run.config_text)] if run.config else []),
        Section("How it came about", [_provenance(run.how)]),
        Section("Not in this report", [paragraphs([*run.missing, *missing])]),
    ]
    write_page(file, f"{run.method} on {run.sequence}", under, sections)
    return file


def _most_wanted(run: Finished) -> list[tuple[Number, str]]:
    found: list[tuple[Number, str]] = []
    if run.evaluation is not None:
        ate_m = run.evaluation.as_given.ate_m.rmse
        found.append((Number(f"{ate_m:.4f} m", ate_m), f"ATE, RMSE after {run.evaluation.alignment}"))
        drift = run.evaluation.for_rpe.rpe_1s
        if drift is not None:
            rmse = drift.translation_m.rmse
            found.append((Number(f"{rmse:.4f} m/s", rmse), "RPE over 1 s, RMSE"))
    coverage = (run.figures or {}).get("coverage")
    if coverage is not None:
        found.append((Number(percent(coverage), coverage), "of the frames tracked"))
    frame_ms = (run.run.get("frame_ms") or {}).get("wall_median_ms")
    if frame_ms is not None:
        found.append((Number(f"{frame_ms:.1f} ms", frame_ms), "a frame, median"))
    if "n_keyframes" in run.run:
        found.append((Number(str(run.run["n_keyframes"]), run.run["n_keyframes"]), "keyframes"))
    return found


def _warnings(run: Finished) -> list[str]:
    """Return what was warned of, and what the figures warn of where nothing was kept."""
    said = list(run.warnings)
    said += [doubt for doubt in run.run.get("doubts", []) if doubt not in said]
    if run.run.get("interrupted"):
        said.insert(0, "the run was stopped before the last image; this is of what there was by then")
    for name, what in (
        ("n_in_unjoined_submaps", "images were tracked in sub-maps that were never joined with the main one"),
        ("n_pictures_failed", "pictures could not be drawn"),
        ("n_frames_not_shown", "frames were not shown by the viewer"),
    ):
        if run.run.get(name):
            said.append(f"{run.run[name]} {what}")
    return said


def _figures(run: Finished) -> tuple[list[Any], list[str]]:
    """Return the figures, in the words of the printed summary, and what of them could not be read."""
    figures, missing = run.figures, list[str]()
    if figures is None:
        return [], missing
    n_recorded = figures.get("n_given")
    own = unless_missing("figures of the run itself", lambda: _own_sentences(run, n_recorded), missing) or []
    if run.evaluation is not None:
        return [errors_table(run.evaluation), paragraphs([*lines(run.evaluation), *own])], missing
    why = summary.NO_TRUTH if run.truth is None else summary.TOO_LITTLE
    return [paragraphs([summary.coverage(figures.get("n_tracked", 0), n_recorded, why), *own])], missing


def _own_sentences(run: Finished, n_recorded: int | None) -> list[str]:
    """Return what a run came to beside its errors.

    Raises:
        KeyError, TypeError: The figures are those of another version.
    """
    n_given = None if n_recorded is None else n_recorded - run.run.get("n_unpaired", 0)
    live = run.run.get("live")
    return summary.sentences(run.run, n_given, bool(live and live["n_images_seen_by_network"])) if run.run else []


def _trajectory(run: Finished) -> list[Any]:
    path, lost_s = path_of(run, run.method, run.begin_s), run.lost_s()
    if path is None:
        return [paragraphs(["There is no pose to draw."])]
    blocks: list[Any] = [heading("In plan view"), charts.plan_view([path], truth_of(run, run.begin_s))]
    if path.errors_m is not None:
        still_m = None if run.error is None else run.error.still_camera_m
        blocks += [heading("Error over time"), charts.errors_over_time([path], still_m, lost_s)]
    if run.frames is not None and len(run.frames.times_s) > 1:
        times_s = run.frames.times_s - run.begin_s
        series = {name: (times_s, counts) for name, counts in run.frames.counts.items()}
        blocks += [heading("Keypoints of each frame"), charts.lines_over_time(series, "keypoints", lost_s)]
    notes = [CHART_NOTE] + (["Shaded: no pose."] if lost_s else [])
    if run.error is not None and run.error.alignment is Alignment.SIM3:
        notes.append(f"The trajectory is up to scale: drawn after Sim(3) alignment, × {run.error.scale:.4g}.")
    elif run.trajectory is not None and not run.trajectory.is_metric:
        notes.append("The trajectory is up to scale: its unit is the map's, not the metre.")
    return [*blocks, paragraphs([" ".join(notes)], "note")]


def _stages(run: Finished) -> list[Any]:
    bars = stage_bars(run)
    if not bars:
        return []
    return [
        charts.bars(bars, "ms", "median, up to the 95th percentile", one_color=True),
        paragraphs([STAGES_NOTE], "note"),
    ]


def _provenance(how: Mapping[str, Any]) -> str:
    """Return how a run came about as a table."""
    flat: list[tuple[str, str]] = []
    for name, value in how.items():
        parts = value.items() if isinstance(value, dict) else [("", value)]
        flat += [(f"{name} {part}".strip().replace("_", " "), _words(one)) for part, one in parts]
    return table(("", ""), [row for row in flat if row[1]], n_words=2) if flat else ""


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_words(one)}" for name, one in value.items() if _words(one))
    if isinstance(value, list):
        return ", ".join(map(_words, value))
    return str(value)
