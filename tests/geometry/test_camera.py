"""The camera against OpenCV's projection and undistortion."""

import dataclasses

import cv2
import numpy as np
import pytest

from stillroom.errors import CalibrationError
from stillroom.geometry.camera import Camera, brown_conrady
from stillroom.geometry.distortion import distorted

IDEAL = Camera(640, 480, 535.4, 539.2, 320.1, 247.6)
BONN = Camera(640, 480, 542.822841, 542.57687, 315.59352, 237.756098, (0.039903, -0.099343, -0.00073, -0.000144, 0.0))
FREIBURG1 = Camera(
    640, 480, 517.306408, 516.469215, 318.64304, 255.313989, (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
)


def points_in_view(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(0)
    z = rng.uniform(0.5, 6, n)
    return np.stack((rng.uniform(-0.5, 0.5, n) * z, rng.uniform(-0.4, 0.4, n) * z, z), axis=1)


def cv2_pixels(camera: Camera, points: np.ndarray, distortion: np.ndarray | None) -> np.ndarray:
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, distortion)
    return pixels.reshape(-1, 2)


@pytest.mark.parametrize("camera", [IDEAL, BONN, FREIBURG1])
def test_project_agrees_with_opencv_without_distortion(camera: Camera) -> None:
    points = points_in_view()
    np.testing.assert_allclose(camera.project(points), cv2_pixels(camera, points, None), atol=1e-9)


@pytest.mark.parametrize("camera", [BONN, FREIBURG1])
def test_undistort_undoes_opencvs_distortion(camera: Camera) -> None:
    points = points_in_view()
    raw = cv2_pixels(camera, points, np.array(camera.distortion))
    inside = np.all((raw > -20) & (raw < [660, 500]), axis=1)
    undistorted = camera.undistort(raw[inside].astype(np.float32))
    assert undistorted.dtype == np.float32
    assert np.abs(raw - camera.project(points)).max() > 1
    np.testing.assert_allclose(undistorted, camera.project(points)[inside], atol=1e-3)


def test_undistort_agrees_with_opencvs_own() -> None:
    raw = np.random.default_rng(1).uniform(0, 1, (100, 2)).astype(np.float32) * [640, 480]
    expected = cv2.undistortPoints(
        raw.reshape(-1, 1, 2), FREIBURG1.K, np.array(FREIBURG1.distortion), None, None, FREIBURG1.K
    )
    np.testing.assert_allclose(FREIBURG1.undistort(raw), expected.reshape(-1, 2), atol=0.1)


@pytest.mark.parametrize("strength", [1.0, 3.0, -1.0, -3.0])
def test_undistort_is_opencvs_iteration_where_that_converges(strength: float) -> None:
    # Distortion of the other sign, as strong, takes the corners of the image beyond where the lens can see.
    camera = dataclasses.replace(FREIBURG1, distortion=tuple(strength * k for k in FREIBURG1.distortion))
    raw = np.random.default_rng(4).uniform([0, 0], [640, 480], (5000, 2)).astype(np.float32)
    iterated = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 5 folded one into the other
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-6)
    points = raw.astype(np.float64).reshape(-1, 1, 2)
    expected = iterated(points, camera.K, np.array(camera.distortion), R=np.eye(3), P=camera.K, criteria=criteria)
    expected, found = expected.reshape(-1, 2), camera.undistort(raw)
    converged = np.linalg.norm(camera.distort(expected) - raw, axis=1) < 1e-3
    assert converged.mean() > 0.85
    np.testing.assert_allclose(found[converged], expected[converged], rtol=1e-6)
    assert np.isfinite(found).all()


def test_undistort_leaves_an_ideal_image_and_no_points_alone() -> None:
    raw = np.random.default_rng(2).uniform(0, 400, (10, 2)).astype(np.float32)
    np.testing.assert_array_equal(IDEAL.undistort(raw), raw)
    assert not IDEAL.is_distorted
    assert BONN.is_distorted
    assert BONN.undistort(np.zeros((0, 2), dtype=np.float32)).shape == (0, 2)


@pytest.mark.parametrize("camera", [IDEAL, FREIBURG1])
def test_back_project_undoes_project(camera: Camera) -> None:
    points = points_in_view()
    np.testing.assert_allclose(camera.back_project(camera.project(points), points[:, 2]), points, atol=1e-12)


def test_right_coordinate_is_where_a_camera_one_baseline_to_the_right_sees_the_point() -> None:
    points = points_in_view()
    left_px = BONN.project(points)
    right_px = BONN.project(points - [BONN.baseline_m, 0, 0])
    np.testing.assert_allclose(BONN.right_coordinate(left_px[:, 0], points[:, 2]), right_px[:, 0], atol=1e-3)


def test_right_coordinate_of_an_unknown_depth_is_minus_one() -> None:
    right = IDEAL.right_coordinate(np.array([100.0, 100.0], np.float32), np.array([0.0, 1.0], np.float32))
    np.testing.assert_allclose(right, [-1, 60])


def test_bounds_are_the_image_where_nothing_is_distorted() -> None:
    assert IDEAL.undistorted_bounds_px == (0, 0, 639, 479)


def test_bounds_come_from_the_undistorted_corners() -> None:
    x_min, y_min, x_max, y_max = FREIBURG1.undistorted_bounds_px
    corners = FREIBURG1.undistort(np.array([[0, 0], [639, 0], [0, 479], [639, 479]], np.float32))
    assert (x_min, y_min) == pytest.approx(corners.min(0), abs=1e-3)
    assert (x_max, y_max) == pytest.approx(corners.max(0), abs=1e-3)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"fx": 0.0}, "fx"),
        ({"fy": -500.0}, "fy"),
        ({"cx": float("nan")}, "cx"),
        ({"width": 0}, "width"),
        ({"depth_factor": 0.0}, "depth_factor"),
        ({"bf": float("inf")}, "bf"),
        ({"distortion": (0.1, 0.2)}, "distortion"),
        ({"distortion": (0.1, 0.2, float("nan"), 0.0, 0.0)}, "distortion"),
    ],
)
def test_an_impossible_camera_is_refused_by_name(change: dict[str, object], word: str) -> None:
    with pytest.raises(CalibrationError, match=word):
        dataclasses.replace(IDEAL, **change)


@pytest.mark.parametrize("camera", [IDEAL, BONN, FREIBURG1])
def test_a_ray_is_seen_where_opencv_projects_it_to_in_kernels_and_out_of_them(camera: Camera) -> None:
    points = points_in_view()
    expected = cv2_pixels(camera, points, np.array(camera.distortion))
    x, y = (points[:, :2] / points[:, 2:]).T
    in_kernels = np.array([distorted(camera.lens, *ray) for ray in zip(x, y, strict=True)])
    np.testing.assert_allclose(in_kernels, expected, atol=1e-9)
    np.testing.assert_array_equal(np.stack(brown_conrady(camera.lens, x, y), axis=1), in_kernels)


def test_a_lens_holds_floats_in_opencvs_order_whatever_the_camera_was_given() -> None:
    lens = Camera(640, 480, 500, 510, 320, 240, (1, 2, 3, 4, 5)).lens
    assert lens == (500.0, 510.0, 320.0, 240.0, 1.0, 2.0, 3.0, 4.0, 5.0)
    assert all(type(value) is float for value in lens), "kernels would be compiled once more for whole numbers"


def test_a_turned_image_has_the_calibration_that_troubleshooting_gives() -> None:
    """A quarter turn counter-clockwise, as `np.rot90` makes it: row `distortion` of docs/troubleshooting.md."""
    k1, k2, p1, p2, k3 = 0.26, -0.95, -0.005, 0.0026, 1.16
    upright = Camera(640, 480, 517.3, 516.5, 318.6, 255.3, distortion=(k1, k2, p1, p2, k3))
    turned = Camera(480, 640, 516.5, 517.3, 255.3, 639.0 - 318.6, distortion=(k1, k2, -p2, p1, k3))
    points = np.random.default_rng(0).uniform((-0.9, -0.7, 2.0), (0.9, 0.7, 4.0), (200, 3))
    seen_px = upright.distort(upright.project(points))
    points_turned = np.column_stack((points[:, 1], -points[:, 0], points[:, 2]))
    expected_px = np.column_stack((seen_px[:, 1], 639.0 - seen_px[:, 0]))
    np.testing.assert_allclose(turned.distort(turned.project(points_turned)), expected_px, atol=1e-9)
    unturned = dataclasses.replace(turned, distortion=upright.distortion)
    assert np.abs(unturned.distort(unturned.project(points_turned)) - expected_px).max() > 1.0
