"""Options that several commands have in common."""

from pathlib import Path
from typing import Annotated

import typer

Method = Annotated[
    str | None,
    typer.Option("--method", "-m", metavar="NAME", help="The method; see 'stillroom methods'. \\[default: oc-slam]"),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="A TOML file, whole or in part, such as the config.toml of a run."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one value, such as tracking.min_inliers=20; repeatable."),
]
Seed = Annotated[int | None, typer.Option("--seed", metavar="N", help="Seed of all random choices. \\[default: 0]")]
