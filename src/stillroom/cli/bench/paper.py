"""`stillroom bench paper`: a paper's tables and figures, made again beside the printed ones."""

from pathlib import Path
from typing import Annotated

import typer

from stillroom.bench.ablation import homography_of
from stillroom.bench.geometry_table import GeometryTable, geometry_table
from stillroom.bench.observers import GeometryTrialConfig
from stillroom.bench.paper.figures import Figures, draw_bars, draw_errors, draw_geometry, draw_paths, draw_portraits
from stillroom.bench.paper.portraits import Portraits, portraits
from stillroom.bench.paper.published import Paper
from stillroom.bench.paper.published import paper as published
from stillroom.bench.paper.runs import SequenceRuns, SystemRuns, run_system, write_trajectories
from stillroom.bench.paper.sequences import Asked, sequences_of
from stillroom.bench.paper.tables import tables_of
from stillroom.cli.arguments import PLOT_FORMATS, Formats, Settings, Tables, chosen_of
from stillroom.cli.bench.grid import split_sequences
from stillroom.cli.bench.session import Bench, Camera, Frames, Runs
from stillroom.cli.output import print_lines, say
from stillroom.config import SlamConfig
from stillroom.errors import StillroomError
from stillroom.pipeline import Source
from stillroom.pipeline.results import chosen_folder, new_folder
from stillroom.presets.registry import configure
from stillroom.protocols import Dataset
from stillroom.warmup import warm_up

FILE = "paper.json"
TRAJECTORIES, FIGURES = "trajectories", "figures"


def paper(
    name: Annotated[str, typer.Argument(metavar="PAPER", help="oc-slam or pspnet-slam.")],
    sequences: Annotated[
        str | None, typer.Option(metavar="A,B", help="Sequences in place of the paper's own, as for run.")
    ] = None,
    runs: Runs = 5,
    frames: Frames = None,
    camera: Camera = None,
    settings: Settings = None,
    tables: Tables = None,
    formats: Formats = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write into this new folder. \\[default: a new one in results/]")
    ] = None,
) -> None:
    """Make a paper's tables and figures again, beside what it prints.

    Each of its systems runs on each of its TUM sequences, once for each seed. A sequence or a network that is not there
    is "not run", and 'stillroom download' is named for it. The folder gets the tables, the figures, the trajectory of
    each run, and a page with all of it.
    """
    chosen, shapes = published(name), chosen_of("--format", formats, PLOT_FORMATS)
    configs = {system: configure(system, None, settings or ()) for system in chosen.systems}
    asked = sequences_of(chosen, split_sequences(sequences or ""))
    bench = Bench(f"paper {name}", None, tables)
    folder = new_folder(Path("results"), f"bench-paper-{name}", latest=False) if out is None else chosen_folder(out)
    bench.write_to(folder / FILE)
    making = _Making(bench, chosen, configs, runs, folder, shapes)
    for one in asked:
        making.add(one, Source(one.source or "", camera, frames=frames))
    making.conclude()


class _Making:
    """Runs everything on one sequence after the other, and writes what came of it."""

    def __init__(
        self,
        bench: Bench,
        paper: Paper,
        configs: dict[str, SlamConfig],
        runs: int,
        folder: Path,
        formats: tuple[str, ...],
    ) -> None:
        self._bench, self._paper, self._configs, self._runs = bench, paper, configs, runs
        self._folder, self._figures = folder, Figures(folder / FIGURES, formats)
        self._found: list[SequenceRuns] = []
        self._geometry: dict[str, GeometryTable] = {}

    def add(self, asked: Asked, source: Source) -> None:
        """Run all systems on a sequence; what is absent is said."""
        if asked.source is None:
            say(asked.missing)
            self._found.append(SequenceRuns(asked, why_not=asked.missing))
            return
        try:
            dataset = self._bench.open(source)
            warm_up()  # also when they are compiled: loading must not count for the first frame
        except StillroomError as error:
            self._found.append(SequenceRuns(asked, why_not=f"{asked.name}: not run: {error}"))
            say(self._found[-1].why_not)
            return
        measure = self._bench.seeds_of(dataset, self._runs)

        def run(name: str, config: SlamConfig) -> SystemRuns:
            one = run_system(name, config, measure, self._paper.both_loops)
            if one.why_not:
                say(one.why_not)
            return one

        done = self._bench.each(self._configs, run)
        found = SequenceRuns(asked, {one.system: one for one in done}, dataset.groundtruth)
        self._found.append(found)
        self._bench.keep([one.to_dict(asked.name, found.of(self._paper.baseline)) for one in done])
        write_trajectories(self._folder / TRAJECTORIES, found)
        if self._paper.geometry_ms:
            self._measure_geometry(asked, dataset)
            draw_paths(self._figures, self._paper, found)
        else:
            self._draw_portraits(asked, dataset)
            draw_errors(self._figures, self._paper, found)

    def _draw_portraits(self, asked: Asked, dataset: Dataset) -> None:
        def take(name: str, config: SlamConfig) -> Portraits | None:
            self._bench.bar.label = f"{name}, pictures"
            try:
                return portraits(dataset, config, self._bench.bar)
            except StillroomError as error:
                say(f"{asked.name}: no pictures: {error}")
                return None

        for seen in self._bench.each({self._paper.name: self._configs[self._paper.name]}, take):
            if seen is not None:
                draw_portraits(self._figures, asked.name, seen)

    def _measure_geometry(self, asked: Asked, dataset: Dataset) -> None:
        def measure(name: str, config: SlamConfig) -> GeometryTable | None:
            self._bench.bar.label = f"{name}, geometry"
            try:
                trial = GeometryTrialConfig(homography=homography_of(config))
                return geometry_table(dataset, config, trial, self._bench.bar)
            except StillroomError as error:
                say(f"{asked.name}: no geometry: {error}")
                return None

        for table in self._bench.each({self._paper.name: self._configs[self._paper.name]}, measure):
            if table is not None:
                self._geometry[asked.name] = table
                self._bench.keep([row | {"sequence": asked.name} for row in table.to_dict()])
                draw_geometry(self._figures, asked.name, table, dataset.camera)

    def conclude(self) -> None:
        """Print the tables and write the rest."""
        for table in tables_of(self._paper, self._found, self._geometry):
            self._bench.print_table(table.title, table.header, table.rows, table.notes, table.n_words)
        if self._paper.geometry_ms:
            draw_bars(self._figures, self._paper, self._found)
        print_lines([f"folder: {self._folder}"])
        print_lines([f"figure: {path}" for path, _ in self._figures.drawn])
        self._bench.finish(self._figures.drawn)
