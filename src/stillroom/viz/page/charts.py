"""Plots of a page, which can be zoomed, and tell a figure where the pointer is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillroom.geometry.arrays import F64
from stillroom.viz.style import ESTIMATES, TRUTH
from stillroom.viz.trajectory_plots import AXES, plane_of, with_breaks

TOOLS = "pan,box_zoom,wheel_zoom,reset,save"
MOST_POINTS = 6000
"""A line with more points is thinned: a page stays small, and a screen shows no more."""

MOST_STRETCHES = 200
"""Stretches that are shaded, the longest: a browser draws each by itself."""

ROW_PX = 26
"""Height of a bar with the air around it."""


@dataclass(frozen=True)
class Path3:
    """The way of a camera, in the frame of the ground truth where there is one.

    Attributes:
        name: In the legend.
        times_s: Times (N,) [s], from the begin of what is shown.
        positions_m: Where it was (N, 3) [m].
        errors_m: Distance to the ground truth (N,) [m]; None where that is not known.
    """

    name: str
    times_s: F64
    positions_m: F64
    errors_m: F64 | None = None

    def thinned(self) -> "Path3":
        """Return every few of its poses, few enough to draw."""
        every = -(-len(self.times_s) // MOST_POINTS)
        errors_m = None if self.errors_m is None else self.errors_m[::every]
        return self if every <= 1 else Path3(self.name, self.times_s[::every], self.positions_m[::every], errors_m)


@dataclass(frozen=True)
class Bar:
    """One bar: a value, and how far it reaches over several runs or frames.

    Attributes:
        name: Beside it.
        value: Its length: the median.
        low, high: Ends of its range; None for a single value.
        note: What the pointer tells in addition.
    """

    name: str
    value: float
    low: float | None = None
    high: float | None = None
    note: str = ""


def plan_view(paths: Sequence[Path3], truth: Path3 | None) -> Any:
    """Return paths in the plane in which the true one, or else the first, extends most, on equal axes.

    Args:
        paths: Of at least one pose each; at least one where there is no truth.
        truth: The true path; None where it is not known.
    """
    shown = [path.thinned() for path in paths]
    base = truth.thinned() if truth is not None else shown[0]
    across, up = plane_of(base.positions_m)
    plot = _figure(f"{AXES[across]} [m]", f"{AXES[up]} [m]", 520, match_aspect=True)
    if truth is not None:
        _way(plot, base, TRUTH, (across, up), 2.0)
    for path, color in zip(shown, colors(len(shown)), strict=True):
        _way(plot, path, color, (across, up), 1.8)
    start = [[base.positions_m[0, across]], [base.positions_m[0, up]]]
    plot.scatter(*start, size=10, fill_color="white", line_color=TRUTH, line_width=1.6, legend_label="start")
    return _with_legend(plot)


def errors_over_time(
    paths: Sequence[Path3], still_camera_m: float | None = None, lost_s: Sequence[tuple[float, float]] = ()
) -> Any:
    """Return the distance to the truth over time.

    Args:
        paths: With errors; at least one, of at least one pose.
        still_camera_m: RMSE of the static-pose baseline [m]; above it an estimate is worse than none.
        lost_s: Stretches without a pose, from and to [s], in the time of the paths.
    """
    plot = _figure("time [s]", "error [m]", 330)
    for path, color in zip((path.thinned() for path in paths), colors(len(paths)), strict=True):
        assert path.errors_m is not None
        times_s, errors_m = with_breaks(path.times_s, path.errors_m[:, None])
        _line(plot, path.name, color, times_s, errors_m[:, 0], "m")
    longest_s = max(float(path.times_s[-1]) for path in paths)
    if still_camera_m is not None:
        label = f"static-pose baseline ({still_camera_m:.3f} m)"
        ends = [min(float(path.times_s[0]) for path in paths), longest_s]
        plot.line(ends, [still_camera_m] * 2, color=TRUTH, line_dash=[6, 4], line_width=1.3, legend_label=label)
    _shade(plot, lost_s)
    plot.y_range.start = 0.0
    return _with_legend(plot)


def lines_over_time(series: Mapping[str, tuple[F64, F64]], ylabel: str, lost_s: Sequence[tuple[float, float]]) -> Any:
    """Return series over time: by name, times (N,) [s] and values (N,); at least one."""
    plot = _figure("time [s]", ylabel, 260)
    for (name, (times_s, values)), color in zip(series.items(), colors(len(series)), strict=True):
        every = max(1, -(-len(times_s) // MOST_POINTS))
        _line(plot, name, color, times_s[::every], values[::every], "")
    _shade(plot, lost_s)
    plot.y_range.start = 0.0
    return _with_legend(plot)


def bars(rows: Sequence[Bar], xlabel: str, of_range: str, digits: int = 1, one_color: bool = False) -> Any:
    """Return bars from above to below, each with its range as a line.

    Args:
        rows: At least one; names are told apart by a number where they are the same.
        xlabel: What they measure, with its unit.
        of_range: What the range is, such as "median, least and largest of the runs".
        digits: After the point, in what the pointer tells.
        one_color: Whether all are of one colour; else each name has its own.
    """
    from bokeh.models import ColumnDataSource, HoverTool, Whisker

    names = _unlike([bar.name for bar in rows])
    of_name = dict(zip(dict.fromkeys(bar.name for bar in rows), colors(len(rows)), strict=False))
    data = {
        "name": names,
        "value": [bar.value for bar in rows],
        "low": [np.nan if bar.low is None else bar.low for bar in rows],
        "high": [np.nan if bar.high is None else bar.high for bar in rows],
        "told": [_told(bar, digits) for bar in rows],
        "note": [bar.note for bar in rows],
        "color": [ESTIMATES[0] if one_color else of_name[bar.name] for bar in rows],
    }
    source = ColumnDataSource(data)
    plot = _figure(xlabel, "", ROW_PX * len(rows) + 72, y_range=names[::-1], tools="", toolbar_location=None)
    drawn = plot.hbar(y="name", right="value", height=0.62, source=source, fill_color="color", line_color=None)
    drawn.glyph.fill_alpha = 0.85
    if any(bar.low is not None for bar in rows):
        ranges = Whisker(base="name", lower="low", upper="high", source=source, dimension="width", level="overlay")
        ranges.line_color, ranges.line_width = TRUTH, 1.4
        for head in (ranges.upper_head, ranges.lower_head):
            head.size, head.line_color, head.line_width = 8, TRUTH, 1.4
        plot.add_layout(ranges)
    tips = [("", "@name"), (of_range, "@told"), ("", "@note")]
    plot.add_tools(HoverTool(tooltips=tips, renderers=[drawn]))
    longest = max([bar.value for bar in rows] + [bar.high for bar in rows if bar.high is not None])
    plot.x_range.start, plot.x_range.end = 0.0, 1.05 * longest if longest > 0 else 1.0
    plot.ygrid.grid_line_color = None
    return plot


def colors(n: int) -> list[str]:
    """Return so many colours of lines; they repeat."""
    return [ESTIMATES[place % len(ESTIMATES)] for place in range(n)]


def _figure(xlabel: str, ylabel: str, height: int, tools: str = TOOLS, **more: Any) -> Any:
    from bokeh.plotting import figure

    more = {"toolbar_location": "right"} | more
    plot = figure(
        height=height,
        sizing_mode="stretch_width",
        tools=tools,
        **({"active_drag": "box_zoom"} if "box_zoom" in tools else {}),
        x_axis_label=xlabel,
        y_axis_label=ylabel,
        **more,
    )
    plot.toolbar.logo = None
    plot.xaxis[0].formatter.use_scientific = False
    return plot


def _with_legend(plot: Any) -> Any:
    """Put the legend below the plot; a click on a name hides its line."""
    legend = plot.legend[0]
    legend.click_policy, legend.orientation, legend.ncols = "hide", "horizontal", 4
    legend.location, legend.spacing, legend.padding, legend.margin = "left", 18, 0, 4
    plot.add_layout(legend, "below")
    return plot


def _way(plot: Any, path: Path3, color: str, axes: tuple[int, int], width: float) -> None:
    from bokeh.models import HoverTool

    times_s, values = with_breaks(path.times_s, _columns(path))
    data = {"t": times_s, "x": values[:, axes[0]], "y": values[:, axes[1]], "error": values[:, 3]}
    drawn = plot.line("x", "y", source=data, color=color, line_width=width, legend_label=path.name)
    tips = [("", path.name), ("time", "@t{0.00} s"), ("at", "@x{0.000} m, @y{0.000} m")]
    if path.errors_m is not None:
        tips.append(("error", "@error{0.0000} m"))
    plot.add_tools(HoverTool(tooltips=tips, renderers=[drawn], line_policy="nearest", visible=False))


def _columns(path: Path3) -> F64:
    errors_m = np.full(len(path.times_s), np.nan) if path.errors_m is None else path.errors_m
    return np.column_stack((path.positions_m, errors_m))


def _line(plot: Any, name: str, color: str, times_s: F64, values: F64, unit: str) -> None:
    from bokeh.models import HoverTool

    data = {"t": times_s, "value": values}
    drawn = plot.line("t", "value", source=data, color=color, line_width=1.8, legend_label=name)
    shown = "@value{0.0000} m" if unit else "@value{0}"
    tips = [("", name), ("time", "@t{0.00} s"), ("value", shown)]
    plot.add_tools(HoverTool(tooltips=tips, renderers=[drawn], mode="mouse", line_policy="nearest", visible=False))


def _shade(plot: Any, lost_s: Sequence[tuple[float, float]]) -> None:
    """Shade stretches of time without a pose."""
    from bokeh.models import BoxAnnotation

    for begin_s, end_s in sorted(lost_s, key=lambda stretch: stretch[0] - stretch[1])[:MOST_STRETCHES]:
        plot.add_layout(
            BoxAnnotation(left=begin_s, right=end_s, fill_color=ESTIMATES[1], fill_alpha=0.12, line_color=None)
        )


def _told(bar: Bar, digits: int) -> str:
    """Return a bar's value and range in words."""
    if bar.low is None or bar.high is None:
        return f"{bar.value:.{digits}f}"
    return f"{bar.value:.{digits}f} ({bar.low:.{digits}f} – {bar.high:.{digits}f})"


def _unlike(names: Sequence[str]) -> list[str]:
    """Return names that differ: the second of the same gets a number."""
    seen: dict[str, int] = {}
    unlike = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        unlike.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return unlike
