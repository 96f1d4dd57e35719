"""What the files of a results folder say."""

import csv
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from stillroom.errors import StillroomError
from stillroom.pipeline import results

T = TypeVar("T")
WALL = "_wall_ms"


def unless_missing(what: str, read: Callable[[], T], missing: list[str]) -> T | None:
    """Return what is read; None where it is not there or damaged, which is added to `missing` in a line."""
    try:
        return read()
    except StillroomError as error:
        missing.append(f"{what}: {error}")
    except OSError as error:
        missing.append(f"{what}: {error.filename}: {error.strerror}")
    except (ValueError, KeyError, TypeError) as error:
        missing.append(f"{what}: the file is damaged ({error})")
    return None


def read_stages(path: Path) -> dict[int, dict[str, float]]:
    """Return the wall time [ms] of each stage that ran in a frame, by the frame's number.

    Raises:
        OSError, ValueError, KeyError: The file is not there, or damaged.
    """
    with path.open(encoding="utf-8", newline="") as file:
        return {
            int(cells["frame"]): {
                name.removesuffix(WALL): float(cell) for name, cell in cells.items() if name.endswith(WALL) and cell
            }
            for cells in csv.DictReader(file)
        }


def read_config(folder: Path) -> dict[str, Any]:
    """Return the configuration of a run; in `run` stands how it came about.

    Raises:
        OSError, ValueError: The file is not there, or damaged.
    """
    return tomllib.loads((folder / results.CONFIG).read_text(encoding="utf-8"))
