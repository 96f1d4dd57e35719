"""The view that is chosen: upright, behind and above the camera, with the whole scene in the picture."""

from dataclasses import replace

import numpy as np
import pytest
from dense_clouds import EMPTY, select

from stillroom.data.dense_cloud import DenseCloud
from stillroom.geometry import se3
from stillroom.viz.cloud.view import Viewpoint, default_view, top_view, upward

WORLDS = [np.eye(4), se3.exp(np.array([3.0, -1.0, 0.5, 0.4, -1.9, 0.3]))]
"""Nothing may depend on where the world's axes point."""


def moved(cloud: DenseCloud, T: np.ndarray) -> DenseCloud:
    positions_m = se3.transform(T, cloud.positions_m).astype(np.float32)
    return replace(cloud, positions_m=positions_m, normals=(cloud.normals @ T[:3, :3].T).astype(np.float32))


def projected(view: Viewpoint, positions_m: np.ndarray) -> np.ndarray:
    seen_m = se3.transform(se3.inverse(view.T_world_cam), positions_m)
    assert seen_m[:, 2].min() > 0
    return view.camera.project(seen_m)


@pytest.mark.parametrize("T", WORLDS)
def test_up_is_the_floors_normal_though_the_camera_leans(room: DenseCloud, poses: np.ndarray, T: np.ndarray) -> None:
    lean = se3.exp(np.array([0, 0, 0, 0.2, 0, 0.1]))
    up = upward(moved(room, T).normals, T @ poses @ lean)
    assert np.degrees(np.arccos(up @ (T[:3, :3] @ [0, -1, 0]))) < 1.0


@pytest.mark.parametrize("T", WORLDS)
@pytest.mark.parametrize("choose", [default_view, top_view])
def test_the_whole_scene_is_in_the_picture_and_fills_it(room, poses, T, choose) -> None:
    cloud = moved(room, T)
    view = choose(cloud, T @ poses, 300, 200)
    px = projected(view, cloud.positions_m[view.shows(cloud.positions_m)])
    assert np.all(px > -3)
    assert np.all(px < [303, 203])
    assert np.max(np.ptp(px, axis=0) / [300, 200]) > 0.85


def test_the_eye_is_behind_and_above_the_camera_and_upright(room: DenseCloud, poses: np.ndarray) -> None:
    T = default_view(room, poses, 300, 200).T_world_cam
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    assert T[2, 3] < -1.0
    assert T[1, 3] < -0.2
    assert T[1, 2] == pytest.approx(np.sin(0.3), abs=0.02)  # Looks down.
    assert T[1, 0] == pytest.approx(0.0, abs=0.01)  # Its x axis is level.
    assert T[1, 1] > 0.9


def test_from_above_the_cameras_forward_direction_is_up_in_the_picture(room, poses) -> None:
    view = top_view(room, poses, 300, 200)
    near, far, left = projected(view, np.array([[0, 1.2, 1], [0, 1.2, 3], [-1, 1.2, 1]]))
    assert far[1] < near[1] - 20
    assert left[0] < near[0] - 20
    assert far[0] == pytest.approx(near[0], abs=5)


def test_a_ceiling_is_cut_away_and_nothing_else(room: DenseCloud, poses: np.ndarray) -> None:
    for choose in (default_view, top_view):
        shown = choose(room, poses).shows(room.positions_m)
        is_ceiling = room.normals @ np.array([0, 1, 0]) > 0.9
        is_ceiling &= room.positions_m[:, 1] < -1
        assert not shown[is_ceiling].any()
        assert shown[~is_ceiling & (room.positions_m[:, 1] > -1.1)].all()
    open_room = select(room, ~is_ceiling)
    assert default_view(open_room, poses).hidden is None


def test_stray_points_do_not_shrink_the_room(room: DenseCloud, poses: np.ndarray) -> None:
    stray = replace(room, positions_m=room.positions_m.copy())
    stray.positions_m[:5] = [50.0, 0.0, 60.0]
    whole, strayed = default_view(room, poses), default_view(stray, poses)
    np.testing.assert_allclose(strayed.T_world_cam[:3, 3], whole.T_world_cam[:3, 3], atol=0.2)


def test_a_scaled_view_puts_points_at_the_same_place_of_a_larger_picture(room, poses) -> None:
    view = default_view(room, poses, 300, 200)
    small, large = projected(view, room.positions_m), projected(view.scaled(3), room.positions_m)
    np.testing.assert_allclose((large + 0.5) / 3 - 0.5, small, atol=1e-9)


def test_one_point_or_none_and_a_camera_that_looks_down_are_no_errors(room: DenseCloud) -> None:
    down = se3.from_rotation_translation(np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), np.zeros(3))
    for cloud in (EMPTY, select(room, np.array([5]))):
        for T in (np.eye(4), down):
            for choose in (default_view, top_view):
                assert np.all(np.isfinite(choose(cloud, T[None]).T_world_cam))
