"""Messages name rows of docs/troubleshooting.md, and every row is named by a message."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "troubleshooting.md"
NAMED = re.compile(r"(?:\[see troubleshooting: |Doubt\(\s*\")([a-z-]+)")
ROW = re.compile(r"^\| `([a-z-]+)` \|", re.MULTILINE)


def named_in_messages() -> dict[str, str]:
    """Return the rows that messages name, and a file that does."""
    return {
        name: str(path.relative_to(ROOT))
        for path in sorted((ROOT / "src").rglob("*.py"))
        for name in NAMED.findall(path.read_text(encoding="utf-8"))
    }


def rows() -> list[str]:
    return ROW.findall(PAGE.read_text(encoding="utf-8"))


def test_every_message_has_its_row() -> None:
    named = named_in_messages()
    assert named
    assert {name: file for name, file in named.items() if name not in rows()} == {}


def test_every_row_has_its_message() -> None:
    assert [name for name in rows() if name not in named_in_messages()] == []


def test_rows_are_named_once_and_are_whole() -> None:
    assert len(rows()) == len(set(rows()))
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if ROW.match(line):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            assert len(cells) == 4, line
            assert all(cells), line
