"""The benefit of rejecting dynamic features: the same detector, several ways of using its boxes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from stillroom.bench.accuracy import NONE, Accuracy, aligned_by
from stillroom.bench.trial import FrameAverages, all_keypoints
from stillroom.config import SlamConfig
from stillroom.dynamics.chain import KeepAllConfig
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.dynamics.paper_clusters import PaperClustersConfig
from stillroom.dynamics.paper_epipolar import PRINTED, PaperEpipolarConfig
from stillroom.dynamics.whole_boxes import WholeBoxesConfig
from stillroom.evaluation.report import percent
from stillroom.presets import oc_slam_paper
from stillroom.semantics.depth_clusters import NoClustersConfig
from stillroom.semantics.yolo_fastest import YoloFastestConfig

WITHOUT_CLUSTERS = "the preset without clusters"
HEADER = ("rejection", "ATE [m]", "min", "max", "tracked", "static kept", "of keypoints", "against boxes", "in use")
"""Names of the columns of `row`."""


NO_REJECTION, WHOLE_BOXES, PAIRS_ONLY, PRESET = "no rejection", "whole boxes", "OC-SLAM 2.2 alone", "the preset"
AS_PRINTED, EQUATION_2 = "OC-SLAM as printed", "… its Eq. 2 too"


def ways(preset: SlamConfig) -> dict[str, SlamConfig]:
    """Return the configs by name: they differ in the match sieve, and in the clusters that only some of them use."""
    preset = all_keypoints(preset)
    boxes_only = replace(preset, clusters=NoClustersConfig())
    found = {
        NO_REJECTION: replace(boxes_only, dynamics=KeepAllConfig()),
        WHOLE_BOXES: replace(boxes_only, dynamics=WholeBoxesConfig()),
        PAIRS_ONLY: replace(boxes_only, dynamics=PaperEpipolarConfig()),
        AS_PRINTED: as_printed(preset),
        EQUATION_2: replace(as_printed(preset), dynamics=PaperClustersConfig(PaperEpipolarConfig(distance=PRINTED))),
    }
    if isinstance(preset.dynamics, ClusterSieveConfig):
        found[WITHOUT_CLUSTERS] = replace(boxes_only, dynamics=preset.dynamics.boxes)
    return found | {PRESET: preset}


def as_printed(preset: SlamConfig) -> SlamConfig:
    """Return a config whose rejection is OC-SLAM's to the letter; where it has YOLO-Fastest, no box is carried."""
    paper = oc_slam_paper.METHOD.config
    semantics = paper.semantics if isinstance(preset.semantics, YoloFastestConfig) else preset.semantics
    return replace(preset, semantics=semantics, clusters=paper.clusters, dynamics=paper.dynamics)


@dataclass(frozen=True)
class Way:
    """One way of rejecting, and its result."""

    accuracy: Accuracy

    @property
    def boxed(self) -> FrameAverages | None:
        """The frames with something potentially dynamic, on average over the runs; None where there were none."""
        return FrameAverages.over_runs([trial.boxed for trial in self.accuracy.trials])

    def more_kept_percent(self, other: "Way") -> float | None:
        """Return how many more static keypoints are kept than another way keeps [%], in frames that both tracked.

        A way that loses the frames with the most people in them keeps many keypoints in the others.
        """
        pairs = [
            (ours.kept[index], theirs.kept[index])
            for ours, theirs in zip(self.accuracy.trials, other.accuracy.trials, strict=False)
            for index in sorted(ours.kept.keys() & theirs.kept.keys())
        ]
        kept, kept_by_other = sum(ours for ours, _ in pairs), sum(theirs for _, theirs in pairs)
        return (kept / kept_by_other - 1) * 100 if kept_by_other else None

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
    """Return notes on how to read the rows."""
    first = table[0].accuracy
    boxed = table[0].boxed
    n = len(first.trials)
    aligned = aligned_by([way.accuracy for way in table])
    lines = [
        f"ATE: RMSE after {aligned} alignment, ground truth as given, median of {n} run{'s' if n > 1 else ''}; "
        "static kept: keypoints judged static per tracked frame in which the detector sees something movable "
        f"({boxed.n_frames if boxed else 0} of {first.trials[0].n_given} frames); against boxes: in those that both "
        "tracked; in use: map points that agree with the pose there",
    ]
    if first.still_camera_m is not None:
        lines.append(f"static-pose baseline (a camera that never moved): ATE {first.still_camera_m:.4f} m")
    by_name = {way.accuracy.method: way for way in table}
    boxes = by_name.get(WHOLE_BOXES)
    ours = [by_name[name] for name in (WITHOUT_CLUSTERS, PRESET) if name in by_name]
    return lines + [line for way in ours if boxes for line in _verdict(way, boxes)]


def _verdict(way: Way, boxes: Way) -> list[str]:
    ours_m, theirs_m = way.accuracy.ate_m, boxes.accuracy.ate_m
    if not ours_m or not theirs_m:
        return []
    difference_mm = (ours_m.median - theirs_m.median) * 1e3
    error = f"its ATE is {abs(difference_mm):.1f} mm {'higher' if difference_mm > 0 else 'lower'}"
    more = way.more_kept_percent(boxes)
    more_or_fewer = "more" if more is not None and more >= 0 else "fewer"
    kept = "" if more is None else f", and it keeps {abs(more):.1f} % {more_or_fewer} static keypoints"
    return [f"{way.accuracy.method} against whole boxes: {error}{kept}"]
