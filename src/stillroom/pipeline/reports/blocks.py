"""Pieces that the pages of one and of several runs have in common."""

from pathlib import Path

import numpy as np

from stillroom.evaluation.report import HEADER, Evaluation, rows, values
from stillroom.pipeline import results
from stillroom.pipeline.plots import DENSE_MAP, SPARSE_MAP
from stillroom.pipeline.reports.finished import Finished
from stillroom.viz.page.charts import Bar, Path3
from stillroom.viz.page.markup import Cell, Number, gallery, table
from stillroom.viz.page.pictures import Album, evenly

MOST_FRAMES = 12
"""Pictures of frames of one kind on a page."""
FRAMES_OF = {
    "frame": "features: static in green, moving in red",
    "clusters": "clusters of the depth cloud",
    "detections": "detections",
}
"""Kinds of pictures of a frame, as their files begin, and what they show."""
MAPS = {DENSE_MAP: "dense map", SPARSE_MAP: "sparse map, from above and at a slant"}
STAGE_OF_ALL = "frame"


def path_of(run: Finished, name: str, begin_s: float) -> Path3 | None:
    """Return the way of a run's camera, aligned with the ground truth where there is one; None where it has no poses.

    Args:
        run: The run.
        name: In the legend.
        begin_s: From when on times are counted [s].
    """
    if run.error is not None:
        aligned = run.error.aligned
        return Path3(name, aligned.timestamps_s - begin_s, aligned.positions_m, run.error.errors_m)
    if run.trajectory is None or len(run.trajectory) == 0:
        return None
    return Path3(name, run.trajectory.timestamps_s - begin_s, run.trajectory.positions_m)


def truth_of(run: Finished, begin_s: float) -> Path3 | None:
    """Return the part of the true way that a run's estimate covers; None where there is none to compare with."""
    if run.error is None:
        return None
    truth = run.error.groundtruth
    return Path3("ground truth", truth.timestamps_s - begin_s, truth.positions_m)


def errors_table(evaluation: Evaluation) -> str:
    """Return the errors as they are printed, with the exact numbers behind them."""
    shown: list[list[Cell]] = []
    for texts, numbers in zip(rows(evaluation), values(evaluation), strict=True):
        shown.append([*texts[:2], *(Number(t, n) for t, n in zip(texts[2:], numbers, strict=True))])
    return table(HEADER, shown, n_words=2)


def stage_bars(run: Finished) -> list[Bar]:
    """Return the median time of each stage, its range up to the 95th percentile; the whole frame first."""
    costs = {name: (float(np.median(ms)), float(np.percentile(ms, 95)), len(ms)) for name, ms in run.stages_ms.items()}
    order = sorted(costs, key=lambda name: (name != STAGE_OF_ALL, -costs[name][0] * costs[name][2]))
    return [Bar(name, costs[name][0], costs[name][0], costs[name][1], f"in {costs[name][2]} frames") for name in order]


def map_pictures(run: Finished, album: Album) -> list[str]:
    """Return the pictures of a run's maps, those that there are, one below the other."""
    files = [(run.folder / results.PICTURES / name, what) for name, what in MAPS.items()]
    return [gallery([album.figure(path, what)], in_a_row=1) for path, what in files if path.is_file()]


def frame_pictures(run: Finished, album: Album) -> tuple[list[str], str]:
    """Return the pictures of a run's frames, and a note where they are not all there."""
    figures, n_files = [], 0
    for kind, what in FRAMES_OF.items():
        files = sorted((run.folder / results.PICTURES).glob(f"{kind}_*.png"))
        n_files += len(files)
        figures += [album.figure(path, f"{what}, frame {_number(path)}") for path in evenly(files, MOST_FRAMES)]
    shown = [figure for figure in figures if figure]
    note = "" if len(shown) == n_files else f"{len(shown)} of {n_files} pictures; all are in {results.PICTURES}/"
    return shown, note


def _number(path: Path) -> str:
    digits = path.stem.rpartition("_")[2]
    return str(int(digits)) if digits.isdecimal() else digits
