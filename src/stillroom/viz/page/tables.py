"""Tables that a reader sorts by a click on the name of a column."""

import re
from collections.abc import Sequence
from math import inf
from typing import Any

from stillroom.viz.page.markup import Cell, Number
from stillroom.viz.style import INK, QUIET

NUMBER = re.compile(r"^[+−-]?\d+(?:[.,]\d+)?(?:e[+-]?\d+)?(?=$|\s*%$)")
ROW_PX = 30
"""Height of a row."""

CHARACTER_PX = 6.8
"""Width of a character, about."""

NO_VALUE = ("", "–", "-")
"""Cells that stand for a number that is missing."""

FITTING_PX = 1190
"""Wider tables scroll; a page is not wider."""

LOOK = f"""
:host {{ font: 13px "DejaVu Sans", Verdana, "Segoe UI", sans-serif; color: {INK}; }}
.slick-header-column {{ background: #ffffff; color: {QUIET}; font-weight: 600; border-right: none !important;
  height: 34px; line-height: 24px; }}
.slick-header-columns {{ border-bottom: 1px solid #b9bec6; }}
.slick-cell {{ border-color: #eceef1 !important; line-height: 24px; border-right: none; }}
.slick-row.odd {{ background: #fafbfc; }}
"""


def sortable_table(header: Sequence[str], rows: Sequence[Sequence[Cell]], n_words: int = 1) -> Any:
    """Return a table of Bokeh, whose rows are sorted by a column when its name is clicked.

    Numbers are sorted as numbers, those that are missing come last; they are shown as they are written.

    Args:
        header: Names of the columns.
        rows: Cells; a text such as "–" or "98.2 %" is read as a number where it is one.
        n_words: How many columns at the left hold words, be it numbers; others do where a cell is neither a number nor
            a dash.
    """
    from bokeh.models import ColumnDataSource, DataTable, HTMLTemplateFormatter, InlineStyleSheet, TableColumn

    data: dict[str, list[Any]] = {}
    columns = []
    for place, name in enumerate(header):
        cells = [row[place] for row in rows]
        texts = [cell.text if isinstance(cell, Number) else cell for cell in cells]
        data[f"text{place}"] = texts
        is_words = place < n_words or any(map(_is_word, texts))
        data[f"sorted{place}"] = texts if is_words else [value_of(cell) for cell in cells]
        align = "left" if is_words else "right"
        look = f'<div style="text-align:{align}"><%- text{place} %></div>'
        width = max(round(CHARACTER_PX * max(map(len, (name, *texts)))) + 22, 60)
        columns.append(
            TableColumn(field=f"sorted{place}", title=name, width=width, formatter=HTMLTemplateFormatter(template=look))
        )
    width = sum(column.width for column in columns)
    size = {"sizing_mode": "stretch_width"} if width > FITTING_PX else {"width": width + 4}
    return DataTable(
        **size,
        source=ColumnDataSource(data),
        columns=columns,
        index_position=None,
        height=ROW_PX * len(rows) + 40,
        row_height=ROW_PX,
        autosize_mode="none",
        selectable=False,
        reorderable=False,
        stylesheets=[InlineStyleSheet(css=LOOK)],
    )


def _is_word(text: str) -> bool:
    return text.strip() not in NO_VALUE and NUMBER.match(text.strip()) is None


def value_of(cell: Cell) -> float:
    """Return the number by which a cell is sorted; infinity where it is none."""
    if isinstance(cell, Number):
        return inf if cell.value is None else cell.value
    found = NUMBER.match(cell.strip())
    return float(found[0].replace("−", "-").replace(",", "")) if found else inf
