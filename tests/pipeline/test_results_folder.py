"""Names of results folders, and the link to the latest."""

from datetime import datetime
from pathlib import Path

import pytest

from stillroom.errors import ConfigError, StillroomError
from stillroom.pipeline import results
from stillroom.pipeline.results import chosen_folder, new_folder, results_folder


class Clock:
    @staticmethod
    def now() -> datetime:
        return datetime(2026, 3, 4, 15, 6, 7)


@pytest.fixture(autouse=True)
def _always_the_same_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "datetime", Clock)


def test_runs_of_one_minute_have_folders_of_their_own(tmp_path: Path) -> None:
    root = tmp_path / "deep" / "results"
    made = [new_folder(root, "oc-slam", "rgbd_bonn_crowd") for _ in range(3)]
    stem = "2026-03-04_15-06_oc-slam_rgbd_bonn_crowd"
    assert [folder.name for folder in made] == [stem, f"{stem}_2", f"{stem}_3"]
    assert all(folder.is_dir() for folder in made)
    assert (root / "latest").resolve() == made[-1].resolve()
    assert sorted(path.name for path in root.iterdir()) == [*sorted(folder.name for folder in made), "latest"]


def test_the_link_is_relative_so_that_results_can_be_moved(tmp_path: Path) -> None:
    made = new_folder(tmp_path / "results", "m", "s")
    (tmp_path / "results").rename(tmp_path / "moved")
    assert (tmp_path / "moved" / "latest").readlink() == Path(made.name)
    assert results_folder(tmp_path / "moved" / "latest").name == made.name


def test_names_that_are_no_folder_names_are_made_ones(tmp_path: Path) -> None:
    assert new_folder(tmp_path, "m", "synthetic:walking,frames=3/..").parent == tmp_path


def test_an_evaluation_is_not_the_latest_run(tmp_path: Path) -> None:
    run = new_folder(tmp_path, "m", "s")
    new_folder(tmp_path, "evaluation", "x", latest=False)
    assert results_folder(tmp_path / "latest") == run.resolve()


def test_where_links_cannot_be_made_a_file_stands_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "symlink_to", refuse)
    for _ in range(2):
        made = new_folder(tmp_path, "m", "s")
        assert results_folder(tmp_path / "latest") == made.resolve()


def test_a_folder_called_latest_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "latest").mkdir()
    (tmp_path / "latest" / "mine").touch()
    made = new_folder(tmp_path, "m", "s")
    assert made.is_dir()
    assert (tmp_path / "latest" / "mine").exists()
    assert not list(tmp_path.glob(".latest*"))


def test_a_chosen_folder_must_be_empty(tmp_path: Path) -> None:
    assert chosen_folder(tmp_path / "a" / "b").is_dir()
    assert chosen_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    with pytest.raises(ConfigError, match="is not empty"):
        chosen_folder(tmp_path / "a")


def test_a_place_where_nothing_can_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for make in (new_folder, chosen_folder):
        with pytest.raises(StillroomError, match="cannot be made a folder for results"):
            make(tmp_path / "file" / "results")


def test_no_results_there(tmp_path: Path) -> None:
    for name in ("latest", "other"):
        with pytest.raises(StillroomError, match="no such results folder"):
            results_folder(tmp_path / name)
