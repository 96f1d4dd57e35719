"""A page as one file: HTML, the plotting library inside it, and no request to any other place."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from stillroom.data.replacing import replacing
from stillroom.viz.page.markup import STYLE, paragraphs
from stillroom.viz.style import FAINT, INK, QUIET

THEME = {
    "attrs": {
        "Plot": {
            "background_fill_color": "#ffffff",
            "border_fill_color": "#ffffff",
            "outline_line_color": None,
            "min_border_right": 16,
        },
        "Grid": {"grid_line_color": "#e8eaee"},
        "Axis": {
            "axis_line_color": "#b9bec6",
            "major_tick_line_color": "#b9bec6",
            "minor_tick_line_color": None,
            "major_label_text_color": "#4a4f57",
            "major_label_text_font": "DejaVu Sans",
            "major_label_text_font_size": "12px",
            "axis_label_text_color": "#4a4f57",
            "axis_label_text_font": "DejaVu Sans",
            "axis_label_text_font_style": "normal",
            "axis_label_text_font_size": "12.5px",
        },
        "Title": {
            "text_color": INK,
            "text_font": "DejaVu Sans",
            "text_font_size": "14px",
            "text_font_style": "bold",
        },
        "Legend": {
            "label_text_font": "DejaVu Sans",
            "label_text_font_size": "12px",
            "label_text_color": INK,
            "border_line_color": None,
            "background_fill_alpha": 0.85,
            "inactive_fill_color": FAINT,
        },
        "Label": {"text_font": "DejaVu Sans", "text_font_size": "12px", "text_color": QUIET},
    }
}
"""The look of `viz.style`, for Bokeh."""


@dataclass(frozen=True)
class Section:
    """A part of a page.

    Attributes:
        title: Above it; empty for the first one, which stands below the page's own title.
        blocks: Its pieces: HTML text (see `markup`), or plots and tables of Bokeh (see `charts`, `tables`).
    """

    title: str
    blocks: Sequence[Any]


def write_page(path: Path, title: str, under: Sequence[str], sections: Sequence[Section]) -> None:
    """Write a page; plots and tables are Bokeh's, whose code is in it.

    Args:
        path: The HTML file to write; its folder is there.
        title: Of the page.
        under: Lines below it.
        sections: What is on it; one without blocks is left out.

    Raises:
        StillroomError: The file cannot be written.
    """
    shown = [section for section in sections if any(not isinstance(b, str) or b for b in section.blocks)]
    models = [block for section in shown for block in section.blocks if not isinstance(block, str)]
    script, code, places = _embedded(models)
    rest = iter(places)
    body = "".join(
        (f"<section><h2>{escape(section.title)}</h2>\n" if section.title else "<section>")
        + "".join(b if isinstance(b, str) else f'<div class="chart">{next(rest)}</div>\n' for b in section.blocks)
        + "</section>\n"
        for section in shown
    )
    text = (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        # A browser would ask for an icon beside the page.
        '<link rel="icon" href="data:,">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n{code}\n</head>\n<body>\n<main>\n"
        f"<header><h1>{escape(title)}</h1>\n{paragraphs(under, 'under')}</header>\n{body}</main>\n{script}\n"
        "</body>\n</html>\n"
    )
    with replacing(path, durable=False) as file:
        file.write(text.encode("utf-8"))


def _embedded(models: list[Any]) -> tuple[str, str, list[str]]:
    """Return the script that draws, the library that it needs, and a place for each plot or table."""
    if not models:
        return "", "", []
    from bokeh.embed import components
    from bokeh.models import DataTable
    from bokeh.resources import Resources
    from bokeh.themes import Theme

    parts = ["bokeh", "bokeh-widgets", "bokeh-tables"] if any(isinstance(m, DataTable) for m in models) else ["bokeh"]
    script, places = components(models, theme=Theme(json=THEME))
    # No line of the library's log in a reader's console.
    code = Resources(mode="inline", components=parts, log_level="error").render()
    return script, code, list(places)
