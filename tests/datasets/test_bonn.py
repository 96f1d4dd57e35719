"""Bonn's ground truth: the marker's pose as given, and the camera's, checked against the images themselves."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.data.association import associate
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.bonn import SCALED_T_MARKER_CAM, marker_calibration, marker_to_camera
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.datasets.tum import open_tum
from stillroom.geometry import se3
from stillroom.protocols import Dataset

STATIC_STARTS = (2, 47, 92, 122, 182)
"""Frames of the stretch's first 200, in which nobody moves yet."""


def test_the_calibration_is_a_rigid_motion_near_the_published_matrix() -> None:
    T_marker_cam = marker_calibration()
    R = T_marker_cam[:3, :3]
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(R) == pytest.approx(1.0)
    # docs/reference.md#bonn-ground-truth: a scale of about 1.059, and a lever arm of 1.86 cm.
    assert np.abs(SCALED_T_MARKER_CAM[:3, :3] / 1.059 - R).max() < 1e-3
    assert np.linalg.norm(T_marker_cam[:3, 3]) == pytest.approx(0.0186, abs=1e-4)


def test_the_camera_rides_rigidly_on_the_marker() -> None:
    rng = np.random.default_rng(0)
    poses = np.stack([se3.exp(rng.normal(size=6)) for _ in range(4)])
    moved = marker_to_camera(Trajectory(np.arange(4.0), poses)).T_world_cam
    lever_m = np.linalg.norm(moved[:, :3, 3] - _turned(poses[:, :3, 3]), axis=1)
    assert np.allclose(lever_m, np.linalg.norm(SCALED_T_MARKER_CAM[:3, 3]))
    R = moved[:, :3, :3]
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3))
    assert np.allclose(np.linalg.det(R), 1.0)


def _turned(positions: np.ndarray) -> np.ndarray:
    """Positions in the data set's axes: x turned round, y and z changed."""
    return np.stack((-positions[:, 0], positions[:, 2], positions[:, 1]), axis=1)


def test_opens_the_real_stretch_with_ground_truth_as_given(bonn: Path) -> None:
    sequence = open_dataset(str(bonn))
    assert len(sequence) == 560
    assert sequence.camera.fx == 542.822841
    assert "rgbd_bonn_" in sequence.camera_source
    assert sequence.groundtruth is not None
    first = np.loadtxt(bonn / "groundtruth.txt")[0]
    assert np.allclose(sequence.groundtruth.T_world_cam[0, :3, 3], first[1:4])
    assert open_tum(bonn).groundtruth_at_camera is None
    moved = sequence.groundtruth_at_camera
    assert moved is not None
    assert np.array_equal(moved.T_world_cam, marker_to_camera(sequence.groundtruth).T_world_cam)
    assert select(sequence, frames="200:300").groundtruth_at_camera is moved
    backwards = select(sequence, reverse=True).groundtruth_at_camera
    assert backwards is not None
    assert np.array_equal(backwards.T_world_cam, moved.T_world_cam[::-1])


def test_other_data_sets_keep_their_ground_truth(tiny: Path) -> None:
    sequence = open_dataset(str(tiny))
    assert sequence.groundtruth is not None
    assert sequence.groundtruth_at_camera is None


def test_the_images_move_as_the_camera_does_and_not_as_the_marker(bonn: Path) -> None:
    """Relative motions over a second, from nothing but images and depth, against both ground truths."""
    sequence = open_dataset(str(bonn))
    as_given, moved = sequence.groundtruth, sequence.groundtruth_at_camera
    assert as_given is not None
    assert moved is not None
    of_image, of_pose = associate(sequence.timestamps_s, as_given.timestamps_s)
    pose_of = dict(zip(of_image.tolist(), of_pose.tolist(), strict=True))
    errors_given, errors_moved = [], []
    for first in STATIC_STARTS:
        T_second_first = relative_motion_of_images(sequence, first, first + 30)
        for truth, errors in ((as_given, errors_given), (moved, errors_moved)):
            T_world_first, T_world_second = truth.T_world_cam[[pose_of[first], pose_of[first + 30]]]
            T_true = se3.inverse(T_world_second) @ T_world_first
            error = se3.inverse(T_true) @ T_second_first
            errors.append((np.linalg.norm(error[:3, 3]), np.degrees(se3.angle_rad(error))))
    translation_m, rotation_deg = np.median(errors_moved, axis=0)
    assert translation_m < 0.03
    assert rotation_deg < 1.0
    translation_given_m, rotation_given_deg = np.median(errors_given, axis=0)
    assert translation_given_m > 4 * translation_m
    assert rotation_given_deg > 8 * rotation_deg


def relative_motion_of_images(sequence: Dataset, first: int, second: int) -> np.ndarray:
    """`T_second_first` (4, 4) by OpenCV's own ORB and PnP."""
    cv2.setRNGSeed(0)
    orb = cv2.ORB_create(1000)
    camera, distortion = sequence.camera, np.array(sequence.camera.distortion)
    images = sequence.load(first), sequence.load(second)
    (points_first, words_first), (points_second, words_second) = (
        orb.detectAndCompute(image.gray, None) for image in images
    )
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(words_first, words_second)
    px_first = np.array([points_first[match.queryIdx].pt for match in matches])
    px_second = np.array([points_second[match.trainIdx].pt for match in matches])
    column, row = np.rint(px_first).astype(int).T
    depth_m = images[0].depth_m[row, column]
    known = (depth_m > 0) & (depth_m < 4)
    points_m = camera.back_project(camera.undistort(px_first[known]), depth_m[known])
    _, _, _, inliers = cv2.solvePnPRansac(
        points_m, px_second[known], camera.K, distortion, iterationsCount=300, reprojectionError=3.0
    )
    inliers = inliers[:, 0]
    _, rotation, translation = cv2.solvePnP(points_m[inliers], px_second[known][inliers], camera.K, distortion)
    return se3.from_rotation_translation(cv2.Rodrigues(rotation)[0], translation[:, 0])
