"""Trajectories against the ground truth: from above, over time, and their error over time."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.data.trajectory import Trajectory
from stillroom.geometry.arrays import F64
from stillroom.viz.style import ESTIMATES, TRUTH, picture

AXES = "xyz"

CROWDED = 4
"""From above, more lines than this are thin, and the true one lies on top."""

GAP_STEPS = 5.0
"""A line breaks where the next pose is later than this many median steps: gaps are not drawn."""


def plot_from_above(path: Path, estimates: Mapping[str, Trajectory], groundtruth: Trajectory, title: str = "") -> None:
    """Draw paths in the plane in which the true one extends most, on equal axes.

    Args:
        path: The file to write: PNG, or SVG or PDF by its suffix.
        estimates: Trajectories aligned with the ground truth, by their name in the legend; at least one.
        groundtruth: The true one, of at least one pose.
        title: Shown above.
    """
    across, up = plane_of(groundtruth.positions_m)
    is_crowded = len(estimates) > CROWDED
    with picture(path, 7.0, 6.2) as figure:
        axes = figure.add_subplot()
        _, true_m = with_breaks(groundtruth.timestamps_s, groundtruth.positions_m)
        # Among many lines the true one would be buried.
        on_top = {"lw": 1.6, "zorder": 4} if is_crowded else {"lw": 1.4}
        axes.plot(true_m[:, across], true_m[:, up], color=TRUTH, label="ground truth", **on_top)
        for (name, trajectory), (color, dashes) in zip(estimates.items(), _lines(), strict=False):
            _, positions_m = with_breaks(trajectory.timestamps_s, trajectory.positions_m)
            thin = {"lw": 0.9} if is_crowded else {}
            axes.plot(positions_m[:, across], positions_m[:, up], color=color, ls=dashes, label=name, **thin)
        start_m = groundtruth.positions_m[0]
        axes.plot(start_m[across], start_m[up], "o", ms=7, mfc="white", mec=TRUTH, mew=1.4, zorder=5, label="start")
        axes.set(xlabel=f"{AXES[across]} [m]", ylabel=f"{AXES[up]} [m]", title=title)
        axes.set_aspect("equal", adjustable="datalim")
        figure.legend(loc="outside lower center", ncols=min(4, len(estimates) + 2))


def plot_over_time(path: Path, estimates: Mapping[str, Trajectory], groundtruth: Trajectory, title: str = "") -> None:
    """Draw x, y and z over time, one below the other; arguments as in `plot_from_above`."""
    start_s = groundtruth.timestamps_s[0]
    with picture(path, 9.0, 6.4) as figure:
        panels = figure.subplots(3, 1, sharex=True)
        for axis, panel in enumerate(panels):
            times_s, true_m = with_breaks(groundtruth.timestamps_s, groundtruth.positions_m)
            panel.plot(times_s - start_s, true_m[:, axis], color=TRUTH, lw=1.4, label="ground truth")
            for (name, trajectory), (color, dashes) in zip(estimates.items(), _lines(), strict=False):
                times_s, positions_m = with_breaks(trajectory.timestamps_s, trajectory.positions_m)
                panel.plot(times_s - start_s, positions_m[:, axis], color=color, ls=dashes, label=name)
            panel.set_ylabel(f"{AXES[axis]} [m]")
        panels[0].set_title(title)
        panels[-1].set_xlabel("time [s]")
        figure.align_ylabels(panels)
        _legend_below(figure, panels[0])


def plot_error(
    path: Path,
    errors: Mapping[str, tuple[F64, F64]],
    still_camera_m: float | None = None,
    title: str = "",
) -> None:
    """Draw the distance to the truth over time, and the static-pose baseline as a line.

    Args:
        path: The file to write: PNG, or SVG or PDF by its suffix.
        errors: By name, times (N,) [s] and errors (N,) [m]; at least one, of at least one pose.
        still_camera_m: RMSE of the static-pose baseline [m]; above it an estimate is worse than none.
        title: Shown above.
    """
    start_s = min(float(times_s[0]) for times_s, _ in errors.values())
    with picture(path, 9.0, 3.8) as figure:
        axes = figure.add_subplot()
        for (name, (times_s, errors_m)), (color, dashes) in zip(errors.items(), _lines(), strict=False):
            shown_s, shown_m = with_breaks(times_s, errors_m[:, None])
            axes.plot(shown_s - start_s, shown_m[:, 0], color=color, ls=dashes, label=name)
        if still_camera_m is not None:
            label = f"static-pose baseline ({still_camera_m:.3f} m)"
            axes.axhline(still_camera_m, color=TRUTH, lw=1.2, ls=(0, (4, 3)), label=label)
        axes.set(xlabel="time [s]", ylabel="error [m]", title=title)
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.01)
        _legend_below(figure, axes)


def plane_of(positions_m: F64) -> tuple[int, int]:
    """Return the two axes along which positions (N, 3) extend most, N ≥ 1, in the order of their names."""
    extent_m = np.ptp(positions_m, axis=0)
    across, up = sorted(int(axis) for axis in np.argsort(-extent_m, kind="stable")[:2])
    return across, up


def _legend_below(figure: Any, axes: Any) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)))


def _lines() -> list[tuple[str, str]]:
    """Return colours and dashes of more lines than a readable picture has: where colours repeat, dashes differ."""
    return [(color, dashes) for dashes in ("-", "--", ":", "-.") for color in ESTIMATES]


def with_breaks(times_s: F64, values: F64) -> tuple[F64, F64]:
    """Return times (N,) and values (N, D) with a NaN wherever a gap in time is to interrupt the line."""
    if len(times_s) < 3:
        return times_s, values
    steps_s = np.diff(times_s)
    gaps = np.flatnonzero(steps_s > GAP_STEPS * np.median(steps_s)) + 1
    return np.insert(times_s, gaps, np.nan), np.insert(values, gaps, np.nan, axis=0)
