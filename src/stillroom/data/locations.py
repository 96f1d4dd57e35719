"""Where Stillroom looks for models and sequences, and where it keeps what it may make again.

Models are sought in the folder named by `STILLROOM_MODELS`, then in `models` of the user's cache; sequences given by a
bare name likewise, in `STILLROOM_DATA` and in `data` of the cache. The cache is the operating system's own:
`~/.cache/stillroom` on Linux (or under `XDG_CACHE_HOME`), `~/Library/Caches/stillroom` on macOS,
`%LOCALAPPDATA%/stillroom/Cache` on Windows.
"""

import os
from pathlib import Path

from platformdirs import user_cache_path

MODELS, DATA = "models", "data"
VARIABLES = {MODELS: "STILLROOM_MODELS", DATA: "STILLROOM_DATA"}


def cache_folder() -> Path:
    """Return the folder for what can be fetched or made again; it need not exist yet."""
    return user_cache_path("stillroom", appauthor=False)


def models_home() -> Path:
    """Return the folder into which models are downloaded: `STILLROOM_MODELS`, else the cache."""
    return model_folders()[0]


def data_home() -> Path:
    """Return the folder into which sequences are downloaded: `STILLROOM_DATA`, else the cache."""
    return data_folders()[0]


def model_folders() -> list[Path]:
    """Return the folders in which a model is sought by its bare name, in order; they need not exist."""
    return _roots(MODELS)


def data_folders() -> list[Path]:
    """Return the folders in which a sequence is sought by its bare name, in order; they need not exist."""
    return _roots(DATA)


def model_path(name: str) -> Path | None:
    """Return the first existing file or folder `name`, such as "detector.onnx", in the search order for models."""
    return _first_existing(MODELS, name)


def sequence_path(name: str) -> Path | None:
    """Return the first existing folder or archive `name` in the search order for sequences."""
    return _first_existing(DATA, name)


def _roots(kind: str) -> list[Path]:
    named = os.environ.get(VARIABLES[kind])
    return list(dict.fromkeys((*([Path(named)] if named else []), cache_folder() / kind)))


def _first_existing(kind: str, name: str) -> Path | None:
    return next((path for root in _roots(kind) if (path := root / name).exists()), None)
