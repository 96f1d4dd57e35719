"""Everything wrong with an input ends in one clear line; a single bad frame in a warning."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.data.trajectory import read_tum

BAD = 12
PICTURE = f"{BAD:04d}.png"


def edit(path: Path, change: Callable[[list[str]], list[str]]) -> None:
    path.write_text("\n".join(change(path.read_text(encoding="utf-8").splitlines())) + "\n", encoding="utf-8")


def swap_words(place: int, line: int, value: str) -> Callable[[list[str]], list[str]]:
    def change(lines: list[str]) -> list[str]:
        words = lines[line].split()
        words[place] = value
        return [*lines[:line], " ".join(words), *lines[line + 1 :]]

    return change


def repeat_a_time(lines: list[str]) -> list[str]:
    return swap_words(0, 6, lines[5].split()[0])(lines)


def every(folder: Path, damage: Callable[[Path], None]) -> None:
    for path in sorted(folder.iterdir()):
        damage(path)


def one_byte_a_pixel(path: Path) -> None:
    cv2.imwrite(str(path), (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) >> 8).astype(np.uint8))


def half_as_large(path: Path) -> None:
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(path), picture[::2, ::2])


def no_picture(path: Path) -> None:
    path.write_bytes(b"this is no picture")


def all_zero(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros_like(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))


FATAL: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "no rgb.txt": (
        lambda room: [(room / name).unlink() for name in ("rgb.txt", "camera.toml")],
        ["room"],
    ),
    "no depth.txt": (lambda room: (room / "depth.txt").unlink(), ["no depth.txt in it"]),
    "an empty list": (lambda room: (room / "rgb.txt").write_text("# nothing\n"), ["rgb.txt", "lists no images"]),
    "no image decodes": (lambda room: every(room / "rgb", no_picture), ["none of the first 5 frames", "decode"]),
    "8-bit depth": (lambda room: every(room / "depth", one_byte_a_pixel), ["8 bits", "16 bits"]),
    "depth of another size": (lambda room: every(room / "depth", half_as_large), ["320×240", "640×480"]),
    "images of another size than the camera": (
        lambda room: [every(room / name, half_as_large) for name in ("rgb", "depth")],
        ["320×240 pixels", "640×480", "calibration"],
    ),
    "a time that repeats": (lambda room: edit(room / "rgb.txt", repeat_a_time), ["rgb.txt:7", "repeats"]),
    "a time that goes back": (
        lambda room: edit(room / "rgb.txt", swap_words(0, 6, "0.5e-6")),
        ["rgb.txt:7", "goes back"],
    ),
    "a time that is no number": (
        lambda room: edit(room / "rgb.txt", swap_words(0, 6, "noon")),
        ["rgb.txt:7", "'noon' is no timestamp"],
    ),
    "an unknown key in the camera file": (
        lambda room: edit(room / "camera.toml", lambda lines: [*lines, "focus = 3"]),
        ["camera.toml", "unknown key 'focus'"],
    ),
    "no calibration": (lambda room: (room / "camera.toml").unlink(), ["no calibration is known", "--camera"]),
}


@pytest.mark.parametrize("case", list(FATAL))
def test_a_sequence_that_cannot_be_used_is_one_line(case: str, recorded: Path, stillroom: Callable) -> None:
    damage, words = FATAL[case]
    damage(recorded)
    said = stillroom("run", recorded, "--method", "orb-slam2")
    assert said.code == 1
    assert said.out == ""
    assert said.err.count("\n") == 1, said.err
    assert said.err.startswith("error: ")
    for word in words:
        assert word in said.err
    assert list(Path.cwd().iterdir()) == []


FLAWS: dict[str, tuple[Callable[[list[str]], list[str]], list[str]]] = {
    "a NaN in the ground truth": (swap_words(3, 7, "nan"), ["groundtruth.txt:8", "not finite"]),
    "a quaternion that is none": (swap_words(7, 7, "3.0"), ["groundtruth.txt:8", "quaternion", "must be 1"]),
}


@pytest.mark.parametrize("case", list(FLAWS))
def test_a_flawed_ground_truth_costs_the_figures_only(case: str, recorded: Path, stillroom: Callable) -> None:
    damage, words = FLAWS[case]
    edit(recorded / "groundtruth.txt", damage)
    said = stillroom("run", recorded, "--method", "orb-slam2", "--frames", ":3", "--out", "run", "--pictures", "0")
    assert said.code == 0
    assert len(said.warnings) == 1, said.err
    for word in [*words, "no figures", "[see troubleshooting: groundtruth]"]:
        assert word in said.warnings[0]
    assert "3 of 3 frames tracked (100.0 %); too little to compare with the ground truth" in said.out
    assert len(read_tum(Path("run") / "trajectory.tum")) == 3
    mine = Path("run") / "trajectory.tum"
    for judge in (("run",), ("--estimate", mine, "--sequence", recorded)):
        judged = stillroom("evaluate", *judge)
        assert judged.code == 1
        assert "[see troubleshooting: groundtruth]" in judged.errors[0]
    assert all(word in judged.errors[0] for word in words)


REQUESTS: dict[str, tuple[list[str], list[str]]] = {
    "a missing folder": (["nowhere/room"], ["nowhere/room: no such folder"]),
    "an unknown method": (["{room}", "--method", "orbslam"], ["'orbslam'", "did you mean 'orb-slam2'"]),
    "an unknown key": (
        ["{room}", "--set", "tracking.min_inlier=3"],
        ["unknown key 'tracking.min_inlier'", "'tracking.min_inliers'"],
    ),
    "a value of the wrong type": (["{room}", "--set", "seed=x"], ["'seed' is 'x'", "whole number"]),
    "no value": (["{room}", "--set", "seed"], ["'seed' sets nothing"]),
    "a config file that is missing": (["{room}", "--config", "mine.toml"], ["mine.toml: no such config file"]),
    "frames that do not exist": (["{room}", "--frames", "200:300"], ["frames 200:300", "0 to 23"]),
    "frames that are no range": (["{room}", "--frames", "12"], ["'12' is no range of frames"]),
    "nothing left": (["{room}", "--drop", ":"], ["leaves no image"]),
    "no such range to silence": (["{room}", "--detector-off", "50:60"], ["detector-off 50:60"]),
    "an unknown camera": (["{room}", "--camera", "kinect"], ["no camera is called 'kinect'"]),
    "a frame rate that is none": (["{room}", "--fps", "0"], ["fps is 0.0"]),
    "a unit of time that is none": (["{room}", "--time-unit", "min"], ["time-unit is 'min'", "s, ms, us, ns"]),
    "a way to pair that is none": (["{room}", "--pair-by", "size"], ["pair-by is 'size'", "time, name, order"]),
    "depth that never comes": (
        ["{room}", "--max-gap", "0.001", "--depth-offset", "-0.01"],
        ["within 0.001 s", "0.01 s earlier", "[see troubleshooting: depth-offset]"],
    ),
    "a negative seed": (["{room}", "--seed", "-3"], ["seed is -3"]),
    "masks that are not there": (
        ["{room}", "--set", "semantics.kind=mask-files", "--set", "semantics.folder=masks"],
        ["masks"],
    ),
    "truth where there is none": (["{room}", "--set", "semantics.kind=truth"], ["has no ground truth"]),
    "a value that cannot be": (
        ["{room}", "--method", "oc-slam", "--set", "semantics.confidence=1.5"],
        ["'semantics.confidence' is 1.5; it must be above 0 and at most 1"],
    ),
    "a synthetic sequence that is none": (["synthetic:moon"], ["moon"]),
}


@pytest.mark.parametrize("case", list(REQUESTS))
def test_a_request_that_cannot_be_is_one_line(case: str, recorded: Path, stillroom: Callable) -> None:
    arguments, words = REQUESTS[case]
    given = [argument.format(room=recorded) for argument in arguments]
    if "--method" not in given:
        given += ["--method", "orb-slam2"]
    said = stillroom("run", *given)
    assert said.code == 1
    assert said.out == ""
    assert len(said.errors) == 1, said.err
    assert said.err.splitlines()[-1] == said.errors[0], said.err
    for word in words:
        assert word in said.errors[0]


def test_an_absent_network_with_a_whole_path_is_named_once(recorded: Path, stillroom: Callable, tmp_path: Path) -> None:
    path = tmp_path / "detector.onnx"
    said = stillroom("run", recorded, "--method", "oc-slam", "--set", f"semantics.model={path}")
    assert said.code == 1
    assert said.errors == [f"error: no such network: {path}; set semantics.model to an ONNX file"]


def test_an_absent_network_is_one_line(
    recorded: Path, stillroom: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STILLROOM_MODELS", str(tmp_path / "none"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    said = stillroom("run", recorded, "--method", "oc-slam", "--set", "semantics.model=detector.onnx")
    assert said.code == 1
    assert said.err.count("\n") == 1
    assert "no such network" in said.err
    assert "detector.onnx" in said.err
    assert list(Path.cwd().iterdir()) == []


SINGLE: dict[str, tuple[Callable[[Path], object], str, int]] = {
    "an image that does not decode": (lambda room: no_picture(room / "rgb" / PICTURE), "does not decode", 23),
    "a missing image": (lambda room: (room / "rgb" / PICTURE).unlink(), "no such image", 23),
    "a missing depth image": (lambda room: (room / "depth" / PICTURE).unlink(), "no such image", 23),
    "depth of another size": (lambda room: half_as_large(room / "depth" / PICTURE), "320×240", 23),
    "8-bit depth": (lambda room: one_byte_a_pixel(room / "depth" / PICTURE), "8 bits", 23),
    "a black frame": (lambda room: all_zero(room / "rgb" / PICTURE), f"image {BAD} is black", 23),
    "a frame without depth": (lambda room: all_zero(room / "depth" / PICTURE), f"image {BAD} has no depth", 24),
}


@pytest.mark.parametrize("case", list(SINGLE))
def test_a_single_bad_frame_is_one_warning_and_the_run_goes_on(case: str, recorded: Path, stillroom: Callable) -> None:
    damage, words, n_poses = SINGLE[case]
    damage(recorded)
    said = stillroom("run", recorded, "--method", "orb-slam2", "--out", "out", "--pictures", "0")
    assert said.code == 0, said.err
    assert len(said.warnings) == 1, said.err
    assert words in said.warnings[0]
    assert f"{n_poses} of 24 frames tracked" in said.out
    assert len(read_tum(Path("out/trajectory.tum"))) == n_poses


def test_a_gap_in_time_is_one_warning_and_the_run_goes_on(recorded: Path, stillroom: Callable) -> None:
    def later(lines: list[str]) -> list[str]:
        moved = [f"{float(line.split()[0]) + 7.0:.6f} {line.split()[1]}" for line in lines[BAD:]]
        return [*lines[:BAD], *moved]

    edit(recorded / "rgb.txt", later)
    edit(recorded / "depth.txt", later)
    said = stillroom("run", recorded, "--method", "orb-slam2", "--out", "out", "--pictures", "0")
    assert said.code == 0, said.err
    assert len(said.warnings) == 1, said.err
    assert f"1 gap(s) in time, the longest 7.0 s before image {BAD}" in said.warnings[0]
    assert "24 of 24 frames tracked" in said.out


EVALUATIONS: dict[str, tuple[list[str], list[str]]] = {
    "no results": ([], ["results/latest: no such results folder"]),
    "another folder": (["{room}"], ["no trajectory.tum in it"]),
    "an estimate alone": (["--estimate", "{room}/groundtruth.txt"], ["--groundtruth FILE"]),
    "two truths": (
        ["--estimate", "{room}/groundtruth.txt", "--groundtruth", "x", "--sequence", "y"],
        ["one of --groundtruth FILE and --sequence"],
    ),
    "no such estimate": (["--estimate", "mine.txt", "--groundtruth", "{room}/groundtruth.txt"], ["mine.txt: no such"]),
    "an estimate that is none": (
        ["--estimate", "{room}/rgb.txt", "--groundtruth", "{room}/groundtruth.txt"],
        ["rgb.txt:1", "not a number"],
    ),
    "truth without estimate": (["--groundtruth", "{room}/groundtruth.txt"], ["--groundtruth goes with --estimate"]),
    "both": (["{room}", "--estimate", "x"], ["leave one out"]),
    "of another time": (
        ["--estimate", "{room}/later.txt", "--groundtruth", "{room}/groundtruth.txt"],
        ["no overlap in time"],
    ),
}


@pytest.mark.parametrize("case", list(EVALUATIONS))
def test_an_evaluation_that_cannot_be_is_one_line(case: str, recorded: Path, stillroom: Callable) -> None:
    arguments, words = EVALUATIONS[case]
    truth = (recorded / "groundtruth.txt").read_text(encoding="utf-8").splitlines()[1:]
    later = [f"{float(line.split()[0]) + 9e4:.6f} {' '.join(line.split()[1:])}" for line in truth]
    (recorded / "later.txt").write_text("\n".join(later), encoding="utf-8")
    said = stillroom("evaluate", *(argument.format(room=recorded) for argument in arguments), "--json")
    assert said.code == 1
    assert said.out == ""
    assert said.err.count("\n") == 1, said.err
    assert said.err.startswith("error: ")
    for word in words:
        assert word in said.err
