"""`stillroom bench accuracy`, `rejection`, `parts`, `shutter` and `speed`: repeated runs of methods."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from stillroom.bench import accuracy as exactness
from stillroom.bench import live_speed as living
from stillroom.bench import parts as combining
from stillroom.bench import rejection as rejecting
from stillroom.bench import shutter as rolling
from stillroom.bench import speed as cost
from stillroom.bench.ghost_trials import HEADER, Ghosts, stretches
from stillroom.bench.ghost_trials import ghosts as judged
from stillroom.bench.parts import BOTH, HALF, Part, every_second_second
from stillroom.bench.rejection import Way, ways
from stillroom.bench.speed import Speed, UnitMeter
from stillroom.cli.arguments import SensorName, Settings, Tables
from stillroom.cli.bench.session import Bench, Camera, Frames, Methods, Out, Runs, Sequence1, Sequences
from stillroom.cli.output import print_lines
from stillroom.config import SlamConfig
from stillroom.errors import ConfigError
from stillroom.pipeline import Source
from stillroom.presets.registry import all_methods, configure
from stillroom.warmup import warm_up

PRESETS = "orb-slam2,oc-slam"


# `stillroom bench ghosts`: what moving objects leave in the dense map.


def ghosts(
    sequence: Sequence1,
    method: Annotated[str, typer.Option(metavar="NAME", help="The preset whose dense map is evaluated.")] = "oc-slam",
    reference: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Frames that see the room empty; 0:200, on rendered sequences the truth."),
    ] = None,
    mapped: Annotated[
        str | None, typer.Option("--map", metavar="A:B", help="Frames to map; by default all after these.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw both maps side by side, as PNG, or as PDF or SVG by its suffix."),
    ] = None,
    camera: Camera = None,
    settings: Settings = None,
    tables: Tables = None,
    out: Out = None,
) -> None:
    """Map some frames with and without removing what moves: ghosts, completeness, surface error.

    Real maps are compared with the free space that the reference frames saw, rendered ones with the truth.
    """
    config = configure(method, None, settings or ())
    bench = Bench("ghosts", out, tables)
    dataset = bench.open(Source(sequence, camera), reads_depth=True)
    chosen = stretches(dataset, reference, mapped)

    def measure(name: str, config: SlamConfig) -> Ghosts:
        bench.bar.label = name
        return judged(dataset, name, config, chosen, bench.bar)

    for figures in bench.each({method: config}, measure):
        bench.print_table(
            f"{method} on {dataset.name}", HEADER, [one.row() for one in figures.maps], figures.sentences()
        )
        bench.keep([figures.to_dict()])
        if picture is not None:
            figures.draw(picture)
            print_lines([f"picture: {picture}"])
    bench.finish()


def accuracy(
    sequences: Sequences,
    methods: Methods = PRESETS,
    runs: Runs = 5,
    frames: Frames = None,
    dense: Annotated[
        bool, typer.Option("--dense", help="Make dense maps too; they cost time and change no pose.")
    ] = False,
    camera: Camera = None,
    sensor: SensorName = None,
    settings: Settings = None,
    tables: Tables = None,
    out: Out = None,
) -> None:
    """Run each method with several seeds: ATE, improvement over the first method, coverage, RPE, time of a frame."""
    configs = _configs(methods, settings)
    bench = Bench("accuracy", out, tables)
    for sequence in sequences:
        dataset = bench.open(Source(sequence, camera, frames=frames, sensor=sensor))
        table = bench.each(configs, bench.seeds_of(dataset, runs, dense=dense))
        notes = exactness.sentences(table, dense) if table else []
        bench.print_table(dataset.name, exactness.HEADER, [row.row(table[0]) for row in table])
        smooth = [row.smoothness_row() for row in table]
        bench.print_table(f"{dataset.name}: smoothness and time", exactness.SMOOTHNESS_HEADER, smooth, notes)
        bench.keep([row.to_dict(table[0]) for row in table])
    bench.finish()


def rejection(
    sequence: Sequence1,
    method: Annotated[str, typer.Option(metavar="NAME", help="The preset whose sieve is compared.")] = "oc-slam",
    runs: Runs = 1,
    frames: Frames = None,
    camera: Camera = None,
    sensor: SensorName = None,
    settings: Settings = None,
    tables: Tables = None,
    out: Out = None,
) -> None:
    """Compare no rejection, whole boxes, OC-SLAM as printed and the preset: ATE, coverage, features kept."""
    bench = Bench("rejection", out, tables)
    dataset = bench.open(Source(sequence, camera, frames=frames, sensor=sensor))
    configs = ways(configure(method, None, settings or ()))
    table = [Way(row) for row in bench.each(configs, bench.seeds_of(dataset, runs))]
    boxes = next((way for way in table if way.accuracy.method == rejecting.WHOLE_BOXES), None)
    if boxes is not None:
        rows = [way.row(boxes) for way in table]
        bench.print_table(dataset.name, rejecting.HEADER, rows, rejecting.sentences(table))
        bench.keep([way.to_dict(boxes) for way in table])
    bench.finish()


def parts(
    sequence: Sequence1,
    method: Annotated[str, typer.Option(metavar="NAME", help="The preset whose parts are compared.")] = "oc-slam",
    runs: Runs = 1,
    frames: Frames = None,
    camera: Camera = None,
    settings: Settings = None,
    tables: Tables = None,
    out: Out = None,
) -> None:
    """Compare neither boxes nor clusters, each alone, both, and both with the detector failing half the time.

    It fails every second second from the first image with a detection on; propagated boxes are withheld too.
    """
    configs = combining.parts(configure(method, None, settings or ()))
    bench = Bench("parts", out, tables)
    dataset = bench.open(Source(sequence, camera, frames=frames))
    table = [Part(row) for row in bench.each(configs, bench.seeds_of(dataset, runs))]
    first = next((part.first_boxed for part in table if part.accuracy.method == BOTH), None)
    withheld = () if first is None else every_second_second(dataset, first)
    if withheld:
        table += map(Part, bench.each({HALF: configs[BOTH]}, bench.seeds_of(dataset, runs, withheld)))
    if table:
        rows, notes = [part.row() for part in table], combining.sentences(table, withheld)
        bench.print_table(dataset.name, combining.HEADER, rows, notes)
        bench.keep([part.to_dict(table[0]) for part in table])
    bench.finish()


def shutter(
    sequences: Sequences,
    method: Annotated[str, typer.Option(metavar="NAME", help="The preset whose parts are compared.")] = "stillroom",
    runs: Runs = 1,
    frames: Frames = None,
    camera: Camera = None,
    settings: Settings = None,
    tables: Tables = None,
    out: Out = None,
) -> None:
    """Compare what models the camera itself, each part alone and all together: ATE, jitter, fast and slow error, RPE.

    Parts are the rolling shutter, the trajectory prior, depth weights, the turn limit above which clusters are not
    judged, matches weighted by the probability that their cluster is static, and the last look.
    """
    configs = rolling.shutter_parts(configure(method, None, settings or ()))
    bench = Bench("shutter", out, tables)
    for sequence in sequences:
        dataset = bench.open(Source(sequence, camera, frames=frames))
        table = bench.each(configs, bench.seeds_of(dataset, runs))
        if table:
            notes = rolling.sentences(table, dataset.camera.readout_s)
            bench.print_table(dataset.name, rolling.HEADER, [rolling.row(one) for one in table], notes)
            bench.keep([one.to_dict(table[0]) for one in table])
    bench.finish()


def speed(
    sequence: Sequence1,
    methods: Methods = PRESETS,
    frames: Frames = None,
    live: Annotated[
        int, typer.Option(min=0, metavar="N", help="Run each live too, N times at each pace; 0: in order only.")
    ] = 0,
    camera: Camera = None,
    sensor: SensorName = None,
    settings: Settings = None,
    tables: Tables = None,
    out: Out = None,
) -> None:
    """Time each stage and the whole frame, in milliseconds and in units of one cv2.ORB_create(1000).detectAndCompute.

    Reading the images is not counted; network and mapping are. A stage includes those that it calls: tracking includes
    dynamics, the frame all.

    With --live N, then on worker threads: as fast as it goes, and at a camera's rate. All images are kept in memory.
    """
    configs = _configs(methods, settings)
    bench = Bench("speed", out, tables)
    dataset = UnitMeter(bench.open(Source(sequence, camera, frames=frames, sensor=sensor)))
    warm_up()  # also when they are compiled: loading must not count for the first frame

    def measure(name: str, config: SlamConfig) -> Speed:
        bench.bar.label = name
        return cost.speed(dataset, name, config, bench.bar)

    for measured in bench.each(configs, measure):
        title = f"{measured.method} on {dataset.name}"
        bench.print_table(title, cost.HEADER, measured.rows(), measured.sentences())
        bench.keep([measured.to_dict()])
    if live > 0:
        _speed_live(bench, Source(sequence, camera, frames=frames, sensor=sensor), configs, live)
    bench.finish()


def _speed_live(bench: Bench, source: Source, configs: dict[str, SlamConfig], n_runs: int) -> None:
    images = living.InMemory(source.open())

    def measure(name: str, config: SlamConfig) -> list[list[living.LiveSpeed]]:
        paces: list[list[living.LiveSpeed]] = []
        for paced in (False, True):
            paces.append([])
            for seed in range(n_runs):
                bench.bar.label = f"{name}, live, seed {seed}"
                paces[-1].append(living.live_speed(images, name, replace(config, seed=seed), paced, bench.bar))
        return paces

    for paces in bench.each(configs, measure):
        runs = [run for pace in paces for run in pace]
        notes = [sentence for pace in paces for sentence in living.sentences(pace)]
        title = f"{runs[0].method} on {images.name}, live"
        bench.print_table(title, living.HEADER, [run.row() for run in runs], notes)
        bench.keep([run.to_dict() for run in runs])


def _configs(methods: str, settings: list[str] | None) -> dict[str, SlamConfig]:
    names = [name.strip() for name in methods.split(",") if name.strip()]
    if not names:
        raise ConfigError("--methods names none; write it like --methods orb-slam2,oc-slam")
    if names == ["all"]:
        names = list(all_methods())
    return {name: configure(name, None, settings or ()) for name in names}
