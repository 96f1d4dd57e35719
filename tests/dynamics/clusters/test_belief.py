"""What a cluster inherits of the last image, against a plain loop over its points."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from small_world import CAMERA, pose
from staged_things import HOME, Thing, clusters_of, seen

from stillroom.data.clusters import PLANE
from stillroom.data.frame import Frame
from stillroom.data.semantics import Semantics
from stillroom.dynamics.cluster_evidence import STEP_PX, Belief, Sampler
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera

BENT = replace(CAMERA, distortion=(0.4, -0.1, 0.01, -0.02, 0.05))
FADES_IN_S, REACH_M = 2.0, 0.3
LEFT, RIGHT = Thing(100, 100, 150, 250, 1.5), Thing(320, 80, 200, 300, 2.0)


def inherited(
    belief: Belief, frame: Frame, semantics: Semantics, now_s: float, T_world_cam: np.ndarray = HOME
) -> np.ndarray:
    clusters = semantics.clusters
    samples = Sampler().take(frame, clusters)
    return belief.of(samples, len(clusters), se3.inverse(T_world_cam), frame.camera, now_s)


def after(frame: Frame, semantics: Semantics, *values: float, T_world_cam: np.ndarray = HOME) -> Belief:
    """Beliefs after one image."""
    belief = Belief(FADES_IN_S, REACH_M)
    belief.remember(frame, semantics.clusters, np.array(values, dtype=np.float64), se3.inverse(T_world_cam))
    return belief


def test_without_a_past_nothing_is_inherited() -> None:
    assert inherited(Belief(FADES_IN_S, REACH_M), *seen([LEFT, RIGHT], 1.0), 1.0).tolist() == [0.0, 0.0]


def test_clusters_inherit_their_own_fading_with_time() -> None:
    frame, semantics = seen([LEFT, RIGHT], 1.0)
    belief = after(frame, semantics, 3.0, -2.0)
    for now_s in (1.0, 1.1, 2.5, 9.0):
        fade = np.exp(-(now_s - 1.0) / FADES_IN_S)
        np.testing.assert_allclose(inherited(belief, frame, semantics, now_s), [3.0 * fade, -2.0 * fade], rtol=1e-6)
    # Time that goes back makes nobody surer.
    np.testing.assert_allclose(inherited(belief, frame, semantics, 0.0), [3.0, -2.0], rtol=1e-6)


def test_a_cluster_that_falls_apart_leaves_its_belief_to_all_its_parts() -> None:
    belief = after(*seen([RIGHT], 1.0), 4.0)
    halves = [replace(RIGHT, width=100), replace(RIGHT, x=420, width=100)]
    np.testing.assert_allclose(inherited(belief, *seen(halves, 1.0), 1.0), [4.0, 4.0])


def test_clusters_that_join_share_what_was_believed_by_their_sizes() -> None:
    # Three quarters and one quarter of the columns that are samples.
    parts = [replace(RIGHT, width=152), replace(RIGHT, x=472, width=48)]
    belief = after(*seen(parts, 1.0), 4.0, -2.0)
    weights = np.array([len(range(-(-part.x // 8) * 8, part.x + part.width, 8)) for part in parts])
    expected = (4.0 * weights[0] - 2.0 * weights[1]) / weights.sum()
    np.testing.assert_allclose(inherited(belief, *seen([RIGHT], 1.0), 1.0), [expected])


def test_what_was_not_seen_before_or_at_another_depth_inherits_nothing() -> None:
    belief = after(*seen([RIGHT], 1.0), 4.0)
    assert inherited(belief, *seen([LEFT], 1.0), 1.0).tolist() == [0.0]
    for change_m, value in ((-0.29, 4.0), (0.29, 4.0), (-0.31, 0.0), (0.31, 0.0)):
        moved = replace(RIGHT, depth_m=RIGHT.depth_m + change_m)
        np.testing.assert_allclose(inherited(belief, *seen([moved], 1.0), 1.0), [value])


def test_planes_and_the_unknown_are_believed_nothing_of() -> None:
    frame, semantics = seen([LEFT, RIGHT], 1.0, rim_px=16)
    belief = after(frame, semantics, 4.0, 4.0)
    labels = np.where(semantics.clusters.labels < 0, 0, PLANE).astype(np.int16)
    rest = replace(semantics, clusters=clusters_of(labels, [-1]))
    assert inherited(belief, frame, rest, 1.0).tolist() == [0.0]


def test_what_was_believed_is_kept_though_the_array_is_used_again() -> None:
    frame, semantics = seen([LEFT], 1.0)
    belief, values, T_cam_world = Belief(FADES_IN_S, REACH_M), np.array([2.0]), np.eye(4)
    belief.remember(frame, semantics.clusters, values, T_cam_world)
    values[:], T_cam_world[:3, 3] = 0.0, 5.0
    assert inherited(belief, frame, semantics, 1.0).tolist() == [2.0]


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["straight", "bent"])
def test_a_moving_camera_finds_the_place_again(camera: Camera) -> None:
    first, second = pose(0.1, 0.0, 0.2, turn=(0.02, -0.03, 0.05)), pose(0.25, -0.1, 0.1, turn=(-0.03, 0.04, 0.0))
    rng = np.random.default_rng(2)
    frame, semantics = (replace_camera(seen([LEFT, RIGHT], 1.0)[0], camera), seen([LEFT, RIGHT], 1.0)[1])
    later, now = replace_camera(seen([RIGHT], 1.2)[0], camera), seen([RIGHT], 1.2)[1]
    later = replace(later, image=replace(later.image, depth_m=later.image.depth_m + tilt()))
    values = rng.uniform(-3, 3, 2)
    belief = after(frame, semantics, *values, T_world_cam=first)
    found = inherited(belief, later, now, 1.2, second)
    expected, n_found, n_all = 0.0, 0, 0
    T_first_second = np.linalg.inv(first) @ second
    depth_m, labels = frame.image.depth_m, semantics.clusters.labels
    samples = Sampler().take(later, now.clusters)
    for point in samples.points_cam_m:
        n_all += 1
        there = T_first_second[:3, :3] @ point + T_first_second[:3, 3]
        raw_px, _ = cv2.projectPoints(there[None], np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion))
        column, row = (round(value / STEP_PX) * STEP_PX for value in raw_px.ravel().tolist())
        if there[2] <= 0.1 or not (0 <= column < 640 and 0 <= row < 480):
            continue
        if labels[row, column] >= 0 and abs(depth_m[row, column] - there[2]) <= REACH_M:
            n_found += 1
            expected += values[labels[row, column]]
    assert 0.3 * n_all < n_found < 0.9 * n_all
    np.testing.assert_allclose(found, [np.exp(-0.1) * expected / n_all], rtol=2e-3)


def replace_camera(frame: Frame, camera: Camera) -> Frame:
    return replace(frame, camera=camera)


def tilt() -> np.ndarray:
    """Depths (H, W) [m] to add, so that part of a thing lies within reach of another and part does not."""
    return np.linspace(-0.5, 0.7, 640, dtype=np.float32)[None].repeat(480, axis=0)


def test_who_left_the_view_or_stands_behind_the_camera_is_not_asked_for() -> None:
    belief = after(*seen([RIGHT], 1.0), 4.0)
    frame, semantics = seen([RIGHT], 1.0)
    for T_world_cam in (pose(3.0), pose(0, 0, 0, turn=(0, np.pi, 0)), pose(0, 4.0)):
        assert inherited(belief, frame, semantics, 1.0, T_world_cam).tolist() == [0.0]


def test_what_was_out_of_view_in_part_inherits_in_part() -> None:
    wide = Thing(0, 80, 640, 300, 2.0)
    belief = after(*seen([wide], 1.0), 4.0)
    for x_m in (-0.8, 0.8):
        # Seen from the side: 0.8 m at 2 m are 208 of its 640 px.
        (found,) = inherited(belief, *seen([wide], 1.0), 1.0, pose(x_m))
        assert found == pytest.approx(4.0 * (1 - 208 / 640), abs=0.1)
    tall = Thing(200, 0, 200, 480, 2.0)
    belief = after(*seen([tall], 1.0), 4.0)
    for y_m in (-0.8, 0.8):
        (found,) = inherited(belief, *seen([tall], 1.0), 1.0, pose(0.0, y_m))
        assert found == pytest.approx(4.0 * (1 - 209 / 480), abs=0.1)


def test_when_the_map_jumps_beliefs_jump_along() -> None:
    frame, semantics = seen([LEFT, RIGHT], 1.0)
    belief, jump = after(frame, semantics, 3.0, -2.0), pose(0.7, -0.2, 0.4, turn=(0.1, 0.5, -0.2))
    belief.follow(jump)
    np.testing.assert_allclose(inherited(belief, frame, semantics, 1.0, jump @ HOME), [3.0, -2.0], rtol=1e-6)
    nobody = Belief(FADES_IN_S, REACH_M)
    nobody.follow(jump)
    assert inherited(nobody, frame, semantics, 1.0).tolist() == [0.0, 0.0]
