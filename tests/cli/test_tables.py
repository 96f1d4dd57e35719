"""Tables for a paper, read back to the same cells."""

import csv
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from stillroom.cli.tables import FORMS, LATEX, as_csv, as_latex, as_markdown, write_table
from stillroom.errors import StillroomError

HEADER = ("rejection", "ATE [m]", "of keypoints", "ms & more")
ROWS = [
    ("OC-SLAM_2.2, as printed", "0.0402", "98.2 %", "–"),
    ("… its Eq. 2 | too", "–", "100.0 %", "−1.5"),
    (r"[a\b {c} ~ ^ # $ %", "1 × 2 µs", "3°", '"quoted", here'),
]


def markdown_cells(text: str) -> list[list[str]]:
    """Cells of the first table of a text; the rule below its head is left out."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    split = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines]
    rows = [[re.sub(r"\\(.)", r"\1", cell.strip()) for cell in row] for row in split]
    assert all(set(cell) <= set(":-") for cell in rows[1])
    return [rows[0], *rows[2:]]


def latex_cells(text: str) -> list[list[str]]:
    """Cells of a tabular, as a reader of the paper sees them."""
    begin, end = text.index("\\toprule"), text.index("\\bottomrule")
    written = {shown: chr(code) for code, shown in LATEX.items()}
    tokens = re.compile("|".join(re.escape(shown) for shown in sorted(written, key=len, reverse=True)))
    rows = [
        row for row in re.split(r"\\\\\n", text[begin:end].replace("\\toprule\n", "").replace("\\midrule\n", "")) if row
    ]
    cells = [re.split(r"(?<!\\) & ", row) for row in rows]
    return [[tokens.sub(lambda found: written[found[0]], cell.strip()) for cell in row] for row in cells]


def csv_cells(text: str) -> list[list[str]]:
    return list(csv.reader(text.splitlines()))


READERS: dict[str, Callable[[str], list[list[str]]]] = {
    "markdown": markdown_cells,
    "latex": latex_cells,
    "csv": csv_cells,
}


def test_every_form_is_read_back() -> None:
    assert READERS.keys() == FORMS.keys()


@pytest.mark.parametrize("form", FORMS)
def test_the_cells_are_those_that_are_printed(form: str, tmp_path: Path) -> None:
    [path] = write_table(tmp_path / "new" / "stem", "on a/b: c", HEADER, ROWS, 1, (form,))
    assert path == tmp_path / "new" / f"stem_on-a-b-c{FORMS[form][0]}"
    assert READERS[form](path.read_text(encoding="utf-8")) == [list(HEADER), *map(list, ROWS)]


def test_words_are_left_and_numbers_right() -> None:
    assert as_markdown(HEADER, ROWS, 2).splitlines()[1] == "| :-- | :-- | --: | --: |"
    assert as_latex(HEADER, ROWS, 2).startswith("\\begin{tabular}{llrr}\n\\toprule\n")


def test_a_cell_of_several_lines_stays_one() -> None:
    assert as_markdown(("a",), [["b\nc"]]).count("\n") == 3
    assert as_latex(("a",), [["b\nc"]]).count("b c") == 1
    assert csv_cells(as_csv(("a", "b"), [["1,5", "x"]])) == [["a", "b"], ["1,5", "x"]]


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StillroomError, match="cannot be written"):
        write_table(tmp_path / "file" / "stem", "", HEADER, ROWS, 1, ("csv",))
