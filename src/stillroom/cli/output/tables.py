"""Figures as tables."""

from collections.abc import Iterable, Sequence

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from stillroom.cli.output.console import STDOUT
from stillroom.evaluation.report import Evaluation
from stillroom.evaluation.report_text import HEADER, lines, rows

FULL_WIDTH = 106
LEFT_OUT_WHERE_NARROW = ("mean", "std", "min")


def print_table(header: Sequence[str], table: Iterable[Sequence[str]], n_words: int = 1) -> None:
    """Print rows; the first columns hold words, the others numbers."""
    shown = Table(box=SIMPLE_HEAD, pad_edge=False)
    for place, name in enumerate(header):
        shown.add_column(escape(name), justify="left" if place < n_words else "right", overflow="fold")
    for row in table:
        shown.add_row(*(escape(cell) for cell in row))
    STDOUT.print(shown)


def print_evaluation(evaluation: Evaluation) -> None:
    """Print all figures of a trajectory, and what they must be read with."""
    narrow = STDOUT.width < FULL_WIDTH
    shown = [place for place, name in enumerate(HEADER) if not (narrow and name in LEFT_OUT_WHERE_NARROW)]
    table = [HEADER, *rows(evaluation)]
    header, *body = [tuple(row[place] for place in shown) for row in table]
    print_table(header, body, n_words=2)
    print_lines(lines(evaluation))


def print_lines(sentences: Iterable[str]) -> None:
    """Print sentences, one a line."""
    for sentence in sentences:
        STDOUT.print(escape(sentence), highlight=False, soft_wrap=True)
