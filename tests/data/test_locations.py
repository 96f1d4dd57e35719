"""Where models and sequences are sought: the variable, then the cache."""

from pathlib import Path

import pytest

from stillroom.data.locations import cache_folder, data_home, model_path, models_home, sequence_path


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
