"""How clean and how complete the dense map is, with and without the removal of what moves."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.bench.dense_maps import (
    HEADER,
    WITH_REMOVAL,
    WITHOUT_REMOVAL,
    DenseMaps,
    MapFigures,
    RealJudge,
    TruthJudge,
    dense_maps,
)
from stillroom.config import SlamConfig
from stillroom.datasets.selection import parse_range, select
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.errors import ConfigError
from stillroom.evaluation.report import percent
from stillroom.pipeline import SILENT, RunProgress
from stillroom.protocols import Dataset, KnownScene
from stillroom.viz.cloud.render import draw_dense_pair

REFERENCE = "0:200"
"""Default range in which a real sequence shows the empty room: that of the Bonn stretch."""


__all__ = ["HEADER", "Ghosts", "Stretches", "ghosts", "stretches"]


@dataclass(frozen=True)
class Stretches:
    """The images used as reference, and those that the map is made of.

    Attributes:
        reference: Numbers of those that show the empty room; None where the renderer's truth is used instead.
        mapped: Numbers of those that the map is made of.
    """

    reference: range | None
    mapped: range


@dataclass(frozen=True)
class Ghosts:
    """The evaluation of a method's dense map.

    Attributes:
        sequence, method: Their names.
        stretches: The images used.
        coverage: Share of the images with a pose, 0 to 1.
        maps: The figures with removal and without.
        made: The maps themselves.
        notes: How to read them.
    """

    sequence: str
    method: str
    stretches: Stretches
    coverage: float
    maps: tuple[MapFigures, ...]
    made: DenseMaps
    notes: tuple[str, ...]

    def sentences(self) -> list[str]:
        """Return notes on how to read the rows."""
        by_name = {figures.name: figures.ghosts.share for figures in self.maps}
        mapped = self.stretches.mapped
        lines = [
            f"a map of images {mapped.start}:{mapped.stop}; {percent(self.coverage)} of all images up to there tracked"
        ]
        clean, raw = by_name[WITH_REMOVAL], by_name[WITHOUT_REMOVAL]
        if clean > 0:
            lines.append(f"without removal there are {raw / clean:.0f} times as many ghosts per point")
        return [*lines, *self.notes]

    def draw(self, path: Path) -> None:
        """Draw both maps side by side.

        Raises:
            StillroomError: The file cannot be written.
        """
        clouds, poses = self.made.clouds, np.stack(list(self.made.T_world_cam.values()))
        draw_dense_pair(path, clouds[WITHOUT_REMOVAL], clouds[WITH_REMOVAL], poses)

    def to_dict(self) -> dict[str, Any]:
        """Return the figures for a JSON file."""
        reference, mapped = self.stretches.reference, self.stretches.mapped
        return {
            "sequence": self.sequence,
            "method": self.method,
            "reference": None if reference is None else [reference.start, reference.stop],
            "mapped": [mapped.start, mapped.stop],
            "coverage": self.coverage,
            "maps": [figures.to_dict() for figures in self.maps],
        }


def ghosts(
    dataset: Dataset, name: str, config: SlamConfig, chosen: Stretches, progress: RunProgress = SILENT
) -> Ghosts:
    """Run a method and evaluate its dense map, made with removal and without.

    Args:
        dataset: The sequence, whole: its images are numbered from 0.
        name: Name of the method in the result.
        config: The method.
        chosen: The images to use.
        progress: Called for each frame.

    Raises:
        KeyboardInterrupt: The user stopped it.
        StillroomError: Something that the run needs is wrong, or no image to be evaluated was tracked.
    """
    made = dense_maps(select(dataset, f":{chosen.mapped.stop}"), config, _dense_map_of(config), chosen.mapped, progress)
    judge: RealJudge | TruthJudge
    if chosen.reference is not None:
        judge = RealJudge(dataset, made.T_world_cam, chosen.reference, chosen.mapped)
    else:
        assert isinstance(dataset, KnownScene)
        judge = TruthJudge(dataset, made.T_world_cam, chosen.mapped)
    maps = tuple(judge.judge(which, cloud.positions_m) for which, cloud in made.clouds.items())
    coverage = len(made.T_world_cam) / made.n_given
    return Ghosts(dataset.name, name, chosen, coverage, maps, made, tuple(judge.sentences()))


def _dense_map_of(config: SlamConfig) -> DenseMapperConfig:
    return config.dense if isinstance(config.dense, DenseMapperConfig) else DenseMapperConfig()


def stretches(dataset: Dataset, reference: str | None = None, mapped: str | None = None) -> Stretches:
    """Return which images are the reference, and which the map is made of.

    Args:
        dataset: The sequence.
        reference: Those that show the empty room, `a:b`. Where not given: none for a rendered sequence, which is
            compared with its truth, and `REFERENCE` for others.
        mapped: Those that the map is made of; where not given, all after the reference.

    Raises:
        ConfigError: A range is malformed, empty or in steps, or the two overlap.
    """
    if reference is None and isinstance(dataset, KnownScene):
        return Stretches(None, _range("map", mapped or ":", len(dataset)))
    empty = _range("reference", reference or REFERENCE, len(dataset))
    chosen = _range("map", mapped or f"{empty.stop}:", len(dataset))
    if max(empty.start, chosen.start) < min(empty.stop, chosen.stop):
        raise ConfigError(
            f"map {chosen.start}:{chosen.stop} and reference {empty.start}:{empty.stop} overlap; what a map is "
            "compared with must not have made it"
        )
    return Stretches(empty, chosen)


def _range(option: str, text: str, length: int) -> range:
    try:
        chosen = range(*parse_range(text).indices(length))
    except ConfigError as error:
        raise ConfigError(f"{option}: {error}") from None
    if chosen.step != 1 or not chosen:
        raise ConfigError(f"{option} {text}: no such images; there are {length}, write it like 0:200")
    return chosen
