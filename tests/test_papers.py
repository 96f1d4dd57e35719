"""`docs/papers.md`: every statement of the papers has a section, files that exist, and a verdict."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "papers.md"
PACKAGE = ROOT / "src" / "stillroom"
VERDICTS = {"as written", "open", "differs", "misprint", "not run"}
SECTION = re.compile(r"^(abstract|[IVX]+|\d)", re.IGNORECASE)
ROW = re.compile(
    r"^\| (?P<section>[^|]+) \| (?P<says>[^|]+) \| (?P<where>[^|]+) \| (?P<verdict>[^|]+) \|(?P<rest>[^|]*)\|$"
)


def statements() -> list[re.Match[str]]:
    found, inside = [], False
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("| section |"):
            inside = True
        elif not line.startswith("|"):
            inside = False
        elif inside and not line.startswith("|---"):
            row = ROW.match(line)
            assert row is not None, f"a row of another form: {line}"
            found.append(row)
    return found


STATEMENTS = statements()


def test_both_papers_are_there() -> None:
    assert len(STATEMENTS) >= 40


@pytest.mark.parametrize("row", STATEMENTS, ids=lambda row: f"{row['section']}: {row['says'][:40]}")
def test_a_statement_names_a_section_a_file_and_a_verdict(row: re.Match[str]) -> None:
    assert SECTION.match(row["section"].strip())
    files = re.findall(r"`([^`]+\.py)`", row["where"])
    assert files, "no file"
    for file in files:
        assert (PACKAGE / file).is_file() or (ROOT / file).is_file(), f"{file} does not exist"
    assert row["verdict"].strip() in VERDICTS
    if row["verdict"].strip() != "as written":
        assert row["rest"].strip(), "why, or what was chosen, is not said"
