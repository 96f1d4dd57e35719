"""Tables for a paper: as Markdown, as LaTeX (booktabs), and as CSV, with the cells that are printed."""

import csv
import re
from collections.abc import Callable, Sequence
from io import StringIO
from pathlib import Path

from stillroom.data.replacing import cannot_be_written, replace_text

LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "{": r"\{",
        "}": r"\}",
        "[": "{[}",  # after the end of a row, a length would follow
        "&": r"\&",
        "%": r"\%",
        "$": r"\$",
        "#": r"\#",
        "_": r"\_",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "–": "--",
        "−": "$-$",
        "×": r"$\times$",
        "°": r"$^\circ$",
        "µ": r"\textmu{}",
        "…": r"\ldots{}",
        "\u202f": r"\,",
    }
)
"""What LaTeX reads as something else, or does not have in every font."""

Rows = Sequence[Sequence[str]]


def as_markdown(header: Sequence[str], rows: Rows, n_words: int = 1) -> str:
    """Return a table as Markdown; the first columns hold words, the others numbers."""
    rule = [":--" if place < n_words else "--:" for place in range(len(header))]
    cells = [[_flat(cell).replace("\\", "\\\\").replace("|", r"\|") for cell in row] for row in (header, *rows)]
    return "".join(f"| {' | '.join(row)} |\n" for row in (cells[0], rule, *cells[1:]))


def as_latex(header: Sequence[str], rows: Rows, n_words: int = 1) -> str:
    """Return a table as a `tabular` of LaTeX; it needs the package booktabs."""
    columns = "".join("l" if place < n_words else "r" for place in range(len(header)))
    head, *body = (" & ".join(_flat(cell).translate(LATEX) for cell in row) + r" \\" for row in (header, *rows))
    lines = [
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        head,
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def as_csv(header: Sequence[str], rows: Rows, n_words: int = 1) -> str:
    """Return a table as CSV, with commas; what is missing is the dash that is printed."""
    text = StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows((header, *rows))
    return text.getvalue()


FORMS: dict[str, tuple[str, Callable[[Sequence[str], Rows, int], str]]] = {
    "markdown": (".md", as_markdown),
    "latex": (".tex", as_latex),
    "csv": (".csv", as_csv),
}
"""By name, the suffix of the file and what writes it."""


def write_table(
    stem: Path, title: str, header: Sequence[str], rows: Rows, n_words: int, forms: Sequence[str]
) -> list[Path]:
    """Write a table in some forms.

    Args:
        stem: Path of the files without suffix; their folder is made.
        title: Added to their names; empty to leave that.
        header: Names of the columns.
        rows: Cells as they are printed.
        n_words: How many columns at the left hold words.
        forms: Names in `FORMS`.

    Returns:
        The files. One that is there is replaced.

    Raises:
        StillroomError: One cannot be written.
    """
    words = re.sub(r"[^\w.+-]+", "-", title).strip("-")
    name = f"{stem.name}_{words}" if words else stem.name
    written = []
    for suffix, write in (FORMS[form] for form in forms):
        path = stem.with_name(name + suffix)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_be_written(path, error) from error
        replace_text(path, write(header, rows, n_words))
        written.append(path)
    return written


def _flat(cell: str) -> str:
    """Return a cell on one line."""
    return " ".join(cell.split(" ")).replace("\n", " ")
