"""Where results lie: a new folder for each run, and a link to the latest."""

import logging
import os
import re
from datetime import datetime
from pathlib import Path

from stillroom.errors import ConfigError, StillroomError

log = logging.getLogger(__name__)

LATEST = "latest"


def new_folder(root: Path, *names: str, latest: bool = True) -> Path:
    """Make `root/<date>_<names…>` and, where it is a run's, let `root/latest` point to it.

    Raises:
        StillroomError: It cannot be made.
    """
    words = [re.sub(r"[^\w.+-]+", "-", name).strip("-") for name in names]
    stem = "_".join([datetime.now().strftime("%Y-%m-%d_%H-%M"), *words])
    try:
        root.mkdir(parents=True, exist_ok=True)
        folder = _unused(root, stem)
    except OSError as error:
        raise _cannot_make(root, error) from error
    if latest:
        _point_latest_to(folder)
    return folder


def chosen_folder(folder: Path) -> Path:
    """Make a folder that the user named.

    Raises:
        ConfigError: There is something in it already.
        StillroomError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_empty = next(folder.iterdir(), None) is None
    except OSError as error:
        raise _cannot_make(folder, error) from error
    if not is_empty:
        raise ConfigError(f"{folder}: is not empty; name a new folder for the results")
    return folder


def results_folder(path: Path) -> Path:
    """Return the results folder that a path stands for, `latest` also where links do not exist.

    Raises:
        StillroomError: There is none.
    """
    note = path.with_name(f"{path.name}.txt")
    if not path.exists() and path.name == LATEST and note.is_file():
        path = path.parent / note.read_text(encoding="utf-8").strip()
    if not path.is_dir():
        raise StillroomError(f"{path}: no such results folder; 'stillroom run' makes one")
    return path.resolve()


def _unused(root: Path, stem: str) -> Path:
    number = 1
    while True:
        folder = root / (stem if number == 1 else f"{stem}_{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
        else:
            return folder


def _point_latest_to(folder: Path) -> None:
    """Move the link at once, so that it never points nowhere; a text file stands in where there are no links."""
    link, new = folder.parent / LATEST, folder.parent / f".{LATEST}-{os.getpid()}"
    try:
        new.unlink(missing_ok=True)
        new.symlink_to(folder.name, target_is_directory=True)
        new.replace(link)
    except (OSError, NotImplementedError) as error:
        log.info("%s: cannot be made a link (%s); its name stands in %s.txt", link, error, LATEST)
        new.unlink(missing_ok=True)
        link.with_name(f"{LATEST}.txt").write_text(folder.name + "\n", encoding="utf-8")


def _cannot_make(folder: Path, error: OSError) -> StillroomError:
    return StillroomError(f"{folder}: cannot be made a folder for results ({error.strerror}); choose another")
