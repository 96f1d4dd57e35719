"""`stillroom run camera:…` and `stillroom record`."""

import csv
from collections.abc import Callable
from pathlib import Path

import pytest

from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError
from stillroom.pipeline import Source

N_FRAMES = 24  # of `recorded`
QUICK = ("--method", "orb-slam2", "--pictures", 0)


def poses(folder: Path) -> bytes:
    return (folder / "trajectory.tum").read_bytes()


def states(folder: Path) -> list[str]:
    with (folder / "frames.csv").open(encoding="utf-8", newline="") as file:
        return [row["state"] for row in csv.DictReader(file)]


def test_a_camera_that_plays_a_folder_gives_the_folder_s_bytes(stillroom: Callable, recorded: Path) -> None:
    of_folder = stillroom("run", recorded, *QUICK, "--out", "a")
    of_camera = stillroom("run", f"camera:replay:{recorded}", *QUICK, "--out", "b")
    assert (of_folder.code, of_camera.code) == (0, 0)
    assert poses(Path("a")) == poses(Path("b"))
    assert poses(Path("a")).count(b"\n") == N_FRAMES + 1
    for name in ("trajectory_online.tum", "keyframes.tum", "frames.csv", "groundtruth.tum"):
        assert (Path("a") / name).read_bytes() == (Path("b") / name).read_bytes(), name
    assert "orb-slam2 on room: RGB-D; camera: " in of_camera.err
    assert f"sequence = 'camera:replay:{recorded}'" in Path("b/config.toml").read_text(encoding="utf-8").replace(
        '"', "'"
    )


def test_what_is_recorded_runs_to_the_same_bytes(stillroom: Callable, recorded: Path) -> None:
    said = stillroom("record", f"camera:replay:{recorded}", "kept")
    assert (said.code, said.errors, said.warnings) == (0, [], [])
    assert said.out == f"{N_FRAMES} images recorded\nsequence: kept\n"
    assert "recording room into kept; camera: the sequence's own camera.toml" in said.err
    assert "Ctrl-C ends it" in said.err
    for name in (str(recorded), "kept"):
        assert stillroom("run", name, *QUICK, "--out", f"of_{Path(name).name}").code == 0
    assert poses(Path("of_room")) == poses(Path("of_kept"))


def test_a_camera_that_is_gone_ends_a_run_as_ctrl_c_does(stillroom: Callable, recorded: Path) -> None:
    faults = "missing=3&doubled=5&swapped=8&unreadable=10&gone=14"
    said = stillroom("run", f"camera:replay:{recorded}?{faults}", *QUICK, "--out", "out")
    assert said.code == 130
    assert said.errors == [
        "error: camera:replay: room: the camera is gone; the run ends here [see troubleshooting: camera]"
    ]
    assert [line for line in said.warnings if "left out" in line and "its time" not in line] == [
        "warning: image 10 is left out: camera:replay: room: image 10 arrived damaged"
    ]
    assert sum("is not after" in line for line in said.warnings) == 2
    assert "stopped after 15 images; the figures are of these" in said.out
    assert states(Path("out")).count("ok") == 12
    assert states(Path("out")).count("unreadable") == 3
    assert poses(Path("out")).count(b"\n") == 13


def test_a_doubled_image_changes_no_pose(stillroom: Callable, recorded: Path) -> None:
    stillroom("run", recorded, *QUICK, "--out", "a")
    stillroom("run", f"camera:replay:{recorded}?doubled=4,9", *QUICK, "--out", "b")
    assert poses(Path("a")) == poses(Path("b"))


@pytest.mark.parametrize(
    ("option", "named"),
    [
        (("--frames", "0:5"), "--frames"),
        (("--drop", "0:5"), "--drop"),
        (("--blackout", "1:2"), "--blackout"),
        (("--reverse",), "--reverse"),
        (("--fps", "30"), "--fps"),
        (("--camera", "bonn"), "--camera"),
        (("--pair-by", "order"), "how images are paired"),
        (("--frames", "0:5", "--reverse"), "--frames, --reverse"),
        (("--detector-off", "0:3"), "--detector-off"),
    ],
)
def test_options_of_recorded_sequences_are_refused_in_one_line(
    stillroom: Callable, recorded: Path, option: tuple[str, ...], named: str
) -> None:
    said = stillroom("run", f"camera:replay:{recorded}", *QUICK, *option)
    assert said.code == 1
    [error] = said.errors
    assert named in error
    assert "recorded sequence" in error
    assert not Path("results").exists()


def test_unknown_cameras_and_absent_libraries_are_one_line(
    stillroom: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "depthai", None)
    for command in (("run", "camera:kinect"), ("record", "camera:kinect", "out")):
        [error] = stillroom(*command).errors
        assert error.endswith("there is: camera:replay:FOLDER[?FAULTS], camera:realsense[:SERIAL], camera:oak[:ID]")
    for command in (("run", "camera:oak"), ("record", "camera:oak", "out")):
        [error] = stillroom(*command).errors
        assert error == "error: depthai is not installed: pip install 'stillroom[oak]'"
    assert stillroom("record", "somewhere", "out").errors == [
        "error: somewhere: is no camera; name one like camera:realsense"
    ]
    assert not Path("out").exists()


def test_other_commands_need_a_sequence(stillroom: Callable, recorded: Path) -> None:
    [error] = stillroom("inpaint", f"camera:replay:{recorded}").errors
    assert error.endswith("is a camera, and this needs a sequence; make one of it with 'stillroom record'")
    with pytest.raises(ConfigError, match="is a camera"):
        Source(f"camera:replay:{recorded}").open()


def test_a_recording_says_what_it_lost(stillroom: Callable, recorded: Path) -> None:
    said = stillroom("record", f"camera:replay:{recorded}?doubled=1&unreadable=2&gone=4", "kept", "--frames", 20)
    assert said.code == 1
    assert said.out.splitlines() == [
        "4 images recorded",
        "not recorded, as they were not taken after the one before them: 1",
        "not recorded, as they could not be read: 1",
        "sequence: kept",
    ]
    [error] = said.errors
    assert error.endswith("the camera is gone; the recording ends here [see troubleshooting: camera]")
    assert len(open_dataset("kept")) == 4


def test_a_recording_has_limits(stillroom: Callable, recorded: Path) -> None:
    assert stillroom("record", f"camera:replay:{recorded}", "few", "--frames", 3).code == 0
    assert stillroom("record", f"camera:replay:{recorded}", "short", "--seconds", 0.19).code == 0
    assert (len(open_dataset("few")), len(open_dataset("short"))) == (3, 6)
    [error] = stillroom("record", f"camera:replay:{recorded}", "few", "--frames", 3).errors
    assert "few: is not empty" in error
    [error] = stillroom("record", f"camera:replay:{recorded}", "none", "--frames", 0).errors
    assert "frames is 0" in error
