"""Rectification of a pair: the published one of EuRoC's rig, and points that must come out in one row."""

from dataclasses import replace

import numpy as np
import pytest

from stillroom.datasets.euroc import EUROC_LEFT, EUROC_RIGHT, RECTIFIED_CENTER_PX, RECTIFIED_FOCAL_PX
from stillroom.errors import CalibrationError
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.geometry.stereo_rig import Rectification, StereoRig

RIG = StereoRig(EUROC_LEFT.camera, EUROC_RIGHT.camera, se3.inverse(EUROC_RIGHT.T_body_cam) @ EUROC_LEFT.T_body_cam)
PINHOLE = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)
# ORB-SLAM2, Examples/Stereo/EuRoC.yaml, LEFT.R and RIGHT.R
PUBLISHED_LEFT = np.array(
    [
        [0.999966347530033, -0.001422739138722922, 0.008079580483432283],
        [0.001365741834644127, 0.9999741760894847, 0.007055629199258132],
        [-0.008089410156878961, -0.007044357138835809, 0.9999424675829176],
    ]
)
PUBLISHED_RIGHT = np.array(
    [
        [0.9999633526194376, -0.003625811871560086, 0.007755443660172947],
        [0.003680398547259526, 0.9999684752771629, -0.007035845251224894],
        [-0.007729688520722713, 0.007064130529506649, 0.999945173484644],
    ]
)


def aside(x: float = 0.1, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """T_right_left of a right camera at a place in the left one's frame."""
    return se3.from_rotation_translation(np.eye(3), -np.array([x, y, z]))


def test_the_rotations_are_those_published_for_euroc() -> None:
    found = RIG.rectification
    np.testing.assert_allclose(found.R_left, PUBLISHED_LEFT, atol=1e-6)
    np.testing.assert_allclose(found.R_right, PUBLISHED_RIGHT, atol=1e-6)
    as_published = Rectification.of(RIG, RECTIFIED_FOCAL_PX, RECTIFIED_CENTER_PX)
    assert as_published.camera.bf == pytest.approx(47.90639384423901, abs=1e-6)
    assert as_published.camera.fx == 435.2046959714599
    assert not as_published.camera.is_distorted


def test_points_come_out_in_one_row_at_the_disparity_of_their_depth() -> None:
    """Points are projected into the images as taken; where the maps read them is where they come out."""
    rng, found = np.random.default_rng(0), RIG.rectification
    points_m = np.column_stack((rng.uniform(-1, 1, 200), rng.uniform(-0.6, 0.6, 200), rng.uniform(2, 8, 200)))
    left_px = EUROC_LEFT.camera.distort(EUROC_LEFT.camera.project(points_m))
    in_right_m = se3.transform(RIG.T_right_left, points_m)
    right_px = EUROC_RIGHT.camera.distort(EUROC_RIGHT.camera.project(in_right_m))
    turned_m = points_m @ found.R_left.T
    expected_px = found.camera.project(turned_m)
    for taken_px, maps, shift_px in (
        (left_px, found.left_maps, 0.0),
        (right_px, found.right_maps, found.camera.bf / turned_m[:, 2]),
    ):
        want_px = expected_px - np.column_stack((np.broadcast_to(shift_px, 200), np.zeros(200)))
        inside = np.all((want_px > 1) & (want_px < (found.camera.width - 2, found.camera.height - 2)), axis=1)
        assert inside.sum() > 100
        nearest = np.rint(want_px[inside]).astype(int)
        read_px = np.column_stack([np.asarray(m)[nearest[:, 1], nearest[:, 0]] for m in maps])
        # half a pixel of rounding, of either image's scale
        assert np.abs(read_px - taken_px[inside]).max() < 0.8


def test_the_rectified_camera_is_at_the_same_place_and_turned() -> None:
    T = RIG.rectification.T_left_rectified
    np.testing.assert_allclose(T[:3, 3], 0.0)
    np.testing.assert_allclose(T[:3, :3] @ RIG.rectification.R_left, np.eye(3), atol=1e-12)


def test_a_pair_that_is_rectified_is_told() -> None:
    assert StereoRig(PINHOLE, PINHOLE, aside()).is_rectified
    assert not RIG.is_rectified
    assert not StereoRig(PINHOLE, replace(PINHOLE, cx=321.0), aside()).is_rectified
    assert not StereoRig(PINHOLE, PINHOLE, aside(y=0.001)).is_rectified


@pytest.mark.parametrize(
    ("right", "T_right_left", "message"),
    [
        (replace(PINHOLE, width=320), aside(), "640x480 pixels and the right ones 320x480"),
        (PINHOLE, aside(x=-0.1), "left and right exchanged"),
        (PINHOLE, aside(x=0.1, y=0.2), "to its right"),
        (PINHOLE, np.full((4, 4), np.nan), "no rigid motion"),
        (PINHOLE, np.diag([2.0, 1.0, 1.0, 1.0]) @ aside(), "no rigid motion"),
    ],
)
def test_an_impossible_rig_is_refused(right: Camera, T_right_left: np.ndarray, message: str) -> None:
    with pytest.raises(CalibrationError, match=message) as raised:
        StereoRig(PINHOLE, right, T_right_left)
    assert "\n" not in str(raised.value)


def test_cameras_that_look_apart_are_refused() -> None:
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    T_left_right = se3.from_rotation_translation(turn, np.array([0.1, 0.0, 0.0]))
    with pytest.raises(CalibrationError, match="turned by 90°"):
        StereoRig(PINHOLE, PINHOLE, se3.inverse(T_left_right))
