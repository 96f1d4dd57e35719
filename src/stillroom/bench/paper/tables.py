"""The papers' tables with our figures beside the printed ones."""

from collections.abc import Mapping, Sequence

from stillroom.bench.accuracy import NONE, Accuracy
from stillroom.bench.geometry_table import GeometryTable
from stillroom.bench.observers import ANTS, MULTI_VIEW, PRINTED
from stillroom.bench.page import NamedTable
from stillroom.bench.paper.published import RMSE, Misprint, Paper
from stillroom.bench.paper.runs import SequenceRuns, SystemRuns, errors_of, why_not
from stillroom.evaluation.report import percent
from stillroom.evaluation.timing import processor
from stillroom.evaluation.trajectory_errors import improvement_percent

NOT_RUN = "not run"
N_WORDS = 2
"""Columns at the left that hold words."""

OC_HEADER = (
    "sequence", "figures", "ORB RMSE", "ORB mean", "ORB median", "OC RMSE", "OC mean", "OC median", "gain RMSE",
    "gain mean", "gain median",
)  # fmt: skip
RUNS_HEADER = (
    "sequence", "system", "median", "mean", "min", "max", "gain", "printed", "tracked", "loops", "still",
)  # fmt: skip
GEOMETRY_HEADER = (
    "sequence", "figures", "DynaSLAM's test", "along the path", "ratio", "as printed, all",
    "along the path, as printed", "ratio, as printed",
)  # fmt: skip


def tables_of(
    paper: Paper, found: Sequence[SequenceRuns], geometry: Mapping[str, GeometryTable] | None = None
) -> list[NamedTable]:
    """Return a paper's tables.

    Args:
        paper: The paper.
        found: What was run, by sequence.
        geometry: By the name of a sequence, both geometries on it; a sequence without was not run.
    """
    notes = _notes(paper, found)
    if paper.name == "oc-slam":
        tables = [
            NamedTable(f"Table 1, proposed: {system}", OC_HEADER, _oc_rows(paper, system, found), N_WORDS)
            for system in paper.proposed
        ]
    else:
        header = ("sequence", "figures", *paper.systems)
        tables = [NamedTable("Table 1, RMSE of the ATE [m]", header, _pspnet_rows(paper, found), N_WORDS)]
    rows = [row for one in found for row in _run_rows(paper, one)]
    tables.append(NamedTable("All runs, RMSE of the ATE [m]", RUNS_HEADER, rows, N_WORDS, notes))
    if paper.geometry_ms:
        tables.append(_geometry(paper, found, geometry or {}))
    tables.append(_times(paper, found))
    return tables


def _notes(paper: Paper, found: Sequence[SequenceRuns]) -> list[str]:
    n_runs = next((len(runs.accuracy.trials) for one in found for runs in one.systems.values() if runs.accuracy), 0)
    ours = f"medians over {n_runs} run{'s' if n_runs > 1 else ''} with seeds 0 to {n_runs - 1}; " if n_runs else ""
    lines = [
        f"ours: {ours}errors [m] after SE(3) alignment, ground truth as given; tracked: the worst run's share of "
        f"the frames; gain: how far the error lies below that of {paper.baseline}; still: static-pose baseline, the "
        "error of a camera that never moved",
        f"printed: {paper.cite}, {paper.sources[0]}; cells marked * are misprints, – is not printed",
    ]
    if paper.both_loops:
        lines.append(
            "loops: how many the runs closed; loops on, off: the preset with loop closing the other way, the same runs "
            "where none closed a loop or merged maps, so that nothing differs; no loops: both systems without loop "
            "closing, as the paper's"
        )
    keys = {one.asked.printed for one in found}
    lines += [slip.sentence() for slip in paper.misprints if slip.sequence in keys]
    return lines + why_not(paper, found)


# OC-SLAM's Table 1: both systems side by side, and the improvement of each figure.


def _oc_rows(paper: Paper, system: str, found: Sequence[SequenceRuns]) -> list[tuple[str, ...]]:
    rows = []
    for one in found:
        base, ours = one.of(paper.baseline), one.of(system)
        rows.append((one.asked.name, "ours", *_side_by_side(base, ours)))
        if any(each is not None and each.has_loops and not each.is_same and each.accuracy for each in (base, ours)):
            without = [None if each is None else each.without_loops for each in (base, ours)]
            rows.append(("", "no loops", *_side_by_side(*without)))
        printed = [_printed(paper, name, one.asked.printed, 3) for name in (paper.baseline, system)]
        known = paper.printed_gains(system, one.asked.printed)
        cells = [NONE] * 3 if known is None else [f"{gain:.1f} %" for gain in known]
        # A gain does not follow from its errors.
        slips = [slip for slip in _slips(paper, system, one.asked.printed) if "improvement" in slip.printed]
        if slips:
            cells[RMSE] += "*"
        rows.append(("", "printed", *printed[0], *printed[1], *cells))
    return rows


def _side_by_side(base: SystemRuns | None, ours: SystemRuns | None) -> list[str]:
    return [*_errors(base), *_errors(ours), *(_better(base, ours, place) for place in range(3))]


def _slips(paper: Paper, system: str, sequence: str | None) -> list[Misprint]:
    return [slip for slip in paper.misprints if slip.system == paper.names.get(system) and slip.sequence == sequence]


def _errors(runs: SystemRuns | None) -> list[str]:
    if runs is None or runs.accuracy is None:
        return [NOT_RUN] * 3
    known = runs.statistics
    return [NONE] * 3 if known is None else [f"{spread.median:.4f}" for spread in known]


def _printed(paper: Paper, system: str, sequence: str | None, n: int) -> list[str]:
    """Return the printed errors of a system, as many as asked for, misprints marked."""
    cells = paper.printed_m(system, sequence)
    slips = [slip for slip in _slips(paper, system, sequence) if "improvement" not in slip.printed]
    if cells is None:
        return [NONE] * n
    # As many digits as the papers print: three, and four for what they copy.
    texts = [f"{value:.4f}".removesuffix("0") for value in cells]
    return [text + ("*" if slips and place == RMSE else "") for place, text in enumerate(texts[:n])]


def _better(base: SystemRuns | None, ours: SystemRuns | None, place: int = RMSE) -> str:
    if base is None or ours is None or base.accuracy is None or ours.accuracy is None:
        return NOT_RUN
    return _better_than(base.accuracy, ours.accuracy, place)


def _better_than(base: Accuracy, ours: Accuracy, place: int = RMSE) -> str:
    theirs, own = errors_of(base), errors_of(ours)
    if theirs is None or own is None:
        return NONE
    gain = improvement_percent(theirs[place].median, own[place].median)
    return NONE if gain is None else f"{round(gain, 1) + 0.0:.1f} %"  # no minus before nothing


# PSPNet-SLAM's Table 1: systems side by side, and the reduction against ORB-SLAM2, which its text describes.


def _pspnet_rows(paper: Paper, found: Sequence[SequenceRuns]) -> list[tuple[str, ...]]:
    rows = []
    for one in found:
        base = one.of(paper.baseline)
        ours = [_errors(one.of(system))[RMSE] for system in paper.systems]
        printed = [_printed(paper, system, one.asked.printed, 1)[0] for system in paper.systems]
        gains = [NONE if system == paper.baseline else _better(base, one.of(system)) for system in paper.systems]
        rows.append((one.asked.name, "ours", *ours))
        rows.append(("", "printed", *printed))
        rows.append(("", "less than orb-slam2", *gains))
    return rows


# Every system by itself, with the range of its runs, and with loop closing the other way.


def _run_rows(paper: Paper, one: SequenceRuns) -> list[tuple[str, ...]]:
    base = one.of(paper.baseline)
    rows: list[tuple[str, ...]] = []
    for system in paper.systems:
        runs, name = one.of(system), "" if rows else one.asked.name
        printed = _printed(paper, system, one.asked.printed, 1)[0]
        if runs is None or runs.accuracy is None:
            rows.append((name, system, *[NOT_RUN] * 5, printed, *[NOT_RUN] * 3))
        else:
            rows.append((name, system, *_figures(base, runs.accuracy, printed, system == paper.baseline)))
        if runs is not None and runs.other is not None:
            label = f"{system}, loops {'off' if runs.has_loops else 'on'}"
            rows.append(("", label, *_figures(base, runs.other, NONE, False)))
    return rows


def _figures(base: SystemRuns | None, accuracy: Accuracy, printed: str, is_base: bool) -> tuple[str, ...]:
    ate_m, still_m = accuracy.ate_m, accuracy.still_camera_m
    spread = [NONE] * 4 if ate_m is None else [f"{v:.4f}" for v in (ate_m.median, ate_m.mean, ate_m.min, ate_m.max)]
    gain = NONE if is_base or base is None or base.accuracy is None else _better_than(base.accuracy, accuracy)
    loops = sorted({trial.n_loops for trial in accuracy.trials})
    closed = f"{loops[0]}" if len(loops) == 1 else f"{loops[0]}–{loops[-1]}"
    still = NONE if still_m is None else f"{still_m:.4f}"
    return (*spread, gain, printed, percent(accuracy.coverage.min), closed, still)


# PSPNet-SLAM's Table 2, and times of a frame.


def _geometry(paper: Paper, found: Sequence[SequenceRuns], geometry: Mapping[str, GeometryTable]) -> NamedTable:
    rows: list[tuple[str, ...]] = []
    for one in found:
        table = geometry.get(one.asked.name)
        ours = [NOT_RUN] * 6 if table is None else [*_search(table, MULTI_VIEW), *_search(table, PRINTED)]
        cells = None if one.asked.printed is None else paper.geometry_ms.get(one.asked.printed)
        printed = [NONE] * 3 if cells is None else [f"{ms:.2f}" for ms in cells] + [f"{cells[1] / cells[0]:.2f}"]
        rows += [(one.asked.name, "ours", *ours), ("", "printed", *printed, *[NONE] * 3)]
    notes = [
        "milliseconds an image, regions included, CPU time of one thread; DynaSLAM's test of the keyframes' points, "
        "all of them and along the ants' path; as printed: the previous frame's projected features "
        "('stillroom bench geometry' has all columns). Without the network: geometry must find the people by itself",
        f"printed: {paper.cite}, {paper.sources[1]}",
    ]
    return NamedTable("Table 2, geometry of an image [ms]", GEOMETRY_HEADER, rows, N_WORDS, notes)


def _search(table: GeometryTable, test: str) -> list[str]:
    one = table.sums.get((test, ANTS))
    if one is None:
        return [NONE] * 3
    every = (one.exhaustive_s + one.exhaustive_growing_s) / one.n_images
    path = (one.search_s + one.growing_s) / one.n_images
    return [f"{every * 1e3:.2f}", f"{path * 1e3:.2f}", f"{one.time_ratio_with_growing:.2f}"]


def _times(paper: Paper, found: Sequence[SequenceRuns]) -> NamedTable:
    header = ("system", "of", *(one.asked.name for one in found), "printed")
    rows = [(system, "a frame, here", *(_frame_ms(one.of(system)) for one in found), NONE) for system in paper.systems]
    rows += [
        (time.system, f"{time.of} ({time.source})", *[NONE] * len(found), f"{time.ms:.0f}") for time in paper.times
    ]
    notes = [
        "ours: CPU time, network and mapping included, without the dense map; median of the runs' means, one thread of "
        f"{processor()}. Printed times are of the wall clock: on a machine that does nothing else the two are alike "
        "('frame_wall_ms' in the file)"
    ]
    return NamedTable("Time of a frame [ms]", header, rows, N_WORDS, notes)


def _frame_ms(runs: SystemRuns | None) -> str:
    if runs is None or runs.accuracy is None:
        return NOT_RUN
    return f"{runs.accuracy.frame_cpu_ms.median:.1f}"
