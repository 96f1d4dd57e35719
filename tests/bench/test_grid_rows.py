"""The rows of a grid on disk, whatever happens while one is written; and what they come to, by plain arithmetic."""

import csv
import errno
import json
import os
from dataclasses import asdict, fields, replace
from pathlib import Path

import pytest
from grid_workers import planned, row_of

from stillroom.bench.grid import rows as rows_module
from stillroom.bench.grid.rows import COLUMNS, FIGURES, Cost, Row, RowFile, in_order, read_rows, write_table
from stillroom.bench.grid.summary import Forecast, duration, sentences, summaries
from stillroom.errors import ConfigError, StillroomError

RUNS = [planned(seed, method) for method in ("a", "b") for seed in range(3)]
COST = Cost(cpu_ms_a_frame=20.0, seconds=0.5, peak_memory_mb=300.0)


def written(path: Path, rows: list[Row]) -> None:
    with RowFile(path) as file:
        for row in rows:
            file.append(row)


def test_rows_are_lines_and_are_read_back(tmp_path: Path) -> None:
    rows = [row_of(RUNS[0], cost=COST), row_of(RUNS[1], "it broke – ünd how")]
    written(tmp_path / "rows.jsonl", rows[:1])
    written(tmp_path / "rows.jsonl", rows[1:])
    lines = (tmp_path / "rows.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line) for line in lines] == [asdict(row) for row in rows]
    assert read_rows(tmp_path / "rows.jsonl") == (rows, (tmp_path / "rows.jsonl").stat().st_size)


def test_no_rows_are_there_before_the_first(tmp_path: Path) -> None:
    assert read_rows(tmp_path / "rows.jsonl") == ([], 0)


def test_a_torn_last_line_is_cut_off_wherever_it_was_torn(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    rows = [row_of(run) for run in RUNS[:2]]
    written(path, rows)
    whole = path.read_bytes()
    first = whole.index(b"\n") + 1
    for end in range(first + 1, len(whole), 7):
        path.write_bytes(whole[:end])
        with RowFile(path) as file:
            assert file.rows == rows[:1]
            assert file.n_torn == end - first
            file.append(rows[1])
        assert path.read_bytes() == whole


def test_a_whole_line_that_is_no_row_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    written(path, [row_of(RUNS[0])])
    for line in ("no json", "[]", '{"sequence": "a"}'):
        with path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")
        with pytest.raises(StillroomError, match=r"rows\.jsonl:2: is no row"):
            read_rows(path)
        path.write_text(path.read_text(encoding="utf-8").splitlines()[0] + "\n", encoding="utf-8")


def test_two_grids_do_not_write_into_one_file(tmp_path: Path) -> None:
    pytest.importorskip("fcntl", reason="Windows has no such lock")
    path, said = tmp_path / "rows.jsonl", "another grid writes into it"
    with RowFile(path), pytest.raises(ConfigError, match=said), RowFile(path):
        pass
    with RowFile(tmp_path / "rows.jsonl") as file:
        assert file.rows == []


def test_a_full_disk_leaves_no_half_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system writes what has room, and says so of the rest."""
    path = tmp_path / "rows.jsonl"
    honest = os.write
    left = [10]

    def write(file: int, data: bytes) -> int:
        if left[0] == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        n = honest(file, data[: left[0]])
        left[0] -= n
        return n

    with RowFile(path) as file:
        file.append(row_of(RUNS[0]))
        whole = path.read_bytes()
        monkeypatch.setattr(rows_module.os, "write", write)
        with pytest.raises(StillroomError, match="No space left"):
            file.append(row_of(RUNS[1]))
        assert file.rows == [row_of(RUNS[0])]
    assert path.read_bytes() == whole


def test_the_table_is_in_the_grid_s_order_with_costs_last(tmp_path: Path) -> None:
    rows = [row_of(RUNS[4], cost=COST), row_of(RUNS[0], "first it failed"), row_of(planned(9)), row_of(RUNS[0])]
    write_table(tmp_path / "rows.csv", in_order(RUNS, rows))
    with (tmp_path / "rows.csv").open(encoding="utf-8", newline="") as file:
        header, *body = list(csv.reader(file))
    assert tuple(header) == COLUMNS
    places = [header.index(name) for name in header if name.startswith("cost_")]
    assert places == list(range(len(header) - len(fields(Cost)), len(header)))
    assert [row[header.index("digest")] for row in body] == [RUNS[0].digest, RUNS[4].digest]
    assert body[0][header.index("error")] == ""
    assert float(body[1][header.index("ate_m")]) == row_of(RUNS[4]).ate_m
    assert body[1][header.index("ate_camera_m")] == ""
    assert float(body[1][header.index("cost_seconds")]) == 0.5


def test_a_row_bears_the_setting_of_the_grid_that_asks_for_it() -> None:
    """What one grid varies may be the default of another: it is the same run."""
    varied = replace(RUNS[0], varied=("tracking.min_inliers=30",))
    (row,) = in_order([varied], [row_of(RUNS[0])])
    assert row == replace(row_of(RUNS[0]), setting="tracking.min_inliers=30")


def test_a_failed_run_has_no_figures_and_its_error_on_one_line() -> None:
    row = Row.failed(RUNS[0], "it broke\n  here", COST)
    assert row.error == "it broke here"
    assert FIGURES == ("n_given", "n_tracked", "n_keyframes", "ate_m", "ate_camera_m", "rpe_m_s", "rpe_deg_s")
    assert {getattr(row, name) for name in FIGURES} == {None}


def test_a_summary_tells_median_extremes_and_the_worst_coverage() -> None:
    cost_ms = (10.0, 50.0, 30.0)
    rows = [row_of(run, cost=Cost(cpu_ms_a_frame=ms)) for run, ms in zip(RUNS[:3], cost_ms, strict=True)]
    rows[1] = replace(rows[1], n_tracked=5)
    one, other = summaries(RUNS, rows)
    assert one.row() == ("a", "", "3", "0.0200", "0.0100", "0.0300", "50.0 %", "30.0")
    assert other.row() == ("b", "", "0 of 3", "–", "–", "–", "–", "–")


def test_failed_runs_count_in_no_figure_and_are_told_with_their_reasons() -> None:
    rows = [row_of(RUNS[0], "no such folder"), row_of(RUNS[1]), row_of(RUNS[3], "no such folder")]
    one, _ = summaries(RUNS, rows)
    assert one.row()[2:6] == ("1 of 3", "0.0200", "0.0200", "0.0200")
    assert sentences(rows)[1:] == ["2 of 3 runs failed:", "  2 × no such folder"]


def test_a_run_without_an_error_of_its_trajectory_hides_no_other() -> None:
    """Where one run tracked too little to compare, the others' figures alone would flatter."""
    rows = [row_of(RUNS[0]), replace(row_of(RUNS[1]), ate_m=None)]
    assert summaries(RUNS, rows)[0].row()[2:6] == ("2 of 3", "–", "–", "–")


def test_a_forecast_is_the_mean_time_of_a_frame_times_the_frames() -> None:
    done = [
        row_of(planned(0, "a", 10), cost=Cost(seconds=1.0, peak_memory_mb=200.0)),
        row_of(planned(1, "a", 20), cost=Cost(seconds=4.0, peak_memory_mb=350.0)),
        row_of(planned(2, "a", 10), "failed", Cost(seconds=99.0, peak_memory_mb=9000.0)),
        row_of(planned(0, "b", 10), cost=Cost(seconds=3.0, peak_memory_mb=100.0)),
    ]
    left = [planned(5, "a", 100), planned(6, "b", 50)]
    assert Forecast.of(left, done) == Forecast(0.15 * 100 + 0.3 * 50, 350.0, ())
    unknown = Forecast.of([*left, planned(0, "c", 10), planned(7, "b", 0)], done)
    assert unknown.unknown == ("c", "b")
    assert unknown.seconds == Forecast.of(left, done).seconds
    assert Forecast.of(left, []) == Forecast(0.0, None, ("a", "b"))


@pytest.mark.parametrize(("seconds", "says"), [(42.4, "42 s"), (600.0, "10 min"), (9000.0, "2.5 h")])
def test_a_duration_in_words(seconds: float, says: str) -> None:
    assert duration(seconds) == says
