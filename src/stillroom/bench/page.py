"""The page of a bench: its tables, which sort, and bars of every figure that has a range over several runs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillroom.viz.page import charts
from stillroom.viz.page.charts import Bar
from stillroom.viz.page.markup import folded, gallery, heading, paragraphs
from stillroom.viz.page.page import Section, write_page
from stillroom.viz.page.pictures import Album
from stillroom.viz.page.tables import sortable_table

SPREAD = {"median", "min", "max"}
"""Keys of a figure over several runs, as `Spread` has them."""
NAMES = ("method", "name", "search")
FIGURES = {
    "ate_se3_m": "ATE [m]",
    "ate_sim3_m": "ATE [m] after Sim(3)",
    "coverage": "share of the frames tracked",
    "rpe_translation_m_s": "RPE [m/s]",
    "rpe_rotation_deg_s": "RPE [deg/s]",
    "frame_cpu_ms": "CPU time of a frame [ms]",
}
"""What is written for the names in the file."""
NOTE = (
    "Bar: median; line: from the least to the largest of the runs, of a stage up to the 95th percentile of the frames."
)
SORT_NOTE = "A click on the name of a column sorts by it."


@dataclass(frozen=True)
class NamedTable:
    """A table as it is printed.

    Attributes:
        title: Above it.
        header, rows: Its cells.
        n_words: How many columns at the left hold words.
        notes: Sentences below it.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    n_words: int = 1
    notes: Sequence[str] = ()


def write_bench_page(
    path: Path,
    title: str,
    tables: Sequence[NamedTable],
    series: Mapping[str, Sequence[Bar]],
    how: Mapping[str, Any],
    pictures: Sequence[tuple[Path, str]] = (),
) -> None:
    """Write the page of a bench.

    Args:
        path: The HTML file to write; its folder is there.
        title: Of the page.
        tables: As they are printed, in order.
        series: By what they measure, bars; see `series_of`.
        how: How the figures came about, as `provenance` gives it.
        pictures: PNG files to show, each with its caption.

    Raises:
        StillroomError: The file cannot be written.
    """
    sections = [
        Section(
            each.title,
            [
                sortable_table(each.header, _whole(each.rows), each.n_words),
                paragraphs([*each.notes, SORT_NOTE], "note"),
            ],
        )
        for each in tables
        if each.rows
    ]
    album = Album()
    sections.append(Section("Pictures", [gallery([album.figure(*one) for one in pictures], in_a_row=1)]))
    drawn = [block for name, bars in series.items() for block in _drawn(name, bars)]
    if drawn:
        sections.append(Section("Figures", [*drawn, paragraphs([NOTE], "note")]))
    lines = [f"{name}: {value}" for name, value in how.items() if not isinstance(value, Mapping)]
    lines += [f"{part} {value}" for one in how.values() if isinstance(one, Mapping) for part, value in one.items()]
    sections.append(Section("How it came about", [folded("versions, commit, command", "\n".join(lines))]))
    write_page(path, title, [str(how[name]) for name in ("date", "command") if name in how], sections)


def series_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Bar]]:
    """Return bars of each figure that has a range, from the rows that a bench keeps for its file.

    Args:
        rows: Figures by name; one over several runs is a mapping with `median`, `min` and `max`. `stages` holds the
            time of each stage, `time_ratio` what a search costs as a share of testing every point.

    Returns:
        By figure, and by sequence where there are several, a bar for each row that has it.
    """
    sequences = {row.get("sequence") for row in rows}
    found: dict[str, list[Bar]] = {}
    for row in rows:
        name = next((str(row[key]) for key in NAMES if key in row), "")
        on = f", {row['sequence']}" if len(sequences) > 1 and row.get("sequence") else ""
        if isinstance(row.get("stages"), Sequence):
            found[f"CPU time of each stage [ms], {name}{on}"] = [_stage(stage) for stage in row["stages"]]
        if "time_ratio" in row:
            bar = Bar(f"{row.get('test', '')}, {name}", row["time_ratio"])
            found.setdefault(f"time, as a share of testing every point{on}", []).append(bar)
        for figure, spread in _spreads(row):
            n_runs = f"{spread['n_runs']} runs" if "n_runs" in spread else ""
            bar = Bar(name, spread["median"], spread["min"], spread["max"], n_runs)
            found.setdefault(f"{FIGURES.get(figure, figure.replace('_', ' '))}{on}", []).append(bar)
    return found


def _whole(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return rows whose first cell is that of the row above where it is left empty: a sorted row stands alone."""
    whole: list[list[str]] = []
    for first, *rest in rows:
        whole.append([first or (whole[-1][0] if whole else ""), *rest])
    return whole


def _stage(stage: Mapping[str, Any]) -> Bar:
    median, p95 = stage["cpu_median_ms"], stage["cpu_p95_ms"]
    return Bar(str(stage["stage"]), median, median, p95, f"in {stage['n_frames']} frames")


def _spreads(row: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for figure, value in row.items():
        if isinstance(value, Mapping) and value.keys() >= SPREAD and all(value[key] is not None for key in SPREAD):
            yield figure, value


def _drawn(name: str, bars: Sequence[Bar]) -> list[Any]:
    return [heading(name), charts.bars(bars, name, "median and range", digits=4)] if bars else []
