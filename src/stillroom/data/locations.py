"""Where Stillroom looks for models and sequences, and where it caches what can be made again.

Models are looked up in the folder named by `STILLROOM_MODELS`, then in `models` of the user's cache; sequences given by
a bare name likewise, in `STILLROOM_DATA` and in `data` of the cache. The cache is the operating system's own:
`~/.cache/stillroom` on Linux (or under `XDG_CACHE_HOME`), `~/Library/Caches/stillroom` on macOS,
`%LOCALAPPDATA%/stillroom/Cache` on Windows.
"""

import os
from contextlib import suppress
from pathlib import Path

from platformdirs import user_cache_path

from stillroom.errors import ConfigError

MODELS, DATA = "models", "data"
VARIABLES = {MODELS: "STILLROOM_MODELS", DATA: "STILLROOM_DATA"}


def cache_folder() -> Path:
    """Return the folder for what can be fetched or made again; it need not exist yet.

    Raises:
        ConfigError: The user has no home folder, as in a container under a number that the system does not know.
    """
    try:
        return user_cache_path("stillroom", appauthor=False)
    except RuntimeError as error:
        raise ConfigError("there is no home folder for the cache; name one by HOME or XDG_CACHE_HOME") from error


def models_home() -> Path:
    """Return the folder into which models are downloaded: `STILLROOM_MODELS`, else the cache.

    Raises:
        ConfigError: Neither is there.
    """
    return (model_folders() or [cache_folder() / MODELS])[0]


def data_home() -> Path:
    """Return the folder into which sequences are downloaded: `STILLROOM_DATA`, else the cache.

    Raises:
        ConfigError: Neither is there.
    """
    return (data_folders() or [cache_folder() / DATA])[0]


def model_folders() -> list[Path]:
    """Return the folders in which a model is looked up by its bare name, in order; they need not exist."""
    return _roots(MODELS)


def data_folders() -> list[Path]:
    """Return the folders in which a sequence is looked up by its bare name, in order; they need not exist."""
    return _roots(DATA)


def model_path(name: str) -> Path | None:
    """Return the first existing file or folder `name`, such as "detector.onnx", in the search order for models."""
    return _first_existing(MODELS, name)


def sequence_path(name: str) -> Path | None:
    """Return the first existing folder or archive `name` in the search order for sequences."""
    return _first_existing(DATA, name)


def _roots(kind: str) -> list[Path]:
    named = os.environ.get(VARIABLES[kind])
    roots = [Path(named)] if named else []
    with suppress(ConfigError):  # nothing can lie in the cache of a user without a home
        roots.append(cache_folder() / kind)
    return list(dict.fromkeys(roots))


def _first_existing(kind: str, name: str) -> Path | None:
    return next((path for root in _roots(kind) if (path := root / name).exists()), None)
