"""What the pages show works: Python blocks run, commands exist with their options, TOML blocks load.

The blocks of a page share a namespace and run in an empty folder; `rgbd_bonn_crowd` is a few rendered frames there. A
block with a title, such as ```` ```python title="my_sieve.py" ````, is a file of that folder, and what a page's
`pyproject.toml` names as entry points is installed there, as pip would.
"""

import ast
import re
import shlex
import shutil
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer.main
from rgbd_folder import write_first_frames, write_rgbd_folder

from stillroom.bench.grid.axes import plan, read_grid
from stillroom.bench.grid.workers import check_backend
from stillroom.cameras.registry import PLUGINS as CAMERAS
from stillroom.cli.installed import GROUP as COMMANDS
from stillroom.cli.main import application, main
from stillroom.config.kinds import SEGMENTERS, SIEVES
from stillroom.datasets.camera_file import REQUIRED, read_camera
from stillroom.datasets.open import open_dataset
from stillroom.datasets.registry import PLUGINS as DATASETS
from stillroom.presets.registry import PLUGINS as METHODS
from stillroom.presets.registry import configure

ROOT = Path(__file__).parents[1]
GROUPS = {group.group: group for group in (METHODS, DATASETS, CAMERAS, SEGMENTERS, SIEVES, COMMANDS)}
SEQUENCES = ("rgbd_bonn_crowd", "rgbd_bonn_crowd_first560")
"""Names of the real sequence that pages use."""
FEW, REAL = 12, 60
FENCE = re.compile(r"^( *)```(\w*)([^\n]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^    (stillroom (?:.*\\\n)*.*)$", re.MULTILINE)
INLINE = re.compile(r"`(stillroom\s[^`]+)`")
TITLE = re.compile(r'title="([^"]+)"')
SHELL = {"", "sh", "bash", "console"}


@dataclass(frozen=True)
class Block:
    """A fenced block of a page; `title` is the file that it shows, if any."""

    line: int
    language: str
    title: str
    text: str


@dataclass(frozen=True)
class Page:
    path: Path

    @property
    def text(self) -> str:
        return self.path.read_text(encoding="utf-8")

    @property
    def name(self) -> str:
        return self.path.relative_to(ROOT).as_posix()

    @property
    def blocks(self) -> list[Block]:
        return blocks_of(self.text)

    def of(self, *languages: str) -> list[Block]:
        return [block for block in self.blocks if block.language in languages]


def blocks_of(text: str) -> list[Block]:
    found = []
    for fence in FENCE.finditer(text):
        title = TITLE.search(fence[3])
        line = text.count("\n", 0, fence.start(4)) + 1
        found.append(Block(line, fence[2], title[1] if title else "", fence[4]))
    return found


def commands_of(text: str) -> Iterator[tuple[str, bool]]:
    """Yield every `stillroom …` of a page, and whether it is a whole command or may be a mere mention of one."""
    for block in blocks_of(text):
        if block.language in SHELL:
            yield from ((line, True) for line in command_lines(block.text))
    rest = FENCE.sub("", text)
    for found in INDENTED.finditer(rest):
        yield from ((line, True) for line in command_lines(found[1]))
    yield from ((" ".join(found[1].split()), False) for found in INLINE.finditer(INDENTED.sub("", rest)))


def command_lines(text: str) -> Iterator[str]:
    for line in re.sub(r"\s*\\\n\s*", " ", text).splitlines():
        for part in re.split(r"&&|;", line):
            command = re.split(r" {3,}| # ", part.strip())[0]  # what stands far behind a command is a remark about it
            if command.startswith("stillroom "):
                yield command.strip()


PAGES = [Page(path) for path in sorted({*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")}) if path.name != "CHANGELOG.md"]
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
Folder = Callable[[Page], Path]


@pytest.fixture(scope="session")
def rendered_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder in which the real sequence is a few rendered frames."""
    data = tmp_path_factory.mktemp("rendered_data")
    write_rgbd_folder(open_dataset(f"synthetic:walking,frames={FEW},fps=10"), data / SEQUENCES[0])
    for name in SEQUENCES[1:]:
        shutil.copytree(data / SEQUENCES[0], data / name)
    return data


@pytest.fixture
def folder_for(tmp_path: Path, rendered_data: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Folder]:
    """Make the folder of a page: its files are there, its packages installed, and imports find them."""
    before = set(sys.modules)

    def made(page: Page) -> Path:
        for block in page.blocks:
            if block.title:
                (tmp_path / block.title).write_text(block.text, encoding="utf-8")
                if block.title == "pyproject.toml":
                    install(tomllib.loads(block.text), tmp_path)
        monkeypatch.chdir(tmp_path)
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setenv("STILLROOM_DATA", str(rendered_data))
        if page.path.name == "map-file.md":  # it reads a map that a run has left
            asked = ["run", f"synthetic:walking,frames={FEW}", "--method", "orb-slam2", "--map", "room.stillmap"]
            with pytest.raises(SystemExit, match="0"):
                main(asked)
        return tmp_path

    yield made
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", None)):
            del sys.modules[name]


def install(project: dict[str, Any], folder: Path) -> None:
    """Name the entry points of a project where Python looks for those of installed packages."""
    name = project["project"]["name"]
    info = folder / f"{name.replace('-', '_')}-{project['project']['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    sections = []
    for group, entries in project["project"]["entry-points"].items():
        sections += [f"[{group}]", *(f"{key} = {value}" for key, value in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(sections) + "\n")


def execute(page: Page) -> dict[str, Any]:
    """Run the blocks of a page in order, and return their namespace. Errors point at the line of the page."""
    module = ModuleType("page")
    sys.modules["page"] = module  # dataclasses look their module up
    try:
        for block in page.of("python", "py"):
            if not block.title:
                tree = ast.increment_lineno(ast.parse(block.text, page.name), block.line - 1)
                exec(compile(tree, str(page.path), "exec"), module.__dict__)
    finally:
        del sys.modules["page"]
    return vars(module)


with_python = [page for page in PAGES if page.of("python", "py")]


@pytest.mark.parametrize("page", with_python, ids=lambda page: page.name)
def test_python_blocks_run(page: Page, folder_for: Folder) -> None:
    folder_for(page)
    execute(page)


def test_the_readme_s_example_runs_on_real_frames(bonn: Path, folder_for: Folder, monkeypatch: Any) -> None:
    page = Page(ROOT / "README.md")
    folder = folder_for(page)
    for name in SEQUENCES:
        write_first_frames(bonn, folder / "data" / name, REAL)
    monkeypatch.setenv("STILLROOM_DATA", str(folder / "data"))
    execute(page)


def words_of(command: str) -> list[str]:
    words = shlex.split(command)[1:]
    return [word for word in words if word not in ("--help", "--version")]


def parse(command: str, whole: bool) -> dict[str, Any]:
    """Read a command as the command line does, without running it; return what its options were set to.

    Args:
        command: With "stillroom" before it.
        whole: Whether nothing may be missing.

    Raises:
        AssertionError: There is no such command, or it has no such option.
    """
    words = words_of(command)
    named = [word for word in words if not word.startswith("-")]
    app = typer.main.get_command(application(*[*named, None, None][:2]))
    values: dict[str, Any] = {}
    try:
        if not words:
            return values
        context = app.make_context("stillroom", list(words))
        part: Any = app
        while hasattr(part, "resolve_command"):
            left = [*getattr(context, "_protected_args", []), *context.args]
            if not left and not whole:
                break
            name, part, rest = part.resolve_command(context, left)
            if not rest and not whole:
                break
            context = part.make_context(name, rest, parent=context)
            values |= context.params
    except Exception as error:
        kind = type(error).__name__
        if kind == "MissingParameter" and not whole:
            return values
        said = error.format_message() if hasattr(error, "format_message") else str(error)
        raise AssertionError(f"{command}: {kind}: {said}") from error
    return values


def alternatives(command: str) -> list[str]:
    """Return the commands that `map info|check FILE` stands for."""
    choice = re.search(r"\S+\|\S+", command)
    return [command.replace(choice[0], one) for one in choice[0].split("|")] if choice else [command]


@each_page
def test_commands_exist_with_their_options(page: Page, folder_for: Folder) -> None:
    folder_for(page)
    for shown, whole in commands_of(page.text):
        for command in alternatives(shown):
            values = parse(command, whole)
            if command.split()[1] in ("run", "show-config", "inpaint", "bench"):
                several = values.get("methods") if values.get("methods") != "all" else None
                names = several.split(",") if isinstance(several, str) else [values.get("method")]
                for name in names:
                    configure(name, values.get("config"), values.get("settings") or ())


@each_page
def test_toml_blocks_load(page: Page, folder_for: Folder) -> None:
    folder = folder_for(page)
    for block in page.of("toml"):
        values = tomllib.loads(block.text)
        file = folder / "block.toml"
        file.write_text(block.text, encoding="utf-8")
        if "project" in values:
            load_entry_points(values["project"]["entry-points"], folder)
        elif set(REQUIRED) & values.keys():
            read_camera(file)
        elif "sequences" in values:
            check_backend(grid := read_grid(file))
            assert plan(grid).runs
        else:
            configure(file=file)


def load_entry_points(groups: dict[str, dict[str, str]], folder: Path) -> None:
    for group, entries in groups.items():
        assert group in GROUPS, f"{group}: Stillroom reads no such group"
        for name, value in entries.items():
            if (folder / f"{value.partition(':')[0]}.py").is_file():
                GROUPS[group].load(EntryPoint(name, value, group))


# The tests above can fail: each kind of fault is found.


def test_blocks_are_found_with_their_lines_and_titles() -> None:
    text = 'a\n```python title="x.py"\nimport x\n```\n\n```\nstillroom methods   # lists\n```\n'
    text += "    stillroom run A \\\n        --fps 3\nSee `stillroom\nexport A`.\n"
    assert blocks_of(text)[0] == Block(3, "python", "x.py", "import x\n")
    assert [*commands_of(text)] == [
        ("stillroom methods", True),
        ("stillroom run A --fps 3", True),
        ("stillroom export A", False),
    ]


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("stillroom fly", "No such command"),
        ("stillroom run A --fast", "No such option"),
        ("stillroom map burn A", "No such command"),
        ("stillroom run", "Missing"),
        ("stillroom run A --fps fast", "Invalid value"),
    ],
)
def test_a_wrong_command_is_found(command: str, said: str) -> None:
    with pytest.raises(AssertionError, match=said):
        parse(command, whole=True)


def test_a_mention_needs_no_arguments_but_its_options_must_exist() -> None:
    parse("stillroom run", whole=False)
    with pytest.raises(AssertionError, match="No such option"):
        parse("stillroom run --fast", whole=False)


def test_a_page_s_faults_are_told_by_its_line(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("one\n\n```python\n1\n1 / 0\n```\n")

    class Other(Page):
        name = "page.md"

    with pytest.raises(ZeroDivisionError) as caught:
        execute(Other(tmp_path / "page.md"))
    assert caught.traceback[-1].lineno + 1 == 5
