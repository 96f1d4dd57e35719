"""`stillroom train pspnet` and `stillroom export pspnet`."""

import typer

from stillroom.cli.pspnet.exporting import export_pspnet
from stillroom.cli.pspnet.training import train_pspnet

HELP = "Train PSPNet, which says where people are."

train_app = typer.Typer(no_args_is_help=True, help=HELP)
train_app.command("pspnet")(train_pspnet)

export_app = typer.Typer(no_args_is_help=True, help="Turn what was trained into a file that runs.")
export_app.command("pspnet")(export_pspnet)
