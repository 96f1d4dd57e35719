"""The commands of `stillroom`, its own and installed ones, and how errors are reported.

Only the module of the command that is asked for is imported: `stillroom --help` answers at once.
"""

import importlib
import inspect
import io
import os
import re
import sys
import traceback
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from stillroom.cli.installed import ALONE, GROUP, BySecondWord, installed, summary_of
from stillroom.cli.streams import flush_all
from stillroom.errors import NO_MEMORY, StillroomError, is_of_memory
from stillroom.stopping import INTERRUPTED, as_ctrl_c, exit_code

ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""numpy's BLAS reads these when it is imported. One thread: results are repeatable, and the cores are left to the
stages.
"""


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
        "Track a camera through a rendered room with people in it, by orb-slam2 and by stillroom, and compare the two.",
    ),
    Command("run", "stillroom.cli.run:run", "Track the camera through a sequence."),
    Command("record", "stillroom.cli.record:record", "Keep what a camera sees as a sequence."),
    Command("view", "stillroom.cli.view:view", "Show a finished run in rerun's viewer."),
    Command("evaluate", "stillroom.cli.evaluate:evaluate", "Evaluate a trajectory: ATE and RPE."),
    Command("report", "stillroom.cli.report:report", "Compare finished runs on a page to look at."),
    Command("calibrate", "stillroom.cli.calibrate:app", "Estimate what a camera file needs from a recording."),
    Command(
        "inpaint",
        "stillroom.cli.inpaint:inpaint",
        "Remove what moves from the images, painted over by what the last keyframes saw behind it.",
    ),
    Command("export", "stillroom.cli.export:export", "Export the dense map of a run for other programs."),
    Command(
        "map",
        "stillroom.cli.map:app",
        "Show what a map file holds, check it, and export it for other programs.",
    ),
    Command("methods", "stillroom.cli.describe:methods", "List the methods."),
    Command("show-config", "stillroom.cli.describe:show_config", "Print the configuration of a method as TOML."),
    Command("bench", "stillroom.cli.bench:app", "Measure accuracy, the benefit of rejection, speed, and ghosts."),
    Command("download", "stillroom.cli.download:download", "Fetch a data set, or a network to train from."),
    Command("warmup", "stillroom.cli.warmup:warmup", "Compile all kernels now, so that the first run starts at once."),
)


def application(chosen: str | None = None, following: str | None = None) -> typer.Typer:
    """Return the command line; the commands that are not chosen are registered by name only.

    Args:
        chosen: The command.
        following: The next word.

    Raises:
        ConfigError: An installed package adds a command whose name is taken, or that cannot be imported.
    """
    app = typer.Typer(
        name="stillroom",
        help="SLAM for rooms full of people: where the camera was, and a map of what stays.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
    )
    app.callback()(_options)
    own = {command.name: command for command in COMMANDS}
    loaded = own[chosen].load() if chosen in own else None
    added = installed([*own, *(f"{chosen}.{name}" for name in _inner_names(loaded))])
    for command in COMMANDS:
        if command.name != chosen:
            app.command(command.name, help=command.summary)(_not_loaded)
    for name, commands in added.items():
        if name not in {chosen, *own}:
            app.command(name, help=None if chosen else summary_of(commands))(_not_loaded)
    if chosen is not None and (chosen in own or chosen in added):
        _add(app, chosen, _with_second_words(loaded, added.get(chosen, {}), following))
    return app


def _with_second_words(own: Any, added: BySecondWord, following: str | None) -> Any:
    """Return the function or app of a command to which installed packages may have added second words.

    Args:
        own: Stillroom's own function or app; None where the command is installed.
        added: The entry points that begin with the command's name.
        following: The word after the command's name.
    """
    if own is None and ALONE in added:
        own = GROUP.load(added[ALONE])
    if following is not None and following in added:
        added = {following: added[following]}
    elif own is not None and not isinstance(own, typer.Typer):
        return own
    if isinstance(own, typer.Typer):
        app = copy(own)
        app.registered_commands, app.registered_groups = list(own.registered_commands), list(own.registered_groups)
    else:
        app = typer.Typer(no_args_is_help=True, help=summary_of(added))
    for word, entry in added.items():
        if word != ALONE:
            _add(app, word, GROUP.load(entry))
    return app


def _add(app: typer.Typer, name: str, loaded: Any) -> None:
    """Add a function, or an app with commands of its own, under a name."""
    if not isinstance(loaded, typer.Typer):
        app.command(name, help=flowing(loaded.__doc__))(loaded)
        return
    for inner in loaded.registered_commands:
        inner.help = flowing(inner.callback.__doc__ if inner.callback else None)
    app.add_typer(loaded, name=name)


def _inner_names(loaded: Any) -> list[str]:
    """Return the names of an app's own commands."""
    inner = loaded.registered_commands if isinstance(loaded, typer.Typer) else []
    return [each.name or getattr(each.callback, "__name__", "").replace("_", "-") for each in inner]


def flowing(docstring: str | None) -> str:
    """Return a docstring as help: paragraphs on one line each, for any width; indented examples stay as they are."""
    return re.sub(r"(?<!\n)\n(?![\n ])", " ", inspect.cleandoc(docstring or ""))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; a known error ends in one red line.

    Raises:
        SystemExit: Always: 0; 1 after an error; 2 after wrong usage; 3 after a run that tracked nothing; 130 after
            Ctrl-C, 143 after SIGTERM, 129 after SIGHUP.
    """
    _print_any_character()
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
    given = list(sys.argv[1:] if arguments is None else arguments)
    # Before a command there are only --help and --version, after which none is run.
    words = [] if given and given[0].startswith("-") else [word for word in given if not word.startswith("-")]
    chosen, following, *_ = [*words, None, None]
    code: str | int | None = INTERRUPTED
    try:
        with as_ctrl_c():
            application(chosen, following)(args=given, prog_name="stillroom")
    except StillroomError as error:
        from stillroom.cli.output import print_error

        print_error(str(error))
        code = 1
    except Exception as error:
        if not is_of_memory(error):
            raise
        traceback.clear_frames(error.__traceback__)  # they hold what there was no room beside
        from stillroom.cli.output import print_error

        print_error(NO_MEMORY)
        code = 1
    except SystemExit as left:
        code = left.code
    except KeyboardInterrupt:
        pass
    flush_all()
    sys.exit(exit_code() if code == INTERRUPTED else code)


def _print_any_character() -> None:
    """Let no character end a command: what a terminal's code page lacks is printed as a question mark."""
    for stream, errors in ((sys.stdout, "replace"), (sys.stderr, "backslashreplace")):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=errors)


def _print_version(asked: bool) -> None:
    if asked:
        from stillroom.version import __version__

        typer.echo(f"stillroom {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """SLAM for rooms full of people: where the camera was, and a map of what stays."""


def _not_loaded() -> None:
    raise AssertionError("this command was not asked for")


if __name__ == "__main__":
    main()
