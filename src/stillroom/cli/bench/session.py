"""What the bench commands have in common: their options, a progress bar, tables, a file of figures, and Ctrl-C."""

import json
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from stillroom.bench.accuracy import Accuracy
from stillroom.bench.page import NamedTable, series_of, write_bench_page
from stillroom.bench.trial import attempt, poses_only
from stillroom.cli.arguments import chosen_of
from stillroom.cli.output import STDERR, FrameBar, print_lines, print_table, say, show_log
from stillroom.cli.tables import FORMS, write_table
from stillroom.cli.warmup import ensure_warm
from stillroom.config import SlamConfig
from stillroom.data.sensor import Sensor
from stillroom.datasets.recording import rendered, sensor_of
from stillroom.errors import ConfigError, StillroomError
from stillroom.pipeline import Source
from stillroom.pipeline.ornaments import ending_nothing
from stillroom.protocols import Dataset
from stillroom.semantics.detector import FrameRange
from stillroom.session.provenance import provenance
from stillroom.stopping import INTERRUPTED

R = TypeVar("R")

Sequences = Annotated[list[str], typer.Argument(metavar="SEQ", help="Sequences, as for run.")]
Sequence1 = Annotated[str, typer.Argument(metavar="SEQ", help="The sequence, as for run.")]
Methods = Annotated[str, typer.Option(metavar="A,B", help="Methods, or all; the first is the baseline.")]
Runs = Annotated[int, typer.Option(min=1, metavar="N", help="Runs of each, with seeds 0, 1, …")]
Frames = Annotated[str | None, typer.Option(metavar="A:B", help="Use these frames only.")]
Camera = Annotated[str | None, typer.Option(metavar="NAME|FILE", help="The calibration.")]
Out = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Where the figures go; by default into results/.")
]


class Bench:
    """One call of a bench command.

    Attributes:
        bar: The progress bar of its runs.
    """

    def __init__(self, kind: str, out: Path | None, tables: list[str] | None = None) -> None:
        """Start one of a kind; its figures go to `out`, or into `results/`, and its page and `tables` beside them.

        Raises:
            ConfigError: A form of tables is not known.
        """
        show_log()
        self._kind, self._forms = kind, chosen_of("--table", tables, tuple(FORMS))
        self._tables: list[NamedTable] = []
        self._out = out or Path("results") / f"{datetime.now():%Y-%m-%d_%H-%M-%S}_bench-{kind}.json"
        self._rows: list[dict[str, Any]] = []
        self._writes_all = False
        self.bar = FrameBar(STDERR)
        self._stopped = False

    def open(self, source: Source, reads_depth: bool = False) -> Dataset:
        """Open a sequence and make sure that the kernels are compiled.

        Raises:
            ConfigError: What is measured reads depth images, and the sequence has none.
        """
        dataset = source.open()
        if reads_depth and sensor_of(dataset) is not Sensor.RGBD:
            raise ConfigError(f"{dataset.name}: has {sensor_of(dataset).words} images; this compares depth images")
        ensure_warm(STDERR, rendered(dataset) is not None)
        return dataset

    def each(self, configs: dict[str, SlamConfig], measure: Callable[[str, SlamConfig], R]) -> list[R]:
        """Measure each config; when the user stops it, those that are done."""
        done: list[R] = []
        try:
            for name, config in configs.items() if not self._stopped else ():
                done.append(measure(name, config))
        except KeyboardInterrupt:
            self._stopped = True
        return done

    def seeds_of(
        self, dataset: Dataset, runs: int, withheld: tuple[FrameRange, ...] = (), dense: bool = False
    ) -> Callable[[str, SlamConfig], Accuracy]:
        """Return a function that runs a config on a sequence with each seed.

        Args:
            dataset: The sequence.
            runs: How many seeds.
            withheld: See `attempt`.
            dense: Whether dense maps are made, which changes no pose.
        """

        def measure(name: str, config: SlamConfig) -> Accuracy:
            trials = []
            for seed in range(runs):
                self.bar.label = f"{name}, seed {seed}"
                whole = config if dense else poses_only(config)
                trials.append(attempt(dataset, whole, seed, self.bar, withheld))
                say(f"{name} on {dataset.name}, {trials[-1].line()}")
            return Accuracy(dataset.name, name, tuple(trials))

        return measure

    def print_table(
        self,
        title: str,
        header: Sequence[str],
        rows: Iterable[Sequence[str]],
        notes: Sequence[str] = (),
        n_words: int = 1,
    ) -> None:
        """Print rows under a title, and sentences below them; they are kept for the page and for `--table`."""
        table = NamedTable(title, header, list(rows), n_words, notes)
        print_lines(["", title])
        print_table(header, table.rows, n_words)
        print_lines(notes)
        self._tables.append(table)

    def keep(self, rows: list[dict[str, Any]]) -> None:
        """Keep figures for the file."""
        self._rows += rows

    def write_to(self, file: Path) -> None:
        """Write the figures to this file, even where nothing was run: its tables then say so."""
        self._out, self._writes_all = file, True

    def finish(self, pictures: Sequence[tuple[Path, str]] = ()) -> None:
        """Write the file, the page and the tables; leave with an error where the user stopped it.

        Args:
            pictures: PNG files that the page shows, each with its caption.
        """
        if self._rows or self._writes_all:
            how = provenance()
            content = {"bench": self._kind, "rows": self._rows, "run": how}
            _write(self._out, json.dumps(content, indent=2) + "\n")
            print_lines([f"figures: {self._out}"])
            self._write_tables()
            page = self._out.with_suffix(".html")
            with ending_nothing("the page is left out"):
                title, series = f"stillroom bench {self._kind}", series_of(self._rows)
                write_bench_page(page, title, self._tables, series, how, pictures)
                print_lines([f"page: {page}"])
        if self._stopped:
            say("stopped; what was not finished is left out")
            raise typer.Exit(INTERRUPTED)

    def _write_tables(self) -> None:
        """Write each table in the forms that were asked for; one title twice gets a number."""
        titles: dict[str, int] = {}
        for table in self._tables:
            titles[table.title] = n = titles.get(table.title, 0) + 1
            title = table.title if n == 1 else f"{table.title} {n}"
            stem = self._out.with_suffix("")
            files = write_table(stem, title, table.header, table.rows, table.n_words, self._forms)
            print_lines([f"table: {path}" for path in files])


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise StillroomError(f"{path}: cannot be written ({error.strerror}); name another file with --json") from error
