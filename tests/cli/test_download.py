"""`stillroom download`, against a server of our own."""

import io
import threading
import zipfile
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from stillroom.cli import download as command
from stillroom.datasets.open import open_dataset
from stillroom.download import Addresses
from stillroom.errors import DownloadError
from stillroom.testing.tiny_sequence import write_tiny_sequence

app = typer.Typer()
app.command()(command.download)


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder that a server on this machine offers as the home of the Bonn sequences."""
    folder = tmp_path / "served"
    folder.mkdir()
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("STILLROOM_DATA", str(tmp_path / "home"))
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder))) as http:
        thread = threading.Thread(target=http.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        address = f"http://127.0.0.1:{http.server_address[1]}"
        monkeypatch.setattr(command, "OFFICIAL", Addresses(bonn=address))
        yield folder
        http.shutdown()
        thread.join()


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments, catch_exceptions=True)


def offer_tiny(served: Path) -> None:
    sequence = served.parent / "rgbd_bonn_tiny"
    write_tiny_sequence(sequence)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as zipped:
        for path in sorted(sequence.rglob("*")):
            zipped.write(path, path.relative_to(served.parent))
    (served / "rgbd_bonn_tiny.zip").write_bytes(packed.getvalue())


def test_the_sequence_lies_where_the_command_says_and_opens(served: Path, tmp_path: Path) -> None:
    offer_tiny(served)
    result = run("bonn/tiny")
    assert result.exit_code == 0, result.output
    place = tmp_path / "home" / "rgbd_bonn_tiny"
    assert str(place) in result.output.splitlines()
    assert f"stillroom run {place}" in result.output
    assert "rgbd_bonn_tiny.zip" in result.output  # the bar of the one file
    assert len(open_dataset("rgbd_bonn_tiny")) == 6  # by its bare name


def test_a_folder_of_ones_own(served: Path, tmp_path: Path) -> None:
    offer_tiny(served)
    assert run("bonn/tiny", "--to", str(tmp_path / "own")).exit_code == 0
    assert (tmp_path / "own" / "rgbd_bonn_tiny" / "rgb.txt").is_file()
    assert not (tmp_path / "home").exists()


@pytest.mark.parametrize(("target", "says"), [("bonn/absent", "no such file"), ("kitti/00", "known: tum/<name>")])
def test_what_cannot_be_had_is_one_line(served: Path, target: str, says: str) -> None:
    result = run(target)
    error = result.exception
    assert result.output == "", "the command line prints the error, and nothing else is said"
    assert isinstance(error, DownloadError)
    assert says in str(error)
    assert "\n" not in str(error)


def test_ctrl_c_says_that_nothing_is_lost(served: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> Path:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "fetch_target", interrupted)
    result = run("bonn/tiny")
    assert result.exit_code == 130
    assert "the same command resumes it" in result.output


def test_a_network_goes_to_the_models(served: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, Path]] = []
    monkeypatch.setattr(command, "fetch_target", lambda target, folder, *_: asked.append((target, folder)) or folder)
    monkeypatch.setenv("STILLROOM_MODELS", str(tmp_path / "models"))
    result = run("pspnet-r50")
    assert result.exit_code == 0, result.output
    assert asked == [("pspnet-r50", tmp_path / "models")]
    assert result.output.splitlines() == [str(tmp_path / "models")]  # and no word of running it
