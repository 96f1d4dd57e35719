"""Where Stillroom looks for models and sequences, and where it keeps what it may make again.

Models are sought in this order: the folder named by `STILLROOM_MODELS`, the user's cache
(`~/.cache/stillroom/models`, or under `XDG_CACHE_HOME`), and `../shared/models` beside the working directory.
Sequences given by a bare name are sought likewise: `STILLROOM_DATA`, the cache, `../shared/data`.
"""

import os
from pathlib import Path


def cache_folder() -> Path:
    """Return the folder for what can be fetched or made again; it need not exist yet."""
    named = os.environ.get("XDG_CACHE_HOME")
    # The XDG rule: a relative path in the variable is to be ignored.
    base = Path(named) if named and Path(named).is_absolute() else Path.home() / ".cache"
    return base / "stillroom"


def models_home() -> Path:
    """Return the folder into which models are downloaded: `STILLROOM_MODELS`, else the cache."""
    return _roots("STILLROOM_MODELS", "models")[0]


def data_home() -> Path:
    """Return the folder into which sequences are downloaded: `STILLROOM_DATA`, else the cache."""
    return _roots("STILLROOM_DATA", "data")[0]


def models_folder(name: str) -> Path | None:
    """Return the first existing folder `name`, such as "yolo_fastest", in the search order for models."""
    return _first_existing("STILLROOM_MODELS", "models", name)


def data_folders() -> list[Path]:
    """Return the folders in which a sequence is sought by its bare name, in order; they need not exist."""
    return _roots("STILLROOM_DATA", "data")


def sequence_path(name: str) -> Path | None:
    """Return the first existing folder or archive `name` in the search order for sequences."""
    return _first_existing("STILLROOM_DATA", "data", name)


def _roots(variable: str, kind: str) -> list[Path]:
    named = os.environ.get(variable)
    return [*([Path(named)] if named else []), cache_folder() / kind, Path("..") / "shared" / kind]


def _first_existing(variable: str, kind: str, name: str) -> Path | None:
    candidates = [root / name for root in _roots(variable, kind)]
    return next((path for path in candidates if path.exists()), None)
