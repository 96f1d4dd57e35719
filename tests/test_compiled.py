"""Where kernels are kept, that nothing else in the process is touched, and what happens where nothing can be kept.

Each case is a process of its own, with a kernel of one line or with a small one of the project.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from stillroom import __version__

KERNEL = """
from stillroom.compiled import is_kept, kernel_cache, njit

@njit(cache=True)
def plus_one(x):
    return x + 1

assert plus_one(1) == 2
print(sum(plus_one.stats.cache_hits.values()), sum(plus_one.stats.cache_misses.values()), plus_one.stats.cache_path)
print(is_kept(), kernel_cache())
"""
LOCKED = """
import os, pathlib, tempfile
real, locked = tempfile.TemporaryFile, pathlib.Path(os.environ["LOCKED"])
def refused(*arguments, dir=None, **options):
    if dir is not None and locked in (pathlib.Path(dir), *pathlib.Path(dir).parents):
        raise PermissionError(13, "Permission denied")
    return real(*arguments, dir=dir, **options)
tempfile.TemporaryFile = refused
import runpy, sys
runpy.run_path(sys.argv[1])
"""
"""The folder as somebody finds it who may not write there, whoever runs this test: root may write everywhere."""
PROJECT_KERNEL = """
import numpy as np
from stillroom.geometry.pixels import grow_runs as kernel
kernel(np.eye(4, dtype=np.uint8), np.array([0, 1, 0]), np.zeros((4, 4), np.uint8))
print(sum(kernel.stats.cache_hits.values()), sum(kernel.stats.cache_misses.values()), kernel.stats.cache_path)
"""


def process(*arguments: str, without: tuple[str, ...] = (), **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a Python that has no cache folder but the one that `variables` name, and must end well."""
    environment = {name: value for name, value in os.environ.items() if name not in {"NUMBA_CACHE_DIR", *without}}
    done = subprocess.run(
        [sys.executable, *arguments], env=environment | variables, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done


def answer(*arguments: str, **variables: str) -> list[str]:
    """Return the words that it prints."""
    return process(*arguments, **variables).stdout.split()


@pytest.fixture
def program(tmp_path: Path) -> str:
    """The file of a kernel: numba caches only what is in a file."""
    (tmp_path / "sources").mkdir()
    path = tmp_path / "sources" / "program.py"
    path.write_text(KERNEL, encoding="utf-8")
    return str(path)


def home(cache: Path) -> Path:
    return cache / "stillroom" / "numba" / __version__


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_second_process_loads_what_the_first_has_compiled(tmp_path: Path) -> None:
    first = answer("-c", PROJECT_KERNEL, XDG_CACHE_HOME=str(tmp_path))
    assert first[:2] == ["0", "1"]
    assert Path(first[2]).parent == home(tmp_path)
    assert list(home(tmp_path).rglob("*.nbi"))
    assert list(home(tmp_path).rglob("*.nbc"))
    second = answer("-c", PROJECT_KERNEL, XDG_CACHE_HOME=str(tmp_path))
    assert second[:2] == ["1", "0"]


@pytest.mark.parametrize("way", ["variable", "setting"])
def test_a_cache_folder_of_the_users_own_is_kept_to(way: str, program: str, tmp_path: Path) -> None:
    own, variables = tmp_path / "own", {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    if way == "variable":
        place = answer(program, NUMBA_CACHE_DIR=str(own), **variables)
    else:
        code = f"import numba, runpy; numba.config.CACHE_DIR = {str(own)!r}; runpy.run_path({program!r})"
        place = answer("-c", code, **variables)
    assert Path(place[2]).parent == own
    assert place[3:] == ["True", str(own)]
    assert not (tmp_path / "cache").exists()


def test_functions_of_others_and_the_process_stay_as_they_were(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "import os\n"
        "before = dict(os.environ)\n"
        "import numba\n"
        "setting = numba.config.CACHE_DIR\n"
        "@numba.njit(cache=True)\n"
        "def earlier(x): return x + 1\n"
        "import stillroom.features.matching\n"
        "@numba.njit(cache=True)\n"
        "def later(x): return x + 1\n"
        "assert dict(os.environ) == before\n"
        "assert numba.config.CACHE_DIR == setting\n"
        "print(earlier.stats.cache_path, later.stats.cache_path)\n",
        encoding="utf-8",
    )
    places = answer(str(file), XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert places == [str(tmp_path / "__pycache__")] * 2


def test_what_fails_to_be_decorated_leaves_the_setting_as_it_was(tmp_path: Path) -> None:
    code = (
        "import numba\n"
        "from stillroom.compiled import njit\n"
        "try:\n"
        "    njit(cache=True)(3)\n"
        "except TypeError:\n"
        "    print(repr(numba.config.CACHE_DIR))\n"
    )
    assert answer("-c", code, XDG_CACHE_HOME=str(tmp_path)) == ["''"]


def test_it_takes_what_numbas_takes() -> None:
    code = (
        "from stillroom.compiled import njit\n"
        "def f(x): return x + 1\n"
        "kernels = [njit(f), njit()(f), njit(nogil=True)(f), njit('int64(int64)')(f), njit(f, nogil=True)]\n"
        "print([kernel(1) for kernel in kernels], [kernel.targetoptions.get('nogil') for kernel in kernels])\n"
        "print(len(kernels[3].signatures), all(kernel.targetoptions['nopython'] for kernel in kernels))\n"
    )
    # Numba itself notes that it was called without options by leaving them out.
    assert " ".join(answer("-c", code)) == "[2, 2, 2, 2, 2] [None, None, True, None, True] 1 True"


def test_a_child_process_loads_what_its_parent_has_compiled(program: str, tmp_path: Path) -> None:
    parent = Path(program).with_name("parent.py")
    parent.write_text(
        "import importlib, multiprocessing, subprocess, sys\n"
        "if __name__ == '__main__':\n"
        "    import program\n"
        "    sys.stdout.flush()\n"
        "    subprocess.run([sys.executable, '-c', 'import program'], cwd=sys.path[0], check=True)\n"
        "    child = multiprocessing.get_context('spawn').Process(target=importlib.import_module, args=('program',))\n"
        "    child.start()\n"
        "    child.join()\n"
        "    sys.exit(child.exitcode)\n",
        encoding="utf-8",
    )
    words = answer(str(parent), XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert [words[at : at + 2] for at in (0, 5, 10)] == [["0", "1"], ["1", "0"], ["1", "0"]]


@pytest.mark.parametrize("obstacle", ["a file in the way", "no home folder"])
def test_where_nothing_can_be_kept_kernels_are_compiled_and_one_line_says_so(
    obstacle: str, program: str, tmp_path: Path
) -> None:
    (tmp_path / "cache").touch()
    (tmp_path / "scratch").mkdir()
    variables = {"TMPDIR": str(tmp_path / "scratch")}
    if obstacle == "a file in the way":
        done = process(program, XDG_CACHE_HOME=str(tmp_path / "cache"), **variables)
    else:
        # As with the number of a user whom the system does not know, in a container.
        code = (
            "import os, pwd, runpy\n"
            "def unknown(number): raise KeyError(number)\n"
            "pwd.getpwuid = unknown\n"
            f"os.chdir({str(tmp_path / 'sources')!r})\n"
            f"runpy.run_path({program!r})\n"
        )
        done = process("-c", code, without=("HOME", "XDG_CACHE_HOME"), **variables)
        assert [path.name for path in (tmp_path / "sources").iterdir()] == ["program.py"]
    hits, misses, place, is_kept, *_ = done.stdout.split()
    assert (hits, misses, is_kept) == ("0", "1", "False")
    assert Path(place).is_relative_to(tmp_path / "scratch")
    assert len(done.stderr.splitlines()) == 1
    assert {"a file in the way": "cannot be written", "no home folder": "no home folder"}[obstacle] in done.stderr
    assert list((tmp_path / "scratch").iterdir()) == [], "the temporary folder outlived the process"


def test_without_even_a_temporary_folder_kernels_are_compiled(program: str, tmp_path: Path) -> None:
    (tmp_path / "cache").touch()
    code = (
        "import runpy, tempfile\n"
        "def refused(*_, **__): raise OSError('no')\n"
        "tempfile.mkdtemp = refused\n"
        f"runpy.run_path({program!r})\n"
    )
    done = process("-c", code, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert done.stdout.split()[:4] == ["0", "1", "None", "False"]
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="Windows gives folders other permissions")
def test_a_full_cache_that_cannot_be_written_is_read_and_stays_as_it_is(program: str, tmp_path: Path) -> None:
    variables = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    answer(program, **variables)
    before, folder = contents(home(tmp_path / "cache")), home(tmp_path / "cache")
    folder.chmod(0o555)
    done = process("-c", LOCKED, program, LOCKED=str(folder), **variables)
    assert done.stdout.split()[:4] == ["1", "0", done.stdout.split()[2], "False"]
    assert done.stderr == ""
    # Another kernel is compiled beside it, and the locked folder stays as it is.
    Path(program).write_text(KERNEL.replace("x + 1", "x + 3 - 2"), encoding="utf-8")
    done = process("-c", LOCKED, program, LOCKED=str(folder), **variables)
    assert done.stdout.split()[:2] == ["0", "1"]
    folder.chmod(0o755)
    assert contents(folder) == before


def test_a_relative_cache_home_is_ignored_as_the_xdg_rule_says(tmp_path: Path) -> None:
    code = "from stillroom.compiled import kernel_cache; print(kernel_cache())"
    place = answer("-c", code, XDG_CACHE_HOME="cache", HOME=str(tmp_path))[0]
    assert Path(place).is_relative_to(tmp_path)
    assert list(tmp_path.iterdir()) == [], "it was touched before there was a kernel"


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_touches_no_folder(option: str, tmp_path: Path) -> None:
    done = process("-m", "stillroom.cli.main", option, XDG_CACHE_HOME=str(tmp_path), HOME=str(tmp_path))
    assert "stillroom" in done.stdout
    assert list(tmp_path.iterdir()) == []


NAMED = """
from typing import NamedTuple
from stillroom.compiled import njit

class {name}(NamedTuple):
    x: float

@njit(cache=True)
def plus_one(given):
    return given.x + 1.0

assert plus_one({name}(1.0)) == 2.0
print(sum(plus_one.stats.cache_hits.values()), sum(plus_one.stats.cache_misses.values()))
"""


def test_an_entry_that_names_a_class_of_before_is_compiled_again(tmp_path: Path) -> None:
    """Whoever fetches a new commit has entries of the old one; the stamp of the file alone does not say so in time."""
    (tmp_path / "sources").mkdir()
    module, program = tmp_path / "sources" / "kernel_of_mine.py", "import kernel_of_mine"
    variables = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(module.parent)}
    said = []
    for name in ("Before", "Before", "Renamed", "Renamed"):
        module.write_text(NAMED.format(name=name), encoding="utf-8")
        os.utime(module, (1_000_000_000, 1_000_000_000 + len(name)))
        said.append(answer("-c", program, **variables))
    assert said == [["0", "1"], ["1", "0"], ["0", "1"], ["1", "0"]]


def test_a_full_disk_costs_a_warning_and_not_the_run(program: str, tmp_path: Path) -> None:
    code = f"""
import errno, runpy
from numba.core.caching import IndexDataCacheFile
def full(*arguments):
    raise OSError(errno.ENOSPC, "No space left on device")
IndexDataCacheFile.save = full
runpy.run_path({program!r})
"""
    done = process("-c", code, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert done.stdout.split()[:2] == ["0", "1"]
    assert done.stderr.count("a compiled kernel cannot be written (No space left on device)") == 1
    assert "Traceback" not in done.stderr


AT_ONCE = """
import sys
from stillroom.compiled import njit

@njit(cache=True)
def plus_one(x):
    return x + 1

sys.stdin.readline()
print(plus_one({"int": 1, "float": 1.5, "complex": 1j}[sys.argv[1]]), sum(plus_one.stats.cache_hits.values()))
"""


def test_processes_that_write_at_once_keep_the_machine_code_of_all(tmp_path: Path) -> None:
    """They choose a name for a file at the same time; none may lose its own, nor find another's code under its name."""
    file = tmp_path / "at_once.py"
    file.write_text(AT_ONCE, encoding="utf-8")
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    for n_hits in (0, 1):
        started = [
            subprocess.Popen(
                [sys.executable, str(file), kind],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for kind in ("int", "float", "complex")
        ]
        for process in started:
            assert process.stdin is not None
            process.stdin.write("go\n")
            process.stdin.flush()
        said = [process.communicate()[0].split() for process in started]
        assert said == [["2", str(n_hits)], ["2.5", str(n_hits)], ["(1+1j)", str(n_hits)]]


def test_a_kernel_from_the_cache_runs_without_numbas_compiler(tmp_path: Path) -> None:
    code = f"import sys{PROJECT_KERNEL}\nprint('numba.np.npyimpl' in sys.modules)"
    assert answer("-c", code, XDG_CACHE_HOME=str(tmp_path))[-1] == "True"
    assert answer("-c", code, XDG_CACHE_HOME=str(tmp_path))[-1] == "False"


SWAPPED = """
import pathlib, sys
from stillroom.compiled import njit

@njit(cache=True)
def plus_one(x):
    return x + 1

if len(sys.argv) > 1:
    first, second = sorted(pathlib.Path(plus_one.stats.cache_path).glob("*.nbc"))
    first.write_bytes(second.read_bytes())
print(plus_one(1), plus_one(1.5))
"""


def test_machine_code_for_other_arguments_is_not_taken(tmp_path: Path) -> None:
    file = tmp_path / "swapped.py"
    file.write_text(SWAPPED, encoding="utf-8")
    variables = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    assert answer(str(file), **variables) == ["2", "2.5"]
    assert answer(str(file), "swap", **variables) == ["2", "2.5"]
