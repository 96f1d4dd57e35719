"""The two streams, and how errors and warnings look on them."""

import logging
import time
from collections import deque
from collections.abc import Iterable, Sequence
from typing import TextIO, cast

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from stillroom.cli.streams import Unbreakable
from stillroom.data.result import FrameSummary, TrackingState
from stillroom.evaluation.report import HEADER, Evaluation, lines, rows

# The two streams, and how errors and warnings look on them.


WIDTH_WITHOUT_TERMINAL = 120


def _console(stderr: bool) -> Console:
    stream = cast(TextIO, Unbreakable("stderr" if stderr else "stdout"))
    console = Console(file=stream, stderr=stderr, emoji=False)  # or synthetic:walking: would end in a picture
    if not console.is_terminal:
        console.width = max(console.width, WIDTH_WITHOUT_TERMINAL)
    return console


STDOUT = _console(stderr=False)
STDERR = _console(stderr=True)


def print_error(message: str) -> None:
    """Print an error as one line, however long."""
    _one_line("[bold red]error:[/] ", message)


def say(message: str) -> None:
    """Print a remark on stderr as one line."""
    _one_line("", message)


def show_log() -> None:
    """Print the package's warnings on stderr, each as one line."""
    logger = logging.getLogger("stillroom")
    if not any(isinstance(handler, _OneLine) for handler in logger.handlers):
        logger.addHandler(_OneLine(logging.WARNING))


class _OneLine(logging.Handler):
    """Prints through the console, so that a progress bar stays whole."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print the record."""
        color = "yellow" if record.levelno < logging.ERROR else "bold red"
        _one_line(f"[{color}]{record.levelname.lower()}:[/] ", record.getMessage())


def _one_line(prefix: str, message: str) -> None:
    text = " ".join(message.split())
    STDERR.print(f"{prefix}{escape(text)}", soft_wrap=True, highlight=False)


# Figures as tables.


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
    """Print all figures of a trajectory, and notes on how to read them."""
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


# The bar of a run.


RATE_OVER_FRAMES = 30
LINES_WITHOUT_TERMINAL = 10
LINE_EVERY = 300
"""Images from one line to the next, of a camera that nobody knows the end of: 10 s at 30 Hz."""
COLORS = {TrackingState.OK: "green", TrackingState.LOST: "red", TrackingState.NOT_INITIALIZED: "yellow"}


class RunBar:
    """Shows frames per second, state, matches and keyframes; without a terminal, a line now and then."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TextColumn("{task.description}"),
            TimeRemainingColumn(compact=True, elapsed_when_finished=True),
            console=console,
            disable=not console.is_terminal,
        )
        self._task: TaskID | None = None
        self._n_frames: int | None = 0
        self._done = 0
        self._times_s: deque[float] = deque(maxlen=RATE_OVER_FRAMES + 1)

    def start(self, n_frames: int | None) -> None:
        """Show an empty bar."""
        self._n_frames, self._done = n_frames, 0
        self._times_s.append(time.perf_counter())
        self._bar.start()
        self._task = self._bar.add_task("starting", total=n_frames)

    def frame(self, result: FrameSummary | None) -> None:
        """Advance it by a frame."""
        self._done += 1
        self._times_s.append(time.perf_counter())
        if self._console.is_terminal and self._task is not None:
            self._bar.update(self._task, advance=1, description=self._text(result, with_color=True))
        elif self._done == self._n_frames or self._done % self._stride() == 0:
            of_all = "" if self._n_frames is None else f"/{self._n_frames}"
            text = f"{self._done}{of_all}  {self._text(result, with_color=False)}"
            self._console.print(text, highlight=False, soft_wrap=True)

    def finish(self) -> None:
        """Stop drawing; the bar stays."""
        self._bar.stop()

    def _stride(self) -> int:
        return LINE_EVERY if self._n_frames is None else max(1, self._n_frames // LINES_WITHOUT_TERMINAL)

    def _text(self, result: FrameSummary | None, with_color: bool) -> str:
        elapsed_s = self._times_s[-1] - self._times_s[0]
        rate = f"{(len(self._times_s) - 1) / elapsed_s:5.1f} frames/s" if elapsed_s > 0 else ""
        if result is None:
            return f"{rate}  unreadable"
        state = result.state.value
        if with_color:
            state = f"[{COLORS[result.state]}]{state}[/]"
        return f"{rate}  {state}  {result.n_inliers} matches  {result.n_keyframes} keyframes"


# A plain bar of frames, for commands that run a method many times.


class FrameBar:
    """A bar that is drawn for each run and leaves nothing behind; without a terminal it is silent.

    Attributes:
        label: What stands before the bar of the next run.
    """

    def __init__(self, console: Console) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._bars = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task: TaskID | None = None
        self.label = ""

    def start(self, n_frames: int | None) -> None:
        """Show an empty bar."""
        self._task = self._bars.add_task(self.label, total=n_frames)
        self._bars.start()

    def frame(self, result: FrameSummary | None) -> None:
        """Advance it by a frame."""
        if self._task is not None:
            self._bars.advance(self._task)

    def finish(self) -> None:
        """Remove it."""
        self._bars.stop()
        if self._task is not None:
            self._bars.remove_task(self._task)
