"""`stillroom bench`: accuracy over seeds, the benefit of rejection, time per frame, ghosts, grids of runs, papers."""

import typer

from stillroom.cli.bench.geometry import ablation, geometry
from stillroom.cli.bench.grid import grid
from stillroom.cli.bench.paper import paper
from stillroom.cli.bench.trials import accuracy, ghosts, parts, rejection, shutter, speed

HELP = "Measure accuracy, the benefit of rejection, speed, and ghosts."

app = typer.Typer(no_args_is_help=True, help=HELP)
for command in (accuracy, rejection, parts, shutter, speed, ghosts, geometry, ablation, grid, paper):
    app.command()(command)
