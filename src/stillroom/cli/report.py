"""`stillroom report`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from stillroom.cli.arguments import PLOT_FORMATS, Formats, Tables, chosen_of

SEQUENCE = 1
"""Which column of a comparison tells the sequence; on a terminal it is a title, and folders, the last, are too wide."""


def report(
    folders: Annotated[list[Path], typer.Argument(metavar="RESULTS", help="Results of runs, such as results/latest.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="The page to write. \\[default: a new one in results/]"),
    ] = None,
    formats: Formats = None,
    tables: Tables = None,
) -> None:
    """Compare finished runs on a page to look at.

    A table that sorts, all paths with the ground truth, their errors over time, bars with ranges where several runs are
    of one method, and the dense maps: one file that needs no network. Of one folder its report.html is made again.

    Plots and tables for a paper go beside the page.

        stillroom report results/a results/b results/c --out compared.html
        stillroom report results/a results/b --format pdf --table latex
    """
    from datetime import datetime

    from stillroom.cli.output import print_lines, print_table, say, show_log
    from stillroom.cli.tables import FORMS, write_table
    from stillroom.pipeline.reports.comparison import N_WORDS, compare_runs
    from stillroom.pipeline.reports.run_page import write_run_page

    show_log()
    drawn, forms = chosen_of("--format", formats, PLOT_FORMATS), chosen_of("--table", tables, tuple(FORMS))
    if len(folders) == 1:
        if drawn or forms:
            say("--format and --table go with several runs; 'stillroom evaluate --format' draws the plots of one")
        print_lines([f"report: {write_run_page(folders[0], out)}"])
        return
    file = out or Path("results") / f"{datetime.now():%Y-%m-%d_%H-%M-%S}_comparison.html"
    compared = compare_runs(folders, file, drawn)
    for sequence in dict.fromkeys(row[SEQUENCE] for row in compared.rows):
        print_lines(["", sequence])
        rows = [row for row in compared.rows if row[SEQUENCE] == sequence]
        print_table(_narrowed(compared.header), map(_narrowed, rows))
    print_lines(compared.notes)
    files = write_table(file.with_suffix(""), "", compared.header, compared.rows, N_WORDS, forms)
    print_lines([f"report: {compared.file}", *(f"table: {path}" for path in files)])
    print_lines([f"plot: {path}" for path in compared.plots])


def _narrowed(cells: Sequence[str]) -> list[str]:
    return [*cells[:SEQUENCE], *cells[SEQUENCE + 1 : -1]]
