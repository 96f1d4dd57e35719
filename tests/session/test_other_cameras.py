"""A metric map, and another camera that is localized in it: of another sensor, image size or focal length."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import stillroom as sr
from stillroom.data.frame import ScaleLevels
from stillroom.protocols import Dataset

ROOM = "synthetic:empty,frames=40,path=halfsphere"


@dataclass(frozen=True)
class Other:
    """A camera that sees the middle of another's images, `share` of their sides, in images of another width."""

    share: float
    width: int

    def camera(self, camera: sr.Camera) -> sr.Camera:
        x0, y0, w, h = self._window(camera)
        ratio = self.width / w
        return replace(
            camera,
            width=self.width,
            height=round(h * ratio),
            fx=camera.fx * ratio,
            fy=camera.fy * ratio,
            cx=(camera.cx - x0 + 0.5) * ratio - 0.5,
            cy=(camera.cy - y0 + 0.5) * ratio - 0.5,
        )

    def image(self, image: sr.Image, camera: sr.Camera, sensor: str) -> sr.Image:
        x0, y0, w, h = self._window(camera)
        size, window = (self.width, round(h * self.width / w)), np.s_[y0 : y0 + h, x0 : x0 + w]
        how = cv2.INTER_AREA if self.width < w else cv2.INTER_CUBIC
        rgb = np.ascontiguousarray(cv2.resize(image.rgb[window], size, interpolation=how))
        if sensor == "monocular":
            return sr.MonoImage(image.timestamp_s, rgb)
        depth_m = cv2.resize(image.depth_m[window], size, interpolation=cv2.INTER_NEAREST)
        return sr.RgbdImage(image.timestamp_s, rgb, depth_m)

    def _window(self, camera: sr.Camera) -> tuple[int, int, int, int]:
        w, h = round(self.share * camera.width), round(self.share * camera.height)
        return (camera.width - w) // 2, (camera.height - h) // 2, w, h


SAME = Other(1.0, 640)


@dataclass(frozen=True)
class Visit:
    """What a camera found in a map of another."""

    share_tracked: float
    ate_m: float
    n_inliers: float
    trajectory: sr.Trajectory


def mapped(images: list[sr.Image], camera: sr.Camera, other: Other, path: Path) -> Path:
    """The map that a camera makes of every second image."""
    with sr.Slam("orb-slam2", other.camera(camera), map=path) as slam:
        for image in images[::2]:
            slam.process(other.image(image, camera, "rgbd"))
    return path


def visited(sequence: Dataset, images: list[sr.Image], path: Path, other: Other, sensor: str = "rgbd") -> Visit:
    """What another finds in it by the images between."""
    before = path.read_bytes()
    camera = other.camera(sequence.camera)
    with sr.Slam("orb-slam2", camera, map=path, map_use="localize", sensor=sensor) as visitor:
        results = [visitor.process(other.image(image, sequence.camera, sensor)) for image in images[1::2]]
    assert path.read_bytes() == before
    found = [result for result in results if result.T_world_cam is not None]
    trajectory = visitor.trajectory()
    return Visit(
        len(found) / len(results),
        sr.evaluate(trajectory, sequence).as_given.ate_se3_m.rmse,
        float(np.median([result.n_inliers for result in found])),
        trajectory,
    )


@pytest.fixture(scope="module")
def desk(freiburg1_xyz: Path) -> tuple[Dataset, list[sr.Image]]:
    sequence = sr.open_dataset(str(freiburg1_xyz))
    return sequence, list(sequence)


@pytest.fixture(scope="module")
def desk_map(desk: tuple[Dataset, list[sr.Image]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    sequence, images = desk
    return mapped(images, sequence.camera, SAME, tmp_path_factory.mktemp("desk") / "whole.stillmap")


@pytest.fixture(scope="module")
def narrow_map(desk: tuple[Dataset, list[sr.Image]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    sequence, images = desk
    return mapped(images, sequence.camera, Other(0.5, 640), tmp_path_factory.mktemp("desk") / "narrow.stillmap")


@pytest.mark.parametrize(
    ("other", "sensor"),
    [
        (SAME, "monocular"),
        (Other(1.0, 960), "rgbd"),
        (Other(1.0, 480), "rgbd"),
        (Other(0.75, 960), "rgbd"),
        (Other(0.6, 480), "monocular"),
        (Other(0.5, 640), "rgbd"),
    ],
)
def test_a_metric_map_knows_the_place_of_another_camera(
    other: Other, sensor: str, desk: tuple[Dataset, list[sr.Image]], desk_map: Path
) -> None:
    found = visited(*desk, desk_map, other, sensor)
    assert found.share_tracked == 1.0
    assert found.ate_m < 0.012  # 0.0067 of the map itself
    assert found.trajectory.is_metric, "the map gives the lengths that a single camera does not measure"


@pytest.mark.parametrize("sensor", ["rgbd", "monocular"])
def test_a_wide_camera_is_localized_in_the_map_of_a_narrow_one(
    sensor: str, desk: tuple[Dataset, list[sr.Image]], narrow_map: Path
) -> None:
    found = visited(*desk, narrow_map, SAME, sensor)
    assert found.share_tracked == 1.0
    assert found.ate_m < 0.015


def test_points_are_searched_on_the_levels_where_the_other_camera_sees_them(
    desk: tuple[Dataset, list[sr.Image]], desk_map: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a focal length twice as long, by the levels of the map's own camera fewer are found."""
    narrow = Other(0.5, 640)
    found = visited(*desk, desk_map, narrow)
    monkeypatch.setattr(ScaleLevels, "reach", lambda self, other: 1.0)
    as_its_own = visited(*desk, desk_map, narrow)
    assert found.n_inliers > 1.5 * as_its_own.n_inliers


@pytest.mark.parametrize("pair", ["rectified", "turned"])
def test_a_pair_is_localized_in_the_map_of_an_rgbd_camera(pair: str, tmp_path: Path) -> None:
    room, pairs = sr.open_dataset(ROOM), sr.open_dataset(f"{ROOM},stereo={pair}")
    path = mapped(list(room), room.camera, SAME, tmp_path / "room.stillmap")
    with sr.Slam("orb-slam2", pairs.camera, map=path, map_use="localize", sensor="stereo") as visitor:
        states = [visitor.process(image).state for image in list(pairs)[1::2]]
    assert states.count(sr.TrackingState.OK) == len(states)
    assert sr.evaluate(visitor.trajectory(), pairs).as_given.ate_se3_m.rmse < 0.02
