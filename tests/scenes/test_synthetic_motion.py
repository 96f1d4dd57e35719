"""Who walks where: closed camera paths, feet on the floor, nobody in the furniture or before the lens."""

from functools import lru_cache

import numpy as np
import pytest

from stillroom.geometry import se3
from stillroom_scenes.camera_path import PATHS
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.room import SyntheticRoom
from stillroom_scenes.scene.atlas import AtlasBuilder
from stillroom_scenes.scene.builder import Footprint
from stillroom_scenes.scene.layout import HALF_X_M, HALF_Y_M, ROOMS, build_room
from stillroom_scenes.scene.people import body, gait
from stillroom_scenes.scene.people.choreography import FIGURES, cast_for
from stillroom_scenes.scene.people.script import RAMP_S, Script
from stillroom_scenes.worlds.single import stage_for

BODY_RADIUS_M = 0.27


def room_of(figures: str, path: str, seed: int = 0, room: str = "office", frames: int = 900) -> SyntheticRoom:
    return open_synthetic(
        f"synthetic:figures={figures},path={path},seed={seed},room={room},frames={frames},noise=off,cache=off"
    )


@pytest.mark.parametrize("path", sorted(PATHS))
@pytest.mark.parametrize("frames", [60, 270, 900])
def test_a_camera_path_is_rigid_smooth_and_closed(path: str, frames: int) -> None:
    room = open_synthetic(f"synthetic:empty,path={path},frames={frames},cache=off")
    poses = room.groundtruth.T_world_cam
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (frames, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1.0)
    for index in (0, frames // 3, frames - 1):
        np.testing.assert_allclose(room.pose(index), poses[index], atol=1e-12)
    closed = np.concatenate((poses, poses[:1]))
    steps = se3.inverse(closed[:-1]) @ closed[1:]
    moved_m = np.linalg.norm(steps[:, :3, 3], axis=1)
    # The step from the last frame back to the first is a step like any other.
    assert moved_m[-1] <= 1.05 * moved_m[:-1].max()
    if frames == 900:
        assert moved_m.max() < 0.05
        assert np.degrees(se3.angle_rad(steps)).max() < 2.0


def test_paths_are_of_their_kind() -> None:
    spread = {}
    for path in PATHS:
        poses = open_synthetic(f"synthetic:empty,path={path},frames=720,cache=off").groundtruth.T_world_cam
        centred = poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)
        angles = se3.angle_rad(se3.inverse(poses[:1]) @ poses)
        spread[path] = float(np.sqrt((centred**2).sum(axis=1).mean())), float(np.degrees(angles.max()))
    assert spread["still"] == pytest.approx((0.0, 0.0), abs=1e-6)
    assert 0.12 < spread["sway"][0] < 0.35
    assert spread["rpy"][0] < 0.05
    assert spread["rpy"][1] > 15
    assert spread["halfsphere"][0] > 0.2
    assert spread["loop"][0] > 1.0
    assert spread["loop"][1] > 170


@lru_cache
def furniture_of(name: str) -> tuple[Footprint, ...]:
    return build_room(name, 0, (), AtlasBuilder()).footprints


@pytest.mark.parametrize("figures", sorted(set(FIGURES) - {"none"}))
@pytest.mark.parametrize("path", ["sway", "halfsphere", "rpy", "loop"])
@pytest.mark.parametrize("seed", [0, 1])
def test_nobody_walks_into_furniture_walls_each_other_or_the_camera(figures: str, path: str, seed: int) -> None:
    cast = cast_for(figures, seed, stage_for(path))
    times_s = np.arange(0, 60, 0.1)
    ways = np.array([[(p.x_m, p.y_m) for p in map(script.at, times_s)] for script in cast.scripts])
    assert (np.abs(ways[..., 0]) < HALF_X_M - BODY_RADIUS_M).all()
    assert (np.abs(ways[..., 1]) < HALF_Y_M - BODY_RADIUS_M).all()
    tables = [Footprint(x - 0.26, y - 0.22, x + 0.26, y + 0.22) for x, y in cast.tables]
    for name in ROOMS:
        for footprint in furniture_of(name):
            assert distances_to(footprint, ways).min() > 0.25, (name, footprint)
    for table in tables:
        assert distances_to(table, ways).min() > 0.15, table
    for a in range(len(ways)):
        for b in range(a):
            assert np.linalg.norm(ways[a] - ways[b], axis=1).min() > 0.3, (a, b)
    eyes = open_synthetic(f"synthetic:empty,path={path},seed={seed},frames=1800,cache=off").groundtruth.positions_m
    eyes = eyes[:: len(eyes) // len(times_s)][: len(times_s)]
    assert np.linalg.norm(ways - eyes[None, :, :2], axis=2).min() > 0.7


def distances_to(place: Footprint, points: np.ndarray) -> np.ndarray:
    beside = np.maximum(np.maximum(place.x_min_m - points[..., 0], points[..., 0] - place.x_max_m), 0)
    before = np.maximum(np.maximum(place.y_min_m - points[..., 1], points[..., 1] - place.y_max_m), 0)
    return np.hypot(beside, before)


@pytest.mark.parametrize("path", ["sway", "loop"])
def test_the_camera_keeps_off_furniture(path: str) -> None:
    eyes = open_synthetic(f"synthetic:empty,path={path},frames=720,cache=off").groundtruth.positions_m[:, :2]
    for name in ROOMS:
        for footprint in furniture_of(name):
            assert distances_to(footprint, eyes).min() > 0.1, (name, footprint)


@pytest.mark.parametrize("figures", sorted(set(FIGURES) - {"none"}))
def test_feet_are_on_the_floor_and_nothing_is_below(figures: str) -> None:
    room = room_of(figures, "sway")
    for time_s in np.arange(0, 20, 0.53):
        for figure in room.scene.figures:
            height_m = figure.patches(float(time_s)).shape_m[:, 2]
            assert -0.03 < height_m.min() < 0.02
        for thing in room.scene.objects:
            assert thing.patches(float(time_s)).shape_m[:, 2].min() > -0.001


@pytest.mark.parametrize("figures", sorted(set(FIGURES) - {"none"}))
def test_figures_and_objects_move_smoothly_for_ever(figures: str) -> None:
    room = room_of(figures, "sway")
    step_s = 1 / 30
    times_s = np.arange(0, 90, step_s)
    for figure in room.scene.figures:
        places = [figure.script.at(float(t)) for t in times_s]
        speed = np.hypot(np.diff([p.x_m for p in places]), np.diff([p.y_m for p in places])) / step_s
        assert speed.max() < 1.0
        assert np.abs(np.diff(speed)).max() < 0.12
        turn = (np.diff([p.heading_rad for p in places]) + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(turn).max() / step_s < 8.0
        walked = np.diff([p.walked_m for p in places]) / step_s
        np.testing.assert_allclose(walked, speed, atol=0.02)
    for thing in room.scene.objects:
        track = np.array([thing.place(float(t))[:3, 3] for t in times_s])
        assert np.linalg.norm(np.diff(track, axis=0), axis=1).max() / step_s < 2.5


def test_a_script_reaches_its_points_on_time_and_repeats() -> None:
    script = Script((0.0, 0.0), 0.0).stand(1.0).walk((1.2, 0.0), 0.6).loop().stand(2.0).walk((0.0, 0.0), 0.6)
    script.walk((1.2, 0.0), 0.6)
    leg_s = 1.2 / 0.6 + RAMP_S
    assert script.at(0.5).x_m == 0.0
    assert script.at(1.0 + leg_s).x_m == pytest.approx(1.2)
    assert script.at(1.0 + leg_s + 2.0 + leg_s).x_m == pytest.approx(0.0)
    round_s = 2.0 + 2 * leg_s
    for time_s in (4.0, 5.5, 8.1, 9.9):
        now, later = script.at(time_s), script.at(time_s + 7 * round_s)
        assert (now.x_m, now.y_m) == pytest.approx((later.x_m, later.y_m))
        assert later.walked_m - now.walked_m == pytest.approx(7 * 2.4)
    assert script.at(1.0 + leg_s / 2).speed_share == 1.0
    assert script.at(1.0 + leg_s / 2).heading_rad == pytest.approx(-np.pi / 2)


def test_bones_hang_together() -> None:
    posture = gait.Posture(phase_rad=1.1, swing_rad=0.4, carry=0.3, push=0.2, sway_rad=0.02, gaze_rad=0.2)
    motions = gait.bone_motions(posture, 1.0)
    np.testing.assert_allclose(np.linalg.det(motions[:, :3, :3]), 1.0)
    for side, sign in ((0, -1), (1, 1)):
        for joint, parent in ((body.CALF, body.THIGH), (body.FOOT, body.CALF), (body.FOREARM, body.UPPER_ARM)):
            at = np.array([*(np.array(body.JOINTS_M[joint]) * (sign, 1, 1)), 1.0])
            np.testing.assert_allclose(motions[joint + side] @ at, motions[parent + side] @ at, atol=1e-12)
    still = gait.bone_motions(gait.Posture(), 1.0)
    assert np.abs(still[body.PELVIS] - np.eye(4)).max() < 0.02


def test_the_carried_box_goes_from_table_to_table_in_the_hands() -> None:
    room = room_of("carried", "sway")
    (box,) = room.scene.objects
    plan = box.handling
    np.testing.assert_allclose(box.place(0.0)[:3, 3], plan.rest_m)
    np.testing.assert_allclose(box.place(1e4)[:3, 3], plan.put_m)
    middle_s = 0.5 * (plan.taken_s + plan.left_s)
    away = box.place(middle_s)[:3, 3] - box.figure.place(middle_s)[:3, 3]
    assert 0.3 < np.hypot(away[0], away[1]) < 0.55
    assert 0.8 < away[2] < 1.2
