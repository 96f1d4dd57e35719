"""Loops of maps up to scale: the drift of the scale is found, spread over the map, and undone where a loop is wrong."""

from dataclasses import dataclass

import numpy as np
import pytest
from building import parts
from map_checks import check_links, check_same, contents
from ring_map import Ring, false_loop, monocular_ring
from small_world import CAMERA

from stillroom.data.map import Map
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.evaluation.trajectory_errors import ate
from stillroom.geometry import se3, sim3
from stillroom.loops.freedom import RigidFreedom, SimilarFreedom, depth_of, freedom_of
from stillroom.loops.loop_closer import LoopCloser, LoopsConfig
from stillroom.loops.moves import Places, carry_newer, follow_keyframes, move
from stillroom.loops.verdict import Snapshot
from stillroom.optimize.bundle import BundleResult


def closer_of(made: Ring, **changes: float) -> LoopCloser:
    closing = LoopsConfig(**changes).build(parts(CAMERA, made.map), made.places)
    assert isinstance(closing, LoopCloser)
    return closing


def run(made: Ring, closer: LoopCloser) -> list[int]:
    return [k for k in range(len(made.T_true)) if closer.close(k)]


def scale_error(made: Ring) -> float:
    """The largest difference of the scale around any keyframe from that around the first."""
    scales = made.scales()
    return float(np.nanmax(np.abs(scales / scales[0] - 1.0)))


def ate_m(made: Ring) -> float:
    alive = made.map.alive_keyframes()
    estimate = Trajectory(alive / 10.0, made.map.keyframes.T_world_cam[alive], is_metric=False)
    return ate(estimate, Trajectory(alive / 10.0, made.T_true[alive])).sim3_m.rmse


@dataclass
class Closed:
    """A ring before and after its loop was closed."""

    made: Ring
    closer: LoopCloser
    n_closed: int
    scale_before: float
    ate_before_m: float
    noted: dict[int, np.ndarray]


TO_CULL = 20
OFFSET = np.array([0.3, -0.1, 0.2, 0.1, 0.05, -0.1])
"""Of a frame's pose in its reference keyframe [m, rad]."""


@pytest.fixture(scope="module")
def closed() -> Closed:
    """A walk of 31 m whose scale drifts by 22 %; one keyframe was culled, and frames are noted in it and in others."""
    made = monocular_ring()
    world, scales = made.map, made.scales()
    noted = {}
    for k in (5, TO_CULL, 30):
        T_keyframe_cam = se3.exp(OFFSET)
        T_keyframe_cam[:3, 3] *= scales[k]
        noted[k] = world.noted_in(k, world.keyframe_pose(k) @ T_keyframe_cam)
    world.remove_keyframe(TO_CULL)
    before = scale_error(made), ate_m(made)
    closer = closer_of(made)
    return Closed(made, closer, len(run(made, closer)), *before, noted)


def test_a_drift_of_scale_is_found_and_spread_over_the_ring(closed: Closed) -> None:
    made, loop = closed.made, closed.closer.closed[0]
    assert closed.n_closed == 1
    assert closed.scale_before > 0.2
    assert closed.ate_before_m > 0.25
    assert scale_error(made) < 0.015
    assert ate_m(made) < 0.03
    assert loop.scale == pytest.approx(np.exp(-0.2 * (loop.keyframe - loop.candidate) / 43), rel=0.01)
    check_links(made.map)
    R = made.map.keyframes.T_world_cam[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9)


def test_the_map_knows_how_lengths_changed(closed: Closed) -> None:
    keyframes = closed.made.map.keyframes
    expected = np.exp(-0.2 * np.arange(len(keyframes)) / (len(keyframes) - 1))
    on_the_way = slice(0, closed.closer.closed[0].keyframe)
    np.testing.assert_allclose(keyframes.scale[on_the_way], expected[on_the_way], rtol=0.015)
    assert keyframes.scale[0] == 1.0


@pytest.mark.parametrize("keyframe", [5, TO_CULL, 30])
def test_frames_that_were_noted_before_take_part(closed: Closed, keyframe: int) -> None:
    """Also those in a keyframe that was culled: the pose in it is the true one, in the map's unit now."""
    made, world = closed.made, closed.made.map
    T_keyframe_cam = se3.inverse(world.keyframe_pose(keyframe)) @ world.placed_by(keyframe, closed.noted[keyframe])
    unit = made.scales()[0]
    np.testing.assert_allclose(T_keyframe_cam[:3, 3] / unit, se3.exp(OFFSET)[:3, 3], rtol=0.02)
    T_world_true = made.T_true[0] @ se3.inverse(world.keyframes.T_world_cam[0])
    pose = T_world_true @ world.keyframe_pose(keyframe)
    reached_m = made.T_true[0, :3, 3] + (pose[:3, 3] - made.T_true[0, :3, 3]) / unit
    assert np.linalg.norm(reached_m - made.T_true[keyframe, :3, 3]) < 0.15


def test_the_same_loop_again_gives_the_same_map_bit_for_bit() -> None:
    maps = []
    for _ in range(2):
        made = monocular_ring(n=40)
        assert run(made, closer_of(made))
        maps.append(contents(made.map))
    for name, values in maps[0].items():
        np.testing.assert_array_equal(maps[1][name], values, err_msg=name)


def test_the_unit_of_the_map_does_not_matter() -> None:
    for unit in (0.05, 20.0):
        made = monocular_ring(unit=unit)
        assert len(run(made, closer_of(made))) == 1
        assert scale_error(made) < 0.015


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_sixty_metres_close_to_one_per_cent(seed: int) -> None:
    made = monocular_ring(seed, n=170, laps=1.12, radius_m=60.0 / (2.0 * np.pi))
    assert scale_error(made) > 0.2
    assert ate_m(made) > 0.4
    assert run(made, closer_of(made))
    assert scale_error(made) <= 0.01
    assert ate_m(made) < 0.05


@pytest.mark.parametrize(
    "changes", [{"drift_scale": 0.01, "drift_scale_per_m": 0.0}, {"drift_rad": 0.0, "sight_rad": 0.0}]
)
def test_what_drift_cannot_have_brought_about_is_refused(changes: dict[str, float]) -> None:
    made = monocular_ring()
    before = contents(made.map)
    assert run(made, closer_of(made, **changes | {"drift_rad_per_m": 0.0})) == []
    check_same(made.map, before)


def test_a_wrong_loop_is_undone_to_the_last_bit() -> None:
    made = monocular_ring(n=30, laps=0.5, drift=0.0)
    before = contents(made.map)
    closer = closer_of(made)
    assert not closer.correct(false_loop(made, 20, 4))
    check_same(made.map, before)
    assert len(closer.refused) == 1


def test_what_came_after_a_wrong_correction_gets_its_lengths_back() -> None:
    made = monocular_ring(n=12, laps=0.25, drift=0.0)
    world, small = made.map, made.small
    snapshot, unit = Snapshot(world), made.scales()[0]
    S_wrong, old = sim3.exp(np.array([[0.2, 0.1, 0.0, 0.1, 0.2, 0.0, 0.4]]))[0], Places.of(world)
    everything = np.arange(len(world.points))
    move(range(12), S_wrong, float(np.exp(0.4)), world)
    follow_keyframes(everything, old, world)
    world.refresh_geometry(everything)
    # A keyframe that is added meanwhile, in the lengths of then.
    T_step = se3.inverse(made.T_true[10]) @ made.T_true[11]
    T_step[:3, 3] *= unit * np.exp(0.4)
    frame, seen = small.world.look(made.T_true[11] @ se3.inverse(made.T_true[10]) @ made.T_true[11], depth_share=0.0)
    new = world.add_keyframe(frame, world.keyframes.T_world_cam[11] @ T_step, small.id_of[seen], frame.is_static, 11)
    snapshot.restore(world)
    step = se3.inverse(world.keyframes.T_world_cam[11]) @ world.keyframes.T_world_cam[new]
    np.testing.assert_allclose(step[:3, 3], T_step[:3, 3] / np.exp(0.4), atol=1e-9)
    np.testing.assert_array_equal(world.keyframes.scale[:12], 1.0)
    assert world.keyframes.scale[new] == pytest.approx(np.exp(-0.4))


def test_a_similarity_moves_points_as_their_keyframes_see_them() -> None:
    made = monocular_ring(n=6, laps=0.1, drift=0.0)
    world, before = made.map, Places.of(made.map)
    own = world.points_of(2)
    ids = own[(own >= 0)]
    ids = ids[world.points.first_keyframe[ids] == 2]
    seen = se3.transform(se3.inverse(world.keyframes.T_world_cam[2]), world.points.position_m[ids])
    move([2], sim3.exp(np.array([[0.1, 0.2, 0.3, 0.3, 0.2, 0.1, 0.7]]))[0], float(np.exp(0.7)), world)
    follow_keyframes(np.arange(len(world.points)), before, world)
    now = se3.transform(se3.inverse(world.keyframes.T_world_cam[2]), world.points.position_m[ids])
    assert len(ids) > 5
    np.testing.assert_allclose(now, np.exp(0.7) * seen, atol=1e-9)
    carry_newer(len(world.keyframes), before, world)
    np.testing.assert_array_equal(world.keyframes.scale, [1, 1, np.exp(0.7), 1, 1, 1])


def test_an_adjustment_keeps_the_scale_that_images_do_not_tell() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3))
    T_world_cam = np.stack([se3.exp(0.3 * rng.normal(size=6)) for _ in range(4)])
    shrunk = T_world_cam.copy()
    centre = T_world_cam[0, :3, 3]
    shrunk[:, :3, 3] = centre + 0.7 * (T_world_cam[:, :3, 3] - centre)
    result = BundleResult(se3.inverse(shrunk), centre + 0.7 * (points - centre), np.ones(3, bool), 1.0, 1.0, 1)
    one, two = np.array([True, False, False, False]), np.array([True, True, False, False])
    found = SimilarFreedom().in_gauge(result, points, one)
    np.testing.assert_allclose(se3.inverse(found.T_cam_world), T_world_cam, atol=1e-12)
    np.testing.assert_allclose(found.points_world_m, points, atol=1e-12)
    assert SimilarFreedom().in_gauge(result, points, two) is result
    assert RigidFreedom().in_gauge(result, points, one) is result


def test_the_sensor_of_the_map_decides() -> None:
    made = monocular_ring(n=3, laps=0.02)
    assert isinstance(freedom_of(made.map), SimilarFreedom)
    for sensor in (Sensor.RGBD, Sensor.STEREO):
        assert isinstance(freedom_of(Map(made.map.scales, sensor)), RigidFreedom)
    true_depth = se3.transform(se3.inverse(made.T_true[1]), made.small.world.points_m[made.small.seen[1]])[:, 2]
    assert depth_of(1, made.map) == pytest.approx(0.4 * np.median(true_depth), rel=0.02)
