"""`stillroom download`: sequences and weights from their own addresses."""

from pathlib import Path
from typing import Annotated, Self

import typer
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from stillroom.cli.output.console import STDERR, say
from stillroom.cli.output.tables import print_lines
from stillroom.data.locations import data_home, models_home
from stillroom.download import OFFICIAL
from stillroom.download import download as fetch_target
from stillroom.download import download_pspnet_r50 as fetch_pspnet_r50
from stillroom.errors import ConfigError

INTERRUPTED = 130


def download(
    target: Annotated[str, typer.Argument(metavar="WHAT", help="tum/<name>, bonn/<name> or models.")],
    to: Annotated[
        Path | None,
        typer.Option(
            "--to",
            metavar="FOLDER",
            help="Where to put it; otherwise STILLROOM_DATA or STILLROOM_MODELS, or the cache.",
        ),
    ] = None,
    pspnet_r50: Annotated[
        bool,
        typer.Option("--pspnet-r50", help="With 'models': OpenMMLab's PSPNet on ResNet-50, too, to train from."),
    ] = False,
) -> None:
    """Fetch a data set or the weights of YOLO-Fastest.

    An interrupted download goes on where it broke off. Checksums are compared where they are known.

    Names are those of the data sets, with or without their prefix:

        stillroom download models
        stillroom download models --pspnet-r50
        stillroom download bonn/crowd
        stillroom download tum/freiburg3_walking_xyz
    """
    models = target == "models"
    if pspnet_r50 and not models:
        raise ConfigError(f"--pspnet-r50 goes with 'stillroom download models', not with '{target}'")
    folder = to if to is not None else models_home() if models else data_home()
    try:
        with _Bars(STDERR) as bars:
            place = fetch_target(target, folder, bars, OFFICIAL)
            checkpoint = fetch_pspnet_r50(folder, bars, OFFICIAL) if pspnet_r50 else None
    except KeyboardInterrupt:
        say("stopped; what has come is kept, the same command goes on from there")
        raise typer.Exit(INTERRUPTED) from None
    print_lines([str(path) for path in (place, checkpoint) if path is not None])
    if not models:
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
