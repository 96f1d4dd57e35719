"""`stillroom bench geometry` and `ablation`: what the ants save, and what each part contributes."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from stillroom.bench import ablation as combining
from stillroom.bench.ablation import Ablated
from stillroom.bench.geometry_table import HEADER, GeometryTable, geometry_table, write_geometry_picture
from stillroom.bench.observers import GeometryTrialConfig, MovingThings
from stillroom.cli.arguments import Settings, Tables
from stillroom.cli.bench.session import Bench, Camera, Frames, Out, Runs, Sequences
from stillroom.cli.output import print_lines, say
from stillroom.config import SlamConfig
from stillroom.datasets.recording import rendered
from stillroom.errors import ConfigError
from stillroom.pipeline import Source
from stillroom.presets.registry import configure
from stillroom.protocols import Dataset
from stillroom.warmup import warm_up


def geometry(
    sequences: Sequences,
    method: Annotated[str, typer.Option(metavar="NAME", help="The preset that tracks the camera.")] = "pspnet-slam",
    network: Annotated[
        bool,
        typer.Option("--network", help="Leave out what the network masks; else geometry must find the people."),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Draw the compensation and the ants' path of an image.")
    ] = None,
    picture_of: Annotated[
        int | None, typer.Option(metavar="N", help="Which image to draw; by default one in which much moves.")
    ] = None,
    frames: Frames = None,
    camera: Camera = None,
    settings: Settings = None,
    tables: Tables = None,
    out: Out = None,
) -> None:
    """Test every point as DynaSLAM does, and along the ants' path as PSPNet-SLAM does: PSPNet-SLAM's Table 2.

    The same images, poses and points for both; with the test of a point that we made of PSPNet-SLAM's, with DynaSLAM's,
    and with PSPNet-SLAM's as printed; with and without growing regions from what was found.
    """
    config = configure(method, None, settings or ())
    trial = GeometryTrialConfig(network=network, homography=combining.homography_of(config), picture_of=picture_of)
    bench = Bench("geometry", out, tables)
    for sequence in sequences:
        dataset = bench.open(Source(sequence, camera, frames=frames), reads_depth=True)
        warm_up()  # also when they are compiled: loading must not count for the first image

        for table in bench.each({method: config}, _measuring(bench, dataset, trial)):
            bench.print_table(dataset.name, HEADER, table.rows(), table.sentences())
            bench.keep(table.to_dict())
            if picture is not None and table.shown is not None:
                write_geometry_picture(picture, table.shown, dataset.camera)
                print_lines([f"picture: {picture}"])
            elif picture is not None:
                say(f"no picture: image {picture_of} was not among those compared")
    bench.finish()


def _measuring(
    bench: Bench, dataset: Dataset, trial: GeometryTrialConfig
) -> Callable[[str, SlamConfig], GeometryTable]:
    def measure(name: str, config: SlamConfig) -> GeometryTable:
        bench.bar.label = name
        return geometry_table(dataset, config, trial, bench.bar)

    return measure


def ablation(
    sequences: Sequences,
    method: Annotated[str, typer.Option(metavar="NAME", help="The preset whose parts are compared.")] = "pspnet-slam",
    runs: Runs = 1,
    only: Annotated[
        str | None, typer.Option(metavar="A,B", help="Run these rows only, by parts of their names.")
    ] = None,
    frames: Frames = None,
    camera: Camera = None,
    settings: Settings = None,
    tables: Tables = None,
    out: Out = None,
) -> None:
    """Compare network only, geometry only, both, both with the ants, and a plain with the compensated homography.

    On rendered sequences it also counts what is found of all that moves, and of objects that people carry or push,
    which are in no class of the network.

    Nine runs of each sequence, with the network that comes with Stillroom: 560 images take some six minutes of one
    core, longer when kernels are compiled first.
    """
    configs = _chosen(combining.ablation(configure(method, None, settings or ())), only)
    bench = Bench("ablation", out, tables)
    for sequence in sequences:
        dataset = bench.open(Source(sequence, camera, frames=frames), reads_depth=True)
        room = rendered(dataset)
        things = None if room is None else MovingThings(room)
        table = bench.each(configs, _ablating(bench, dataset, runs, things))
        if table:
            rows, notes = [one.row() for one in table], combining.sentences(table)
            bench.print_table(dataset.name, combining.HEADER, rows, notes)
            bench.keep([one.to_dict(table[0]) for one in table])
    bench.finish()


def _ablating(
    bench: Bench, dataset: Dataset, runs: int, things: MovingThings | None
) -> Callable[[str, SlamConfig], Ablated]:
    def measure(name: str, config: SlamConfig) -> Ablated:
        bench.bar.label = name
        one = combining.ablated(dataset, name, config, runs, things, bench.bar)
        say(f"{name} on {dataset.name}: {', '.join(one.row()[1:])}")
        return one

    return measure


def _chosen(configs: dict[str, SlamConfig], only: str | None) -> dict[str, SlamConfig]:
    if only is None:
        return configs
    words = [word.strip() for word in only.split(",")]
    chosen = {name: config for name, config in configs.items() if any(word in name for word in words)}
    if not chosen:
        raise ConfigError(f"--only {only}: no such row; there are {', '.join(configs)}")
    return chosen
