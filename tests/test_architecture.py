"""The rules of docs/conventions.md, read from the source without running it, and proof that each rule bites.

A rule takes a source root, the folder that holds the packages, and returns its violations, one line each:
"stillroom/geometry/rays.py:12: …".
"""

import ast
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
from longest_first import LONGEST_FIRST

SOURCE = Path(__file__).parents[1] / "src"

LEVELS = {
    "geometry": 0,
    "schedule": 0,
    "data": 1,
    "protocols": 2,
    "plugins": 2,
    "features": 3,
    "optimize": 3,
    "datasets": 4,
    "semantics": 4,
    "dynamics": 4,
    "tracking": 4,
    "mapping": 4,
    "loops": 4,
    "dense": 4,
    "storage": 4,
    "evaluation": 4,
    "viz": 4,
    "cameras": 5,
    "config": 5,
    "download": 5,
    "system": 6,
    "presets": 7,
    "session": 8,
    "pipeline": 9,
    "warmup": 9,
    "testing": 9,
    "bench": 10,
    "cli": 11,
}
FREE_TO_ALL = {"bounds", "compiled", "errors", "stopping", "version", "__init__"}
LOOKS_BELOW = {"compiled": 2}
"""What is free to all looks into no room, but for these, which may look into rooms below this level: machine code is
kept in the cache folder, of which `data` knows."""
ROOT_ATTRIBUTES = {"__version__"}
"""What the root of a package offers beside its rooms."""

MAX_FILE_LINES = 450
MAX_FUNCTION_LINES = 60
BANNED_NAMES = {"utils", "helpers", "common", "misc"}
HEAVY = {"onnxruntime", "onnx", "rerun", "torch", "matplotlib", "bokeh", "rosbags", "pyrealsense2", "depthai", "scipy"}
HEAVY |= {"joblib", "dask", "distributed"}
DECORATORS = {"jit", "njit", "vectorize", "guvectorize", "stencil", "cfunc"}
KERNELS_ARE_DECORATED_IN = "stillroom/compiled.py"
PRINTING_ROOMS = {"cli"}
PRINTS_AND_EXITS = {"print", "exit", "quit", "sys.exit"}
BROAD = {"Exception", "BaseException"}


@dataclass(frozen=True)
class Package:
    """Levels of a package's rooms, None where they are in no order, and the other packages that it may import."""

    levels: Mapping[str, int] | None
    may_import: frozenset[str]

    def has_room(self, room: str) -> bool:
        return self.levels is None or room in self.levels or room in FREE_TO_ALL


PACKAGES = {
    "stillroom": Package(LEVELS, frozenset()),
    "stillroom_scenes": Package(None, frozenset({"stillroom"})),
    "stillroom_train": Package(None, frozenset({"stillroom"})),
}


@dataclass(frozen=True)
class Import:
    """One imported name: `from module import member`, or `import module` where member is empty."""

    line: int
    module: str
    member: str
    is_relative: bool

    @property
    def name(self) -> str:
        return f"{self.module}.{self.member}" if self.member else self.module

    @property
    def package(self) -> str:
        return "" if self.is_relative else self.name.split(".")[0]

    @property
    def room(self) -> str:
        """Room of the package that this imports from, empty where it is the package alone."""
        parts = self.name.split(".")
        return parts[1] if len(parts) > 1 and parts[1] not in ROOT_ATTRIBUTES else ""


@dataclass(frozen=True, eq=False)
class Module:
    """One source file, parsed."""

    path: str
    line_count: int
    tree: ast.Module
    nodes: tuple[ast.AST, ...]
    imports: tuple[Import, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Package, folders and file, the latter without its suffix."""
        return tuple(self.path.removesuffix(".py").split("/"))

    @property
    def dotted(self) -> str:
        return ".".join(self.names).removesuffix(".__init__")

    @property
    def package(self) -> str:
        return self.names[0]

    @property
    def room(self) -> str:
        return self.names[1]


def imports_of(node: ast.AST) -> list[Import]:
    if isinstance(node, ast.Import):
        return [Import(node.lineno, alias.name, "", False) for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [Import(node.lineno, node.module or "", alias.name, node.level > 0) for alias in node.names]
    return []


@cache
def modules(source: Path) -> tuple[Module, ...]:
    """Return every module of the known packages below `source`, parsed once."""
    found = []
    for path in sorted(path for package in PACKAGES for path in (source / package).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text, filename=str(path))
        nodes = tuple(ast.walk(tree))
        imports = tuple(found_import for node in nodes for found_import in imports_of(node))
        found.append(Module(path.relative_to(source).as_posix(), len(text.splitlines()), tree, nodes, imports))
    return tuple(found)


def house_imports(source: Path) -> Iterator[tuple[Module, Import]]:
    """Yield the imports of a package under src, with the module that holds them."""
    for module in modules(source):
        for found in module.imports:
            if found.package in PACKAGES:
                yield module, found


def once(violations: list[str]) -> list[str]:
    """Return the violations without repeats: `from a import b, c` is two imports of one room."""
    return list(dict.fromkeys(violations))


# The rules.


def unknown_rooms(source: Path) -> list[str]:
    packages = sorted({path.relative_to(source).parts[0] for path in source.rglob("*.py")} - set(PACKAGES))
    homeless = [
        f"{module.path}:1: the room {module.room} has no level"
        for module in modules(source)
        if not PACKAGES[module.package].has_room(module.room)
    ]
    imported = [
        f"{module.path}:{found.line}: imports the unknown room {found.package}.{found.room}"
        for module, found in house_imports(source)
        if found.room and not PACKAGES[found.package].has_room(found.room)
    ]
    return once([f"{name}: not in PACKAGES" for name in packages] + homeless + imported)


def imports_of_rooms_that_are_not_lower(source: Path) -> list[str]:
    violations = []
    for module, found in house_imports(source):
        levels = PACKAGES[module.package].levels
        if levels is None or found.package != module.package or found.room == module.room or found.room not in levels:
            continue
        # Below every room stands what is free to all; a room without a level is a violation of its own.
        own = LOOKS_BELOW.get(module.room, -1) if module.room in FREE_TO_ALL else levels.get(module.room)
        if own is not None and levels[found.room] >= own:
            violations.append(
                f"{module.path}:{found.line}: {module.room} ({own}) imports {found.room} ({levels[found.room]})"
            )
    return once(violations)


def imports_across_packages(source: Path) -> list[str]:
    return once(
        [
            f"{module.path}:{found.line}: {module.package} imports {found.package}"
            for module, found in house_imports(source)
            if found.package != module.package and found.package not in PACKAGES[module.package].may_import
        ]
    )


def relative_imports(source: Path) -> list[str]:
    return once(
        [
            f"{module.path}:{found.line}: a relative import hides the room"
            for module in modules(source)
            for found in module.imports
            if found.is_relative
        ]
    )


def import_cycles(source: Path) -> list[str]:
    """Return each import that closes a cycle. `from package import module` is an import of the module alone."""
    paths = {module.dotted: module.path for module in modules(source)}
    graph: dict[str, dict[str, int]] = {name: {} for name in paths}
    for module, found in house_imports(source):
        target = found.name if found.name in paths else found.module
        if target in paths and target != module.dotted:
            graph[module.dotted].setdefault(target, found.line)
    violations = []
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        trail = (*trail, name)
        for target, line in sorted(graph[name].items()):
            if target in trail:
                cycle = " → ".join((*trail[trail.index(target) :], target))
                violations.append(f"{paths[name]}:{line}: import cycle {cycle}")
            elif target not in done:
                visit(target, trail)
        done.add(name)

    for name in sorted(graph):
        if name not in done:
            visit(name, ())
    return violations


def run_on_import(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what is below `node` and runs when the module is imported: no function, nothing for type checkers alone."""
    below = list(ast.iter_child_nodes(node))
    if isinstance(node, ast.If) and ast.unparse(node.test) in {"TYPE_CHECKING", "typing.TYPE_CHECKING"}:
        below = list(node.orelse)
    for child in below:
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield child
            yield from run_on_import(child)


def heavy_imports_at_the_top(source: Path) -> list[str]:
    return once(
        [
            f"{module.path}:{found.line}: imports {found.package} at the top"
            for module in modules(source)
            for node in run_on_import(module.tree)
            for found in imports_of(node)
            if found.package in HEAVY
        ]
    )


def kernels_cached_elsewhere(source: Path) -> list[str]:
    """Return what decorates with numba itself: its machine code would lie beside the sources, or nowhere."""
    named = [
        f"{module.path}:{found.line}: numba's {found.member} instead of stillroom.compiled's"
        for module in modules(source)
        for found in module.imports
        if found.package == "numba" and found.member in DECORATORS
    ]
    return named + [
        f"{module.path}:{node.lineno}: numba's {node.attr} instead of stillroom.compiled's"
        for module in modules(source)
        if module.path != KERNELS_ARE_DECORATED_IN
        for node in module.nodes
        if isinstance(node, ast.Attribute) and node.attr in DECORATORS and ast.unparse(node.value) == "numba"
    ]


def prints_and_exits(source: Path) -> list[str]:
    return [
        f"{module.path}:{node.lineno}: {ast.unparse(node.func)}() outside the command line"
        for module in modules(source)
        if module.room not in PRINTING_ROOMS
        for node in module.nodes
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name | ast.Attribute)
        and ast.unparse(node.func) in PRINTS_AND_EXITS
    ]


def swallowed_exceptions(source: Path) -> list[str]:
    def is_broad(handler: ast.ExceptHandler) -> bool:
        caught = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
        return any(kind is None or (isinstance(kind, ast.Name) and kind.id in BROAD) for kind in caught)

    return [
        f"{module.path}:{node.lineno}: a broad except that swallows"
        for module in modules(source)
        if module.room not in PRINTING_ROOMS
        for node in module.nodes
        if isinstance(node, ast.ExceptHandler)
        and is_broad(node)
        and not any(isinstance(inner, ast.Raise) for inner in ast.walk(node))
    ]


def long_files(source: Path) -> list[str]:
    return [
        f"{module.path}:{module.line_count}: the file has more than {MAX_FILE_LINES} lines"
        for module in modules(source)
        if module.line_count > MAX_FILE_LINES
    ]


def long_functions(source: Path) -> list[str]:
    return [
        f"{module.path}:{node.lineno}: {node.name} has {length} lines, more than {MAX_FUNCTION_LINES}"
        for module in modules(source)
        for node in module.nodes
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (length := (node.end_lineno or node.lineno) - node.lineno + 1) > MAX_FUNCTION_LINES
    ]


def bad_names(source: Path) -> list[str]:
    """Return the modules and folders whose name says nothing, or says that they are a test."""
    violations = []
    for module in modules(source):
        for name in module.names[1:]:
            if name in BANNED_NAMES:
                violations.append(f"{module.path}:1: {name} is a name that says nothing")
            if name.startswith("test_") or name.endswith("_test"):
                violations.append(f"{module.path}:1: {name} is the name of a test")
    return violations


Rule = Callable[[Path], list[str]]
RULES: list[Rule] = [
    unknown_rooms,
    imports_of_rooms_that_are_not_lower,
    imports_across_packages,
    relative_imports,
    import_cycles,
    heavy_imports_at_the_top,
    kernels_cached_elsewhere,
    prints_and_exits,
    swallowed_exceptions,
    long_files,
    long_functions,
    bad_names,
]


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_source_keeps_the_rule(rule: Rule) -> None:
    violations = rule(SOURCE)
    assert not violations, "\n".join(violations)


def test_every_room_with_a_level_is_there_to_be_judged() -> None:
    missing = set(LEVELS) - {module.room for module in modules(SOURCE) if module.package == "stillroom"}
    assert not missing, f"rooms with a level but without a file: {sorted(missing)}"


def test_the_quick_run_names_tests_that_are_there() -> None:
    """A path that is left out may have moved, and nobody would hear of it."""
    root = Path(__file__).parents[1]
    text = (root / "scripts" / "test").read_text(encoding="utf-8")
    named = re.findall(r"tests/[\w/.]+", text[text.index("QUICK=(") : text.index("\n)\n")])
    assert len(named) > 20
    assert [path for path in named if not (root / path).exists()] == []


CLOCKS = {"time", "perf_counter", "monotonic", "process_time", "thread_time"}


def clocks_read(folder: Path) -> list[str]:
    """Return where a clock is read: what a test says of time depends on what else the machine does."""
    return [
        f"{path.relative_to(folder).as_posix()}:{node.lineno}: reads {ast.unparse(node.func)}"
        for path in sorted(folder.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr.removesuffix("_ns") in CLOCKS
        and ast.unparse(node.func.value) == "time"
    ]


def test_files_that_are_begun_first_are_there() -> None:
    assert [name for name in LONGEST_FIRST if not (Path(__file__).parent / name).is_file()] == []


def test_no_test_reads_a_clock() -> None:
    violations = clocks_read(Path(__file__).parent)
    assert not violations, "\n".join(violations)


def test_a_test_that_reads_a_clock_is_found(tmp_path: Path) -> None:
    write(tmp_path, {"cli/test_run.py": "import time\nclock = time.monotonic\nassert time.thread_time_ns() < 3\n"})
    assert clocks_read(tmp_path) == ["cli/test_run.py:3: reads time.thread_time_ns"]


# The proof: each small faulty tree breaks one rule once and no other; a fine tree breaks none.


def long_function(line_count: int) -> str:
    return "def long():\n" + "    pass\n" * (line_count - 1)


SWALLOWED = "try:\n    pass\nexcept {}:\n    pass\n"

# Name: the rule, the files, what the rule says.
FAULTS: dict[str, tuple[Rule, dict[str, str], str]] = {
    "room without a level": (
        unknown_rooms,
        {"stillroom/attic/box.py": ""},
        "stillroom/attic/box.py:1: the room attic has no level",
    ),
    "import of an unknown room": (
        unknown_rooms,
        {"stillroom/cli/run.py": "import os\nfrom stillroom.attic import box, chest\n"},
        "stillroom/cli/run.py:2: imports the unknown room stillroom.attic",
    ),
    "unknown room from another package": (
        unknown_rooms,
        {"stillroom_train/losses.py": "from stillroom import attic\n"},
        "stillroom_train/losses.py:1: imports the unknown room stillroom.attic",
    ),
    "unknown package": (
        unknown_rooms,
        {"stillroom_attic/box.py": ""},
        "stillroom_attic: not in PACKAGES",
    ),
    "upward import": (
        imports_of_rooms_that_are_not_lower,
        {"stillroom/geometry/rays.py": "def f():\n    from stillroom.system import Slam, SlamConfig\n"},
        "stillroom/geometry/rays.py:2: geometry (0) imports system (6)",
    ),
    "upward import by the root": (
        imports_of_rooms_that_are_not_lower,
        {"stillroom/tracking/pose.py": "from stillroom import presets\n"},
        "stillroom/tracking/pose.py:1: tracking (4) imports presets (7)",
    ),
    "import of a room of one's own level": (
        imports_of_rooms_that_are_not_lower,
        {"stillroom/tracking/pose.py": "import stillroom.mapping.map\n"},
        "stillroom/tracking/pose.py:1: tracking (4) imports mapping (4)",
    ),
    "import of a room that is too high by what may look below": (
        imports_of_rooms_that_are_not_lower,
        {"stillroom/compiled.py": "from stillroom.features import orb\n"},
        "stillroom/compiled.py:1: compiled (2) imports features (3)",
    ),
    "import of a room by what is free to all": (
        imports_of_rooms_that_are_not_lower,
        {"stillroom/errors.py": "from stillroom.geometry import rays\n"},
        "stillroom/errors.py:1: errors (-1) imports geometry (0)",
    ),
    "core imports the scenes": (
        imports_across_packages,
        {"stillroom/cli/run.py": "from stillroom_scenes.people import body\n"},
        "stillroom/cli/run.py:1: stillroom imports stillroom_scenes",
    ),
    "core imports the training": (
        imports_across_packages,
        {"stillroom/__init__.py": "import stillroom_train\n"},
        "stillroom/__init__.py:1: stillroom imports stillroom_train",
    ),
    "training imports the scenes": (
        imports_across_packages,
        {"stillroom_train/images.py": "from stillroom_scenes import rooms\n"},
        "stillroom_train/images.py:1: stillroom_train imports stillroom_scenes",
    ),
    "relative import": (
        relative_imports,
        {"stillroom/data/frame.py": "from ..system import Slam\n"},
        "stillroom/data/frame.py:1: a relative import hides the room",
    ),
    "relative import without a module": (
        relative_imports,
        {"stillroom_scenes/rooms.py": "from . import people\n"},
        "stillroom_scenes/rooms.py:1: a relative import hides the room",
    ),
    "cycle of two": (
        import_cycles,
        {
            "stillroom/data/frame.py": "from stillroom.data.map import Map\n",
            "stillroom/data/map.py": "import math\nfrom stillroom.data import frame\n",
        },
        "stillroom/data/map.py:2: import cycle stillroom.data.frame → stillroom.data.map → stillroom.data.frame",
    ),
    "cycle through a package's root": (
        import_cycles,
        {
            "stillroom_scenes/people/__init__.py": "from stillroom_scenes.people.body import Body\n",
            "stillroom_scenes/people/body.py": "def f():\n    from stillroom_scenes.rooms import Room\n",
            "stillroom_scenes/rooms.py": "from stillroom_scenes.people import Body\n",
        },
        "stillroom_scenes/rooms.py:1: import cycle stillroom_scenes.people → stillroom_scenes.people.body → "
        "stillroom_scenes.rooms → stillroom_scenes.people",
    ),
    "heavy import": (
        heavy_imports_at_the_top,
        {"stillroom/viz/plots.py": "import math\nimport matplotlib.pyplot as plt\n"},
        "stillroom/viz/plots.py:2: imports matplotlib at the top",
    ),
    "heavy import below try and class": (
        heavy_imports_at_the_top,
        {"stillroom_train/losses.py": "try:\n    class A:\n        from torch import nn\nfinally:\n    pass\n"},
        "stillroom_train/losses.py:3: imports torch at the top",
    ),
    "numba's decorator": (
        kernels_cached_elsewhere,
        {"stillroom/geometry/rays.py": "from numba import njit, types\n"},
        "stillroom/geometry/rays.py:1: numba's njit instead of stillroom.compiled's",
    ),
    "numba's decorator by its module": (
        kernels_cached_elsewhere,
        {"stillroom_scenes/rooms.py": "import numba\n@numba.njit(cache=True)\ndef f():\n    pass\n"},
        "stillroom_scenes/rooms.py:2: numba's njit instead of stillroom.compiled's",
    ),
    "print": (
        prints_and_exits,
        {"stillroom/data/frame.py": "def f():\n    print(1)\n"},
        "stillroom/data/frame.py:2: print() outside the command line",
    ),
    "exit": (
        prints_and_exits,
        {"stillroom/data/frame.py": "exit(1)\n"},
        "stillroom/data/frame.py:1: exit() outside the command line",
    ),
    "quit": (
        prints_and_exits,
        {"stillroom/data/frame.py": "quit()\n"},
        "stillroom/data/frame.py:1: quit() outside the command line",
    ),
    "sys.exit": (
        prints_and_exits,
        {"stillroom_train/losses.py": "import sys\nsys.exit(1)\n"},
        "stillroom_train/losses.py:2: sys.exit() outside the command line",
    ),
    "broad except": (
        swallowed_exceptions,
        {"stillroom/data/frame.py": SWALLOWED.format("Exception")},
        "stillroom/data/frame.py:3: a broad except that swallows",
    ),
    "broad except among others": (
        swallowed_exceptions,
        {"stillroom/data/frame.py": SWALLOWED.format("(OSError, BaseException) as error")},
        "stillroom/data/frame.py:3: a broad except that swallows",
    ),
    "bare except": (
        swallowed_exceptions,
        {"stillroom/data/frame.py": SWALLOWED.format("").replace("except :", "except:")},
        "stillroom/data/frame.py:3: a broad except that swallows",
    ),
    "long file": (
        long_files,
        {"stillroom/data/frame.py": "\n" * 451},
        "stillroom/data/frame.py:451: the file has more than 450 lines",
    ),
    "long function": (
        long_functions,
        {"stillroom/data/frame.py": "\n" + long_function(61)},
        "stillroom/data/frame.py:2: long has 61 lines, more than 60",
    ),
    "long method": (
        long_functions,
        {"stillroom/data/frame.py": "class A:\n    async def long(self):\n" + "        pass\n" * 60},
        "stillroom/data/frame.py:2: long has 61 lines, more than 60",
    ),
    "banned name": (
        bad_names,
        {"stillroom/data/helpers.py": ""},
        "stillroom/data/helpers.py:1: helpers is a name that says nothing",
    ),
    "banned name of a folder": (
        bad_names,
        {"stillroom_train/utils/losses.py": ""},
        "stillroom_train/utils/losses.py:1: utils is a name that says nothing",
    ),
    "name that starts as a test": (
        bad_names,
        {"stillroom/data/test_frame.py": ""},
        "stillroom/data/test_frame.py:1: test_frame is the name of a test",
    ),
    "name that ends as a test": (
        bad_names,
        {"stillroom/dynamics/point_test.py": ""},
        "stillroom/dynamics/point_test.py:1: point_test is the name of a test",
    ),
}

FINE = {
    "stillroom/__init__.py": '__version__ = "1"\n',
    "stillroom/errors.py": "from stillroom import __version__\n",
    "stillroom/geometry/rays.py": "from stillroom.errors import StillroomError\n",
    "stillroom/compiled.py": "import numba\nfrom stillroom.data.frame import ray\nnjit = numba.njit\n",
    "stillroom/data/__init__.py": "",
    "stillroom/data/frame.py": "from stillroom.data import map\nfrom stillroom.geometry.rays import ray\n",
    "stillroom/data/map.py": "\n" * (450 - 60) + long_function(60),
    "stillroom/viz/plots.py": (
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import torch\n"
        "def f():\n    import matplotlib\n    console.print(1)\n"
    ),
    "stillroom/tracking/contest.py": SWALLOWED.format("OSError"),
    "stillroom/system.py": "try:\n    pass\nexcept Exception as error:\n    raise ValueError from error\n",
    "stillroom/testing/testers.py": "",
    "stillroom/cli/main.py": "import sys\nprint(1)\nsys.exit(1)\n" + SWALLOWED.format("Exception"),
    **{f"stillroom/datasets/format_{i}.py": "" for i in range(20)},
    "stillroom_scenes/cli.py": "from stillroom_scenes import rooms\nprint(1)\n",
    "stillroom_scenes/rooms.py": "import stillroom.system\nfrom stillroom.cli.main import main\n",
    "stillroom_train/losses.py": "import stillroom\nfrom stillroom.errors import StillroomError\n",
}


def write(root: Path, files: Mapping[str, str]) -> None:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def reports(source: Path) -> dict[str, list[str]]:
    """Return what each rule that found something has found."""
    return {rule.__name__: violations for rule in RULES if (violations := rule(source))}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_reported_by_its_rule_alone(fault: str, tmp_path: Path) -> None:
    rule, files, violation = FAULTS[fault]
    write(tmp_path, files)
    assert reports(tmp_path) == {rule.__name__: [violation]}


def test_every_rule_has_a_fault() -> None:
    assert {rule for rule, _, _ in FAULTS.values()} == set(RULES)


def test_a_fine_tree_gives_nothing(tmp_path: Path) -> None:
    write(tmp_path, FINE)
    assert reports(tmp_path) == {}
