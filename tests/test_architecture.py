"""The house rules of docs/conventions.md, read from the source without running it."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "stillroom"

LEVELS = {
    "geometry": 0,
    "data": 1,
    "protocols": 2,
    "schedule": 2,
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
    "config": 5,
    "download": 5,
    "training": 5,
    "system": 6,
    "methods": 7,
    "pipeline": 8,
    "warmup": 8,
    "testing": 8,
    "benchmark": 9,
    "cli": 10,
}
FREE_TO_ALL = {"errors", "__init__"}
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_FOLDER_FILES = 10
BANNED_NAMES = {"utils", "helpers", "common", "misc"}
HEAVY = {"onnxruntime", "onnx", "rerun", "torch", "matplotlib", "rosbags", "pyrealsense2"}
PRINTING_ROOMS = {"cli"}

FILES = sorted(SOURCE.rglob("*.py"))


def room_of(path: Path) -> str:
    relative = path.relative_to(SOURCE)
    return relative.parts[0].removesuffix(".py")


def imported_modules(tree: ast.AST) -> list[str]:
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide the room"
            names.append(node.module or "")
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def internal_rooms(path: Path) -> set[str]:
    rooms = set()
    for name in imported_modules(parse(path)):
        parts = name.split(".")
        if parts[0] == "stillroom" and len(parts) > 1:
            room = parts[1]
            if room in LEVELS or room in FREE_TO_ALL:
                rooms.add(room)
            else:
                assert room == "__version__", f"{path}: imports the unknown room {name}"
    return rooms


def ids(path: Path) -> str:
    return str(path.relative_to(SOURCE))


@pytest.mark.parametrize("path", FILES, ids=ids)
def test_a_room_imports_only_lower_rooms(path: Path) -> None:
    own = room_of(path)
    if own in FREE_TO_ALL:
        assert not internal_rooms(path) - FREE_TO_ALL
        return
    assert own in LEVELS, f"{path}: the room {own} has no level"
    for room in internal_rooms(path) - FREE_TO_ALL - {own}:
        assert LEVELS[room] < LEVELS[own], f"{ids(path)} ({own}, {LEVELS[own]}) imports {room} ({LEVELS[room]})"


@pytest.mark.parametrize("path", FILES, ids=ids)
def test_files_and_functions_stay_small(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").count("\n")
    assert lines <= MAX_FILE_LINES, f"{ids(path)} has {lines} lines"
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = (node.end_lineno or node.lineno) - node.lineno + 1
            assert length <= MAX_FUNCTION_LINES, f"{ids(path)}: {node.name} has {length} lines"


def test_folders_stay_small_and_names_say_something() -> None:
    for folder in [SOURCE, *[p for p in SOURCE.rglob("*") if p.is_dir() and p.name != "__pycache__"]]:
        files = [p for p in folder.glob("*.py") if p.name != "__init__.py"]
        assert len(files) <= MAX_FOLDER_FILES, f"{folder} has {len(files)} files"
    for path in FILES:
        assert path.stem not in BANNED_NAMES, f"{ids(path)}: a name that says nothing"


@pytest.mark.parametrize("path", FILES, ids=ids)
def test_heavy_libraries_are_imported_where_they_are_used(path: Path) -> None:
    for node in parse(path).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            for name in imported_modules(ast.Module(body=[node], type_ignores=[])):
                assert name.split(".")[0] not in HEAVY, f"{ids(path)} imports {name} at the top"


@pytest.mark.parametrize("path", FILES, ids=ids)
def test_no_print_exit_or_broad_except_outside_the_command_line(path: Path) -> None:
    if room_of(path) in PRINTING_ROOMS:
        return
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in {"print", "exit", "quit"}, f"{ids(path)}:{node.lineno}: {node.func.id}"
        if isinstance(node, ast.ExceptHandler):
            broad = node.type is None or (
                isinstance(node.type, ast.Name) and node.type.id in {"Exception", "BaseException"}
            )
            reraises = any(isinstance(inner, ast.Raise) for inner in ast.walk(node))
            assert not broad or reraises, f"{ids(path)}:{node.lineno}: a broad except that swallows"


def _module_name(path: Path) -> str:
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return ".".join(("stillroom", *parts)).removesuffix(".__init__")


def _edges() -> dict[str, set[str]]:
    """Return which module imports which. `from package import module` is an import of the module alone."""
    modules = {_module_name(path) for path in FILES}
    graph: dict[str, set[str]] = {}
    for path in FILES:
        targets = set()
        for node in ast.walk(parse(path)):
            if isinstance(node, ast.Import):
                targets |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                named = {f"{node.module}.{alias.name}" for alias in node.names}
                targets |= {name if name in modules else str(node.module) for name in named}
        graph[_module_name(path)] = (targets & modules) - {_module_name(path)}
    return graph


def test_no_import_cycles() -> None:
    graph = _edges()
    done: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " → ".join((*trail[trail.index(module) :], module))
        if module in done:
            return
        for name in sorted(graph[module]):
            visit(name, (*trail, module))
        done.add(module)

    for module in graph:
        visit(module, ())
