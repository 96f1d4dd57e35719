"""The pages are built strictly, ask the network for nothing, and name all that `import stillroom` offers."""

import dataclasses
import importlib.util
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import stillroom
from stillroom.data.result import FrameResult
from stillroom.system import System

ROOT = Path(__file__).parents[1]
pytest.importorskip("mkdocs", reason="mkdocs is not installed; pip install 'stillroom[docs]'")
pytest.importorskip("mkdocstrings", reason="mkdocstrings is not installed; pip install 'stillroom[docs]'")

LOADS = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src", "audio": "src"}
LINKS_THAT_ARE_NOT_LOADED = {"canonical", "prev", "next", "edit"}
REMOTE = re.compile(r"(https?:)?//", re.IGNORECASE)
REMOTE_IN_STYLE = re.compile(r"(?:url\(\s*|@import\s+)['\"]?(?:https?:)?//", re.IGNORECASE)


class Loaded(HTMLParser):
    """Collects what a page has loaded, and the anchors that it has."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.anchors: set[str] = set()
        self.classes: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.classes |= set(values.get("class", "").split())
        if "id" in values:
            self.anchors.add(values["id"])
        if tag in LOADS and LOADS[tag] in values:
            self.addresses.append(values[LOADS[tag]])
        if tag == "link" and not set(values.get("rel", "").split()) & LINKS_THAT_ARE_NOT_LOADED:
            self.addresses.append(values.get("href", ""))


def read(html: str) -> Loaded:
    page = Loaded()
    page.feed(html)
    return page


def build(config: Path, site: Path) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--config-file",
        str(config),
        "--site-dir",
        str(site),
    ]
    # The theme announces its successor on every build; that is no warning about the pages.
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    built = build(ROOT / "mkdocs.yml", folder)
    said = built.stdout + built.stderr
    assert built.returncode == 0, said
    assert "WARNING" not in said
    assert "ERROR" not in said
    return folder


def test_every_page_is_built(site: Path) -> None:
    pages = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").glob("**/*.md")}
    assert pages >= {Path("index.html"), Path("tutorial.html"), Path("api/index.html")}
    built = {path.relative_to(site) for path in site.glob("**/*.html")}
    assert pages - built == set()
    assert {Path("contributing.html"), Path("changelog.html"), Path("cards/yolo_fastest.html")} <= built


def test_the_pages_ask_the_network_for_nothing(site: Path) -> None:
    for path in site.glob("**/*.html"):
        text = path.read_text(encoding="utf-8")
        page = read(text)
        assert page.addresses, f"{path.name}: nothing is loaded, so nothing was looked at"
        assert [address for address in page.addresses if REMOTE.match(address)] == [], path.name
        assert not REMOTE_IN_STYLE.search(text), path.name
        assert "mermaid" not in page.classes, f"{path.name}: the theme would fetch mermaid from a CDN"
    for path in site.glob("**/*.css"):
        assert not REMOTE_IN_STYLE.search(path.read_text(encoding="utf-8")), path.name


def test_no_mark_of_a_docstring_is_left_in_the_text(site: Path) -> None:
    for path in site.glob("**/*.html"):
        assert "::</p>" not in path.read_text(encoding="utf-8"), path.name


def module_of(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_architecture_is_drawn_with_the_parts_of_the_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawing = module_of(ROOT / "docs" / "draw_architecture.py")
    names: list[str] = []
    draw_box = drawing.box

    def noted(axes: Any, x: float, y: float, width: float, height: float, name: str, *rest: Any, **more: Any) -> None:
        names.append(name)
        draw_box(axes, x, y, width, height, name, *rest, **more)

    monkeypatch.setattr(drawing, "box", noted)
    drawing.main(tmp_path / "architecture.svg")
    assert (tmp_path / "architecture.svg").read_text(encoding="utf-8").rstrip().endswith("</svg>")
    parts = {name.replace(" ", "_") for name in names}
    assert parts & {field.name for field in dataclasses.fields(System)} >= {
        *("segmenter", "clusterer", "features", "mapper", "places", "joiner", "loop_closer", "map")
    }
    assert {"SIEVE_1", "SIEVE_2", "SIEVE_3", FrameResult.__name__} <= parts


def test_what_is_loaded_is_found() -> None:
    page = read('<link rel="stylesheet" href="//x/y.css"><script src=https://z></script><a href="https://fine"></a>')
    assert [bool(REMOTE.match(address)) for address in page.addresses] == [True, True]
    assert REMOTE_IN_STYLE.search("a { background: url('https://x/y.png') }")
    assert not REMOTE_IN_STYLE.search("a { background: url(data:image/svg+xml,abc) }")


def test_all_that_the_package_offers_is_described(site: Path) -> None:
    anchors = set().union(*(read(path.read_text(encoding="utf-8")).anchors for path in site.glob("api/*.html")))
    offered = module_of(ROOT / "docs" / "site_hooks.py").offered()
    assert {name for name in stillroom.__all__ if hasattr(getattr(stillroom, name), "__qualname__")} == {
        name.removeprefix("stillroom.") for name in offered
    }
    assert "stillroom.Slam" in offered
    assert [place for place, _ in offered.values() if place not in anchors] == []
    assert [name for name, (_, summary) in offered.items() if not summary] == []
    front = (site / "api" / "index.html").read_text(encoding="utf-8")
    assert [name for name in offered if f"<code>{name}</code>" not in front] == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[away](no-such-page.md)", "leads nowhere"),
        ("[away](index.md#no-such-anchor)", "no-such-anchor"),
        ("::: stillroom.no_such_module", "no_such_module"),
    ],
)
def test_a_strict_build_fails_on_what_is_broken(text: str, said: str, tmp_path: Path) -> None:
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text(f"# Page\n\n{text}\n", encoding="utf-8")
    config = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    before_nav = config.partition("\nnav:")[0]
    before_nav = before_nav.replace("docs/site_hooks.py", str(ROOT / "docs" / "site_hooks.py"))
    before_nav = before_nav.replace("omitted_files: warn", "omitted_files: ignore")
    (tmp_path / "mkdocs.yml").write_text(before_nav.replace("[src]", f"[{ROOT / 'src'}]") + "\n", encoding="utf-8")
    built = build(tmp_path / "mkdocs.yml", tmp_path / "site")
    assert built.returncode != 0
    assert said in built.stdout + built.stderr
