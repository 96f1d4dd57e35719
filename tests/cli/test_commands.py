"""The commands and what they print."""

import inspect
import json
import textwrap
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import typer
from rich.console import Console

from stillroom import __version__
from stillroom.cli import main as command_line
from stillroom.cli.main import COMMANDS, application, main
from stillroom.cli.output import STDOUT, RunBar, say
from stillroom.config import to_toml
from stillroom.data.result import FrameSummary, TrackingState
from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.errors import StillroomError
from stillroom.evaluation.report import HEADER
from stillroom.presets.registry import all_methods, configure


def first_line(text: str | None) -> str:
    return (text or "").strip().splitlines()[0]


def result(state: TrackingState) -> FrameSummary:
    return FrameSummary(0, 0.0, state, None, 1000, 900, 321, 7, False, -1, None)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of a second, of which one frame is missing and one is black."""
    folder = tmp_path_factory.mktemp("run") / "out"
    arguments = ["run", "synthetic:empty", "--frames", "0:32", "--drop", "20:21", "--blackout", "25:26"]
    arguments += ["--method", "oc-slam", "--set", "semantics.kind=truth", "--detector-off", "10:12"]
    arguments += ["--seed", "4", "--pictures", "1", "--out", str(folder)]
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code in (0, None)
    return folder


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_the_list_of_commands_says_what_their_help_says(command: command_line.Command) -> None:
    loaded = command.load()
    own = loaded.info.help if isinstance(loaded, typer.Typer) else loaded.__doc__
    assert command.summary == first_line(own)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_every_command_has_help(command: command_line.Command, stillroom: Callable) -> None:
    said = stillroom(command.name, "--help")
    assert said.code == 0
    assert "Usage: stillroom" in said.out
    assert command.summary in " ".join(said.out.split())
    # Examples keep a line of their own.
    for line in said.out.splitlines():
        assert line.count("stillroom ") <= 1 or "Usage" in line


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_help_flows_in_a_terminal_of_80_columns(
    command: command_line.Command, stillroom: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line break of the source in the middle of a paragraph leaves a stump."""
    monkeypatch.setenv("COLUMNS", "80")
    loaded = command.load()
    apps = {(): loaded.__doc__}
    if isinstance(loaded, typer.Typer):
        inner = [(each.name, each.callback) for each in loaded.registered_commands]
        apps = {(name or callback.__name__.replace("_", "-"),): callback.__doc__ for name, callback in inner}
    for words, docstring in apps.items():
        said = [line.strip() for line in stillroom(command.name, *words, "--help").out.splitlines()]
        for paragraph in inspect.cleandoc(docstring).split("\n\n"):
            examples = paragraph.startswith(" ")
            lines = paragraph.split("\n") if examples else textwrap.wrap(" ".join(paragraph.split()), 78)
            start = said.index(lines[0].strip())
            assert said[start : start + len(lines)] == [line.strip() for line in lines]


def test_the_help_lists_all_commands(stillroom: Callable) -> None:
    said = stillroom("--help")
    assert said.code == 0
    for command in COMMANDS:
        assert command.name in said.out
    assert "download" in stillroom().out + stillroom().err  # without arguments, too


def test_version(stillroom: Callable) -> None:
    assert stillroom("--version").out == f"stillroom {__version__}\n"


def test_wrong_usage_is_no_error_of_ours(stillroom: Callable) -> None:
    for arguments in (["run"], ["fly"], ["run", "x", "--no-such-option"]):
        said = stillroom(*arguments)
        assert said.code == 2
        assert "Usage" in said.err
        assert said.errors == []


def test_what_is_not_an_error_of_ours_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("stillroom.presets.registry.configure", broken)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        main(["show-config"])


def test_a_long_error_stays_one_line(stillroom: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise StillroomError("no [bold]such[/] thing " * 30 + "\nand more")

    monkeypatch.setattr("stillroom.presets.registry.configure", fail)
    said = stillroom("show-config")
    assert said.code == 1
    assert said.err.count("\n") == 1
    assert "[bold]such[/]" in said.err
    assert said.err.endswith("and more\n")


def test_a_name_between_colons_is_not_drawn_as_a_picture(capsys: pytest.CaptureFixture[str]) -> None:
    say("seed 0, on synthetic:walking: all tracked")
    assert capsys.readouterr().err == "seed 0, on synthetic:walking: all tracked\n"


def test_methods_lists_every_method(stillroom: Callable) -> None:
    said = stillroom("methods")
    assert said.code == 0
    text = " ".join(said.out.split())
    for method in all_methods().values():
        assert method.name in text
    assert "yolo-fastest" in text


def test_show_config_prints_what_run_takes(stillroom: Callable, tmp_path: Path) -> None:
    said = stillroom("show-config", "--method", "oc-slam", "--set", "tracking.min_inliers=21", "--seed", "6")
    assert said.code == 0
    assert tomllib.loads(said.out)["tracking"]["min_inliers"] == 21
    file = tmp_path / "mine.toml"
    file.write_text(said.out, encoding="utf-8")
    assert stillroom("show-config", "--config", file).out == said.out
    assert said.out == to_toml(configure("oc-slam", None, ["tracking.min_inliers=21"], 6))


def test_run_does_what_its_options_say(done: Path) -> None:
    config = tomllib.loads((done / "config.toml").read_text(encoding="utf-8"))
    assert (config["method"], config["seed"], config["semantics"]["kind"]) == ("oc-slam", 4, "truth")
    source = {"sequence": "synthetic:empty", "camera": "", "fps": "", "frames": "0:32", "reverse": False, "sensor": ""}
    pairing = {"time_unit": "", "by": "", "max_gap_s": 0.02, "depth_offset_s": 0.0}
    assert config["run"]["source"] == source | {"drop": ["20:21"], "blackout": ["25:26"], "pairing": pairing}
    assert config["run"]["detector_off"] == ["10:12"]
    times = read_tum(done / "trajectory.tum").timestamps_s
    assert len(times) == 30
    metrics = json.loads((done / "metrics.json").read_text(encoding="utf-8"))
    assert (metrics["n_tracked"], metrics["n_given"]) == (30, 31)


def test_a_run_can_be_made_again_from_its_config(done: Path, stillroom: Callable) -> None:
    arguments = ["--frames", "0:32", "--drop", "20:21", "--blackout", "25:26", "--detector-off", "10:12"]
    said = stillroom("run", "synthetic:empty", *arguments, "--config", done / "config.toml", "--pictures", 0)
    assert said.code == 0, said.err
    again = Path("results/latest/trajectory.tum")
    assert again.read_bytes() == (done / "trajectory.tum").read_bytes()


def test_run_ends_with_figures_and_the_place_of_the_results(stillroom: Callable) -> None:
    said = stillroom("run", "synthetic:walking", "--frames", ":8", "--method", "orb-slam2", "--pictures", "0")
    assert said.code == 0, said.err
    assert "ATE [m], SE(3)" in said.out
    assert "8 of 8 frames tracked (100.0 %)" in said.out
    assert "static-pose baseline (a camera that never moved): ATE" in said.out
    last = said.out.splitlines()[-1]
    assert last.startswith("results: results/")
    assert (Path(last.removeprefix("results: ")) / "trajectory.tum").exists()
    assert "camera: " in said.err.splitlines()[0]
    assert "matches" in said.err


def test_the_chosen_folder_must_be_new(stillroom: Callable) -> None:
    Path("full").mkdir()
    Path("full/mine").touch()
    said = stillroom("run", "synthetic:walking", "--frames", ":3", "--method", "orb-slam2", "--out", "full")
    assert said.code == 1
    assert "full: is not empty" in said.errors[0]
    assert said.err.count("\n") == 1, "told before the kernels are compiled"
    assert [path.name for path in Path("full").iterdir()] == ["mine"]


def test_evaluate_a_folder(done: Path, stillroom: Callable) -> None:
    pictures = sorted((done / "pictures").glob("*.png"))
    assert {path.name for path in pictures} > {"trajectory_above.png", "trajectory_over_time.png", "error.png"}
    for path in pictures:
        path.unlink()
    said = stillroom("evaluate", done, "--baseline", done)
    assert said.code == 0
    assert "30 of 31 frames tracked (96.8 %)" in said.out
    assert "improvement over out in RMSE" in said.out
    assert "ATE +0.0 %" in said.out
    assert (done / "pictures" / "error.png").exists()


def test_evaluate_json_is_json_and_writes_nothing(done: Path, stillroom: Callable) -> None:
    before = (done / "metrics.json").read_bytes()
    (done / "pictures" / "error.png").unlink(missing_ok=True)
    said = stillroom("evaluate", done, "--json")
    figures = json.loads(said.out)
    assert figures["coverage"] == 30 / 31
    assert figures["as_given"]["ate_se3_m"]["rmse"] == pytest.approx(
        json.loads(before)["as_given"]["ate_se3_m"]["rmse"], abs=1e-6
    )
    assert (done / "metrics.json").read_bytes() == before
    assert not (done / "pictures" / "error.png").exists()


def test_evaluate_anyone_s_trajectory(done: Path, stillroom: Callable) -> None:
    estimate, truth = done / "trajectory_online.tum", done / "groundtruth.tum"
    said = stillroom("evaluate", "--estimate", estimate, "--groundtruth", truth, "--out", "judged")
    assert said.code == 0
    assert "30 poses; of how many frames is not known" in said.out
    names = {"metrics.json", "trajectory_above.png", "trajectory_over_time.png", "error.png"}
    assert {path.name for path in Path("judged").iterdir()} == names
    by_name = stillroom("evaluate", "--estimate", estimate, "--sequence", "synthetic:empty", "--json")
    by_file = json.loads(Path("judged/metrics.json").read_text(encoding="utf-8"))
    assert json.loads(by_name.out)["as_given"]["ate_se3_m"]["rmse"] == pytest.approx(
        by_file["as_given"]["ate_se3_m"]["rmse"], abs=1e-6
    )
    assert stillroom("evaluate", "--estimate", estimate, "--groundtruth", truth).code == 0
    assert [path.name.split("_", 2)[2] for path in Path("results").iterdir()] == ["evaluation_trajectory_online"]


def test_evaluate_by_another_clock(done: Path, stillroom: Callable) -> None:
    lines = (done / "trajectory.tum").read_text(encoding="utf-8").splitlines()
    late = [f"{float(line.split()[0]) + 0.8:.6f} {line.split(maxsplit=1)[1]}" for line in lines[1:]]
    Path("late.tum").write_text("\n".join(late) + "\n", encoding="utf-8")
    judge = ("evaluate", "--estimate", "late.tum", "--groundtruth", done / "groundtruth.tum")
    said = stillroom(*judge, "--offset", "-0.8", "--interpolate", "--max-gap", "0.01", "--out", "judged")
    assert said.code == 0, said.err
    assert "-0.8000 s were added to the estimate's times" in said.out
    assert "the ground truth was interpolated" in said.out
    assert (Path("judged") / "error.png").is_file()
    assert stillroom("evaluate", done, "--max-gap", "0.01", "--json").code == 0
    for offset, words in (("soon", "a number of seconds, or 'estimate'"), ("1e6", "troubleshooting: groundtruth-gaps")):
        said = stillroom(*judge, "--offset", offset)
        assert said.code == 1
        assert words in said.errors[0]


def test_a_baseline_of_the_same_file_name(done: Path, stillroom: Callable) -> None:
    truth, mine = read_tum(done / "groundtruth.tum"), Path("mine")
    mine.mkdir()
    worse = truth.T_world_cam.copy()
    worse[::2, 0, 3] += 0.1
    Trajectory(truth.timestamps_s, worse).write_tum(mine / "trajectory.tum")
    said = stillroom(
        "evaluate",
        *("--estimate", done / "trajectory.tum", "--groundtruth", done / "groundtruth.tum"),
        *("--baseline", mine / "trajectory.tum", "--json"),
    )
    gain = json.loads(said.out)["improvement"]
    assert gain["baseline"] == "mine/trajectory.tum"
    assert 50 < gain["ate_percent"] < 100


@pytest.mark.parametrize("state", list(TrackingState))
def test_the_bar_shows_rate_state_matches_and_keyframes(state: TrackingState) -> None:
    console = Console(record=True, force_terminal=True, width=120, force_jupyter=False)
    bar = RunBar(console)
    bar.start(3)
    for _ in range(2):
        bar.frame(result(state))
    bar.finish()
    text = console.export_text()
    assert "2/3" in text
    assert f"frames/s  {state.value}  321 matches  7 keyframes" in text


def test_without_a_terminal_a_line_comes_now_and_then() -> None:
    console = Console(record=True, force_terminal=False, width=120)
    bar = RunBar(console)
    bar.start(95)
    for _ in range(94):
        bar.frame(result(TrackingState.OK))
    bar.frame(None)
    bar.finish()
    lines = console.export_text().splitlines()
    assert 9 <= len(lines) <= 12
    assert lines[0].startswith("9/95")
    assert lines[-1].startswith("95/95")
    assert lines[-1].endswith("unreadable")


def test_other_commands_are_not_imported() -> None:
    names = {group.name for group in application("bench").registered_groups}
    assert names == {"bench"}
    assert application(None).registered_groups == []


@pytest.mark.parametrize(("width", "columns"), [(80, ["rmse", "median", "max"]), (120, list(HEADER[2:]))])
def test_figures_fit_a_terminal(
    done: Path, stillroom: Callable, monkeypatch: pytest.MonkeyPatch, width: int, columns: list[str]
) -> None:
    monkeypatch.setattr(STDOUT, "width", width)
    lines = stillroom("evaluate", done).out.splitlines()
    header = next(line for line in lines if "ground truth" in line and "rmse" in line)
    assert header.split()[3:] == columns
    assert sum(line.startswith(" ATE") for line in lines) == 2
    first = next(line for line in lines if "ATE [m], SE(3)" in line)
    assert len(first.split()) == 5 + len(columns)
