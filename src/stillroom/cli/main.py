"""The commands of `stillroom`, and what becomes of an error.

Only the module of the command that is asked for is imported: `stillroom --help` answers at once.
"""

import importlib
import inspect
import os
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import typer

from stillroom.errors import StillroomError

INTERRUPTED = 130
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""numpy's BLAS reads these when it is imported. One thread: results repeat, and the cores are for the stages."""


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        name: As typed.
        place: `module:function`, or `module:app` for a command with commands of its own.
        summary: For the list of commands; the first line of its help.
    """

    name: str
    place: str
    summary: str

    def load(self) -> Any:
        """Import the function or app."""
        module, _, name = self.place.partition(":")
        return getattr(importlib.import_module(module), name)


COMMANDS = (
    Command(
        "demo",
        "stillroom.cli.demo:demo",
        "Track a camera through a rendered room with people in it, by orb-slam2 and by oc-slam, and compare the two.",
    ),
    Command("run", "stillroom.cli.run:run", "Track the camera through a sequence."),
    Command("evaluate", "stillroom.cli.evaluate:evaluate", "Say how good a trajectory is."),
    Command(
        "inpaint",
        "stillroom.cli.inpaint:inpaint",
        "Paint what moves out of a sequence, from what the last keyframes saw behind it.",
    ),
    Command("export", "stillroom.cli.export:export", "Turn the dense map of a run into files for other programs."),
    Command(
        "map",
        "stillroom.cli.map:app",
        "Say what a map file holds, check it, and turn it into files for other programs.",
    ),
    Command("methods", "stillroom.cli.describe.methods:methods", "List the methods."),
    Command(
        "show-config", "stillroom.cli.describe.show_config:show_config", "Print the configuration of a method as TOML."
    ),
    Command("bench", "stillroom.cli.bench:app", "Measure accuracy, the worth of rejection, speed, and ghosts."),
    Command("download", "stillroom.cli.download:download", "Fetch a data set or the weights of YOLO-Fastest."),
    Command("train", "stillroom.cli.pspnet:train_app", "Train PSPNet, which says where people are."),
    Command(
        "train-vocabulary",
        "stillroom.cli.train_vocabulary:train_vocabulary",
        "Make a vocabulary of places from sequences.",
    ),
    Command("warmup", "stillroom.cli.warmup:warmup", "Compile all kernels now, so that the first run starts at once."),
)

SECOND_WORDS = {("export", "pspnet"): "stillroom.cli.pspnet:export_app"}
"""Where a command of one word is another one when a certain word follows it."""


def application(chosen: str | None = None, following: str | None = None) -> typer.Typer:
    """Return the command line; the commands that are not chosen are there by name only.

    Args:
        chosen: The command.
        following: The next word.
    """
    app = typer.Typer(
        name="stillroom",
        help="RGB-D SLAM for rooms full of people: where the camera was, and a map of what stays.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
    )
    app.callback()(_options)
    for command in COMMANDS:
        if command.name != chosen:
            app.command(command.name, help=command.summary)(_not_loaded)
            continue
        place = SECOND_WORDS.get((chosen, following or ""), command.place)
        loaded = replace(command, place=place).load()
        if isinstance(loaded, typer.Typer):
            for inner in loaded.registered_commands:
                inner.help = flowing(inner.callback.__doc__ if inner.callback else None)
            app.add_typer(loaded, name=command.name)
        else:
            app.command(command.name, help=flowing(loaded.__doc__))(loaded)
    return app


def flowing(docstring: str | None) -> str:
    """Return a docstring as help: paragraphs on one line each, for any width; indented examples stay as they are."""
    return re.sub(r"(?<!\n)\n(?![\n ])", " ", inspect.cleandoc(docstring or ""))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; a known error ends in one red line.

    Raises:
        SystemExit: Always: 0, 1 after an error, 2 after wrong usage, 130 after Ctrl-C.
    """
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
    given = list(sys.argv[1:] if arguments is None else arguments)
    chosen, following, *_ = [*(word for word in given if not word.startswith("-")), None, None]
    try:
        application(chosen, following)(args=given, prog_name="stillroom")
    except StillroomError as error:
        from stillroom.cli.output.console import print_error

        print_error(str(error))
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _print_version(asked: bool) -> None:
    if asked:
        import stillroom

        typer.echo(f"stillroom {stillroom.__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """RGB-D SLAM for rooms full of people: where the camera was, and a map of what stays."""


def _not_loaded() -> None:
    raise AssertionError("this command was not asked for")


if __name__ == "__main__":
    main()
