"""Folders that several test files read, made by whichever of the workers needs one first."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

if sys.platform != "win32":
    import fcntl


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder that is not to be changed.

    Args:
        factory: Where it lies: beside what each worker makes for itself.
        name: Its name, of its own among all.
        make: Fills the folder, which is not there yet. While one worker does so, others that want it wait.
    """
    own = factory.getbasetemp()
    if sys.platform == "win32" or "PYTEST_XDIST_WORKER" not in os.environ:
        folder = own / name
        make(folder)
        return folder
    folder, done = own.parent / name, own.parent / f"{name} is made"
    with (own.parent / f"{name} lock").open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # closing the file lets go
        if not done.exists():
            make(folder)
            done.touch()
    return folder
