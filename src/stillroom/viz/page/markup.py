"""Pieces of a page, as HTML text; what comes from outside is escaped here."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

from stillroom.viz.style import ESTIMATES, FAINT, INK, QUIET


@dataclass(frozen=True)
class Number:
    """A figure: as it is read, and as it is.

    Attributes:
        text: For readers, rounded.
        value: For programs, exactly; None where there is none.
    """

    text: str
    value: float | None = None


Cell = str | Number

STYLE = f"""
:root {{ color-scheme: light; }}
* {{ box-sizing: border-box; }}
body {{ margin: 0; background: #ffffff; color: {INK}; line-height: 1.5;
  font: 15px "DejaVu Sans", Verdana, "Segoe UI", sans-serif; }}
main {{ max-width: 1240px; margin: 0 auto; padding: 40px 24px 64px; }}
h1 {{ font-size: 25px; font-weight: 600; margin: 0; overflow-wrap: anywhere; }}
h2 {{ font-size: 18px; font-weight: 600; margin: 44px 0 14px; padding-top: 14px; border-top: 1px solid {FAINT}; }}
h3 {{ font-size: 15px; font-weight: 600; margin: 24px 0 8px; overflow-wrap: anywhere; }}
p {{ margin: 0 0 8px; }}
.under {{ color: {QUIET}; margin-top: 4px; overflow-wrap: anywhere; }}
.note {{ color: {QUIET}; font-size: 13px; margin-top: 8px; }}
.cards {{ display: flex; flex-wrap: wrap; gap: 14px; margin-bottom: 18px; }}
.card {{ flex: 1 1 150px; border: 1px solid {FAINT}; border-radius: 8px; padding: 12px 16px; }}
.card b {{ display: block; font-size: 22px; font-weight: 600; white-space: nowrap; }}
.card span {{ color: {QUIET}; font-size: 13px; }}
.scroll {{ overflow-x: auto; margin-bottom: 14px; }}
table {{ border-collapse: collapse; font-size: 13.5px; }}
th {{ font-weight: 600; color: {QUIET}; text-align: left; vertical-align: bottom; }}
td, th {{ padding: 5px 18px 5px 0; border-bottom: 1px solid #eceef1; }}
td.number, th.number {{ text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }}
td.word {{ overflow-wrap: anywhere; }}
.warnings {{ border-left: 4px solid {ESTIMATES[1]}; background: #fdf4f2; padding: 10px 16px; margin: 0;
  list-style: none; }}
.pictures {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(330px, 1fr)); gap: 18px; }}
.pictures.of2 {{ grid-template-columns: repeat(auto-fill, minmax(480px, 1fr)); }}
.pictures.of1 {{ grid-template-columns: 1fr; max-width: 960px; margin-bottom: 18px; }}
figure {{ margin: 0; }}
figure img {{ width: 100%; display: block; border: 1px solid #eceef1; border-radius: 4px; }}
figcaption {{ color: {QUIET}; font-size: 13px; margin-top: 5px; overflow-wrap: anywhere; }}
details {{ margin: 10px 0; }}
summary {{ cursor: pointer; color: {ESTIMATES[0]}; }}
pre {{ background: #f6f7f9; border-radius: 6px; padding: 14px 18px; overflow: auto; max-height: 560px;
  font: 12.5px/1.45 "DejaVu Sans Mono", Menlo, Consolas, monospace; }}
.chart {{ margin: 6px 0 18px; }}
header + section {{ margin-top: 26px; }}
@media print {{ main {{ max-width: none; padding: 0; }}
  h2 {{ break-after: avoid; }} figure {{ break-inside: avoid; }} }}
"""
"""How every page looks: the colours of the plots."""


def paragraphs(sentences: Iterable[str], kind: str = "") -> str:
    """Return sentences, a paragraph each; `kind` may be `note` or `under`."""
    attribute = f' class="{kind}"' if kind else ""
    return "".join(f"<p{attribute}>{escape(sentence)}</p>\n" for sentence in sentences)


def heading(text: str) -> str:
    """Return a heading within a section."""
    return f"<h3>{escape(text)}</h3>\n"


def cards(figures: Iterable[tuple[Number, str]]) -> str:
    """Return the figures that a reader looks for first, large, each with what it is."""
    inner = "".join(f'<div class="card"><b>{_shown(n)}</b><span>{escape(what)}</span></div>\n' for n, what in figures)
    return f'<div class="cards">\n{inner}</div>\n' if inner else ""


def table(header: Sequence[str], rows: Iterable[Sequence[Cell]], n_words: int = 1) -> str:
    """Return a table; the first columns hold words, the others numbers."""
    kinds = ["word" if place < n_words else "number" for place in range(len(header))]
    head = "".join(f'<th class="{kind}">{escape(name)}</th>' for kind, name in zip(kinds, header, strict=True))
    body = "".join(
        "<tr>" + "".join(f'<td class="{k}">{_shown(c)}</td>' for k, c in zip(kinds, row, strict=True)) + "</tr>\n"
        for row in rows
    )
    top = f"<thead><tr>{head}</tr></thead>\n" if any(header) else ""
    return f'<div class="scroll"><table>{top}<tbody>\n{body}</tbody></table></div>\n'


def warnings(sentences: Sequence[str]) -> str:
    """Return warnings as a list that is seen; nothing where there are none."""
    items = "".join(f"<li>{escape(sentence)}</li>\n" for sentence in sentences)
    return f'<ul class="warnings">\n{items}</ul>\n' if items else ""


def folded(summary: str, text: str) -> str:
    """Return a text that is unfolded by a click."""
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>\n"


def gallery(figures: Iterable[str], in_a_row: int = 3) -> str:
    """Return pictures (see `pictures.Album.figure`), so many beside each other, one to three, where there is room."""
    inner = "".join(figures)
    return f'<div class="pictures of{in_a_row}">\n{inner}</div>\n' if inner else ""


def _shown(cell: Cell) -> str:
    if isinstance(cell, str):
        return escape(cell)
    return (
        escape(cell.text)
        if cell.value is None
        else f'<data value="{escape(repr(cell.value))}">{escape(cell.text)}</data>'
    )
