"""What boxes and clusters contribute, each alone and both together, and what remains when the detector fails."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stillroom.bench.accuracy import NONE, Accuracy
from stillroom.bench.accuracy import sentences as accuracy_sentences
from stillroom.bench.rejection import AS_PRINTED, as_printed
from stillroom.bench.trial import FrameAverages
from stillroom.config import SlamConfig
from stillroom.dynamics.chain import KeepAllConfig
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.errors import ConfigError
from stillroom.evaluation.report import percent
from stillroom.protocols import Dataset
from stillroom.semantics.depth_clusters import NoClustersConfig
from stillroom.semantics.detector import FrameRange
from stillroom.semantics.no_segmenter import NothingConfig

HALF = "both, detector half the time"
HEADER = ("what rejects", "ATE [m]", "min", "max", "tracked", "static kept", "of keypoints", "in use")
"""Names of the columns of `Part.row`."""
WITHHELD_S = 1.0


NEITHER, BOXES, CLUSTERS, BOTH = "none", "boxes only", "clusters only", "both"


def parts(preset: SlamConfig) -> dict[str, SlamConfig]:
    """Return five configs by name, from a method that rejects by boxes and clusters.

    Raises:
        ConfigError: The method does not.
    """
    dynamics = preset.dynamics
    if not isinstance(dynamics, ClusterSieveConfig) or isinstance(preset.clusters, NoClustersConfig):
        raise ConfigError(
            f"{preset.method} does not reject by boxes and clusters; name a method that does, such as oc-slam, and "
            "leave its clusters and dynamics as they are"
        )
    without_clusters = replace(preset, clusters=NoClustersConfig())
    return {
        NEITHER: replace(without_clusters, semantics=NothingConfig(), dynamics=KeepAllConfig()),
        BOXES: replace(without_clusters, dynamics=dynamics.boxes),
        CLUSTERS: replace(preset, semantics=NothingConfig()),
        BOTH: preset,
        AS_PRINTED: as_printed(preset),
    }


def every_second_second(dataset: Dataset, first: int) -> tuple[FrameRange, ...]:
    """Return the ranges of image numbers in every second second after an image, which itself is in none.

    Args:
        dataset: The sequence.
        first: Number of the image; it need not be shown.
    """
    numbers = dataset.numbers
    start = int(np.searchsorted(numbers, first))
    if start >= len(numbers):
        return ()
    seconds = np.floor((dataset.timestamps_s[start:] - dataset.timestamps_s[start]) / WITHHELD_S).astype(np.int64)
    ranges = []
    for second in np.unique(seconds[seconds % 2 == 1]):
        within = numbers[start:][seconds == second]
        ranges.append((int(within[0]), int(within[-1]) + 1))
    return tuple(ranges)


@dataclass(frozen=True)
class Part:
    """The result of one config."""

    accuracy: Accuracy

    @property
    def tracked(self) -> FrameAverages | None:
        """The tracked frames, on average over the runs; None where there were none."""
        return FrameAverages.over_runs([trial.tracked for trial in self.accuracy.trials])

    @property
    def first_boxed(self) -> int | None:
        """Number of the first image with something potentially dynamic, in the first run."""
        return self.accuracy.trials[0].first_boxed

    def row(self) -> tuple[str, ...]:
        """Return the cells under `HEADER`; the coverage is the worst run's."""
        kept = self.tracked
        cells = (
            [NONE] * 3 if kept is None else [f"{kept.static:.0f}", percent(kept.static_share), f"{kept.inliers:.0f}"]
        )
        return (self.accuracy.method, *self.accuracy.ate_cells(), percent(self.accuracy.coverage.min), *cells)

    def to_dict(self, baseline: "Part") -> dict[str, Any]:
        """Return the figures for a JSON file."""
        kept = self.tracked
        return self.accuracy.to_dict(baseline.accuracy) | {
            "static_kept_per_frame": None if kept is None else kept.static,
            "static_kept_share": None if kept is None else kept.static_share,
            "inliers_per_frame": None if kept is None else kept.inliers,
        }


def sentences(table: Sequence[Part], withheld: Sequence[FrameRange]) -> list[str]:
    """Return notes on how to read the rows."""
    kept = "static kept: keypoints judged static per tracked frame; in use: map points that agree with the pose there"
    lines = [*accuracy_sentences([part.accuracy for part in table]), kept]
    if withheld:
        n_images = sum(end - first for first, end in withheld)
        lines.append(
            f"{HALF}: every second second from image {withheld[0][0]} to {withheld[-1][1] - 1}, {n_images} images in "
            "all, the method gets no boxes, propagated ones neither"
        )
    return lines
