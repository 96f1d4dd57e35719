"""`--sensor` by command: told by the sequence, asked for, and refused in one line."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from pair_folders import write_euroc, write_kitti

from stillroom.data.sensor import Sensor
from stillroom.pipeline.replay import _source

FEW = ("--pictures", "0", "--no-report", "--method", "orb-slam2", "--out", "out")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--sensor", "rgbd"), "its images are stereo and have no depth images; leave --sensor rgbd out"),
        (("--sensor", "sonar"), "sensor is 'sonar'; it must be one of rgbd, stereo, monocular"),
        (("--sensor", "monocular", "--method", "dynaslam-g"), "dynaslam-g: finds what moves in depth images alone"),
        (("--method", "dynaslam-g"), "unless --set stereo.dense=sgbm makes one"),
    ],
)
def test_what_a_sequence_cannot_give_is_refused(
    arguments: tuple[str, ...], message: str, stillroom: Callable, tmp_path: Path
) -> None:
    said = stillroom("run", write_kitti(tmp_path / "00"), *arguments, "--out", "out")
    assert said.code == 1
    assert len(said.errors) == 1
    assert message in said.errors[0]
    assert not Path("out").exists() or not any(Path("out").iterdir())


@pytest.mark.parametrize(
    "command",
    [
        ("inpaint",),
        ("calibrate", "shutter"),
        ("calibrate", "depth"),
        ("bench", "ghosts"),
        ("bench", "geometry"),
        ("bench", "ablation"),
    ],
)
def test_what_needs_depth_images_says_so(command: tuple[str, ...], stillroom: Callable, tmp_path: Path) -> None:
    said = stillroom(*command, write_kitti(tmp_path / "00"))
    assert said.code == 1
    assert len(said.errors) == 1
    assert "depth images" in said.errors[0]


def test_a_pair_cannot_be_recorded_again_as_colour_and_depth(stillroom: Callable, tmp_path: Path) -> None:
    said = stillroom("record", f"camera:replay:{write_kitti(tmp_path / '00')}", "copy")
    assert said.code == 1
    assert "has no depth images; what is recorded is colour and depth" in said.errors[0]


def test_a_run_names_its_sensor(stillroom: Callable, tmp_path: Path) -> None:
    """Three images of a wall are too few for a map of one camera, whatever begins it; what is said and noted counts."""
    said = stillroom("run", write_euroc(tmp_path / "walls", cameras=1), "--frames", ":3", *FEW)
    assert "orb-slam2 on walls: monocular; 3 images; camera: the sequence's own sensor.yaml" in said.err
    figures = json.loads(Path("out/metrics.json").read_text())["run"]
    assert figures["sensor"] == "monocular"
    assert figures["left_out"] == []


def test_the_sensor_asked_for_is_noted_and_replayed(stillroom: Callable, recorded: Path) -> None:
    said = stillroom("run", recorded, "--sensor", "monocular", "--frames", ":3", *FEW)
    assert "monocular; 3 images" in said.err
    assert 'sensor = "monocular"' in Path("out/config.toml").read_text()
    again = _source({"sequence": str(recorded), "sensor": "monocular"}).open()
    assert again.sensor is Sensor.MONOCULAR
