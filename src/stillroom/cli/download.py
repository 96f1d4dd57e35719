"""`stillroom download`: sequences and networks from their own addresses."""

from pathlib import Path
from typing import Annotated, Self

import typer
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from stillroom.cli.output import STDERR, print_lines, say
from stillroom.data.locations import data_home, models_home
from stillroom.download import OFFICIAL, PSPNET_R50
from stillroom.download import download as fetch_target
from stillroom.stopping import INTERRUPTED


def download(
    target: Annotated[str, typer.Argument(metavar="WHAT", help="tum/<name>, bonn/<name> or pspnet-r50.")],
    to: Annotated[
        Path | None,
        typer.Option(
            "--to",
            metavar="FOLDER",
            help="Target folder. \\[default: STILLROOM_DATA or STILLROOM_MODELS, else the cache]",
        ),
    ] = None,
) -> None:
    """Fetch a data set, or a network to train from.

    An interrupted download is resumed. Checksums are verified where they are known. The networks that
    methods run with come with Stillroom; pspnet-r50 is what 'stillroom train pspnet --backbone resnet50' starts from.

    Names are those of the data sets, with or without their prefix:

        stillroom download bonn/crowd
        stillroom download tum/freiburg3_walking_xyz
        stillroom download pspnet-r50
    """
    is_network = target == PSPNET_R50
    folder = to if to is not None else models_home() if is_network else data_home()
    try:
        with _Bars(STDERR) as bars:
            place = fetch_target(target, folder, bars, OFFICIAL)
    except KeyboardInterrupt:
        say("stopped; the partial download is kept, the same command resumes it")
        raise typer.Exit(INTERRUPTED) from None
    print_lines([str(place)])
    if not is_network:
        say(f"next: stillroom run {place} --method oc-slam")


class _Bars(Progress):
    """One bar a file."""

    def __init__(self, console: Console) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            DownloadColumn(),
            TimeRemainingColumn(compact=True, elapsed_when_finished=True),
            console=console,
        )
        self._bar_of: dict[str, TaskID] = {}

    def __enter__(self) -> Self:
        """Show nothing before there is a file to fetch."""
        return self

    def __exit__(self, *raised: object) -> None:
        """Let go of the terminal."""
        if self._bar_of:
            self.stop()

    def __call__(self, name: str, done_bytes: int, total_bytes: int | None) -> None:
        """Move the file's bar."""
        if not self._bar_of:
            self.start()
        if name not in self._bar_of:
            self._bar_of[name] = self.add_task(name)
        self.update(self._bar_of[name], completed=done_bytes, total=total_bytes)
