"""Citations of docs/reference.md and links between pages lead somewhere, and every section of it is cited."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
REFERENCE_PAGE = ROOT / "docs" / "reference.md"

CITATION = re.compile(r"\breference\.md(?:#([\w-]+))?")
NUMBERED = re.compile(r"\bREFERENCE:?[\s#]+(?:section\s+)?\d")
FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^(#{1,6}) +(.+?)[ #]*$", re.MULTILINE)
LINK = re.compile(r"\]\(([^()\s]+)\)")
ELSEWHERE = re.compile(r"[a-z][a-z0-9+.-]*:")


def files(*patterns: str) -> list[Path]:
    return sorted({path for pattern in patterns for path in ROOT.glob(pattern) if path != Path(__file__)})


SOURCES = files("src/**/*.py", "tests/**/*.py", "benchmarks/**/*.py")
PAGES = files("*.md", "docs/**/*.md", "src/**/*.md")


def headings(markdown: str) -> list[tuple[int, str]]:
    """Return level and anchor of each heading, as GitHub makes them."""
    found: list[tuple[int, str]] = []
    for marks, title in HEADING.findall(FENCE.sub("", markdown)):
        anchor = re.sub(r"[^\w\- ]", "", LINK.sub("]", title).lower()).replace(" ", "-")
        taken = sum(re.fullmatch(rf"{re.escape(anchor)}(-\d+)?", other) is not None for _, other in found)
        found.append((len(marks), f"{anchor}-{taken}" if taken else anchor))
    return found


def anchors(page: Path) -> set[str]:
    return {anchor for _, anchor in headings(page.read_text(encoding="utf-8"))}


def cited_by(paths: list[Path]) -> dict[str, str]:
    """Return the anchors that are cited, "" for none, and where."""
    return {
        anchor: f"{path.relative_to(ROOT)}: reference.md#{anchor}"
        for path in paths
        for anchor in CITATION.findall(path.read_text(encoding="utf-8"))
    }


def broken_links(page: Path) -> list[str]:
    broken = []
    for link in LINK.findall(FENCE.sub("", page.read_text(encoding="utf-8"))):
        if ELSEWHERE.match(link):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(f"{page.relative_to(ROOT)}: {link}")
    return broken


def test_anchors_are_those_that_github_makes() -> None:
    page = "# A page\n```\n# code\n```\n## ORB-SLAM2: `bf`, and [more](x.md)\n### Again\n### Again\n#no heading\n"
    assert headings(page) == [(1, "a-page"), (2, "orb-slam2-bf-and-more"), (3, "again"), (3, "again-1")]


def test_every_citation_names_a_section_that_exists() -> None:
    in_sources, in_pages = cited_by(SOURCES), cited_by(PAGES)
    in_pages.pop("", None)  # A page may link to the whole of it.
    assert len(in_sources) > 10, "citations are looked for in the wrong place"
    known = anchors(REFERENCE_PAGE)
    cited = (*in_sources.items(), *in_pages.items())
    assert [where for anchor, where in cited if anchor not in known] == []


def test_no_citation_by_number_is_left() -> None:
    numbered = [path for path in SOURCES + PAGES if NUMBERED.search(path.read_text(encoding="utf-8"))]
    assert numbered == []


def test_every_section_of_the_reference_is_cited() -> None:
    cited = cited_by(SOURCES + [page for page in PAGES if page != REFERENCE_PAGE])
    idle, parent = {}, ""
    for level, anchor in headings(REFERENCE_PAGE.read_text(encoding="utf-8")):
        if level == 2:
            parent = anchor
            idle[anchor] = anchor not in cited
        elif level == 3:
            idle[anchor] = anchor not in cited and parent not in cited
            # A section without text of its own is cited through its parts.
            idle[parent] = idle[parent] and idle[anchor]
    assert [anchor for anchor, is_idle in idle.items() if is_idle] == []


def test_links_between_pages_lead_somewhere() -> None:
    assert [link for page in PAGES for link in broken_links(page)] == []
