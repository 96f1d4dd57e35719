"""What earlier depth images say of a point, against a plain loop, a flat wall and rendered frames."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from building import parts
from flat_wall import WALL_M, before_the_wall, points_on_the_wall
from small_world import CAMERA, SmallWorld, pose

from stillroom.data.frame import Frame
from stillroom.data.semantics import Box
from stillroom.datasets.open import open_dataset
from stillroom.dynamics.depth_history import (
    STRIDE,
    DepthHistory,
    DepthHistoryConfig,
    Evidence,
    SmallView,
    ask,
    ask_ranges,
    depth_ranges,
)
from stillroom.features.orb import OrbConfig
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset

# A lens worse than any that is sold: a wrong term shows.
BENT = replace(CAMERA, distortion=(0.2, -0.3, 0.004, -0.006, 0.1))
NARROW = DepthHistoryConfig(tolerance_m=0.05, tolerance_share=0.02)


def asked(depth_m: np.ndarray, T_cam_world: np.ndarray, camera: Camera, points_m: np.ndarray) -> Evidence:
    """Put points to one small image."""
    answer = Evidence(np.zeros(len(points_m), np.int64), np.zeros(len(points_m), np.int64))
    ask(SmallView(depth_m, T_cam_world, camera.lens), points_m, 0.05, 0.02, answer.agrees, answer.empty)
    return answer


def plainly(depth_m: np.ndarray, T_cam_world: np.ndarray, camera: Camera, point_m: np.ndarray) -> tuple[bool, bool]:
    """One point: does a neighbour agree, and do all neighbours that know lie behind it?"""
    x, y, z = T_cam_world[:3, :3] @ point_m + T_cam_world[:3, 3]
    if z <= 0.1:
        return False, False
    raw_px, _ = cv2.projectPoints(
        np.array([[x, y, z]]), np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion)
    )
    column, row = np.floor(raw_px.ravel() / STRIDE + 0.5).astype(int)
    if raw_px.min() < STRIDE or column > depth_m.shape[1] - 2 or row > depth_m.shape[0] - 2:
        return False, False
    around = depth_m[row - 1 : row + 2, column - 1 : column + 2].ravel()
    known = [float(seen_m) for seen_m in around if seen_m > 0]
    tolerance_m = max(0.05, 0.02 * z)
    agrees = any(abs(seen_m - z) <= tolerance_m for seen_m in known)
    return agrees, bool(known) and all(seen_m > z + tolerance_m for seen_m in known)


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["straight", "bent"])
@pytest.mark.parametrize("T_world_cam", [pose(), pose(0.3, -0.2, 0.4, turn=(0.2, -0.3, 0.1))], ids=["home", "away"])
def test_the_kernel_agrees_with_a_plain_loop(camera: Camera, T_world_cam: np.ndarray) -> None:
    rng = np.random.default_rng(11)
    shape = (camera.height // STRIDE, camera.width // STRIDE)
    # Terraces a few pixels wide, 4 cm apart, with holes: neighbours disagree in all ways.
    terraces = np.kron(rng.integers(40, 60, (shape[0] // 4, shape[1] // 4)), np.ones((4, 4)))
    depth_m = np.where(rng.random(shape) < 0.3, 0.0, 0.04 * terraces).astype(np.float32)
    depth_m[40:60, 40:60] = 0
    n = 4000
    px = np.stack((rng.uniform(-40, 680, n), rng.uniform(-40, 520, n)), axis=1)
    z_m = np.where(rng.random(n) < 0.05, rng.uniform(-2.0, 0.1, n), rng.uniform(1.4, 2.6, n))
    points_m = se3.transform(T_world_cam, camera.back_project(px, z_m))
    found = asked(depth_m, se3.inverse(T_world_cam), camera, points_m)
    by_ranges = np.zeros((2, n), dtype=np.int64)
    view = SmallView(depth_m, se3.inverse(T_world_cam), camera.lens)
    ask_ranges(view, depth_ranges(depth_m), points_m, 0.05, 0.02, *by_ranges)
    np.testing.assert_array_equal(by_ranges, (found.agrees, found.empty))
    expected = np.array([plainly(depth_m, se3.inverse(T_world_cam), camera, point) for point in points_m])
    assert np.all(expected.sum(axis=0) > 200), "each answer must occur"
    assert np.sum(~expected.any(axis=1)) > 200
    np.testing.assert_array_equal(found.agrees, expected[:, 0])
    np.testing.assert_array_equal(found.empty, expected[:, 1])


def test_ranges_say_the_same_of_depths_that_are_no_numbers() -> None:
    rng = np.random.default_rng(5)
    depth_m = rng.choice(
        [np.nan, np.inf, -np.inf, -1.0, 0.0, 1.0, 2.0], (120, 160), p=[0.1, 0.1, 0.1, 0.1, 0.2, 0.2, 0.2]
    )
    depth_m = depth_m.astype(np.float32)
    px = np.stack((rng.uniform(0, 640, 3000), rng.uniform(0, 480, 3000)), axis=1)
    view = SmallView(depth_m, np.eye(4), CAMERA.lens)
    points_m = CAMERA.back_project(px, rng.uniform(0.7, 2.3, 3000))
    plain, ranged = np.zeros((2, 3000), dtype=np.int64), np.zeros((2, 3000), dtype=np.int64)
    ask(view, points_m, 0.05, 0.02, *plain)
    ask_ranges(view, depth_ranges(depth_m), points_m, 0.05, 0.02, *ranged)
    assert plain.sum(axis=1).min() > 20
    np.testing.assert_array_equal(ranged, plain)


def test_the_kernel_adds_to_what_is_counted() -> None:
    depth_m = np.full((120, 160), 2.0, np.float32)
    points_m = CAMERA.back_project(np.array([[320.0, 240.0], [320.0, 240.0]]), np.array([2.0, 1.0]))
    agrees, empty = np.array([5, 5]), np.array([7, 7])
    for _ in range(2):
        ask(SmallView(depth_m, np.eye(4), CAMERA.lens), points_m, 0.05, 0.02, agrees, empty)
    assert agrees.tolist() == [7, 5]
    assert empty.tolist() == [7, 9]


def test_what_cannot_be_projected_is_not_asked_about() -> None:
    depth_m = np.full((120, 160), 2.0, np.float32)
    points_m = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -2.0], [1e30, 0.0, 2.0], [np.nan, 0.0, 2.0], [0.0, 0.0, 1e-9]])
    answer = asked(depth_m, np.eye(4), BENT, points_m)
    assert not answer.agrees.any()
    assert not answer.empty.any()


@pytest.mark.parametrize(
    ("z_m", "seen_m", "agrees", "empty"),
    [
        (2.0, 2.049, 1, 0),
        (2.0, 2.051, 0, 1),
        (2.0, 1.951, 1, 0),
        (2.0, 1.949, 0, 0),  # Hidden then by something nearer: nobody knows.
        (5.0, 5.099, 1, 0),  # Far away the share counts.
        (5.0, 5.101, 0, 1),
        (2.0, 0.0, 0, 0),
    ],
)
def test_the_tolerance_is_the_larger_of_a_length_and_a_share(
    z_m: float, seen_m: float, agrees: int, empty: int
) -> None:
    depth_m = np.full((120, 160), seen_m, np.float32)
    answer = asked(depth_m, np.eye(4), CAMERA, CAMERA.back_project(np.array([[300.0, 200.0]]), np.array([z_m])))
    assert (answer.agrees[0], answer.empty[0]) == (agrees, empty)


def frame_at(time_s: float, T_world_cam: np.ndarray, figure: Box | None = None, camera: Camera = CAMERA) -> Frame:
    """A frame without keypoints that saw the wall."""
    frame, _ = SmallWorld.of(0, 0).look(T_world_cam)
    frame = replace(frame, camera=camera, image=replace(frame.image, timestamp_s=time_s))
    return before_the_wall(frame, T_world_cam, figure)


def test_a_wall_is_where_it_was_and_what_stands_before_it_was_not() -> None:
    """From three poses, through a bent lens: the wall's distance is known from geometry alone."""
    history = DepthHistory(replace(NARROW, ages_s=(1.0, 2.0, 3.0)))
    for age_s, T_world_cam in ((3.0, pose(-0.2)), (2.0, pose(0.1, 0.1, -0.3, turn=(0.05, 0.1, 0.2))), (1.0, pose(0.2))):
        history.remember(frame_at(10.0 - age_s, T_world_cam, camera=BENT), se3.inverse(T_world_cam))
    on_wall = points_on_the_wall(n=200).points_m
    seen = np.all(np.abs(on_wall[:, :2]) < (0.9, 0.6), axis=1)
    evidence = history.evidence(BENT, on_wall[seen], 10.0)
    assert seen.sum() > 30
    assert evidence.agrees.tolist() == [3] * seen.sum()
    assert not evidence.empty.any()
    evidence = history.evidence(BENT, on_wall[seen] * (1.0, 1.0, 0.9), 10.0)
    assert not evidence.agrees.any()
    assert evidence.empty.tolist() == [3] * seen.sum()
    evidence = history.evidence(BENT, on_wall[seen] * (1.0, 1.0, 1.1), 10.0)
    assert not evidence.agrees.any()
    assert not evidence.empty.any(), "what the wall hides was not seen to be empty"


def test_what_is_remembered_is_a_copy() -> None:
    history, frame, T_cam_world = DepthHistory(NARROW), frame_at(9.0, pose()), np.eye(4)
    history.remember(frame, T_cam_world)
    T_cam_world[0, 3] = 7.0
    frame.image.depth_m[:] = 1.0
    evidence = history.evidence(CAMERA, np.array([[0.0, 0.0, WALL_M]]), 10.0)
    assert evidence.agrees.tolist() == [1]


def depths_at(history: DepthHistory, now_s: float) -> list[float]:
    """When the images that are asked were taken: each showed the wall at a distance of its own time."""
    times_s = []
    for tenth in range(400):
        evidence = history.evidence(CAMERA, np.array([[0.0, 0.0, 1.0 + tenth]]), now_s)
        times_s += [tenth / 10.0] * int(evidence.agrees[0])
    return times_s


def remember_until(history: DepthHistory, end_s: float) -> None:
    """Ten images a second, each a flat surface at 1 m + 10 m for each second."""
    frame = frame_at(0.0, pose())
    for tenth in range(round(10 * end_s) + 1):
        depth_m = np.full_like(frame.image.depth_m, 1.0 + tenth)
        image = replace(frame.image, timestamp_s=tenth / 10.0, depth_m=depth_m)
        history.remember(replace(frame, image=image), np.eye(4))


def test_images_of_the_configured_ages_are_asked() -> None:
    """Of images half a second apart those nearest to each age, once each, and none of just now."""
    config = DepthHistoryConfig(0.5, (0.3, 0.4, 1.1, 2.6, 5.2), tolerance_m=0.3, tolerance_share=0.0)
    history = DepthHistory(config)
    remember_until(history, 8.0)
    assert depths_at(history, 8.3) == [3.0, 5.5, 7.0, 8.0]
    assert depths_at(history, 8.2) == [3.0, 5.5, 7.0], "0.2 s is less than half the interval: the same people"


def test_what_is_asked_at_the_start_is_what_there_is() -> None:
    history = DepthHistory(replace(NARROW, tolerance_m=0.3, tolerance_share=0.0))
    assert depths_at(history, 0.0) == []
    remember_until(history, 0.0)
    assert depths_at(history, 0.1) == []
    assert depths_at(history, 4.0) == [0.0]


def test_the_oldest_age_bounds_what_is_kept() -> None:
    history = DepthHistory(DepthHistoryConfig(0.5, (2.0,), tolerance_m=0.3, tolerance_share=0.0))
    remember_until(history, 20.0)
    assert depths_at(history, 20.4) == [18.5]
    assert depths_at(history, 12.0) == [], "what was two seconds old then is gone by now"


@pytest.fixture(scope="module")
def walk() -> Dataset:
    """Figures walk in from both sides in the second second; with the noise of a Kinect."""
    return open_dataset("synthetic:walking,frames=20,fps=8,cache=off")


def test_on_rendered_frames_the_room_agrees_and_who_walked_in_stands_where_it_was_empty(walk: Dataset) -> None:
    assert walk.groundtruth is not None
    T_world_cam, extract = walk.groundtruth.T_world_cam, OrbConfig().build(parts(walk.camera)).extract
    history = DepthHistory(DepthHistoryConfig())
    for index in range(14):
        history.remember(extract(walk.load(index)), se3.inverse(T_world_cam[index]))
    image = walk.load(14)
    assert image.truth is not None
    kernel = np.ones((9, 9), np.uint8)
    known = image.depth_m > 0
    figures = cv2.erode((image.truth.movable & known).astype(np.uint8), kernel) > 0
    room = cv2.dilate(image.truth.movable.astype(np.uint8), kernel) == 0
    # Three steps from the border, so that a camera that moved on still saw the place.
    inner = np.zeros_like(room)
    inner[40:-40:3, 40:-40:3] = True
    shares = {}
    for name, chosen in (("figures", figures), ("room", room & known)):
        row, column = np.nonzero(chosen & inner)
        px = np.stack((column, row), axis=1).astype(np.float64)
        points_m = walk.camera.back_project(px, image.depth_m[row, column])
        evidence = history.evidence(walk.camera, se3.transform(T_world_cam[14], points_m), image.timestamp_s)
        shown = (evidence.agrees >= 1) & (evidence.empty == 0)
        shares[name] = (len(row), float(np.mean(shown)), float(np.mean(evidence.empty > 0)))
    assert shares["figures"][0] > 1000
    assert shares["room"][0] > 10000
    assert shares["room"][1] > 0.99
    assert shares["room"][2] < 0.005
    assert shares["figures"][2] > 0.98
    assert shares["figures"][1] < 0.02


def test_when_the_map_jumps_the_past_jumps_along() -> None:
    history, jump = DepthHistory(NARROW), pose(0.7, -0.2, 0.4, turn=(0.1, 0.5, -0.2))
    history.remember(frame_at(9.0, pose()), np.eye(4))
    on_wall = points_on_the_wall(n=200).points_m
    on_wall = on_wall[np.all(np.abs(on_wall[:, :2]) < (0.9, 0.6), axis=1)]
    before = history.evidence(CAMERA, on_wall, 10.0)
    history.follow(jump)
    after = history.evidence(CAMERA, se3.transform(jump, on_wall), 10.0)
    assert before.agrees.all()
    np.testing.assert_array_equal(after.agrees, before.agrees)
    assert not history.evidence(CAMERA, on_wall, 10.0).agrees.all()
