"""`stillroom map check`."""

from pathlib import Path
from typing import Annotated

import typer

MapPath = Annotated[Path, typer.Argument(metavar="MAP", help="A map file, such as room.stillmap.")]
MOST_SHOWN = 20


def check(path: MapPath) -> None:
    """Tell whether a map file is whole.

    Every observation's keyframe, point and keypoint must exist, every pose must be rigid, every number finite.

        stillroom map check room.stillmap
    """
    from stillroom.cli.output.console import print_error
    from stillroom.cli.output.tables import print_lines
    from stillroom.storage.check import check_map

    problems = check_map(path)
    if not problems:
        print_lines([f"{path}: whole"])
        return
    print_lines(problems[:MOST_SHOWN])
    if len(problems) > MOST_SHOWN:
        print_lines([f"… and {len(problems) - MOST_SHOWN} more"])
    print_error(f"{path}: is damaged in {len(problems)} place{'s' if len(problems) > 1 else ''}")
    raise typer.Exit(1)
