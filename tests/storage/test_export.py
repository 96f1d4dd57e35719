"""What other programs get, read by them or by a plain reader of their format."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from evo.tools import file_interface
from random_map import EventfulLife, session
from small_world import CAMERA

from stillroom.data.image import RgbdImage
from stillroom.data.sensor import Sensor
from stillroom.errors import MapError
from stillroom.geometry import se3
from stillroom.storage.map_export import keyframe_trajectories, trajectories, write_colmap, write_trajectories
from stillroom.storage.schema import FrameNote, StoredMap


@pytest.fixture
def stored() -> StoredMap:
    life = EventfulLife(11)
    life.happen(30)
    life.world.keyframes.submap[:] = 0
    life.world.keyframes.timestamp_s[:] = np.arange(len(life.world.keyframes)) / 10.0
    return StoredMap(life.world, CAMERA, (session(),))


def images_of(stored: StoredMap) -> Iterator[tuple[int, RgbdImage]]:
    """An image of each keyframe, as taken; its colours tell the column (red) and the row (green) of a pixel."""
    columns, rows = np.meshgrid(np.arange(640) / 3, np.arange(480) / 2)
    rgb = np.stack((columns, rows, np.full_like(rows, 77)), axis=2).astype(np.uint8)
    for keyframe in stored.world.alive_keyframes().tolist():
        yield keyframe, RgbdImage(0.0, rgb, np.zeros((480, 640), np.float32), keyframe)


def lines(path: Path) -> list[list[str]]:
    said = path.read_text(encoding="utf-8").splitlines()
    return [line.split() for line in said if not line.startswith("#")]


def test_colmap_projects_its_points_to_its_keypoints(stored: StoredMap, tmp_path: Path) -> None:
    """Read as COLMAP's documentation says, every track leads to the keypoint and near it, by OpenCV's projection."""
    world = stored.world
    for k in world.alive_keyframes():  # the life of this map moved keyframes at random; let them see what they saw
        rows = world.rows(int(k))
        seen = world.keypoints.point[rows]
        T_cam_world = se3.inverse(world.keyframes.T_world_cam[k])
        points_cam = se3.transform(T_cam_world, world.points.position_m[np.maximum(seen, 0)])
        keep = (seen >= 0) & (points_cam[:, 2] > 0.1)
        world.keypoints.px[rows][keep] = CAMERA.project(points_cam[keep])
    model = write_colmap(stored, images_of(stored), tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["cameras.txt", "images", "images.txt", "points3D.txt"]

    [(number, kind, width, height, *parameters)] = lines(model.files[0])
    assert (number, kind, width, height) == ("1", "PINHOLE", "640", "480")
    fx, fy, cx, cy = map(float, parameters)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    image_lines = lines(model.files[1])
    images = {}
    for head, keypoints in zip(image_lines[::2], image_lines[1::2], strict=True):
        w, x, y, z, *translation = map(float, head[1:8])
        R = se3.from_quaternions_xyzw(np.array([[x, y, z, w]]), np.zeros((1, 3)))[0, :3, :3]
        table = np.array(keypoints, dtype=float).reshape(-1, 3)
        images[int(head[0])] = (R, np.array(translation), table)
        assert head[8] == "1"
    assert len(images) == model.n_images == len(world.alive_keyframes())

    points, n_tracked = {}, 0
    for number, x, y, z, _r, _g, _b, error, *track in lines(model.files[2]):
        points[int(number)] = np.array([x, y, z], dtype=float)
        errors = []
        for image, place in zip(map(int, track[::2]), map(int, track[1::2]), strict=True):
            R, t, table = images[image]
            assert table[place, 2] == int(number)
            px, _ = cv2.projectPoints(points[int(number)], cv2.Rodrigues(R)[0], t, K, None)
            if (R @ points[int(number)] + t)[2] > 0.1:
                errors.append(np.linalg.norm(px.ravel() - table[place, :2]))
            n_tracked += 1
        assert max(errors, default=0.0) < 0.01
        assert float(error) == pytest.approx(np.mean(errors), abs=0.01) or len(errors) < len(track) // 2
    assert len(points) == model.n_points > 100
    assert n_tracked == sum(int((table[:, 2] > 0).sum()) for _, _, table in images.values())


def test_frames_go_where_their_keyframes_are_now(stored: StoredMap, tmp_path: Path) -> None:
    world = stored.world
    poses = [se3.exp(np.full(6, 0.01 * i)) for i in range(4)]
    frames = [FrameNote(0, i, i / 30.0, 1, poses[i]) for i in (2, 0, 3, 1)]
    later = [FrameNote(1, i, i / 30.0, 0, poses[i]) for i in range(2)]
    two = replace(stored, sessions=(session(), session(4)), frames=(*frames, *later))
    first, second = trajectories(two)
    assert first.timestamps_s.tolist() == [0.0, 1 / 30, 2 / 30, 0.1]
    expected = np.array([world.keyframe_pose(1) @ poses[i] for i in range(4)])
    np.testing.assert_allclose(first.T_world_cam, expected, atol=1e-12)
    assert len(second) == 2
    n_keyframes = [len(trajectory) for trajectory in keyframe_trajectories(two)]
    assert sum(n_keyframes) == len(world.alive_keyframes())
    assert n_keyframes[0] == int((world.alive_keyframes() < 4).sum())

    written = write_trajectories(two, tmp_path)
    names = ["trajectory_0.tum", "trajectory_1.tum", "keyframes_0.tum", "keyframes_1.tum"]
    assert [path.name for path, _ in written] == names
    for (path, n), trajectory in zip(written[:2], (first, second), strict=True):
        read = file_interface.read_tum_trajectory_file(str(path))
        assert len(read.timestamps) == n
        np.testing.assert_allclose(np.array(read.poses_se3), trajectory.T_world_cam, atol=1e-6)


def test_what_is_not_joined_stays_out(stored: StoredMap, tmp_path: Path) -> None:
    world = stored.world
    alone = int(world.alive_keyframes()[-1])
    world.keyframes.submap[alone] = 1
    frames = tuple(FrameNote(0, i, i / 30.0, k, np.eye(4)) for i, k in enumerate((0, alone, 0)))
    [trajectory] = trajectories(replace(stored, frames=frames))
    assert len(trajectory) == 2
    assert len(keyframe_trajectories(stored)[0]) == len(world.alive_keyframes()) - 1
    assert write_colmap(stored, images_of(stored), tmp_path).n_images == len(world.alive_keyframes()) - 1


def test_colmap_images_are_undistorted_and_colour_the_points(stored: StoredMap, tmp_path: Path) -> None:
    """Each keypoint has, in the image that was written, the colour of where the lens saw it."""
    for k in stored.world.alive_keyframes().tolist():
        stored.world.keyframes.image_index[k] = k
    camera = replace(CAMERA, distortion=(0.05, -0.08, 0.002, -0.001, 0.01))
    model = write_colmap(replace(stored, camera=camera), images_of(stored), tmp_path)
    image_lines, n_checked = lines(model.files[1]), 0
    expected: dict[int, list[tuple[float, float, float]]] = {}
    for head, keypoints in zip(image_lines[::2], image_lines[1::2], strict=True):
        bgr = cv2.imread(str(model.images / head[9]))
        assert bgr is not None
        assert bgr.shape == (480, 640, 3)
        for u, v, point in np.array(keypoints, dtype=float).reshape(-1, 3):
            [(column, row)] = camera.distort(np.array([[u - 0.5, v - 0.5]]))
            if point < 0 or not (10 < column < 630 and 10 < row < 470 and 0.5 < u < 639 and 0.5 < v < 479):
                continue
            np.testing.assert_allclose(bgr[round(v - 0.5), round(u - 0.5), 1:], (row / 2, column / 3), atol=2.0)
            expected.setdefault(int(point), []).append((column / 3, row / 2, 77.0))
            n_checked += 1
    assert n_checked > 200
    n_coloured = 0
    for line in lines(model.files[2]):
        seen = expected.get(int(line[0]), [])
        if len(seen) == len(line[8:]) // 2:  # else a keypoint of it lies at the border, where nothing is known
            np.testing.assert_allclose(np.array(line[4:7], dtype=float), np.mean(seen, axis=0), atol=2.0)
            n_coloured += 1
    assert n_coloured > 50


def test_keyframes_without_an_image_are_left_out_of_colmap(stored: StoredMap, tmp_path: Path) -> None:
    alive = stored.world.alive_keyframes()
    first = [(k, image) for k, image in images_of(stored) if k in alive[:2]]
    model = write_colmap(stored, iter(first), tmp_path)
    assert (model.n_images, model.n_without_image) == (2, len(alive) - 2)
    named = {int(line[0]) for line in lines(model.files[1])[::2]}
    assert named == set((alive[:2] + 1).tolist())
    tracks = [line[8:] for line in lines(model.files[2])]
    assert all(tracks)
    assert {int(image) for track in tracks for image in track[::2]} <= named
    in_images = {int(point) for line in lines(model.files[1])[1::2] for point in line[2::3]} - {-1}
    assert in_images == {int(line[0]) for line in lines(model.files[2])}
    for sensor, message in (
        (Sensor.RGBD, r"storage\.images=true \[see troubleshooting: colmap\]"),
        (Sensor.STEREO, r"storage\.images=true --set stereo\.dense=sgbm"),
        (Sensor.MONOCULAR, "a single camera has none"),
    ):
        stored.world.sensor = sensor
        with pytest.raises(MapError, match=message):
            write_colmap(stored, iter(()), tmp_path)
