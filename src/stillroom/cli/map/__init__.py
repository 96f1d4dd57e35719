"""`stillroom map`: what a map file holds, whether it is whole, and what other programs can read of it."""

import typer

from stillroom.cli.map.check import check
from stillroom.cli.map.export import export
from stillroom.cli.map.info import info

HELP = "Say what a map file holds, check it, and turn it into files for other programs."

app = typer.Typer(no_args_is_help=True, help=HELP)
for command in (info, check, export):
    app.command()(command)
