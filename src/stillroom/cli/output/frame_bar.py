"""A plain bar of frames, for commands that run a method many times."""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from stillroom.data.result import FrameResult


class FrameBar:
    """Starts anew for each run and leaves nothing behind; without a terminal it is silent.

    Attributes:
        label: What stands before the bar of the next run.
    """

    def __init__(self, console: Console) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._bars = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task: TaskID | None = None
        self.label = ""

    def start(self, n_frames: int) -> None:
        """Show an empty bar."""
        self._task = self._bars.add_task(self.label, total=n_frames)
        self._bars.start()

    def frame(self, result: FrameResult | None) -> None:
        """Move it on by a frame."""
        if self._task is not None:
            self._bars.advance(self._task)

    def finish(self) -> None:
        """Take it away."""
        self._bars.stop()
        if self._task is not None:
            self._bars.remove_task(self._task)
