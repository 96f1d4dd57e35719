"""What a grid is: its axes, how it is run, and each of its runs with the digest of all that decides the result."""

import dataclasses
import functools
import hashlib
import itertools
import json
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillroom.bench.trial import poses_only
from stillroom.bounds import bounded
from stillroom.config import SlamConfig, read_toml, to_toml, updated
from stillroom.config.settings import as_toml
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import rendered
from stillroom.errors import ConfigError, StillroomError
from stillroom.pipeline import Source
from stillroom.presets.registry import DEFAULT, all_methods, configure
from stillroom.protocols import Dataset
from stillroom.session.provenance import provenance
from stillroom.version import __version__

JOBLIB, DASK = "joblib", "dask://"
ALL = "all"
PACKAGES = "stillroom", "stillroom_scenes"
"""Packages whose sources decide results: the core, and the renderer, which lies beside it."""
DECIDING = {".py", ".onnx", ".vocabulary"}
"""Suffixes of the files in them that do: sources, networks, vocabularies."""
PLACE_OF_AXES = {"method": "methods", "seed": "seeds"}
"""Keys of a config that are axes of their own, and the axes."""


@dataclass(frozen=True)
class Grid:
    """The axes of a grid, and how it is run; the keys of a grid's TOML file and the options of `stillroom bench grid`.

    Attributes:
        sequences: As for a run.
        methods: Names of methods; "all" for all of them.
        seeds: Seeds of the random choices.
        set: `key=value`, for all runs.
        vary: `key=value,value,…`, each a further axis. A value in brackets or quotes may hold commas.
        frames: The frames to use, `a:b`; all by default.
        camera: The calibration to use, where it is not the sequence's own.
        jobs: How many worker processes; 0 for one on each core. A cluster has its own number.
        backend: "joblib", or "dask://HOST:PORT" for the scheduler of a Dask cluster.
        memory_gb: How much memory a worker may hold [GB of 10⁹ bytes]; None for no bound.
    """

    sequences: tuple[str, ...] = ()
    methods: tuple[str, ...] = (DEFAULT,)
    seeds: tuple[int, ...] = bounded((0,), least=0)
    set: tuple[str, ...] = ()
    vary: tuple[str, ...] = ()
    frames: str | None = None
    camera: str | None = None
    jobs: int = bounded(0, least=0)
    backend: str = JOBLIB
    memory_gb: float | None = bounded(None, above=0.0)

    @property
    def scheduler(self) -> str | None:
        """HOST:PORT of the Dask scheduler; None where joblib runs the grid."""
        return self.backend.removeprefix(DASK) if self.backend.startswith(DASK) else None

    def to_toml(self) -> str:
        """Return it as the text of a TOML file that `read_grid` reads, with how it came about."""
        return as_toml(dataclasses.asdict(self) | {"run": provenance()})


def read_grid(path: Path) -> Grid:
    """Read a grid from a TOML file.

    Raises:
        ConfigError: The file cannot be read; or a key is unknown, and the message names the nearest; or a value is not
            what it must be.
    """
    return updated(Grid(), read_toml(path), str(path))


@dataclass(frozen=True)
class PlannedRun:
    """One run of a grid; it is what a worker is sent.

    Attributes:
        sequence, frames, camera: As the grid names them.
        method: The method.
        varied: The settings that are varied, `key=value`.
        settings: All settings, `key=value`, the varied ones among them.
        seed: The seed.
        digest: Identifies all that decides its result.
        version: The version of Stillroom, and a digest of its sources; see `code_version`.
        n_frames: Frames of the sequence; 0 where it cannot be opened here.
    """

    sequence: str
    frames: str | None
    camera: str | None
    method: str
    varied: tuple[str, ...]
    settings: tuple[str, ...]
    seed: int
    digest: str
    version: str
    n_frames: int

    @property
    def setting(self) -> str:
        """The varied settings in one text; "" where nothing is varied."""
        return " ".join(self.varied)

    @property
    def name(self) -> str:
        """The run in words."""
        return " ".join((self.method, *self.varied)) + f", seed {self.seed}, on {self.sequence}"

    @property
    def config(self) -> SlamConfig:
        """What is run: poses only, as a dense map changes none.

        Raises:
            ConfigError: The method, a key or a value is wrong.
        """
        return poses_only(configure(self.method, None, self.settings, self.seed))


@dataclass(frozen=True)
class Plan:
    """The runs of a grid in its order: by sequence, method, setting and seed.

    Attributes:
        runs: The runs.
        is_rendered: Whether a sequence of it is rendered.
    """

    runs: tuple[PlannedRun, ...]
    is_rendered: bool


def plan(grid: Grid) -> Plan:
    """Lay out a grid. Each sequence is opened once, which unpacks archives before workers need them.

    A sequence that cannot be opened is left for its runs to fail on: on a cluster it may be there.

    Raises:
        ConfigError: An axis is empty or names something twice; or a method, a key or a value is wrong.
    """
    methods = tuple(all_methods()) if grid.methods == (ALL,) else grid.methods
    combinations = list(_combinations(grid))
    for name, values in {"sequences": grid.sequences, "methods": methods, "seeds": grid.seeds}.items():
        _check_axis(name, values)
    version, content = code_version(), functools.cache(_content)
    opened = {sequence: _Opened.of(sequence, grid) for sequence in grid.sequences}
    runs = []
    for sequence, method, varied, seed in itertools.product(grid.sequences, methods, combinations, grid.seeds):
        run = PlannedRun(
            sequence=sequence,
            frames=grid.frames,
            camera=grid.camera,
            method=method,
            varied=varied,
            settings=(*grid.set, *varied),
            seed=seed,
            digest="",
            version=version,
            n_frames=opened[sequence].n_frames,
        )
        runs.append(dataclasses.replace(run, digest=_digest(run, opened[sequence].identity, content)))
    return Plan(tuple(runs), any(one.is_rendered for one in opened.values()))


@functools.cache
def code_version() -> str:
    """Return the version of Stillroom, and the first digits of a digest of its sources and of what comes with them."""
    digest, packages = hashlib.sha256(), Path(__file__).parents[3]
    for package in PACKAGES:
        for path in sorted(path for path in (packages / package).rglob("*") if path.suffix in DECIDING):
            digest.update(f"{path.relative_to(packages).as_posix()}\n".encode() + path.read_bytes())
    return f"{__version__} {digest.hexdigest()[:12]}"


def split_values(text: str) -> list[str]:
    """Split a text at its commas, but for those in brackets and quotes."""
    parts = re.findall(r'(?:"[^"]*"|\[[^\]]*\]|[^,"\[]|["\[])+', text)
    return [part.strip() for part in parts if part.strip()]


def _combinations(grid: Grid) -> Iterator[tuple[str, ...]]:
    """Yield the combinations of varied values; one without any where nothing is varied."""
    axes: dict[str, list[str]] = {}
    for text in grid.vary:
        key, equals, values = (part.strip() for part in text.partition("="))
        choices = split_values(values)
        if not key or not equals or not choices:
            raise ConfigError(f"vary: '{text}' varies nothing; write it like tracking.min_inliers=20,30")
        _check_axis(f"vary {key}", choices)
        if key in axes:
            raise ConfigError(f"vary: names '{key}' twice; write all its values into one")
        axes[key] = [f"{key}={choice}" for choice in choices]
    for text in (*grid.set, *grid.vary):
        axis = PLACE_OF_AXES.get(text.partition("=")[0].strip())
        if axis is not None:
            raise ConfigError(f"'{text}' is an axis of its own; name its values in {axis}")
    yield from itertools.product(*axes.values())


def _check_axis(name: str, values: Iterable[object]) -> None:
    seen: list[object] = []
    for value in values:
        if value in seen:
            raise ConfigError(f"{name}: names {value} twice; each run is made once")
        seen.append(value)
    if not seen:
        raise ConfigError(f"{name}: names none; a grid needs at least one")


# What decides a result.


@dataclass(frozen=True)
class _Opened:
    """What a grid must know of a sequence before it is run."""

    identity: str
    n_frames: int
    is_rendered: bool

    @classmethod
    def of(cls, sequence: str, grid: Grid) -> "_Opened":
        """Open a sequence."""
        try:
            dataset = Source(sequence, grid.camera, frames=grid.frames).open()
        except StillroomError:
            return cls("cannot be opened", 0, False)
        return cls(_identity(dataset), len(dataset), rendered(dataset) is not None)


def _identity(dataset: Dataset) -> str:
    """Return a digest of times, numbers, calibration and ground truth; not of pixels, which would take minutes."""
    digest = hashlib.sha256(repr((dataset.name, len(dataset), dataset.camera)).encode())
    digest.update(dataset.timestamps_s.tobytes())
    digest.update(dataset.numbers.tobytes())
    for truth in (dataset.groundtruth, dataset.groundtruth_at_camera):
        digest.update(_truth_bytes(truth))
    return digest.hexdigest()


def _truth_bytes(truth: Trajectory | None) -> bytes:
    return b"none" if truth is None else truth.timestamps_s.tobytes() + truth.T_world_cam.tobytes()


def _digest(run: PlannedRun, identity: str, content: Callable[[Path], str]) -> str:
    config = run.config
    decides = {
        "sequence": [run.sequence, run.frames, run.camera, identity],
        "config": to_toml(config),
        "files": [content(path) for path in _paths(config)],
        "version": run.version,
    }
    return hashlib.sha256(json.dumps(decides).encode()).hexdigest()[:16]


def _paths(config: Any) -> Iterator[Path]:
    """Yield the paths that a config names."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if isinstance(value, Path):
            yield value
        elif dataclasses.is_dataclass(value):
            yield from _paths(value)


def _content(path: Path) -> str:
    """Return a digest of a file, such as a network's weights; of a folder, of the names and sizes in it."""
    try:
        if path.is_dir():
            sizes = sorted((inner.name, inner.stat().st_size) for inner in path.iterdir())
            return hashlib.sha256(repr(sizes).encode()).hexdigest()
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:  # the run says what is wrong with it
        return ""
