"""The page of a bench: which bars it has, and that its tables are those that are printed."""

from dataclasses import asdict
from pathlib import Path

import pytest
from read_pages import ReadPage

from stillroom.bench.page import NamedTable, series_of, write_bench_page
from stillroom.cli.bench.session import Bench
from stillroom.evaluation.timing import StageTime
from stillroom.evaluation.trajectory_errors import Spread
from stillroom.viz.page.charts import Bar

SPREAD = {"median": 2.0, "mean": 2.5, "min": 1.0, "max": 4.0, "n_runs": 3}


def test_a_figure_over_several_runs_has_a_bar() -> None:
    rows = [
        {"sequence": "a", "method": "x", "ate_se3_m": SPREAD, "coverage": None, "n": 3},
        {"sequence": "a", "method": "y", "ate_se3_m": None, "oddity_px": SPREAD},
    ]
    assert series_of(rows) == {
        "ATE [m]": [Bar("x", 2.0, 1.0, 4.0, "3 runs")],
        "oddity px": [Bar("y", 2.0, 1.0, 4.0, "3 runs")],
    }


def test_a_spread_as_it_is_written_is_one() -> None:
    [bar] = series_of([{"method": "x", "ate_se3_m": asdict(Spread.of([3.0, 1.0]))}])["ATE [m]"]
    assert (bar.low, bar.value, bar.high) == (1.0, 2.0, 3.0)


def test_sequences_are_kept_apart() -> None:
    rows = [{"sequence": name, "method": "x", "ate_se3_m": SPREAD} for name in ("a", "b")]
    assert list(series_of(rows)) == ["ATE [m], a", "ATE [m], b"]


def test_stages_reach_up_to_the_95th_percentile() -> None:
    stage = StageTime("frame", 9, 3.0, 6.0, 3.5, cpu_median_ms=2.0, cpu_p95_ms=5.0, cpu_mean_ms=2.5)
    [(name, bars)] = series_of([{"method": "x", "stages": (asdict(stage),)}]).items()
    assert name == "CPU time of each stage [ms], x"
    assert bars == [Bar("frame", 2.0, 2.0, 5.0, "in 9 frames")]


def test_searches_have_their_share_of_the_time() -> None:
    [(_, bars)] = series_of([{"sequence": "a", "test": "ours", "search": "ants", "time_ratio": 0.7}]).items()
    assert bars == [Bar("ours, ants", 0.7)]


def test_the_page_has_every_table_with_its_notes(tmp_path: Path) -> None:
    tables = [NamedTable("first", ("a", "b"), [("x", "1")], notes=["a note"]), NamedTable("none", ("a",), [])]
    write_bench_page(tmp_path / "page.html", "bench", tables, {}, {"date": "today", "versions": {"numpy": "2"}})
    page = ReadPage(tmp_path / "page.html")
    for text in ("bench", "first", "a note", "today", "numpy 2"):
        assert text in page.text
    assert "none" not in page.text
    assert page.asks_the_network == []


def test_a_row_keeps_its_name_when_it_is_sorted(tmp_path: Path) -> None:
    table = NamedTable("t", ("test", "ms"), [("ours", "2"), ("", "1"), ("theirs", "3")])
    write_bench_page(tmp_path / "page.html", "bench", [table], {}, {})
    assert '["ours","ours","theirs"]' in ReadPage(tmp_path / "page.html").scripts.replace("&quot;", '"')


def test_a_page_that_cannot_be_written_costs_no_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "figures.html").mkdir()
    bench = Bench("accuracy", tmp_path / "figures.json", ["csv"])
    for value in ("1", "2"):
        bench.print_table("twice", ("a", "b"), [("x", value)])
    bench.keep([{"method": "x", "n": 1}])
    bench.finish()
    assert (tmp_path / "figures.json").is_file()
    assert [message for message in caplog.messages if message.startswith("the page is left out: ")]
    cells = [(tmp_path / f"figures_twice{n}.csv").read_text(encoding="utf-8") for n in ("", "-2")]
    assert cells == ["a,b\nx,1\n", "a,b\nx,2\n"]
