"""An ablation: what the network, the geometry, the ants and the compensation contribute, alone and together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from stillroom.bench.accuracy import NONE, Accuracy
from stillroom.bench.accuracy import sentences as accuracy_sentences
from stillroom.bench.observers import ANTS, EXHAUSTIVE, Count, MovingThings, TruthObserver
from stillroom.bench.trial import FrameAverages, all_keypoints, attempt, poses_only
from stillroom.config import SlamConfig
from stillroom.config.kinds import ChainConfig
from stillroom.dynamics.chain import KeepAllConfig, KeepAllKeypointsConfig
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig
from stillroom.dynamics.whole_boxes import WholeBoxesConfig
from stillroom.evaluation.report import percent
from stillroom.pipeline import SILENT, RunProgress
from stillroom.protocols import Dataset
from stillroom.semantics.depth_clusters import NoClustersConfig
from stillroom.semantics.no_segmenter import NothingConfig
from stillroom.system import System

HEADER = ("what decides", "ATE [m]", "tracked", "static kept", "moving found", "object found", "its pixels", "wrong")
"""Names of the columns of `Ablated.row`; the last four need a rendered sequence."""
BOTH_ANTS = "both, ants"
PLAIN = "both, ants, plain homography"
PRESET = "the preset"


NEITHER, NETWORK, GEOMETRY, BOTH = "nothing", "network only", "geometry only", "both, every point"
LETTER_PLAIN, LETTER = "the same by the homography alone", "the same, compensated"


def homography_of(config: SlamConfig) -> CompensatedHomographyConfig:
    """Return the compensated homography of a method; the usual one where it has none."""
    sieve = config.dynamics
    parts = (sieve.first, sieve.second) if isinstance(sieve, ChainConfig) else (sieve,)
    return next(
        (part for part in parts if isinstance(part, CompensatedHomographyConfig)), CompensatedHomographyConfig()
    )


def ablation(preset: SlamConfig) -> dict[str, SlamConfig]:
    """Return the configs by name, from a method's: they differ in how dynamic features are found.

    The plain homography is RANSAC's answer; compensated, it has been refined (Eq. 11). Where the homography alone
    decides, as the paper has it, depth and pose explain nothing, and the image just before is compared with.
    """
    preset = all_keypoints(preset)
    every = replace(homography_of(preset), search=EXHAUSTIVE)
    along = replace(every, search="reverse", ants=replace(every.ants, path=replace(every.ants.path, kind=ANTS)))
    plain = replace(every.compensation, magsac=False, refine=False)
    letter = replace(along, earlier_s=0.0, test=replace(along.test, use_depth=False))
    bare = replace(preset, clusters=NoClustersConfig())
    blind = replace(bare, semantics=NothingConfig(), keypoints=KeepAllKeypointsConfig())
    return {
        NEITHER: replace(blind, dynamics=KeepAllConfig()),
        NETWORK: replace(bare, dynamics=WholeBoxesConfig()),
        GEOMETRY: replace(blind, dynamics=every),
        BOTH: replace(bare, dynamics=every),
        BOTH_ANTS: replace(bare, dynamics=along),
        PLAIN: replace(bare, dynamics=replace(along, compensation=plain)),
        LETTER_PLAIN: replace(bare, dynamics=replace(letter, compensation=plain)),
        LETTER: replace(bare, dynamics=replace(letter, compensation=replace(plain, refine=True))),
        PRESET: preset,
    }


@dataclass(frozen=True)
class Ablated:
    """The result of one config. Of several runs, the counts against the truth are summed over all."""

    accuracy: Accuracy
    observers: tuple[TruthObserver, ...]

    def row(self) -> tuple[str, ...]:
        """Return the cells under `HEADER`; the coverage is the worst run's."""
        kept = FrameAverages.over_runs([trial.tracked for trial in self.accuracy.trials])
        return (
            self.accuracy.method,
            self.accuracy.ate_cells()[0],
            percent(self.accuracy.coverage.min),
            NONE if kept is None else f"{kept.static:.0f}",
            *(NONE if share is None else percent(share) for share in self.shares().values()),
        )

    def shares(self) -> dict[str, float | None]:
        """Return the shares that were classified as dynamic, 0 to 1; None without ground truth."""
        return {
            "moving_keypoints_found": self._share("moving"),
            "object_keypoints_found": self._share("handled"),
            "object_pixels_found": self._share("handled_pixels"),
            "static_keypoints_wrong": self._share("static"),
        }

    def _share(self, name: str) -> float | None:
        counts = [getattr(observer, name) for observer in self.observers]
        return Count(sum(count.n for count in counts), sum(count.said for count in counts)).share

    def to_dict(self, baseline: "Ablated") -> dict[str, Any]:
        """Return the figures for a JSON file."""
        return self.accuracy.to_dict(baseline.accuracy) | self.shares()


def ablated(
    dataset: Dataset,
    name: str,
    config: SlamConfig,
    runs: int,
    things: MovingThings | None,
    progress: RunProgress = SILENT,
) -> Ablated:
    """Run a config with seeds 0, 1, … over a sequence, and count what it finds where the truth is known.

    Args:
        dataset: The sequence.
        name: Name of the config in the result.
        config: The config.
        runs: How many runs.
        things: The true moving objects; None where they are unknown.
        progress: Called for each frame.

    Raises:
        KeyboardInterrupt: The user stopped it.
        StillroomError: Something that a run needs is wrong.
    """
    observers: list[TruthObserver] = []

    def observe(system: System) -> TruthObserver:
        assert things is not None, "asked only where the truth is known"
        observers.append(TruthObserver(things))
        return observers[-1]

    trials = [
        attempt(dataset, poses_only(config), seed, progress, observe=None if things is None else observe)
        for seed in range(runs)
    ]
    return Ablated(Accuracy(dataset.name, name, tuple(trials)), tuple(observers))


def sentences(table: Sequence[Ablated]) -> list[str]:
    """Return notes on how to read the rows."""
    lines = [
        *accuracy_sentences([row.accuracy for row in table]),
        "static kept: keypoints judged static per tracked frame",
    ]
    if table[0].observers:
        lines.append(
            "moving found, object found: share of the keypoints on all that moves, and on handled objects while they "
            "move, that is classified as dynamic; its pixels: the same of the objects' pixels with a depth; "
            "wrong: share of the keypoints clear of all that moves that is classified as dynamic"
        )
    return lines
