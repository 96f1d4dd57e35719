"""Options that several commands have in common, and how those with few values are read."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from stillroom.errors import ConfigError

MAX_GAP_S = 0.02
"""`TUM_MAX_GAP_S` of `data.association`, here because that one loads numpy, and `--help` does not."""

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
Frames = Annotated[str | None, typer.Option(metavar="A:B", help="Use these frames only, such as 200:560.")]
CameraName = Annotated[
    str | None, typer.Option(metavar="NAME|FILE", help="The calibration, where it is not the sequence's own.")
]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Write into this new folder. \\[default: a new one in results/]")
]
Formats = Annotated[
    list[str] | None,
    typer.Option("--format", metavar="NAME", help="Draw the plots as pdf or svg too, beside png; repeatable."),
]
Tables = Annotated[
    list[str] | None,
    typer.Option(
        "--table", metavar="NAME", help="Write each table as markdown, latex or csv too, into a file; repeatable."
    ),
]
Fps = Annotated[
    float | None, typer.Option(metavar="N", help="Frame rate, where names or lists of images tell no times.")
]
TimeUnit = Annotated[
    str | None,
    typer.Option(
        metavar="UNIT", help="Unit of the times in lists and names: s, ms, us, ns. \\[default: told from them]"
    ),
]
PairBy = Annotated[
    str | None,
    typer.Option(metavar="WAY", help="Pair colour and depth by time, name or order. \\[default: time, else name]"),
]
MaxGap = Annotated[
    float, typer.Option(metavar="S", help="Colour and depth further apart in time than this are not paired.")
]
DepthOffset = Annotated[
    float, typer.Option(metavar="S", help="Add this to depth's times, such as -0.03 where depth is stamped 30 ms late.")
]


SensorName = Annotated[
    str | None,
    typer.Option(
        "--sensor",
        metavar="NAME",
        help="Use the images as rgbd, stereo or monocular; monocular drops depth. \\[default: told by the sequence]",
    ),
]


PLOT_FORMATS = ("png", "svg", "pdf")
"""`FORMATS` of `viz.style`, here because that one loads numpy, and `--help` does not."""


def chosen_of(option: str, given: Iterable[str] | None, known: Sequence[str]) -> tuple[str, ...]:
    """Return what was chosen of a few, each once; commas may stand between them.

    Args:
        option: As typed, for the message.
        given: What was typed; None for nothing.
        known: What there is.

    Raises:
        ConfigError: Something else was typed.
    """
    words = [word.strip().lower() for text in given or () for word in text.split(",")]
    for word in words:
        if word not in known:
            raise ConfigError(f"{option} {word}: no such form; there are {', '.join(known)}")
    return tuple(dict.fromkeys(words))
