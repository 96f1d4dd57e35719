"""A short run in the synthetic room, made once."""

from pathlib import Path

import pytest

from stillroom.config import SlamConfig
from stillroom.pipeline import RunOptions, RunOutcome, Source, run
from stillroom.protocols import Dataset
from stillroom.semantics.truth import TrueSemanticsConfig

ROOM = Source("synthetic:walking,frames=45")
CONFIG = SlamConfig(semantics=TrueSemanticsConfig())


@pytest.fixture(scope="session")
def room() -> Dataset:
    """A second and a half of a room in which figures walk."""
    return ROOM.open()


@pytest.fixture(scope="session")
def finished(room: Dataset, tmp_path_factory: pytest.TempPathFactory) -> RunOutcome:
    """A run through it, with everything that is written."""
    root: Path = tmp_path_factory.mktemp("results")
    return run(room, CONFIG, RunOptions(root=root, pictures=3, source=ROOM, asked={"light": "dim"}))
