"""What rejecting moving things is worth: the same detector, four ways of using what it says."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from stillroom.benchmark.accuracy import NONE, Accuracy
from stillroom.benchmark.trial import FrameAverages
from stillroom.config import SlamConfig
from stillroom.dynamics.keep_all import KeepAllConfig
from stillroom.dynamics.paper_epipolar import PaperEpipolarConfig
from stillroom.dynamics.whole_boxes import WholeBoxesConfig
from stillroom.evaluation.report_text import percent
from stillroom.semantics.depth_clusters import NoClustersConfig

NO_REJECTION, WHOLE_BOXES, LITERAL, PRESET = "no rejection", "whole boxes", "the paper's literal rule", "the preset"
HEADER = ("rejection", "ATE [m]", "min", "max", "tracked", "static kept", "of keypoints", "against boxes", "in use")
"""Names of the columns of `row`."""


def ways(preset: SlamConfig) -> dict[str, SlamConfig]:
    """Return the four configs by name: they differ in the match sieve, and in the clusters that only some ask for."""
    boxes_only = replace(preset, clusters=NoClustersConfig())
    return {
        NO_REJECTION: replace(boxes_only, dynamics=KeepAllConfig()),
        WHOLE_BOXES: replace(boxes_only, dynamics=WholeBoxesConfig()),
        LITERAL: replace(boxes_only, dynamics=PaperEpipolarConfig()),
        PRESET: preset,
    }


@dataclass(frozen=True)
class Way:
    """One way of rejecting, and what came of it."""

    accuracy: Accuracy

    @property
    def boxed(self) -> FrameAverages | None:
        """The frames with something movable, on average over the runs; None where there were none."""
        return FrameAverages.over_runs([trial.boxed for trial in self.accuracy.trials])

    def more_kept_percent(self, other: "Way") -> float | None:
        """Return how many more static keypoints are kept than another way keeps [%]."""
        ours, theirs = self.boxed, other.boxed
        return None if ours is None or theirs is None or not theirs.static else (ours.static / theirs.static - 1) * 100

    def row(self, whole_boxes: "Way") -> tuple[str, ...]:
        """Return the cells under `HEADER`."""
        boxed, more = self.boxed, self.more_kept_percent(whole_boxes)
        kept = [NONE] * 2 if boxed is None else [f"{boxed.static:.0f}", percent(boxed.static_share)]
        gain = NONE if more is None or self is whole_boxes else f"{more:+.1f} %"
        in_use = NONE if boxed is None else f"{boxed.inliers:.0f}"
        return (
            self.accuracy.method,
            *self.accuracy.ate_cells(),
            percent(self.accuracy.coverage.min),
            *kept,
            gain,
            in_use,
        )

    def to_dict(self, whole_boxes: "Way") -> dict[str, Any]:
        """Return the figures for a JSON file."""
        boxed = self.boxed
        return self.accuracy.to_dict(whole_boxes.accuracy) | {
            "static_kept_per_frame": None if boxed is None else boxed.static,
            "static_kept_share": None if boxed is None else boxed.static_share,
            "kept_more_than_whole_boxes_percent": self.more_kept_percent(whole_boxes),
            "inliers_per_frame": None if boxed is None else boxed.inliers,
        }


def sentences(table: Sequence[Way]) -> list[str]:
    """Return what the rows must be read with."""
    first = table[0].accuracy
    boxed = table[0].boxed
    n = len(first.trials)
    lines = [
        f"ATE: RMSE after SE(3) alignment, ground truth as given, median of {n} run{'s' if n > 1 else ''}; "
        "static kept: keypoints judged static per tracked frame in which the detector sees something movable "
        f"({boxed.n_frames if boxed else 0} of {first.trials[0].n_given} frames); in use: map points that agree with "
        "the pose there",
    ]
    if first.still_camera_m is not None:
        lines.append(f"a camera that never moved has ATE {first.still_camera_m:.4f} m")
    by_name = {way.accuracy.method: way for way in table}
    boxes, preset = by_name.get(WHOLE_BOXES), by_name.get(PRESET)
    if boxes and preset and boxes.accuracy.ate_m and preset.accuracy.ate_m:
        difference_mm = (preset.accuracy.ate_m.median - boxes.accuracy.ate_m.median) * 1e3
        more = preset.more_kept_percent(boxes)
        error = f"its ATE is {abs(difference_mm):.1f} mm {'higher' if difference_mm > 0 else 'lower'}"
        kept = (
            ""
            if more is None
            else f", and it keeps {abs(more):.1f} % {'more' if more >= 0 else 'fewer'} static keypoints"
        )
        lines.append(f"the preset against whole boxes: {error}{kept}")
    return lines
