"""Commands that come by entry points: those of `stillroom_train`, and what packages of other people's add."""

import sys
from collections.abc import Callable
from pathlib import Path

import onnx
import pytest

from stillroom.cli.installed import ALONE, GROUP, installed
from stillroom.cli.main import COMMANDS, flowing

MODULE = '''
import typer

def wave(name: str) -> None:
    """Wave to somebody.

    With the left hand.
    """
    print(f"waving to {name}")

def robot(folder: str) -> None:
    """Write a map for robots."""
    print(f"for robots: {folder}")

app = typer.Typer(no_args_is_help=True, help="Do things twice.")
app.command()(wave)
app.command()(robot)
NUMBER = 3
'''

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install a package with the module above and these lines in its group of commands."""

    def into_new_folder(*lines: str) -> None:
        folder = tmp_path / "installed"
        info = folder / "mine-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text("[stillroom.commands]\n" + "\n".join(lines) + "\n")
        (folder / "mine_of_a_test.py").write_text(MODULE)
        monkeypatch.delitem(sys.modules, "mine_of_a_test", raising=False)
        monkeypatch.syspath_prepend(folder)

    return into_new_folder


def flat(text: str) -> str:
    """Return a text without line breaks and frames."""
    return " ".join(text.replace("│", " ").split())


def ours() -> dict[tuple[str, ...], Callable]:
    """Return the functions of the commands that `stillroom_train` adds, by their words."""
    return {
        tuple(word for word in (first, second) if word != ALONE): GROUP.load(entry)
        for first, commands in installed(command.name for command in COMMANDS).items()
        for second, entry in commands.items()
        if entry.value.startswith("stillroom_train.")
    }


def test_training_and_converters_are_commands() -> None:
    assert set(ours()) == {("train", "pspnet"), ("export", "pspnet"), ("export", "yolo"), ("train-vocabulary",)}


def test_the_list_says_what_their_help_says(stillroom: Callable) -> None:
    listed = flat(stillroom("--help").out)
    assert "train Train PSPNet, which segments people." in listed
    assert "train-vocabulary Make a vocabulary of places from sequences." in listed
    assert "pspnet Train PSPNet, which segments people." in flat(stillroom("train", "--help").out)
    for words, function in ours().items():
        said = stillroom(*words, "--help")
        assert said.code == 0
        assert f"Usage: stillroom {' '.join(words)} " in said.out
        for paragraph in flowing(function.__doc__).split("\n\n"):
            assert flat(paragraph) in flat(said.out)


def test_a_second_word_leaves_the_first_command_alone(stillroom: Callable) -> None:
    assert "Export the dense map of a run" in flat(stillroom("export", "--help").out)
    said = stillroom("export", "nowhere")
    assert (said.code, said.out) == (1, "")
    assert "nowhere" in said.errors[0]


def test_a_package_adds_commands_of_one_word_and_of_two(install: Install, stillroom: Callable) -> None:
    install(
        "wave = mine_of_a_test:wave",
        "greet.wave = mine_of_a_test:wave",
        "greet.twice = mine_of_a_test:app",
        "export.robot = mine_of_a_test:robot",
        "map.robot = mine_of_a_test:robot",
    )
    listed = flat(stillroom("--help").out)
    assert "wave Wave to somebody." in listed
    assert "greet Do things twice. Wave to somebody." in listed
    assert stillroom("wave", "Anna").out == "waving to Anna\n"
    assert stillroom("greet", "wave", "Anna").out == "waving to Anna\n"
    assert stillroom("greet", "twice", "wave", "Anna").out == "waving to Anna\n"
    assert stillroom("export", "robot", "here").out == "for robots: here\n"
    assert stillroom("map", "robot", "here").out == "for robots: here\n"
    maps = flat(stillroom("map", "--help").out)
    assert "robot Write a map for robots." in maps
    assert "check " in maps
    assert "With the left hand." in flat(stillroom("wave", "--help").out)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("run = mine_of_a_test:wave", "there is a command 'run' already"),
        ("train-vocabulary = mine_of_a_test:wave", "there is a command 'train-vocabulary' already"),
        ("export.pspnet = mine_of_a_test:wave", "there is a command 'export.pspnet' already"),
        ("map.info = mine_of_a_test:wave", "there is a command 'map.info' already"),
    ],
)
def test_a_name_that_is_taken_is_one_line(install: Install, stillroom: Callable, line: str, said: str) -> None:
    install(line)
    answer = stillroom("map", "info", "x")
    assert answer.code == 1
    assert len(answer.errors) == 1
    assert said in answer.errors[0]


@pytest.mark.parametrize(
    ("value", "said"),
    [("no_such_module_anywhere:x", "cannot be imported"), ("mine_of_a_test:NUMBER", "is a int; it must be a function")],
)
def test_what_cannot_be_used_is_said_where_it_is_met(
    install: Install, stillroom: Callable, value: str, said: str
) -> None:
    install(f"broken = {value}")
    listed = stillroom("--help")
    assert listed.code == 0
    assert said in flat(listed.out)
    assert "Track the camera through a sequence." in flat(listed.out)
    answer = stillroom("broken")
    assert answer.code == 1
    assert len(answer.errors) == 1
    assert said in answer.errors[0]
    assert stillroom("methods").code == 0


def test_a_network_of_darknets_becomes_a_file(yolo_weights: Path, stillroom: Callable, tmp_path: Path) -> None:
    files = [yolo_weights / f"yolo-fastest-1.1.{suffix}" for suffix in ("cfg", "weights")]
    names, out = yolo_weights / "coco.names", tmp_path / "my.onnx"
    said = stillroom("export", "yolo", *files, "--names", names, "--about", "by somebody", "--out", out)
    assert (said.code, said.out) == (0, f"{out}: 1.3 MB\n")
    assert onnx.load(str(out)).doc_string == "by somebody"
    said = stillroom("export", "yolo", *files, "--names", names, "--out", tmp_path / "no" / "my.onnx")
    assert (said.code, said.out) == (1, "")
    assert "cannot be written" in said.errors[0]
    said = stillroom("export", "yolo", *reversed(files), "--names", names, "--out", out)
    assert (said.code, len(said.errors)) == (1, 1)
