"""`stillroom warmup`, and the progress line that other commands show when kernels are not compiled yet."""

import time

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from stillroom.cli.output import STDERR, print_lines
from stillroom.compiled import is_kept, kernel_cache
from stillroom.warmup import WarmUp, is_warm, warm_up


def warmup() -> None:
    """Compile all kernels now, so that the first run starts at once.

    Takes a minute or two, once: the machine code is kept in the user's cache.
    """
    done = with_progress(STDERR, renderer=True)
    origin = f"{done.n_compiled} of them compiled" if done.n_compiled else "all from the cache"
    print_lines(
        [
            f"{done.n_kernels} kernels ready in {done.seconds:.1f} s, {origin}",
            f"kept in {kernel_cache()}" if is_kept() else "not kept: the cache folder cannot be written",
        ]
    )


def ensure_warm(console: Console, renderer: bool = False, loaded: bool = False) -> None:
    """Compile the kernels, with a progress line, unless they are in the cache.

    Args:
        console: Where the line is shown.
        renderer: Whether the synthetic room's kernels will be needed too.
        loaded: Whether they must be loaded too, which takes some seconds: a camera does not wait for the first frames.
    """
    if loaded or not is_warm(renderer):
        with_progress(console, renderer)


def with_progress(console: Console, renderer: bool) -> WarmUp:
    """Compile or load the kernels, with a progress bar and the time left; without a terminal, a line now and then."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    if not console.is_terminal:
        console.print("loading kernels; those not compiled yet are, which takes a minute or two, once …")
        return warm_up(_Lines(console), renderer)
    # Kernels take from half a second to ten: over a few of them the time left would jump.
    with Progress(*columns, console=console, transient=True, speed_estimate_period=300.0) as bar:
        task = bar.add_task("loading kernels", total=None)

        def show(kernel: str, done: int, total: int) -> None:
            bar.update(task, description=f"compiling kernels (once) {kernel}", completed=done, total=total)

        return warm_up(show, renderer)


class _Lines:
    """Prints how far a compilation is each time that a quarter of what was to be done is done."""

    QUARTERS = 4

    def __init__(self, console: Console) -> None:
        self._console, self._told = console, 0
        self._first, self._start_s = -1, 0.0

    def __call__(self, kernel: str, done: int, total: int) -> None:
        if self._first < 0:
            self._first, self._start_s = done, time.perf_counter()
        quarters = self.QUARTERS * (done - self._first) // max(total - self._first, 1)
        if quarters > self._told and done < total:
            self._told = quarters
            left_s = (time.perf_counter() - self._start_s) * (total - done) / (done - self._first)
            self._console.print(f"{done}/{total} kernels compiled; about {left_s:.0f} s left", highlight=False)
