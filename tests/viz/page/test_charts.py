"""Plots and tables of a page, as Bokeh holds them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bokeh.models import BoxAnnotation, GlyphRenderer, HoverTool, Line, Whisker
from read_pages import ReadPage

from stillroom.viz.page.charts import MOST_POINTS, Bar, Path3, bars, errors_over_time, plan_view
from stillroom.viz.page.markup import Number
from stillroom.viz.page.page import Section, write_page
from stillroom.viz.page.tables import sortable_table, value_of
from stillroom.viz.style import ESTIMATES, TRUTH


def circle(name: str, n: int = 100, error_m: float | None = None) -> Path3:
    """A circle of 1 m in x and z, 10 s long."""
    times_s = np.linspace(0.0, 10.0, n)
    positions_m = np.column_stack((np.cos(times_s), 0.01 * times_s, np.sin(times_s)))
    return Path3(name, times_s, positions_m, None if error_m is None else np.full(n, error_m))


def lines(plot: Any) -> list[tuple[Any, str]]:
    """Data and colour of each line, in order."""
    found = [each for each in plot.renderers if isinstance(each, GlyphRenderer) and isinstance(each.glyph, Line)]
    return [(line.data_source.data, line.glyph.line_color) for line in found]


def test_the_plan_is_the_plane_of_most_extent() -> None:
    truth, estimate = circle("ground truth"), circle("ours", error_m=0.02)
    plot = plan_view([estimate], truth)
    assert (plot.xaxis[0].axis_label, plot.yaxis[0].axis_label) == ("x [m]", "z [m]")
    assert plot.match_aspect
    (true, black), (ours, blue) = lines(plot)
    assert (black, blue) == (TRUTH, ESTIMATES[0])
    assert np.array_equal(true["x"], truth.positions_m[:, 0])
    assert np.array_equal(ours["y"], estimate.positions_m[:, 2])
    assert np.array_equal(ours["error"], np.full(100, 0.02))
    assert [label.label.value for label in plot.legend[0].items] == ["ground truth", "ours", "start"]
    assert len(plot.select(HoverTool)) == 2


def test_a_gap_breaks_the_line() -> None:
    whole = circle("ours", error_m=0.1)
    kept = np.r_[0:40, 60:100]
    plot = errors_over_time([Path3("ours", whole.times_s[kept], whole.positions_m[kept], np.full(80, 0.1))])
    [(data, _)] = lines(plot)
    assert list(np.flatnonzero(np.isnan(data["t"]))) == [40]


def test_errors_have_the_baseline_and_the_stretches_without_a_pose() -> None:
    plot = errors_over_time([circle("a", error_m=0.1), circle("b", error_m=0.2)], 0.5, [(2.0, 3.0), (7.0, 8.5)])
    assert plot.y_range.start == 0.0
    *_, (baseline, color) = lines(plot)
    assert list(baseline["y"]) == [0.5, 0.5]
    assert color == TRUTH
    # The box that is drawn to zoom is nowhere yet.
    shaded = {(box.left, box.right) for box in plot.select(BoxAnnotation) if np.isfinite(box.left)}
    assert shaded == {(2.0, 3.0), (7.0, 8.5)}


def test_long_paths_are_thinned() -> None:
    path = circle("ours", 10 * MOST_POINTS + 1, 0.1)
    [(data, _)] = lines(errors_over_time([path]))
    assert MOST_POINTS / 2 < len(data["t"]) <= MOST_POINTS + 1
    assert set(data["t"]) <= set(path.times_s)


def test_bars_reach_from_the_least_to_the_largest() -> None:
    plot = bars([Bar("a", 2.0, 1.0, 4.0, "3 runs"), Bar("b", 3.0), Bar("a", 5.0)], "m", "range", digits=2)
    [whisker] = plot.select(Whisker)
    data = whisker.source.data
    assert data["name"] == ["a", "b", "a (2)"]
    assert plot.y_range.factors == ["a (2)", "b", "a"], "from above to below"
    assert data["low"][0], data["high"][0] == (1.0, 4.0)
    assert np.isnan([*data["low"][1:], *data["high"][1:]]).all()
    assert data["told"] == ["2.00 (1.00 – 4.00)", "3.00", "5.00"]
    assert data["color"] == [ESTIMATES[0], ESTIMATES[1], ESTIMATES[0]]
    assert plot.x_range.end >= 5.0


def test_bars_of_nothing_are_drawn() -> None:
    assert bars([Bar("a", 0.0)], "m", "range").x_range.end == 1.0


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ("0.0402", 0.0402),
        ("−1.5", -1.5),
        ("+87.3 %", 87.3),
        ("100.0 %", 100.0),
        ("–", np.inf),
        ("", np.inf),
        ("0.67–0.87", np.inf),
        (Number("0.04", 0.0402), 0.0402),
        (Number("–"), np.inf),
    ],
)
def test_cells_are_sorted_as_numbers(cell: str | Number, value: float) -> None:
    assert value_of(cell) == value


def test_a_table_sorts_by_values_and_shows_texts() -> None:
    rows = [["a", Number("0.04", 0.0402), "10.0 %", "up"], ["b", Number("–"), "9.5 %", "–"]]
    table = sortable_table(("name", "error", "share", "word"), rows)
    assert [column.title for column in table.columns] == ["name", "error", "share", "word"]
    assert all(column.sortable for column in table.columns)
    sorted_by = [table.source.data[column.field] for column in table.columns]
    assert sorted_by == [["a", "b"], [0.0402, np.inf], [10.0, 9.5], ["up", "–"]]
    assert [table.source.data[f"text{n}"] for n in range(4)] == [
        ["a", "b"],
        ["0.04", "–"],
        ["10.0 %", "9.5 %"],
        ["up", "–"],
    ]
    assert [column.formatter.template for column in table.columns] == [
        f'<div style="text-align:{align}"><%- text{n} %></div>'
        for n, align in enumerate(("left", "right", "right", "left"))
    ]


def test_names_cannot_leave_the_script(tmp_path: Path) -> None:
    odd = "</script><b>'\\\""
    blocks = [plan_view([circle(odd)], None), bars([Bar(odd, 1.0)], odd, odd), sortable_table((odd,), [[odd]])]
    write_page(tmp_path / "page.html", "page", [], [Section("part", blocks)])
    page = ReadPage(tmp_path / "page.html")
    assert page.text == "page page part"
    assert "Bokeh" in page.scripts
    assert page.asks_the_network == []
