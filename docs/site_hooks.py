"""What mkdocs is told beyond `mkdocs.yml`: pages from elsewhere in the repository, and the API of `import stillroom`.

Pages are written for readers of the repository, so they link to files of it. Here such links become links of the site.
"""

import importlib
import inspect
import posixpath
import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
ELSEWHERE = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "README.md": "index.md",
    "src/stillroom/semantics/weights/yolo_fastest.md": "cards/yolo_fastest.md",
    "src/stillroom/semantics/weights/pspnet_mobilenetv2_voc.md": "cards/pspnet_mobilenetv2_voc.md",
}
"""Pages of the repository outside `docs/`, and where they are in the site; the README's place is the front page's."""
IN_REPOSITORY = {site: repository for repository, site in ELSEWHERE.items() if site != "index.md"}
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^()\s]+)\)")
OF_ANOTHER_SITE = re.compile(r"[a-z][a-z0-9+.-]*:|#")
FRONT_DOOR_MARK = "<!-- front door -->"
DESCRIBED_HERE = "stillroom.session."
"""Where the things are that have no page but the front door's."""


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that lie elsewhere."""
    for site, repository in IN_REPOSITORY.items():
        files.append(File.generated(config, site, content=(ROOT / repository).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Page, config: Any, files: Files) -> str:
    """Return a page with its links turned to the site, and with the front door's API where it is asked for."""
    site = page.file.src_uri
    here = IN_REPOSITORY.get(site, f"docs/{site}")

    def turned(link: re.Match[str]) -> str:
        mark, text, target = link.groups()
        if OF_ANOTHER_SITE.match(target):
            return link[0]
        path, _, anchor = target.partition("#")
        place = posixpath.normpath(posixpath.join(posixpath.dirname(here), path))
        if not (ROOT / place).exists():
            raise PluginError(f"{here}: {target} leads nowhere")
        there = ELSEWHERE.get(place) or (place.removeprefix("docs/") if place.startswith("docs/") else None)
        if there is None:
            return text  # a file of the repository that is no page
        turned_path = posixpath.relpath(there, posixpath.dirname(site) or ".")
        return f"{mark}[{text}]({turned_path}{'#' + anchor if anchor else ''})"

    return LINK.sub(turned, markdown).replace(FRONT_DOOR_MARK, front_door())


def on_page_content(html: str, page: Page, config: Any, files: Files) -> str:
    """Return a page without the double colons that announce an example in a docstring."""
    return html.replace("<p>::</p>", "").replace("::</p>", ":</p>")


def front_door() -> str:
    """Return a table of all that `import stillroom` offers, and below it what no other page of the API describes."""
    rows, own = ["| name | what |", "|---|---|"], []
    for name, (place, summary) in offered().items():
        rows.append(f"| [`{name}`][{place}] | {summary} |")
        if place.startswith(DESCRIBED_HERE):
            own.append(f"::: {place}\n    options:\n      heading: {name}\n      toc_label: {name}")
    return "\n".join(rows) + "\n\n" + "\n\n".join(own)


def offered() -> dict[str, tuple[str, str]]:
    """Return the names that `import stillroom` offers: the full names of the things themselves, and what they are."""
    if str(ROOT / "src") not in sys.path:
        sys.path.insert(0, str(ROOT / "src"))
    stillroom = importlib.import_module("stillroom")
    found = {}
    for name in getattr(stillroom, "__all__", ()):
        thing = getattr(stillroom, name)
        if hasattr(thing, "__qualname__"):
            summary = (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ").replace("|", "\\|")
            found[f"stillroom.{name}"] = f"{thing.__module__}.{thing.__qualname__}", summary
    return found
