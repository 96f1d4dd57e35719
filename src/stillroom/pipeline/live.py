"""What a live run came to: delays, dropped images, and what the workers did."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stillroom.evaluation.report import Evaluation
from stillroom.pipeline.intake import Arrival
from stillroom.schedule import LiveSchedule, Worker

LEFT_OUT = {Worker.DENSE: "used to carve the dense map", Worker.VIEWER: "shown by the viewer"}
"""What is left out where a worker is late."""
MEDIAN, P95 = "due_to_pose_median_ms", "due_to_pose_p95_ms"


@dataclass
class LiveFigures:
    """Figures of a live run.

    Attributes:
        speed: Seconds of a recording that were played in one; 0 for one image after the other.
        schedule: The schedule, whose workers' loads are known when it is closed.
        dropped: Images that were due while tracking was late.
        has_segmenter: Whether the method has a detector or a network.
        delays_s: From when each tracked image was due until its pose was known [s].
        wall_s: From the first image until every queue was empty [s].
        online: Figures of the poses as they were known at once; None without ground truth.
    """

    speed: float
    schedule: LiveSchedule
    dropped: list[Arrival]
    has_segmenter: bool
    delays_s: list[float] = field(default_factory=list)
    wall_s: float = 0.0
    online: Evaluation | None = None

    @property
    def delay_ms(self) -> tuple[float, float]:
        """Median and 95th percentile of the delays [ms]; NaN where nothing was tracked."""
        if not self.delays_s:
            return float("nan"), float("nan")
        median, p95 = np.percentile(self.delays_s, (50, 95)) * 1e3
        return float(median), float(p95)

    @property
    def n_seen(self) -> int:
        """Images that the detector or the network saw; 0 where the method has none."""
        loads = self.schedule.loads if self.has_segmenter else {}
        worker = Worker.NETWORK if Worker.NETWORK in loads else Worker.SEMANTICS
        return loads[worker].n_done if worker in loads else 0

    def shares(self) -> dict[Worker, float]:
        """Return the share of the wall time for which each worker was busy."""
        busy_s = {worker: load.busy_s for worker, load in self.schedule.loads.items()}
        return {worker: seconds / self.wall_s if self.wall_s > 0 else 0.0 for worker, seconds in busy_s.items()}

    def to_dict(self) -> dict[str, Any]:
        """Return the figures for a JSON file."""
        median, p95 = self.delay_ms
        shares = self.shares()
        return {
            "speed": self.speed,
            "n_dropped": len(self.dropped),
            MEDIAN: None if np.isnan(median) else median,
            P95: None if np.isnan(p95) else p95,
            "wall_s": self.wall_s,
            "ate_online_m": None if self.online is None else self.online.as_given.ate_m.rmse,
            "n_images_seen_by_network": self.n_seen,
            "workers": {
                worker.value: {
                    "share_busy": shares[worker],
                    "n_done": load.n_done,
                    "n_left_out": load.n_left_out,
                    "cpu_s": load.cpu_s,
                    "longest_queue": load.longest,
                }
                for worker, load in self.schedule.loads.items()
            },
        }

    def sentences(self) -> list[str]:
        """Return the figures in words."""
        return live_sentences(self.to_dict(), self.has_segmenter)


def live_sentences(figures: Mapping[str, Any], has_segmenter: bool) -> list[str]:
    """Return figures of a live run, as `LiveFigures.to_dict` gives them, in words."""
    speed, workers = figures["speed"], figures["workers"]
    median, p95 = (float("nan") if ms is None else ms for ms in (figures[MEDIAN], figures[P95]))
    pace = f"at {speed:g} × its own speed" if speed > 0 else "as fast as it goes"
    text = f"live, {pace}: {figures['n_dropped']} images dropped, as tracking was late"
    if speed > 0:
        text += f"; from due to pose {median:.1f} ms (median), {p95:.1f} ms (95th percentile)"
    for worker, what in LEFT_OUT.items():
        n_left_out = workers.get(worker.value, {}).get("n_left_out", 0)
        if n_left_out > 0:
            text += f"; {n_left_out} frames were not {what}, as its worker was late"
    if figures["ate_online_m"] is not None:
        text += f"; ATE of the poses as known at once {figures['ate_online_m']:.4f} m"
    busy = ", ".join(f"{name} {100 * load['share_busy']:.0f} %" for name, load in workers.items())
    seen = f"; {figures['n_images_seen_by_network']} images seen by the network" if has_segmenter else ""
    return [text, f"workers busy: {busy}{seen}"]
