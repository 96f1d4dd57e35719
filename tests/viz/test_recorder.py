"""Pictures of the chosen frames lie in the folder, and no others."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.data.clusters import PLANE, Clusters
from stillroom.data.frame import Frame, Keypoints, ScaleLevels
from stillroom.data.image import RgbdImage
from stillroom.data.motion import Motion
from stillroom.data.result import FrameResult, Tracked, TrackingState
from stillroom.data.semantics import Semantics
from stillroom.errors import ConfigError, StillroomError
from stillroom.geometry.camera import Camera
from stillroom.viz.clusters import draw_clusters
from stillroom.viz.marks import MOVING, STATIC
from stillroom.viz.no_observer import NoObserver
from stillroom.viz.recorder import PictureRecorder, PictureRecorderConfig, draw_verdict

CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)


def frame_at(index: int) -> tuple[Tracked, Semantics, FrameResult]:
    image = RgbdImage(index / 30, np.full((48, 64, 3), (200, 120, 40), np.uint8), np.ones((48, 64), np.float32), index)
    px = np.array([[10, 10], [30, 10], [50, 10]], np.float32)
    n = len(px)
    keypoints = Keypoints(
        px + 5, px, np.zeros(n, np.int32), np.zeros(n, np.float32), np.zeros((n, 32), np.uint8),
        np.ones(n, np.float32), np.ones(n, np.float32),
    )  # fmt: skip
    frame = Frame(image, CAMERA, ScaleLevels(), keypoints, np.array([True, False, True]))
    motion = Motion(np.array([True, True, False]), np.zeros((48, 64), bool))
    tracked = Tracked(frame, TrackingState.OK, np.eye(4), np.array([7, -1, -1], np.int32), motion)
    result = FrameResult(
        index,
        index / 30,
        TrackingState.OK,
        np.eye(4),
        n,
        1,
        1,
        1,
        False,
        0,
        np.eye(4),
        motion=motion,
        keypoints=keypoints,
    )
    return tracked, Semantics(48, 64), result


def run(observer: PictureRecorder | NoObserver, indices: range) -> None:
    for index in indices:
        observer.on_frame(*frame_at(index))


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (PictureRecorderConfig(every=4), [200, 204, 208]),
        (PictureRecorderConfig(every=0, frames=(203, 7)), [203]),
        (PictureRecorderConfig(every=5, frames=(201,)), [200, 201, 205]),
        (PictureRecorderConfig(every=0), []),
    ],
)
def test_the_chosen_frames_are_written(tmp_path: Path, config: PictureRecorderConfig, expected: list[int]) -> None:
    folder = tmp_path / "pictures"
    run(config.build(folder), range(200, 209))
    assert sorted(path.name for path in folder.glob("*")) == [f"frame_{index:05d}.png" for index in expected]
    assert folder.exists() == bool(expected)


def test_the_picture_shows_both_sieves_verdicts_in_true_colours(tmp_path: Path) -> None:
    PictureRecorderConfig(every=1, scale=4.0).build(tmp_path).on_frame(*frame_at(42))
    picture = cv2.imread(str(tmp_path / "frame_00042.png"), cv2.IMREAD_COLOR_RGB)
    assert picture.shape == (192, 256, 3)
    np.testing.assert_array_equal(picture[100, 100], [200, 120, 40])
    for x_px, color in ((10, STATIC), (30, MOVING), (50, MOVING)):
        np.testing.assert_array_equal(picture[42, round((x_px + 0.5) * 4)], color)
    tracked, semantics, _ = frame_at(42)
    keypoints, is_static = tracked.frame.keypoints, np.array([True, False, False])
    expected = draw_verdict(
        tracked.frame.image.rgb, keypoints.raw_px, is_static, tracked.is_matched, semantics, tracked.motion.moving, 4.0
    )
    np.testing.assert_array_equal(picture, expected)


def test_of_each_kind_there_is_a_picture_where_there_is_something_to_draw(tmp_path: Path) -> None:
    tracked, semantics, result = frame_at(42)
    labels = np.full((48, 64), PLANE, np.int16)
    labels[10:30, 10:30] = 0
    corners = np.zeros((1, 3), np.float32)
    one = np.array([400], np.int32)
    clusters = Clusters(labels, one, corners, corners, corners, -one, np.zeros((1, 4), np.float32))
    recorder = PictureRecorderConfig(every=1, scale=1.0, kinds=("frame", "clusters", "detections")).build(tmp_path)
    recorder.on_frame(tracked, semantics, result)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["detections_00042.png", "frame_00042.png"]
    recorder.on_frame(tracked, replace(semantics, clusters=clusters), result)
    picture = cv2.imread(str(tmp_path / "clusters_00042.png"), cv2.IMREAD_COLOR_RGB)
    expected = draw_clusters(tracked.frame.image.rgb, clusters, semantics, tracked.motion.moving, 1.0)
    np.testing.assert_array_equal(picture, expected)


def test_clusters_are_drawn_unless_they_are_not_wanted(tmp_path: Path) -> None:
    assert "clusters" in PictureRecorderConfig().kinds
    PictureRecorderConfig(every=1, kinds=()).build(tmp_path / "none").on_frame(*frame_at(42))
    assert not (tmp_path / "none").exists()


def test_an_unknown_kind_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"'clouds'.*clusters"):
        PictureRecorderConfig(kinds=("clouds",)).build(tmp_path)


def test_nothing_looks_at_nothing() -> None:
    run(NoObserver(), range(3))


@pytest.mark.parametrize(("config", "word"), [({"every": -1}, "every"), ({"scale": 0.0}, "scale")])
def test_an_impossible_value_is_named(tmp_path: Path, config: dict[str, float], word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        PictureRecorderConfig(**config).build(tmp_path)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(StillroomError, match=r"taken/.*cannot be written"):
        PictureRecorderConfig(every=1).build(tmp_path / "taken" / "pictures").on_frame(*frame_at(0))
