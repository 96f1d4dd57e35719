"""Whole runs with a pair of cameras: a street, a vehicle at rest, and rendered rooms with and without people."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from stillroom.config import SlamConfig
from stillroom.config.sensors import fit_to_sensor
from stillroom.data.sensor import Sensor
from stillroom.datasets.open import open_dataset
from stillroom.evaluation.trajectory_errors import ate
from stillroom.geometry import se3
from stillroom.presets.registry import configure
from stillroom.protocols import Dataset
from stillroom.schedule import LiveSchedule
from stillroom.storage import StoredMap, load_map, save_map
from stillroom.system import System, build


def run(dataset: Dataset, config: SlamConfig, images: Iterable[int]) -> System:
    fitted, _ = fit_to_sensor(config, dataset.sensor)
    system = build(fitted, dataset.camera, sensor=dataset.sensor)
    for index in images:
        system.process(dataset.load(index))
    system.close()
    return system


def test_a_car_is_tracked_along_a_street(kitti: Path) -> None:
    street = open_dataset(str(kitti))
    assert street.sensor is Sensor.STEREO
    system = run(street, configure("orb-slam2"), range(len(street)))
    found, truth = system.trajectory(), street.groundtruth
    assert truth is not None
    assert len(found) == len(street) == 51
    assert ate(found, truth).se3_m.rmse < 0.2  # 0.070 is the median of five seeds
    path_m = np.linalg.norm(np.diff(truth.T_world_cam[:, :3, 3], axis=0), axis=1).sum()
    ends = [se3.inverse(poses[0]) @ poses[-1] for poses in (found.T_world_cam, truth.T_world_cam)]
    assert path_m == pytest.approx(59.9, abs=0.1)
    assert np.linalg.norm(ends[0][:3, 3] - ends[1][:3, 3]) < 0.012 * path_m


def test_a_vehicle_at_rest_stays_where_it_is(euroc_v101: Path) -> None:
    room = open_dataset(str(euroc_v101))
    system = run(room, configure("orb-slam2"), range(20))
    centres_m = system.trajectory().T_world_cam[:, :3, 3]
    assert len(centres_m) == 20
    assert np.linalg.norm(centres_m - centres_m.mean(axis=0), axis=1).max() < 0.005
    known = [float((system.features.extract(room.load(index)).keypoints.depth_m > 0).mean()) for index in (0, 40, 90)]
    assert min(known) >= 0.6


@pytest.mark.parametrize("pair", ["rectified", "turned"])
def test_a_rendered_room_without_people_is_tracked(pair: str) -> None:
    room = open_dataset(f"synthetic:empty,frames=20,path=halfsphere,stereo={pair}")
    system = run(room, configure("orb-slam2"), range(20))
    truth = room.groundtruth
    assert truth is not None
    assert len(system.trajectory()) == 20
    assert ate(system.trajectory(), truth).se3_m.rmse < 0.01


def test_people_are_kept_out_by_masks_and_by_clusters_of_the_pairs_own_depth_image() -> None:
    room = open_dataset("synthetic:walking,frames=90,stereo=rectified")
    truth = room.groundtruth
    assert truth is not None
    masked = ("semantics.kind=truth", "dynamics.kind=keep-all")
    clustered = ("semantics.kind=truth", "stereo.dense=sgbm")
    errors_m = {}
    for name, settings in (("orb-slam2", ()), ("pspnet-slam", masked), ("oc-slam", clustered)):
        system = run(room, configure(name, overrides=settings), range(60, 85))
        assert len(system.trajectory()) == 25, name
        errors_m[name] = ate(system.trajectory(), truth).se3_m.rmse
        assert (system.dense_cloud() is not None) == (name == "oc-slam")
    # People fill half of the view in the end.
    assert errors_m["orb-slam2"] > 0.03
    assert errors_m["pspnet-slam"] < 0.01
    assert errors_m["oc-slam"] < 0.01


def test_workers_make_the_depth_images_of_pairs_while_others_are_tracked() -> None:
    room = open_dataset("synthetic:walking,frames=90,stereo=rectified")
    settings = ("semantics.kind=truth", "stereo.dense=sgbm")
    fitted, _ = fit_to_sensor(configure("oc-slam", overrides=settings), room.sensor)
    system = build(fitted, room.camera, schedule=LiveSchedule(), sensor=room.sensor)
    images = [room.load(index) for index in range(60, 70)]
    for place, image in enumerate(images):
        for coming in images[place : place + 3]:
            system.begin(coming)
        result = system.process(image)
        assert result.index == image.index
    system.close()
    assert len(system.trajectory()) == 10


def test_a_map_of_wide_pairs_is_read_back_with_its_pyramid(kitti: Path, tmp_path: Path) -> None:
    street = open_dataset(str(kitti))
    world = run(street, configure("orb-slam2"), range(3)).map
    assert world.scales.finest_px == 1.0
    save_map(tmp_path / "street.stillmap", StoredMap(world, street.camera))
    assert load_map(tmp_path / "street.stillmap").world.scales == world.scales
