"""The camera goes on as it went."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillroom.geometry import se3
from stillroom.tracking.last_frame import ConstantVelocity

STEP = se3.exp(np.array([0.03, -0.01, 0.05, 0.02, -0.04, 0.01]))
START = se3.exp(np.array([1.0, 2.0, -0.5, 0.4, 0.3, -0.9]))


def test_without_a_past_the_camera_stands_still() -> None:
    model = ConstantVelocity()
    assert not model.is_known
    np.testing.assert_allclose(model.predict(START), np.linalg.inv(START), atol=1e-12)


def test_a_steady_motion_is_predicted_exactly() -> None:
    model, poses = ConstantVelocity(), [START]
    for _ in range(20):
        poses.append(poses[-1] @ STEP)
    for last, now, following in zip(poses, poses[1:], poses[2:], strict=False):
        model.update(last, now)
        assert model.is_known
        np.testing.assert_allclose(model.predict(now), np.linalg.inv(following), atol=1e-12)


def test_the_prediction_starts_from_where_the_last_frame_is_now() -> None:
    model = ConstantVelocity()
    model.update(START, START @ STEP)
    moved = se3.exp(np.array([0.2, 0, 0, 0, 0.1, 0])) @ START @ STEP  # mapping moved the map
    np.testing.assert_allclose(model.predict(moved), np.linalg.inv(moved @ STEP), atol=1e-12)


def test_a_forgotten_velocity_is_unknown() -> None:
    model = ConstantVelocity()
    model.update(START, START @ STEP)
    model.forget()
    assert not model.is_known
    np.testing.assert_allclose(model.predict(START), np.linalg.inv(START), atol=1e-12)


def test_the_velocity_stays_a_rigid_motion() -> None:
    model = ConstantVelocity()
    bent = START.copy()
    bent[:3, :3] *= 1.0 + 1e-4
    model.update(START, bent)
    rotation = model.predict(np.eye(4))[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert Rotation.from_matrix(rotation).magnitude() < 1e-6
