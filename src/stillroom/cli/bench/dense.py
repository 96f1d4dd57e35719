"""`stillroom bench ghosts`: what moving things leave behind in the dense map."""

from pathlib import Path
from typing import Annotated

import typer

from stillroom.benchmark.ghosts import HEADER, Ghosts, stretches
from stillroom.benchmark.ghosts import ghosts as judged
from stillroom.cli.arguments import Settings
from stillroom.cli.bench.session import Bench, Camera, Out, Sequence1
from stillroom.cli.output import print_lines
from stillroom.config import SlamConfig
from stillroom.methods.registry import configure
from stillroom.pipeline import Source


def ghosts(
    sequence: Sequence1,
    method: Annotated[str, typer.Option(metavar="NAME", help="The preset whose dense map is on trial.")] = "oc-slam",
    reference: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Frames that see the room empty; 0:200, on rendered sequences the truth."),
    ] = None,
    mapped: Annotated[
        str | None, typer.Option("--map", metavar="A:B", help="Frames to map; by default all after these.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Draw both maps side by side, and write them here.")
    ] = None,
    camera: Camera = None,
    settings: Settings = None,
    out: Out = None,
) -> None:
    """Map some frames with and without removing what moves: ghosts, completeness, surface error.

    Real maps are held against the free space that the reference frames saw, rendered ones against the truth.
    """
    config = configure(method, None, settings or ())
    bench = Bench("ghosts", out)
    dataset = bench.open(Source(sequence, camera))
    chosen = stretches(dataset, reference, mapped)

    def measure(name: str, config: SlamConfig) -> Ghosts:
        bench.bar.label = name
        return judged(dataset, name, config, chosen, bench.bar)

    for figures in bench.each({method: config}, measure):
        bench.print_table(f"{method} on {dataset.name}", HEADER, [one.row() for one in figures.maps])
        print_lines(figures.sentences())
        bench.keep([figures.to_dict()])
        if picture is not None:
            figures.draw(picture)
            print_lines([f"picture: {picture}"])
    bench.finish()
