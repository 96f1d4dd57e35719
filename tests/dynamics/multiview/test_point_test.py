"""The two kernels of multi-view geometry against plain loops."""

from collections import deque
from dataclasses import replace

import cv2
import numpy as np
import pytest
from small_world import CAMERA, pose

from stillroom.dynamics.multiview.multiview_geometry import offsets, rays_of
from stillroom.dynamics.multiview.multiview_kernels import (
    AGREES,
    BORDER,
    DYNAMIC,
    EMPTY,
    STATIC,
    STEEP,
    UNCONFIRMED,
    UNKNOWN,
    UNSEEN,
    Growth,
    Here,
    KeyframeDepths,
    Limits,
    Points,
    PointVerdicts,
    grow,
    judge_points,
    project,
)
from stillroom.dynamics.multiview.views import STRIDE, with_neighbours
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera

# A lens worse than any that is sold: a wrong term shows.
BENT = replace(CAMERA, distortion=(0.2, -0.3, 0.004, -0.006, 0.1))
LIMITS = Limits(float(np.cos(np.deg2rad(8.0))), 0.15, 0.01, 4.0, 2, 0.02, 0.004, True, 0.05, 0.02)
HERE = pose(0.05, -0.03, 0.02, turn=(0.02, -0.03, 0.01))
VIEWS = np.stack([pose(), pose(0.3, -0.2, 0.1, turn=(0.05, -0.1, 0.02))])
WINDOW = offsets(2)


def terraces(seed: int, shape: tuple[int, int], size: int, step_m: float = 0.04) -> np.ndarray:
    """Depths in flat squares with holes: neighbours agree, differ by little, and differ by much."""
    rng = np.random.default_rng(seed)
    steps = rng.integers(30, 60, (shape[0] // size, shape[1] // size))
    depth_m = step_m * np.kron(steps, np.ones((size, size)))
    return np.where(rng.random(shape) < 0.02, 0.0, depth_m).astype(np.float32)


def on_pixel(camera: Camera, T_cam_world: np.ndarray, point_m: np.ndarray) -> tuple[float, float, float]:
    """Where a point lies in an image as taken, by OpenCV's own words, and how deep."""
    x, y, z = T_cam_world[:3, :3] @ point_m + T_cam_world[:3, 3]
    if z <= 0.1:
        return -1.0, -1.0, z
    px, _ = cv2.projectPoints(np.array([[x, y, z]]), np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion))
    return *px.ravel(), z


def plain_sees(small_m: np.ndarray, T_cam_world: np.ndarray, camera: Camera, place_m: np.ndarray) -> int:
    """What a keyframe says of a place: one pixel after the other."""
    u, v, z = on_pixel(camera, T_cam_world, place_m)
    if z <= 0.1 or u < 0 or v < 0:
        return UNKNOWN
    column, row = int(np.floor(u / STRIDE + 0.5)), int(np.floor(v / STRIDE + 0.5))
    if row >= small_m.shape[0] or column >= small_m.shape[1]:
        return UNKNOWN
    around = small_m[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2].ravel()
    known = [float(depth_m) for depth_m in around if depth_m > 0]
    if not known:
        return UNKNOWN
    tolerance_m = max(LIMITS.tolerance_m, LIMITS.tolerance_share * z)
    asked = [float(small_m[row, column]), min(known), max(known)]
    if any(abs(depth_m - z) <= tolerance_m for depth_m in asked):
        return AGREES
    return EMPTY if min(known) > z else UNKNOWN


def plain_verdict(point_world_m: np.ndarray, k: int, depth_m: np.ndarray, small_m: np.ndarray, camera: Camera) -> int:
    """The test of one point, word by word (DynaSLAM III.C)."""
    u, v, z = on_pixel(camera, se3.inverse(HERE), point_world_m)
    column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    height, width = depth_m.shape
    if z <= 0.1 or not (0 <= column < width and 0 <= row < height) or z > LIMITS.far_m:
        return UNSEEN
    a, b = HERE[:3, 3] - point_world_m, VIEWS[k, :3, 3] - point_world_m
    if a @ b / np.linalg.norm(a) / np.linalg.norm(b) < LIMITS.min_parallax_cosine:
        return STEEP
    known, nearer = False, None
    for du, dv in WINDOW:
        if 0 <= column + du < width and 0 <= row + dv < height:
            seen_m = float(depth_m[row + dv, column + du])
            known |= seen_m > 0
            if nearer is None and 0 < seen_m < z:
                nearer = (column + du, row + dv, seen_m)
    if not known:
        return UNSEEN
    if nearer is None or z - nearer[2] <= LIMITS.tau_m + LIMITS.tau_per_m * z**2:
        return STATIC
    column, row, near_m = nearer
    reach = LIMITS.patch_px
    patch = depth_m[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]
    if np.std(patch[patch > 0].astype(np.float64)) > LIMITS.std_m + LIMITS.std_per_m * near_m**2:
        return BORDER
    raw_px = np.array([[column, row]], np.float32)
    place_m = se3.transform(HERE, camera.back_project(camera.undistort(raw_px), np.array([near_m])))[0]
    confirmed = plain_sees(small_m[k], se3.inverse(VIEWS[k]), camera, place_m) == EMPTY
    return DYNAMIC if confirmed else UNCONFIRMED


def scene(camera: Camera, n: int) -> tuple[Here, KeyframeDepths, Points, np.ndarray, np.ndarray]:
    """A present image of terraces, two keyframes of others, and points all over; with the keyframes' own pixels."""
    rng = np.random.default_rng(5)
    depth_m = terraces(1, (camera.height, camera.width), 16)
    small_m = np.stack([terraces(2 + k, (120, 160), 8) for k in range(2)])
    # Some keyframes saw farther: what stands here now is then confirmed.
    small_m[:, :, 60:] += np.float32(0.8) * (small_m[:, :, 60:] > 0)
    here = Here(depth_m, rays_of(camera), HERE, camera.lens)
    T_cam_world = se3.inverse(VIEWS)
    centres_m = np.stack(
        [se3.transform(T, np.stack((V[:3, 3], HERE[:3, 3]))) for T, V in zip(T_cam_world, VIEWS, strict=True)]
    )
    there = KeyframeDepths(
        np.stack([with_neighbours(m) for m in small_m]), T_cam_world, se3.inverse(HERE) @ VIEWS, centres_m
    )
    px = np.stack((rng.uniform(-30, 670, n), rng.uniform(-30, 510, n)), axis=1)
    z_m = np.where(rng.random(n) < 0.04, rng.uniform(-2.0, 0.1, n), rng.uniform(1.2, 4.3, n))
    points_cam = camera.back_project(px, z_m)
    seen_in = rng.integers(0, 2, n)
    points = Points(points_cam, seen_in, np.empty((n, 2), np.int32), np.empty(n))
    return here, there, points, small_m, depth_m


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["straight", "bent"])
def test_a_point_is_judged_as_by_plain_words(camera: Camera) -> None:
    n = 4000
    here, there, points, small_m, depth_m = scene(camera, n)
    project(points, there, here.lens, camera.height, camera.width)
    verdict, before_px = np.full(n, UNSEEN, np.uint8), np.full((n, 2), -1, np.int32)
    judge_points(np.arange(n), points, here, there, WINDOW, LIMITS, PointVerdicts(verdict, before_px))
    expected = np.empty(n, np.uint8)
    for i in range(n):
        k = points.seen_in[i]
        point_world_m = VIEWS[k][:3, :3] @ points.cam_m[i] + VIEWS[k][:3, 3]
        expected[i] = plain_verdict(point_world_m, k, depth_m, small_m, camera)
    counts = np.bincount(expected, minlength=6)
    assert np.all(counts >= 40), f"each verdict must occur: {counts}"
    # Two roundings of one position may differ where it lies half-way between pixels.
    assert np.count_nonzero(verdict != expected) <= 2
    stands_before = np.isin(verdict, (BORDER, UNCONFIRMED, DYNAMIC))
    np.testing.assert_array_equal(before_px[stands_before].min(axis=1) >= 0, True)
    nearer_m = depth_m[before_px[stands_before, 1], before_px[stands_before, 0]]
    assert np.all(points.z_m[stands_before] - nearer_m > LIMITS.tau_m)


def test_only_chosen_points_are_judged() -> None:
    here, there, points, _, _ = scene(CAMERA, 500)
    project(points, there, here.lens, CAMERA.height, CAMERA.width)
    everything, some = np.full(500, 99, np.uint8), np.full(500, 99, np.uint8)
    before_px = np.full((500, 2), -1, np.int32)
    judge_points(np.arange(500), points, here, there, WINDOW, LIMITS, PointVerdicts(everything, before_px))
    chosen = np.arange(3, 500, 7)
    judge_points(chosen, points, here, there, WINDOW, LIMITS, PointVerdicts(some, before_px))
    np.testing.assert_array_equal(some[chosen], everything[chosen])
    assert np.all(np.delete(some, chosen) == 99)


def plain_regions(depth_m: np.ndarray, seeds: np.ndarray, growth: Growth) -> np.ndarray:
    """Breadth-first growth with a running mean, in the words of the books."""
    taken = np.zeros(depth_m.shape, bool)
    refused = np.zeros(depth_m.shape, bool)
    for column, row in seeds:
        if depth_m[row, column] <= 0 or taken[row, column] or refused[row, column]:
            continue
        members, waiting = [(row, column)], deque([(row, column)])
        taken[row, column] = True
        mean = float(depth_m[row, column])
        while waiting:
            v, u = waiting.popleft()
            for q, p in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
                if not (0 <= q < depth_m.shape[0] and 0 <= p < depth_m.shape[1]) or taken[q, p] or refused[q, p]:
                    continue
                z = float(depth_m[q, p])
                near_mean = abs(z - mean) < growth.mean_m + growth.mean_per_m * z**2
                near_neighbour = abs(z - float(depth_m[v, u])) <= growth.step_m + growth.step_per_m * z**2
                if z > 0 and near_mean and near_neighbour:
                    taken[q, p] = True
                    members.append((q, p))
                    waiting.append((q, p))
                    mean += (z - mean) / len(members)
        if len(members) < growth.min_pixels:
            for member in members:
                taken[member], refused[member] = False, True
    return taken


@pytest.mark.parametrize(
    "growth",
    [
        Growth(0.2, 0.0, 100.0, 0.0, 1, 0.0),
        Growth(0.3, 0.02, 0.03, 0.008, 30, 0.0),
        Growth(0.1, 0.0, 0.05, 0.0, 1, 0.0),
    ],
    ids=["paper", "ours", "tight"],
)
def test_regions_grow_as_a_plain_search_grows_them(growth: Growth) -> None:
    rng = np.random.default_rng(8)
    # Slopes, steps, noise and holes.
    row, column = np.mgrid[:120, :160]
    depth_m = 1.5 + 0.004 * column + 0.5 * ((row // 30 + column // 40) % 2) + rng.normal(0, 0.01, (120, 160))
    depth_m = np.where(rng.random(depth_m.shape) < 0.1, 0.0, depth_m).astype(np.float32)
    seeds = np.stack((rng.integers(0, 160, 25), rng.integers(0, 60, 25)), axis=1).astype(np.int32)
    here = Here(depth_m, np.zeros((120, 160, 2), np.float32), np.eye(4), CAMERA.lens)
    there = KeyframeDepths(
        np.zeros((0, 1, 1, 3), np.float32), np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), np.zeros((0, 2, 3))
    )
    region = np.zeros(depth_m.shape, np.uint8)
    grow(seeds, here, there, growth, LIMITS, region)
    expected = plain_regions(depth_m, seeds, growth)
    assert 300 < expected.sum() < 0.9 * expected.size
    np.testing.assert_array_equal(region.view(np.bool_), expected)


def test_regions_stop_at_what_keyframes_saw_there() -> None:
    """A figure on the floor: its depth runs on into the floor's, which was there before."""
    depth_m = np.full((240, 320), 2.0, np.float32)  # every second pixel
    before = np.full((120, 160), 3.0, np.float32)  # the wall behind ...
    before[90:] = 2.0  # ... and what the figure's feet stand on
    here = Here(depth_m, rays_of(CAMERA, 2), np.eye(4), CAMERA.lens)
    views = np.stack([with_neighbours(before)] * 3)
    there = KeyframeDepths(views, np.stack([np.eye(4)] * 3), np.stack([np.eye(4)] * 3), np.zeros((3, 2, 3)))
    region = np.zeros(depth_m.shape, np.uint8)
    seeds = np.array([[160, 20]], np.int32)
    growth = Growth(0.2, 0.0, 0.1, 0.0, 1, 0.0)
    grow(seeds, here, there, growth, LIMITS, region)
    assert region[:176].all()
    assert not region[182:].any()
    # Seeds on the floor grow nothing.
    region[:] = 0
    grow(seeds + np.int32([0, 200]), here, there, growth, LIMITS, region)
    assert not region.any()


def test_the_window_is_a_square_nearest_first() -> None:
    window = offsets(20)
    assert window[0].tolist() == [0, 0]
    assert len({tuple(offset) for offset in window.tolist()}) == len(window) == 41 * 41
    assert np.all(np.diff((window**2).sum(axis=1)) >= 0)
    assert np.abs(window).max() == 20
