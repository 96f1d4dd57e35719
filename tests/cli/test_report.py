"""`stillroom report`, and the options that draw and write for a paper."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from read_pages import ReadPage

ROOM = ("synthetic:walking", "--frames", "100:124", "--set", "semantics.kind=truth")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two finished runs of a second."""
    from stillroom.cli.main import main

    folders = [tmp_path_factory.mktemp("runs") / method for method in ("orb-slam2", "oc-slam")]
    for folder in folders:
        arguments = ["run", *ROOM, "--method", folder.name, "--pictures", "1", "--format", "svg", "--out", str(folder)]
        with pytest.raises(SystemExit) as left:
            main(arguments)
        assert left.value.code in (0, None)
    return folders


def test_a_run_draws_for_a_paper_and_writes_its_report(runs: list[Path]) -> None:
    for folder in runs:
        names = {path.name for path in (folder / "pictures").glob("*.svg")}
        assert names == {"trajectory_above.svg", "trajectory_over_time.svg", "error.svg", "sparse_map.svg"}
        for name in names:
            assert ElementTree.parse(folder / "pictures" / name).getroot().tag.endswith("}svg")
            assert (folder / "pictures" / name).with_suffix(".png").is_file()
        assert ReadPage(folder / "report.html").numbers


def test_the_comparison_is_printed_and_written(runs: list[Path], stillroom: Callable, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    said = stillroom("report", *runs, "--out", page, "--table", "csv", "--table", "markdown,latex", "--format", "pdf")
    assert said.code == 0, said.err
    assert f"report: {page}" in said.out
    assert "synthetic_walking_sway_office_270_seed0" in said.out
    with (tmp_path / "page.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows] == ["orb-slam2", "oc-slam"]
    for row, folder in zip(rows, runs, strict=True):
        figures = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
        assert row["ATE [m]"] == f"{figures['as_given']['ate_se3_m']['rmse']:.4f}"
        assert row["ATE [m]"] in said.out
    assert {path.suffix for path in tmp_path.glob("page.*")} == {".html", ".csv", ".md", ".tex"}
    plots = sorted(path.name for path in (tmp_path / "page_plots").glob("*.pdf"))
    assert plots == ["error.pdf", "trajectory_above.pdf", "trajectory_over_time.pdf"]
    assert "orb-slam2, oc-slam on synthetic_walking" in ReadPage(page).text


def test_a_comparison_goes_into_results(runs: list[Path], stillroom: Callable) -> None:
    assert stillroom("report", *runs).code == 0
    [page] = Path("results").glob("*_comparison.html")
    assert ReadPage(page).asks_the_network == []


def test_one_folder_gets_its_report_again(runs: list[Path], stillroom: Callable, tmp_path: Path) -> None:
    (runs[0] / "report.html").unlink()
    said = stillroom("report", runs[0])
    assert said.code == 0
    assert said.out == f"report: {runs[0] / 'report.html'}\n"
    assert ReadPage(runs[0] / "report.html").numbers
    assert stillroom("report", runs[0], "--out", tmp_path / "elsewhere.html").code == 0
    assert ReadPage(tmp_path / "elsewhere.html").numbers == ReadPage(runs[0] / "report.html").numbers


def test_an_evaluation_draws_for_a_paper(runs: list[Path], stillroom: Callable) -> None:
    said = stillroom("evaluate", runs[1], "--baseline", runs[0], "--format", "pdf,svg")
    assert said.code == 0
    assert "figures and 9 pictures" in said.out
    assert (runs[1] / "pictures" / "error.pdf").read_bytes().startswith(b"%PDF")


def test_a_run_without_a_report(stillroom: Callable, tmp_path: Path) -> None:
    said = stillroom("run", *ROOM, "--method", "orb-slam2", "--pictures", "0", "--no-report", "--out", tmp_path / "out")
    assert said.code == 0
    assert "report: " not in said.out
    assert not (tmp_path / "out" / "report.html").exists()


def test_forms_that_there_are_not(runs: list[Path], stillroom: Callable, tmp_path: Path) -> None:
    for arguments, message in (
        (("report", *runs, "--format", "eps"), "--format eps: no such form; there are png, svg, pdf"),
        (("report", *runs, "--table", "html"), "--table html: no such form; there are markdown, latex, csv"),
        (("run", *ROOM, "--format", "gif"), "--format gif: no such form; there are png, svg, pdf"),
        (("bench", "accuracy", *ROOM, "--table", "odt"), "--table odt: no such form; there are markdown, latex, csv"),
        (("report", tmp_path / "nowhere", runs[0]), f"{tmp_path / 'nowhere'}: no such results folder"),
    ):
        said = stillroom(*arguments)
        assert said.code == 1
        assert said.errors
        assert message in said.errors[0]
