"""How a result came about: versions, commit, machine, time."""

import platform
import shlex
import subprocess
import sys
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from stillroom.version import __version__

LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "onnxruntime")


def provenance() -> dict[str, Any]:
    """Return what a reader needs to make a result again, as nested mappings."""
    return {
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "commit": source_commit(Path(__file__).parents[1]),
        "command": shlex.join(sys.argv),
        "versions": {
            "stillroom": __version__,
            "python": platform.python_version(),
            **{name: _version(name) for name in LIBRARIES},
            "platform": platform.platform(),
        },
    }


def source_commit(folder: Path) -> str:
    """Return the git commit of a source folder, with "+changes" when files differ from it; "" outside of git.

    A folder that lies in somebody's repository without being part of it, such as a virtual environment, has none.
    """
    if _git(folder, "ls-files", "--error-unmatch", "__init__.py") is None:
        return ""
    commit = _git(folder, "rev-parse", "HEAD") or ""
    return commit + ("+changes" if _git(folder, "status", "--porcelain", "--", ".") else "")


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
