"""A place is recognised by pixels alone: neither the map's keyframes nor the frame have depth, nor the map a scale."""

import numpy as np
import pytest
from building import parts
from ring_map import vocabulary_of
from small_world import CAMERA, SCALES, SmallMap, SmallWorld, no_semantics, pose

from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.result import Recovery, Tracked, TrackingState
from stillroom.data.sensor import Sensor
from stillroom.dynamics.asking import Asking
from stillroom.dynamics.chain import KeepAllConfig
from stillroom.features.places.place_index import PlaceMemory
from stillroom.geometry import se3
from stillroom.tracking.low_cost import NoLowCostConfig
from stillroom.tracking.relocalizer import RecognitionConfig, RelocalizerConfig
from stillroom.tracking.tracker import TrackerConfig

UNIT = 0.3
"""A metre is this long in the map."""
KEYFRAMES = [pose(0.15 * k, turn=(0, 0.03 * k, 0)) for k in range(5)]
TRUE = pose(0.25, -0.1, 0.15, turn=(0.05, 0.1, 0.3))


@pytest.fixture(scope="module")
def small() -> SmallMap:
    world = SmallWorld.of(0, 900)
    made = SmallMap(world, Map(SCALES, Sensor.MONOCULAR))
    for T_world_cam in KEYFRAMES:
        made.add(T_world_cam, noise_px=0.3, flips=6, depth_share=0.0)
    made.map.keyframes.T_world_cam[:, :3, 3] *= UNIT
    made.map.points.position_m[:] *= UNIT
    made.map.refresh_geometry(np.arange(len(made.map.points)))
    return made


@pytest.fixture(scope="module")
def places(small: SmallMap) -> PlaceMemory:
    memory = PlaceMemory(vocabulary_of(small.world), small.map)
    memory.remember_all()
    return memory


def off(T_cam_world: np.ndarray) -> tuple[float, float]:
    """How far a pose is from the true one, in metres and radians."""
    T_world_cam = se3.inverse(T_cam_world)
    T_world_cam[:3, 3] /= UNIT
    between = se3.inverse(TRUE) @ T_world_cam
    return float(np.linalg.norm(between[:3, 3])), float(se3.angle_rad(between))


def test_the_map_and_the_frame_have_no_depth(small: SmallMap) -> None:
    """What the tests below rely on."""
    frame, _ = small.world.look(TRUE, depth_share=0.0)
    assert not (frame.keypoints.depth_m > 0).any()
    assert not (frame.keypoints.right_px >= 0).any()
    assert not (small.map.keypoints.right_px >= 0).any()


def test_a_place_is_recognised_with_its_pose(small: SmallMap, places: PlaceMemory) -> None:
    frame, seen = small.world.look(TRUE, seed=99, noise_px=0.3, flips=20, depth_share=0.0)
    bag = places.bag_of_frame(frame)
    found = RecognitionConfig().build(parts()).recognise(frame, bag, 2, places.index.nodes(2), small.map)
    assert found is not None
    error_m, error_rad = off(found.T_cam_world)
    assert error_m < 0.01
    assert error_rad < 0.005
    has = found.point_ids >= 0
    assert found.n_inliers >= 100
    assert np.mean(small.id_of[seen[has]] == found.point_ids[has]) > 0.98


@pytest.mark.parametrize("by_place", [True, False])
def test_a_lost_camera_is_found_again(small: SmallMap, places: PlaceMemory, by_place: bool) -> None:
    whole = parts(CAMERA, small.map)
    sieve = Asking(KeepAllConfig().build(whole), small.map)
    tracker = TrackerConfig().build(whole, sieve, NoLowCostConfig().build(whole, sieve))
    config = RelocalizerConfig(n_places=5 if by_place else 0, n_keyframes=10)
    relocalizer = config.build(whole, tracker, places)
    frame, _ = small.world.look(TRUE, seed=5, noise_px=0.3, flips=6, depth_share=0.0)
    nothing = Motion.none(len(frame), CAMERA.height, CAMERA.width)
    lost = Tracked(frame, TrackingState.LOST, None, np.full(len(frame), -1, np.int32), nothing, -1)
    found = relocalizer.recover(lost, no_semantics(), small.map)
    assert found.state is TrackingState.OK
    assert found.recovery is (Recovery.PLACE if by_place else Recovery.LAST_KEYFRAMES)
    assert found.T_world_cam is not None
    error_m, error_rad = off(se3.inverse(found.T_world_cam))
    assert error_m < 0.01
    assert error_rad < 0.005
