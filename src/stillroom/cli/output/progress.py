"""The bar of a run."""

import time
from collections import deque

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from stillroom.data.result import FrameResult, TrackingState

RATE_OVER_FRAMES = 30
LINES_WITHOUT_TERMINAL = 10
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
        self._n_frames = 0
        self._done = 0
        self._times_s: deque[float] = deque(maxlen=RATE_OVER_FRAMES + 1)

    def start(self, n_frames: int) -> None:
        """Show an empty bar."""
        self._n_frames, self._done = n_frames, 0
        self._times_s.append(time.perf_counter())
        self._bar.start()
        self._task = self._bar.add_task("starting", total=n_frames)

    def frame(self, result: FrameResult | None) -> None:
        """Move it on by a frame."""
        self._done += 1
        self._times_s.append(time.perf_counter())
        if self._console.is_terminal and self._task is not None:
            self._bar.update(self._task, advance=1, description=self._text(result, with_color=True))
        elif self._done == self._n_frames or self._done % max(1, self._n_frames // LINES_WITHOUT_TERMINAL) == 0:
            text = f"{self._done}/{self._n_frames}  {self._text(result, with_color=False)}"
            self._console.print(text, highlight=False, soft_wrap=True)

    def finish(self) -> None:
        """Leave it as it is."""
        self._bar.stop()

    def _text(self, result: FrameResult | None, with_color: bool) -> str:
        elapsed_s = self._times_s[-1] - self._times_s[0]
        rate = f"{(len(self._times_s) - 1) / elapsed_s:5.1f} frames/s" if elapsed_s > 0 else ""
        if result is None:
            return f"{rate}  unreadable"
        state = result.state.value
        if with_color:
            state = f"[{COLORS[result.state]}]{state}[/]"
        return f"{rate}  {state}  {result.n_inliers} matches  {result.n_keyframes} keyframes"
