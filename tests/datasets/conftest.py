"""A tiny sequence on disk, and a cache of its own for each test."""

from pathlib import Path

import pytest

from stillroom.testing.tiny_sequence import write_tiny_sequence


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """Six frames of 64×48 in the TUM layout, with camera.toml and ground truth."""
    folder = tmp_path / "tiny"
    write_tiny_sequence(folder)
    return folder


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    monkeypatch.delenv("STILLROOM_MODELS", raising=False)
