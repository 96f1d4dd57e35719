"""Maps whose scale was corrected: what is noted in keyframes is in the file in lengths as they are now."""

from pathlib import Path

import numpy as np
import pytest
from random_map import session
from small_world import CAMERA, SCALES, SmallMap, SmallWorld, pose

from stillroom.data.map import Map
from stillroom.data.sensor import Sensor
from stillroom.geometry import se3, sim3
from stillroom.loops.moves import Places, follow_keyframes, move, rescale_culled
from stillroom.storage import FrameNote, StoredMap, load_map, save_map
from stillroom.storage.map_export import keyframe_trajectories, trajectories
from stillroom.storage.writer import MapWriter

GROWTH = 1.6
OFFSETS = [se3.exp(np.array([0.02 * i, -0.01, 0.03, 0.0, 0.1, 0.02 * i])) for i in range(5)]


def grown_map() -> SmallMap:
    """A map of one camera; keyframe 2 is culled."""
    small = SmallMap(SmallWorld.of(0, 500), Map(SCALES, Sensor.MONOCULAR))
    for k in range(5):
        small.add(pose(0.1 * k, turn=(0, 0.02 * k, 0)), depth_share=0.0)
    small.map.remove_keyframe(2)
    return small


def correct(world: Map) -> None:
    """Do what a loop does to the last keyframes: 1 and those after it, and what hangs on them."""
    before = Places.of(world)
    move([1, 3, 4], sim3.exp(np.array([[0.3, 0.0, 0.1, 0.0, 0.2, 0.0, np.log(GROWTH)]]))[0], GROWTH, world)
    rescale_culled(before, world)
    follow_keyframes(np.arange(len(world.points)), before, world)
    world.refresh_geometry(np.arange(len(world.points)))


def note(k: int, index: int, world: Map) -> FrameNote:
    """A frame that was tracked beside a keyframe."""
    T_world_cam = world.keyframe_pose(k) @ OFFSETS[k]
    return FrameNote(0, index, index / 30.0, k, world.noted_in(k, T_world_cam))


def poses_of(world: Map, notes: list[FrameNote]) -> np.ndarray:
    return np.array([world.placed_by(one.reference_keyframe, one.T_reference_cam) for one in notes])


@pytest.mark.parametrize("times", [1, 2])
def test_frames_that_were_written_before_a_correction_come_back_where_they_are(times: int, tmp_path: Path) -> None:
    path, world = tmp_path / "room.stillmap", grown_map().map
    early = [note(k, k, world) for k in range(5)]
    with MapWriter.create(path, world, CAMERA) as writer:
        writer.begin(session())
        writer.commit(early)
        for _ in range(times):
            correct(world)
            writer.commit()
        late = [note(k, 10 + k, world) for k in range(5)]
        writer.commit(late)
    stored = load_map(path)
    np.testing.assert_array_equal(stored.world.keyframes.scale, 1.0)
    assert world.keyframes.scale.tolist() == pytest.approx([1.0, *[GROWTH**times] * 4])
    np.testing.assert_allclose(
        poses_of(stored.world, list(stored.frames)), poses_of(world, [*early, *late]), atol=1e-12
    )
    np.testing.assert_allclose(stored.world.keyframe_pose(2), world.keyframe_pose(2), atol=1e-12)
    # As they are now: an early frame is as far from its keyframe as was noted, times what lengths grew by.
    step = stored.frames[3].T_reference_cam[:3, 3]
    np.testing.assert_allclose(step, GROWTH**times * OFFSETS[3][:3, 3], atol=1e-12)


def test_a_map_that_goes_on_is_corrected_once_more(tmp_path: Path) -> None:
    path, world = tmp_path / "room.stillmap", grown_map().map
    notes = [note(k, k, world) for k in range(5)]
    correct(world)
    save_map(path, StoredMap(world, CAMERA, (session(),), tuple(notes)))
    again = load_map(path)
    again.world.sensor = Sensor.MONOCULAR
    with MapWriter.go_on(path, again.world) as writer:
        correct(again.world)
        writer.commit()
    correct(world)
    found = load_map(path)
    np.testing.assert_allclose(poses_of(found.world, list(found.frames)), poses_of(world, notes), atol=1e-12)
    np.testing.assert_allclose(found.world.keyframe_pose(2), world.keyframe_pose(2), atol=1e-12)


def test_exported_trajectories_say_that_they_are_up_to_scale() -> None:
    world = grown_map().map
    notes = tuple(note(k, k, world) for k in range(5))
    correct(world)
    stored = StoredMap(world, CAMERA, (session(),), notes)
    (frames,), (keyframes,) = trajectories(stored), keyframe_trajectories(stored)
    assert not frames.is_metric
    assert not keyframes.is_metric
    np.testing.assert_allclose(frames.T_world_cam, poses_of(world, list(notes)), atol=1e-12)
