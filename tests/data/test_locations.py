"""Where models and sequences are sought: the folder that the variable names, then the cache."""

import subprocess
import sys
from pathlib import Path

import pytest
from platformdirs.macos import MacOS
from platformdirs.windows import Windows

from stillroom.data.locations import (
    cache_folder,
    data_folders,
    data_home,
    model_folders,
    model_path,
    models_home,
    sequence_path,
)


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    named, cache = tmp_path / "named", tmp_path / "cache/stillroom/models"
    monkeypatch.setenv("STILLROOM_MODELS", str(named))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return named, cache


def test_the_first_that_exists_wins(places: tuple[Path, Path]) -> None:
    assert model_path("net") is None
    for place in reversed(places):
        (place / "net").mkdir(parents=True)
        found = model_path("net")
        assert found is not None
        assert found.resolve() == (place / "net").resolve()


def test_places_are_named_in_the_order_of_the_search_and_once(
    places: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert model_folders() == list(places)
    monkeypatch.setenv("STILLROOM_MODELS", str(places[1]))
    assert model_folders() == [places[1]]
    monkeypatch.setenv("STILLROOM_MODELS", "")
    assert model_folders() == [places[1]]


def test_nothing_is_sought_beside_the_working_directory(
    places: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in ("models", "data"):
        (tmp_path / "shared" / kind / "net").mkdir(parents=True)
    (tmp_path / "project").mkdir()
    monkeypatch.chdir(tmp_path / "project")
    monkeypatch.delenv("STILLROOM_DATA", raising=False)
    assert model_path("net") is None
    assert sequence_path("net") is None
    assert data_folders() == [places[1].parent / "data"]


def test_downloads_go_where_the_search_begins(places: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    assert models_home() == places[0]
    monkeypatch.delenv("STILLROOM_MODELS")
    assert models_home() == places[1]
    monkeypatch.delenv("STILLROOM_DATA", raising=False)
    assert data_home() == places[1].parent / "data"


def test_sequences_are_sought_likewise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STILLROOM_DATA", str(tmp_path))
    (tmp_path / "a.tgz").touch()
    assert sequence_path("a.tgz") == tmp_path / "a.tgz"
    assert sequence_path("b") is None


@pytest.mark.skipif(sys.platform != "linux", reason="the default is another on other systems")
@pytest.mark.parametrize("value", [None, "", "relative/cache"])
def test_the_cache_is_in_the_home_folder_by_default(
    value: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    if value is None:
        monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    else:
        monkeypatch.setenv("XDG_CACHE_HOME", value)
    assert cache_folder() == tmp_path / ".cache" / "stillroom"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no XDG_CACHE_HOME")
def test_an_absolute_cache_home_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "stillroom"


def test_each_system_has_its_own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("platformdirs.PlatformDirs", MacOS)
    assert cache_folder() == tmp_path / "Library" / "Caches" / "stillroom"
    monkeypatch.setattr("platformdirs.windows.get_win_folder", lambda _: str(tmp_path / "Local"))
    monkeypatch.setattr("platformdirs.PlatformDirs", Windows)
    assert cache_folder().relative_to(tmp_path / "Local").parts == ("stillroom", "Cache")


def test_importing_the_package_is_light() -> None:
    code = "import stillroom, sys; print(sorted({'numpy', 'numba', 'cv2', 'scipy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
