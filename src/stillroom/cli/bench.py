"""`stillroom bench`: accuracy over seeds, what rejection is worth, and what a frame costs."""

import json
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from stillroom.benchmark import accuracy as exactness
from stillroom.benchmark import rejection as rejecting
from stillroom.benchmark import speed as cost
from stillroom.benchmark.accuracy import Accuracy
from stillroom.benchmark.rejection import Way, ways
from stillroom.benchmark.speed import Speed, UnitMeter
from stillroom.benchmark.trial import attempt
from stillroom.cli.arguments import Settings
from stillroom.cli.output.console import STDERR, say, show_log
from stillroom.cli.output.frame_bar import FrameBar
from stillroom.cli.output.tables import print_lines, print_table
from stillroom.cli.warmup import ensure_warm
from stillroom.config import SlamConfig
from stillroom.datasets.open import SYNTHETIC
from stillroom.errors import ConfigError, StillroomError
from stillroom.methods.registry import configure
from stillroom.pipeline import Source
from stillroom.pipeline.provenance import provenance
from stillroom.protocols import Dataset
from stillroom.warmup import warm_up

INTERRUPTED = 130
BOTH = "orb-slam2,oc-slam"

app = typer.Typer(no_args_is_help=True, help="Measure accuracy over seeds, the worth of rejection, and speed.")
R = TypeVar("R")

Sequences = Annotated[list[str], typer.Argument(metavar="SEQ", help="Sequences, as for run.")]
Sequence1 = Annotated[str, typer.Argument(metavar="SEQ", help="The sequence, as for run.")]
Methods = Annotated[str, typer.Option(metavar="A,B", help="Methods; the first is the baseline.")]
Runs = Annotated[int, typer.Option(min=1, metavar="N", help="Runs of each, with seeds 0, 1, …")]
Frames = Annotated[str | None, typer.Option(metavar="A:B", help="Use these frames only.")]
Camera = Annotated[str | None, typer.Option(metavar="NAME|FILE", help="The calibration.")]
Out = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Where the figures go; by default into results/.")
]


@app.command()
def accuracy(
    sequences: Sequences,
    methods: Methods = BOTH,
    runs: Runs = 5,
    frames: Frames = None,
    camera: Camera = None,
    settings: Settings = None,
    out: Out = None,
) -> None:
    """Run each method with several seeds: ATE, improvement over the first method, coverage, RPE."""
    configs = _configs(methods, settings)
    bench = _Bench("accuracy", out)
    for sequence in sequences:
        dataset = bench.open(Source(sequence, camera, frames=frames))
        table = bench.each(configs, bench.seeds_of(dataset, runs))
        bench.print_table(dataset.name, exactness.HEADER, [row.row(table[0]) for row in table])
        print_lines(exactness.sentences(table) if table else [])
        bench.keep([row.to_dict(table[0]) for row in table])
    bench.finish()


@app.command()
def rejection(
    sequence: Sequence1,
    method: Annotated[str, typer.Option(metavar="NAME", help="The preset whose sieve is on trial.")] = "oc-slam",
    runs: Runs = 1,
    frames: Frames = None,
    camera: Camera = None,
    settings: Settings = None,
    out: Out = None,
) -> None:
    """Compare no rejection, whole boxes, the paper's literal rule and the preset: ATE, coverage, features kept."""
    bench = _Bench("rejection", out)
    dataset = bench.open(Source(sequence, camera, frames=frames))
    configs = ways(configure(method, None, settings or ()))
    table = [Way(row) for row in bench.each(configs, bench.seeds_of(dataset, runs))]
    boxes = next((way for way in table if way.accuracy.method == rejecting.WHOLE_BOXES), None)
    if boxes is not None:
        bench.print_table(dataset.name, rejecting.HEADER, [way.row(boxes) for way in table])
        print_lines(rejecting.sentences(table))
        bench.keep([way.to_dict(boxes) for way in table])
    bench.finish()


@app.command()
def speed(
    sequence: Sequence1,
    methods: Methods = BOTH,
    frames: Frames = None,
    camera: Camera = None,
    settings: Settings = None,
    out: Out = None,
) -> None:
    """Time each stage and the whole frame, in milliseconds and in units of one cv2.ORB_create(1000).detectAndCompute.

    Reading the images is not counted; network and mapping are. A stage includes those that it calls: tracking holds
    dynamics, the frame holds all.
    """
    configs = _configs(methods, settings)
    bench = _Bench("speed", out)
    dataset = UnitMeter(bench.open(Source(sequence, camera, frames=frames)))
    warm_up()  # also when they are compiled: loading them is no cost of the first frame
    for measured in bench.each(configs, lambda name, config: bench.speed(dataset, name, config)):
        bench.print_table(f"{measured.method} on {dataset.name}", cost.HEADER, measured.rows())
        print_lines(measured.sentences())
        bench.keep([measured.to_dict()])
    bench.finish()


class _Bench:
    """What the three have in common: a progress bar, tables, a file of figures, and Ctrl-C."""

    def __init__(self, kind: str, out: Path | None) -> None:
        show_log()
        self._kind = kind
        self._out = out or Path("results") / f"{datetime.now():%Y-%m-%d_%H-%M-%S}_bench-{kind}.json"
        self._rows: list[dict[str, Any]] = []
        self._bar = FrameBar(STDERR)
        self._stopped = False

    def open(self, source: Source) -> Dataset:
        """Open a sequence and see to it that the kernels are compiled."""
        dataset = source.open()
        ensure_warm(STDERR, source.sequence.startswith(SYNTHETIC))
        return dataset

    def each(self, configs: dict[str, SlamConfig], measure: Callable[[str, SlamConfig], R]) -> list[R]:
        """Measure each config; those that are done by then when the user stops it."""
        done: list[R] = []
        try:
            for name, config in configs.items() if not self._stopped else ():
                done.append(measure(name, config))
        except KeyboardInterrupt:
            self._stopped = True
        return done

    def seeds_of(self, dataset: Dataset, runs: int) -> Callable[[str, SlamConfig], Accuracy]:
        """Return what runs a config on a sequence with each seed."""

        def measure(name: str, config: SlamConfig) -> Accuracy:
            trials = []
            for seed in range(runs):
                self._bar.label = f"{name}, seed {seed}"
                trials.append(attempt(dataset, config, seed, self._bar))
                say(f"{name} on {dataset.name}, {trials[-1].line()}")
            return Accuracy(dataset.name, name, tuple(trials))

        return measure

    def speed(self, dataset: UnitMeter, name: str, config: SlamConfig) -> Speed:
        """Time a config."""
        self._bar.label = name
        return cost.speed(dataset, name, config, self._bar)

    def print_table(self, title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        """Print rows under a title."""
        print_lines(["", title])
        print_table(header, rows)

    def keep(self, rows: list[dict[str, Any]]) -> None:
        """Take figures for the file."""
        self._rows += rows

    def finish(self) -> None:
        """Write the file; leave with an error where the user stopped it."""
        if self._rows:
            content = {"bench": self._kind, "rows": self._rows, "run": provenance()}
            _write(self._out, json.dumps(content, indent=2) + "\n")
            print_lines([f"figures: {self._out}"])
        if self._stopped:
            say("stopped; what was not finished is left out")
            raise typer.Exit(INTERRUPTED)


def _configs(methods: str, settings: list[str] | None) -> dict[str, SlamConfig]:
    names = [name.strip() for name in methods.split(",") if name.strip()]
    if not names:
        raise ConfigError("--methods names none; write it like --methods orb-slam2,oc-slam")
    return {name: configure(name, None, settings or ()) for name in names}


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise StillroomError(f"{path}: cannot be written ({error.strerror}); name another file with --json") from error
