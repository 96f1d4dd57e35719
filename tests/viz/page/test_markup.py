"""Pieces of a page: what comes from outside stays text, and figures keep their exact value."""

from pathlib import Path

from read_pages import ReadPage

from stillroom.viz.page.markup import Number, cards, folded, gallery, paragraphs, table, warnings
from stillroom.viz.page.page import Section, write_page

ODD = "</script><b title=\"x\">&amp; 'room'"


def written(tmp_path: Path, *blocks: object, title: str = "a page") -> ReadPage:
    write_page(tmp_path / "page.html", title, ["below it"], [Section("part", blocks), Section("empty", ["", ""])])
    return ReadPage(tmp_path / "page.html")


def test_what_comes_from_outside_is_text(tmp_path: Path) -> None:
    blocks = (paragraphs([ODD]), folded(ODD, ODD), table([ODD], [[ODD]]), warnings([ODD]), cards([(Number("1"), ODD)]))
    page = written(tmp_path, *blocks, title=ODD)
    # The title twice: in the window, too.
    assert page.text.count(" ".join(ODD.split())) == 2 + 7
    assert page.scripts == ""


def test_figures_keep_their_exact_value(tmp_path: Path) -> None:
    value = 0.1 + 0.2
    page = written(tmp_path, table(("a", "b"), [["x", Number("0.30", value)], ["y", Number("–")]]))
    assert page.numbers == [value]
    assert "0.30" in page.text
    assert "–" in page.text


def test_sections_and_lists_without_content_are_left_out(tmp_path: Path) -> None:
    page = written(tmp_path, paragraphs(["something"]), warnings([]), gallery([]), cards([]))
    assert "part" in page.text
    assert "empty" not in page.text
    assert "<ul" not in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_a_page_without_plots_carries_no_library(tmp_path: Path) -> None:
    assert written(tmp_path, paragraphs(["something"])).n_bytes < 10_000
