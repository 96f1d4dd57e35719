"""A Slam of one sensor: what it refuses, what it leaves out, and which maps it goes on in."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest
from random_map import EventfulLife, session
from small_world import CAMERA

import stillroom as sr
from stillroom.data.map import submaps
from stillroom.data.sensor import Sensor
from stillroom.errors import ConfigError, FrameError, MapError
from stillroom.pipeline import RunOptions, Source, run
from stillroom.storage import StoredMap, save_map

RGB = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
DEPTH_M = np.ones((CAMERA.height, CAMERA.width), np.float32)
RGBD, STEREO, MONOCULAR = Sensor


def map_of(sensor: Sensor, path: Path) -> Path:
    life = EventfulLife(0)
    life.world.sensor = sensor
    for _ in range(8):
        life.happen(0)
    save_map(path, StoredMap(life.world, CAMERA, (session(),)))
    return path


@pytest.mark.parametrize(
    ("made_with", "sensor", "use", "message"),
    [
        (MONOCULAR, RGBD, "continue", "lengths of a single camera are known up to a factor"),
        (MONOCULAR, STEREO, "continue", "lengths of a single camera are known up to a factor"),
        (RGBD, MONOCULAR, "continue", "lengths of a single camera are known up to a factor"),
        (STEREO, MONOCULAR, "continue", "lengths of a single camera are known up to a factor"),
        (MONOCULAR, RGBD, "localize", "lengths of a single camera are known up to a factor"),
        (MONOCULAR, STEREO, "localize", "lengths of a single camera are known up to a factor"),
        (STEREO, RGBD, "continue", "one map holds one sensor's keyframes; --localize works with any sensor"),
        (RGBD, STEREO, "continue", "one map holds one sensor's keyframes; --localize works with any sensor"),
    ],
)
def test_a_map_of_another_sensor_is_refused(
    made_with: Sensor, sensor: Sensor, use: str, message: str, tmp_path: Path
) -> None:
    path = map_of(made_with, tmp_path / "room.stillmap")
    before = path.read_bytes()
    with pytest.raises(MapError, match=message) as raised:
        sr.Slam("orb-slam2", CAMERA, map=path, map_use=use, sensor=sensor, sequence="a walk")
    said = str(raised.value)
    assert "\n" not in said
    assert f"is a map of {made_with.words} images, and a walk has {sensor.words} ones" in said
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["room.stillmap"]


@pytest.mark.parametrize("use", ["continue", "localize"])
def test_a_map_that_was_dropped_as_a_whole_is_refused(use: str, tmp_path: Path) -> None:
    path = map_of(MONOCULAR, tmp_path / "whole.stillmap")
    world = sr.load_map(path).world
    submaps.discard(0, world)
    save_map(tmp_path / "room.stillmap", StoredMap(world, CAMERA, (session(),)))
    with pytest.raises(MapError, match="holds no keyframe; there is nothing to recognise"):
        sr.Slam("orb-slam2", CAMERA, map=tmp_path / "room.stillmap", map_use=use, sensor=MONOCULAR)


def test_what_only_localizes_begins_no_map(tmp_path: Path) -> None:
    path, asked = map_of(MONOCULAR, tmp_path / "room.stillmap"), ["monocular.patience=5"]
    with sr.Slam("orb-slam2", CAMERA, map=path, map_use="localize", sensor=MONOCULAR, settings=asked) as slam:
        assert slam.system.recovery.config.patience == 0


def test_a_metric_map_of_another_sensor_can_be_localized_in(tmp_path: Path) -> None:
    """A stereo map has what an RGB-D one has, so one of these, with its sensor changed, stands for it."""
    sequence = sr.select(sr.open_dataset("synthetic:empty,frames=40"), "0:40")
    with sr.Slam("orb-slam2", sequence.camera) as slam:
        for image in list(sequence)[:25]:
            slam.process(image)
    slam.map.sensor = STEREO
    slam.save_map(tmp_path / "room.stillmap")
    assert sr.load_map(tmp_path / "room.stillmap").world.sensor is STEREO
    with sr.Slam("orb-slam2", sequence.camera, map=tmp_path / "room.stillmap", map_use="localize") as visitor:
        states = [visitor.process(image).state for image in list(sequence)[25:40]]
    assert states[-1] is sr.TrackingState.OK
    assert sr.evaluate(visitor.trajectory(), sequence).as_given.ate_se3_m.rmse < 0.02


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (sr.RgbdImage(0.0, RGB, DEPTH_M), "image 0: is RGB-D; this Slam takes monocular images"),
        (sr.StereoImage(0.0, RGB, RGB[..., 0]), "image 0: is stereo; this Slam takes monocular images"),
    ],
)
def test_images_of_another_kind_are_refused(image: sr.Image, message: str) -> None:
    with sr.Slam("orb-slam2", CAMERA, sensor="monocular") as slam, pytest.raises(FrameError, match=message):
        slam.process(image)


def test_a_sensor_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="sensor is 'sonar'; it must be one of rgbd, stereo, monocular"):
        sr.Slam("orb-slam2", CAMERA, sensor="sonar")
    with pytest.raises(ConfigError, match="dynaslam-g: finds what moves in depth images alone"):
        sr.Slam("dynaslam-g", CAMERA, sensor="monocular")


def test_what_is_left_out_is_said_once_and_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    dataset = Source("synthetic:walking,frames=30", frames="0:2", sensor="monocular").open()
    settings = ["semantics.kind=truth"]
    with caplog.at_level(logging.WARNING):
        outcome = run(
            dataset, sr.configure("oc-slam", overrides=settings), RunOptions(folder=tmp_path / "out", pictures=0)
        )
    said = [record.getMessage() for record in caplog.records if "left out" in record.getMessage()]
    assert len(said) == len(outcome.left_out) == 4
    assert said[0] == "oc-slam with monocular images: left out: clusters of the depth cloud"
    figures = json.loads((tmp_path / "out" / "metrics.json").read_text())["run"]
    assert figures["sensor"] == "monocular"
    assert figures["n_left_out"] == 4
    assert figures["left_out"] == list(outcome.left_out)
    assert not [doubt for doubt in outcome.doubts if doubt.name in {"no-depth", "depth-factor"}]


def test_with_rgbd_nothing_is_left_out() -> None:
    with sr.Slam("stillroom", CAMERA, settings=["semantics.kind=truth"]) as slam:
        assert slam.left_out == ()
        assert slam.sensor is RGBD


def test_a_pair_that_repeats_has_the_depth_image_of_the_one_before() -> None:
    room = sr.open_dataset("synthetic:empty,frames=20,path=halfsphere,stereo=rectified")
    shown: list[sr.Image] = []

    class Watching:
        def on_frame(self, tracked: object, semantics: object, result: object) -> None:
            shown.append(tracked.frame.image)  # type: ignore[attr-defined]

    with sr.Slam(
        "orb-slam2", room.camera, sensor=STEREO, settings=["stereo.dense=sgbm"], observers=[Watching()]
    ) as slam:
        first = room.load(0)
        slam.process(first)
        slam.process(first.at(1, first.timestamp_s + 0.1))
        assert slam.system.n_repeated == 1
    assert [image.index for image in shown] == [0, 1]
    assert shown[1].depth_m is shown[0].depth_m


@pytest.mark.parametrize("sensor", [STEREO, MONOCULAR])
def test_without_depth_images_no_setting_is_named_that_makes_no_dense_map(sensor: Sensor) -> None:
    with sr.Slam("orb-slam2", CAMERA, sensor=sensor) as slam, pytest.raises(MapError) as raised:
        slam.dense_cloud()
    assert "has no depth image" in str(raised.value)
    assert "dense.kind" not in str(raised.value)
