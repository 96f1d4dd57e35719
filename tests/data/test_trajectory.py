"""The TUM text format: what is written comes back, and what is wrong is named with its line."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.errors import TrajectoryError

GOOD = "1.0 1 2 3 0 0 0 1\n"


def wandering(n: int) -> Trajectory:
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.random(n, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.normal(0, 2, (n, 3))
    return Trajectory(1548339819.87426 + np.arange(n) / 30, T)


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    trajectory = wandering(50)
    trajectory.write_tum(tmp_path / "t.tum")
    back = read_tum(tmp_path / "t.tum")
    assert len(back) == 50
    np.testing.assert_allclose(back.timestamps_s, trajectory.timestamps_s, atol=1e-6)
    np.testing.assert_allclose(back.T_world_cam, trajectory.T_world_cam, atol=1e-6)
    np.testing.assert_array_equal(back.positions_m, back.T_world_cam[:, :3, 3])


def test_the_order_of_the_columns_is_tums(tmp_path: Path) -> None:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([0.5, 0.1, -0.1, 0.85]).as_matrix()
    T[:3, 3] = 1, 2, 3
    Trajectory(np.array([12.5]), T[None]).write_tum(tmp_path / "t.tum")
    row = np.loadtxt(tmp_path / "t.tum")
    expected = np.array([0.5, 0.1, -0.1, 0.85]) / np.linalg.norm([0.5, 0.1, -0.1, 0.85])
    np.testing.assert_allclose(row, [12.5, 1, 2, 3, *expected], atol=1e-6)


def test_no_poses_are_written_as_a_header_alone(tmp_path: Path) -> None:
    Trajectory(np.zeros(0), np.zeros((0, 4, 4))).write_tum(tmp_path / "t.tum")
    assert (tmp_path / "t.tum").read_text() == "# timestamp tx ty tz qx qy qz qw\n"
    with pytest.raises(TrajectoryError, match="no poses"):
        read_tum(tmp_path / "t.tum")


def test_comments_blank_lines_commas_and_negated_quaternions_are_fine(tmp_path: Path) -> None:
    (tmp_path / "t.tum").write_text("# a\n\n1 0 0 0 0 0 0 -1\n  2.5,1,2,3,0,0,1.0005,0\r\n")
    back = read_tum(tmp_path / "t.tum")
    np.testing.assert_allclose(back.T_world_cam[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(back.T_world_cam[1][:3, :3], np.diag([-1, -1, 1]), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no poses in it"),
        ("# only a header\n", "no poses in it"),
        (GOOD + "2.0 1 2 3 0 0 0\n", r":2: 7 numbers; a pose has 8"),
        (GOOD + "\n2.0 1 2 three 0 0 0 1\n", r":3: not a number in '2.0 1 2 three"),
        (GOOD + "2.0 1 nan 3 0 0 0 1\n", r":2: a number is not finite"),
        (GOOD + "2.0 1 inf 3 0 0 0 1\n", r":2: a number is not finite"),
        ("nan 1 2 3 0 0 0 1\n", r":1: a number is not finite"),
        (GOOD + "2.0 1 2 3 0 0 0 0.9\n", r":2: the quaternion has length 0.900"),
        (GOOD + "2.0 1 2 3 0 0 0 0\n", r":2: the quaternion has length 0.000"),
        ("# x\n" + GOOD + GOOD, r":3: the timestamp repeats"),
        (GOOD + "0.5 1 2 3 0 0 0 1\n", r":2: the timestamp goes back"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "t.tum"
    path.write_text(text)
    with pytest.raises(TrajectoryError, match=message) as error:
        read_tum(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_a_folder_and_a_picture_are_named(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="no such file"):
        read_tum(tmp_path / "absent.tum")
    with pytest.raises(TrajectoryError, match="cannot be read as text"):
        read_tum(tmp_path)
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\xff\xfe\x00")
    with pytest.raises(TrajectoryError, match="cannot be read as text"):
        read_tum(tmp_path / "picture.png")


def test_real_ground_truths_read(bonn: Path, freiburg1: Path) -> None:
    for folder, poses in ((bonn, 563), (freiburg1, 507)):
        truth = read_tum(folder / "groundtruth.txt")
        rows = np.loadtxt(folder / "groundtruth.txt")
        assert len(truth) == len(rows) == poses
        expected = Rotation.from_quat(rows[:, 4:]).as_matrix()
        np.testing.assert_allclose(truth.T_world_cam[:, :3, :3], expected, atol=1e-12)
        np.testing.assert_array_equal(truth.positions_m, rows[:, 1:4])
