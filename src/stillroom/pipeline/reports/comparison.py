"""Several runs beside each other, on one page: a table, their ways, their errors, and how far these reach."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillroom.data.replacing import cannot_be_written
from stillroom.errors import ConfigError, StillroomError
from stillroom.evaluation.report import percent, said_alignment
from stillroom.evaluation.time_matching import TimeMatching
from stillroom.evaluation.trajectory_errors import Spread
from stillroom.pipeline import results
from stillroom.pipeline.plots import DENSE_MAP, draw_plots
from stillroom.pipeline.reports.blocks import path_of, truth_of
from stillroom.pipeline.reports.finished import Finished, read_finished
from stillroom.viz.page import charts
from stillroom.viz.page.charts import Bar
from stillroom.viz.page.markup import Cell, Number, gallery, heading, paragraphs
from stillroom.viz.page.page import Section, write_page
from stillroom.viz.page.pictures import Album
from stillroom.viz.page.tables import sortable_table

NONE = "–"
N_WORDS = 2
"""Columns at the left of the table that hold words."""

SORT_NOTE = "A click on the name of a column sorts by it."
ZOOM_NOTE = "Drag to zoom; the arrow at the right goes back; a click on a name hides its line."
RANGE = "median, least and largest of the runs"


@dataclass(frozen=True)
class Column:
    """A figure of a run, and how it is written.

    Attributes:
        name: Of the column, with its unit.
        value: Takes it from a run; None where it has none.
        text: Writes it.
        is_drawn: Whether bars show it.
    """

    name: str
    value: Callable[[Finished], float | None]
    text: Callable[[float], str]
    is_drawn: bool = True

    def cell(self, run: Finished) -> Number:
        """Return the figure of a run as it is written."""
        value = self.value(run)
        return Number(NONE if value is None else self.text(value), value)


@dataclass(frozen=True)
class Comparison:
    """What a comparison came to.

    Attributes:
        file: The page.
        header, rows: The table, as text.
        notes: What is to be said with it: what is missing, and what cannot be compared.
        plots: What was drawn beside it.
    """

    file: Path
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]
    plots: tuple[Path, ...] = ()


def _ate(run: Finished) -> float | None:
    return None if run.evaluation is None else run.evaluation.as_given.ate_m.rmse


def _drift(run: Finished) -> float | None:
    drift = None if run.evaluation is None else run.evaluation.for_rpe.rpe_1s
    return None if drift is None else drift.translation_m.rmse


def _turning(run: Finished) -> float | None:
    drift = None if run.evaluation is None else run.evaluation.for_rpe.rpe_1s
    return None if drift is None else drift.rotation_deg.rmse


def _of_run(name: str) -> Callable[[Finished], float | None]:
    return lambda run: None if run.run.get(name) is None else float(run.run[name])


def _frame_ms(run: Finished) -> float | None:
    cost = run.run.get("frame_ms")
    return float(cost["wall_median_ms"]) if cost and "wall_median_ms" in cost else None


def _coverage(run: Finished) -> float | None:
    coverage = (run.figures or {}).get("coverage")
    return None if coverage is None else float(coverage)


def _seed(run: Finished) -> float | None:
    seed = run.config.get("seed")
    return float(seed) if isinstance(seed, int) else None


COLUMNS = (
    Column("seed", _seed, "{:.0f}".format, is_drawn=False),
    Column("ATE [m]", _ate, "{:.4f}".format),
    Column("RPE [m/s]", _drift, "{:.4f}".format),
    Column("RPE [deg/s]", _turning, "{:.3f}".format),
    Column("tracked", _coverage, percent, is_drawn=False),
    Column("ms a frame", _frame_ms, "{:.1f}".format),
    Column("keyframes", _of_run("n_keyframes"), "{:.0f}".format),
    Column("map points", _of_run("n_points"), "{:.0f}".format, is_drawn=False),
)
"""Errors are RMSEs after the run's own alignment, ground truth as given; a frame's time is the median, wall time."""


def compare_runs(paths: Sequence[Path], out: Path, formats: Sequence[str] = ()) -> Comparison:
    """Write the comparison of several runs from what their folders hold; what is missing is said on it.

    Args:
        paths: Results folders, two at least; `latest` may stand for one.
        out: The HTML file to write; its folder is made.
        formats: In which paths and errors are drawn beside it: "png", "svg", "pdf".

    Raises:
        ConfigError: They are fewer than two.
        StillroomError: One of them is no results folder, or the page cannot be written.
    """
    runs = [read_finished(path) for path in paths]
    if len(runs) < 2:
        raise ConfigError("a comparison needs the results folders of two runs at least")
    names, sequences = _names(runs), list(dict.fromkeys(run.sequence for run in runs))
    groups = {sequence: [run for run in runs if run.sequence == sequence] for sequence in sequences}
    header = ("method", "sequence", *(column.name for column in COLUMNS), "folder")
    rows: list[list[Cell]] = [
        [run.method, run.sequence, *(column.cell(run) for column in COLUMNS), run.folder.name] for run in runs
    ]
    notes = _notes(runs, names, sequences)
    table = sortable_table(header, rows, N_WORDS)
    by = said_alignment(run.evaluation for run in runs)
    how = f"ATE and RPE (over 1 s): RMSE, after {by} alignment; time of a frame: median. "
    sections = [Section("", [table, paragraphs([how + SORT_NOTE], "note")]), Section("", [paragraphs(notes)])]
    album = Album()
    for sequence, group in groups.items():
        sections += _sections(sequence, group, names, album, len(groups) > 1)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_be_written(out, error) from error
    write_page(
        out, _title(runs, sequences), [f"{len(runs)} runs: {' · '.join(dict.fromkeys(names.values()))}"], sections
    )
    texts = tuple(tuple(c.text if isinstance(c, Number) else c for c in row) for row in rows)
    return Comparison(out, header, texts, tuple(notes), _plots(out, groups, names, formats) if formats else ())


def _names(runs: Sequence[Finished]) -> dict[Path, str]:
    """Return a name for each run by its folder: the method where that tells it from the others, else more."""
    ways: tuple[Callable[[Finished], str], ...] = (
        lambda run: run.method,
        lambda run: f"{run.method}, seed {run.config.get('seed', NONE)}",
        lambda run: f"{run.method}, {run.folder.name}",
    )
    names: dict[Path, str] = {}
    for run in runs:
        others = [other for other in runs if other.sequence == run.sequence and other.folder != run.folder]
        telling = (way(run) for way in ways if all(way(run) != way(other) for other in others))
        names[run.folder] = next(telling, str(run.folder))
    return names


def _title(runs: Sequence[Finished], sequences: Sequence[str]) -> str:
    methods = list(dict.fromkeys(run.method for run in runs))
    what = ", ".join(methods) if len(methods) <= 4 else f"{len(methods)} methods"
    return f"{what} on {sequences[0] if len(sequences) == 1 else f'{len(sequences)} sequences'}"


def _notes(runs: Sequence[Finished], names: Mapping[Path, str], sequences: Sequence[str]) -> list[str]:
    notes = []
    if len(sequences) > 1:
        notes.append(
            f"the runs are of {len(sequences)} sequences ({', '.join(sequences)}): errors are compared within each only"
        )
    for run in runs:
        notes += [f"missing, {names[run.folder]} ({run.folder.name}): {what}" for what in run.missing]
        if run.run.get("interrupted"):
            notes.append(f"{names[run.folder]} ({run.folder.name}) was stopped before the last image")
    return notes


def _sections(
    sequence: str, group: Sequence[Finished], names: Mapping[Path, str], album: Album, several: bool
) -> list[Section]:
    begin_s = min(run.begin_s for run in group)
    best = max((run for run in group if run.error is not None), key=_n_compared, default=None)
    drawn = [run for run in group if best is None or run.error is not None]
    paths = [path for run in drawn if (path := path_of(run, names[run.folder], begin_s)) is not None]
    truth, on = None if best is None else truth_of(best, begin_s), f" on {sequence}" if several else ""
    ways: list[Any] = [charts.plan_view(paths, truth)] if paths else []
    if paths and truth is None:
        ways.append(paragraphs(["Without ground truth, each is in the frame of its own first image."], "note"))
    others = [names[run.folder] for run in group if run not in drawn]
    if others:
        ways.append(paragraphs([f"Not drawn, as nothing aligns it with the ground truth: {', '.join(others)}."]))
    errors: list[Any] = []
    with_errors = [path for path in paths if path.errors_m is not None]
    if best is not None and best.error is not None:
        errors = [charts.errors_over_time(with_errors, best.error.still_camera_m)]
    ways += [paragraphs([ZOOM_NOTE], "note")] if paths else [paragraphs([f"No run{on} has a pose to draw."])]
    return [
        Section(f"Trajectories{on}", ways),
        Section(f"Error over time{on}", errors),
        Section(f"Figures{on}", _bars(group) if len(group) > 1 else []),
        Section(f"Dense maps{on}", _dense_maps(group, names, album)),
    ]


def _n_compared(run: Finished) -> int:
    return 0 if run.error is None else run.error.n_compared


def _bars(group: Sequence[Finished]) -> list[Any]:
    """Return bars of each figure by method, with their range where several runs are of one method."""
    blocks: list[Any] = []
    n_most = 1
    for column in (column for column in COLUMNS if column.is_drawn):
        by_method: dict[str, list[float]] = {}
        for run in group:
            value = column.value(run)
            if value is not None:
                by_method.setdefault(run.method, []).append(value)
        rows = [_bar(method, values) for method, values in by_method.items()]
        if rows:
            n_most = max(n_most, *(len(values) for values in by_method.values()))
            blocks += [
                heading(column.name),
                charts.bars(rows, column.name, RANGE, digits=4 if "[" in column.name else 1),
            ]
    note = f"Bar: median; line: {RANGE} of a method." if n_most > 1 else "One run of each method: no range."
    return [*blocks, paragraphs([note], "note")] if blocks else []


def _bar(method: str, values: Sequence[float]) -> Bar:
    if len(values) == 1:
        return Bar(method, values[0], note="1 run")
    spread = Spread.of(values)
    return Bar(method, spread.median, spread.min, spread.max, f"{spread.n_runs} runs")


def _dense_maps(group: Sequence[Finished], names: Mapping[Path, str], album: Album) -> list[Any]:
    figures, without = [], []
    for run in group:
        figure = album.figure(run.folder / results.PICTURES / DENSE_MAP, names[run.folder])
        if figure:
            figures.append(figure)
        else:
            without.append(names[run.folder])
    if not figures:
        return [paragraphs(["None of the runs has a picture of a dense map."])]
    note = [f"No picture of a dense map: {', '.join(without)}."] if without else []
    return [gallery(figures, in_a_row=2), paragraphs(note, "note")]


def _plots(
    out: Path, groups: Mapping[str, Sequence[Finished]], names: Mapping[Path, str], formats: Sequence[str]
) -> tuple[Path, ...]:
    """Draw paths and errors of each sequence beside the page, in `<page>_plots/`."""
    drawn: list[Path] = []
    for sequence, group in groups.items():
        judged = [run for run in group if run.error is not None]
        if not judged:
            continue
        folder = out.with_name(f"{out.stem}_plots") / (sequence if len(groups) > 1 else "")
        first = judged[0]
        estimates = {names[run.folder]: run.trajectory for run in judged if run.trajectory is not None}
        if first.truth is None:
            raise StillroomError(f"{first.folder}: it has errors and no ground truth")
        matching = TimeMatching()
        if first.evaluation is not None:
            matching = TimeMatching(offset_s=first.evaluation.offset_s, interpolate=first.evaluation.interpolated)
        drawn += draw_plots(folder, estimates, first.truth, sequence, matching, formats=formats)
    return tuple(drawn)
