"""The search along epipolar lines against all pairs, written plainly, and against known geometry."""

from dataclasses import replace

import numpy as np
import pytest
from plain_epipolar import fundamental_from_motion
from plain_search import best_two, bits_between, one_to_one
from small_world import CAMERA, SCALES, SmallWorld, pose

from stillroom.features.matching import NEAR_BITS, Described, Targets, find_on_lines, keep_nearest
from stillroom.geometry import se3
from stillroom.geometry.hamming import words


def search_plainly(F: np.ndarray, first: Targets, second: Targets, epipole_px: np.ndarray) -> dict[int, int]:
    bits, wanted = bits_between(first.descriptors, second.descriptors), {}
    sigma_px = SCALES.factors[second.octave]
    near_epipole = ((second.px - epipole_px) ** 2).sum(axis=1) < 100 * sigma_px
    for i in np.flatnonzero(first.usable):
        a, b, c = F @ np.array([*first.px[i].astype(float), 1.0])
        distance_px = np.abs(a * second.px[:, 0] + b * second.px[:, 1] + c) / np.hypot(a, b)
        allowed = second.usable & (distance_px**2 <= 3.84 * sigma_px**2)
        if first.right_px[i] < 0:
            allowed &= ~((second.right_px < 0) & near_epipole)
        nearest, _ = best_two(bits[i], allowed)
        if nearest >= 0 and bits[i, nearest] <= NEAR_BITS:
            wanted[int(i)] = (nearest, int(bits[i, nearest]))
    return one_to_one(wanted)


def search_epipolar(
    F: np.ndarray, first: Targets, second: Targets, factors: np.ndarray, epipole_px: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The kernel's matches of the usable keypoints, one to one."""
    usable = [np.flatnonzero(targets.usable) for targets in (first, second)]
    described = [
        Described(t.px[chosen].astype(np.float64), t.octave[chosen], t.right_px[chosen], words(t.descriptors[chosen]))
        for t, chosen in zip((first, second), usable, strict=True)
    ]
    target, bits = find_on_lines(F, *described, factors, np.asarray(epipole_px, np.float64))
    query, found = keep_nearest(target, bits, len(usable[1]))
    return usable[0][query], usable[1][found]


def two_views(seed: int, T_world_second: np.ndarray) -> tuple[Targets, Targets, np.ndarray, np.ndarray, tuple]:
    """Targets of two noisy views of a small world, F, the epipole, and which point each keypoint is."""
    rng = np.random.default_rng(seed)
    world = SmallWorld.of(seed, 400)
    views, seen = [], []
    for k, T in enumerate((np.eye(4), T_world_second)):
        frame, numbers = world.look(T, seed=seed + k, noise_px=1.0, flips=20, depth_share=0.6)
        kp = frame.keypoints
        views.append(Targets(kp.px, kp.octave, kp.right_px, kp.descriptors, rng.random(len(frame)) < 0.8))
        seen.append(numbers)
    T_second_first = se3.inverse(T_world_second)
    t = T_second_first[:3, 3]
    epipole = CAMERA.project(t[None])[0] if abs(t[2]) > 1e-6 else np.full(2, 1e9)
    return *views, fundamental_from_motion(T_second_first, CAMERA.K), epipole, tuple(seen)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("step", [pose(0.2, 0.05, 0.02), pose(0.02, 0.01, 0.5), pose(-0.1, 0, -0.3, (0.05, -0.1, 0.1))])
def test_matches_are_those_of_the_plain_search_and_true(seed: int, step: np.ndarray) -> None:
    first, second, F, epipole_px, (seen_first, seen_second) = two_views(seed, step)
    mine, theirs = search_epipolar(F, first, second, SCALES.factors, epipole_px)
    assert dict(zip(mine.tolist(), theirs.tolist(), strict=True)) == search_plainly(F, first, second, epipole_px)
    np.testing.assert_array_equal(seen_first[mine], seen_second[theirs])
    common = np.intersect1d(seen_first[first.usable], seen_second[second.usable])
    assert len(mine) > 0.7 * len(common)


def test_near_the_epipole_a_match_needs_depth() -> None:
    first, second, F, epipole_px, _ = two_views(0, pose(0.02, 0.01, 0.5))
    blind = [replace(t, right_px=np.full_like(t.right_px, -1.0)) for t in (first, second)]
    # All of the second view's keypoints are moved next to the epipole; every line passes there.
    close = epipole_px + np.random.default_rng(0).uniform(-3, 3, second.px.shape)
    second, blind[1] = (replace(t, px=close.astype(np.float32)) for t in (second, blind[1]))
    assert len(search_epipolar(F, blind[0], blind[1], SCALES.factors, epipole_px)[0]) == 0
    assert len(search_epipolar(F, first, blind[1], SCALES.factors, epipole_px)[0]) > 0
    assert len(search_epipolar(F, blind[0], second, SCALES.factors, epipole_px)[0]) > 0


@pytest.mark.parametrize(("distance_px", "is_found"), [(15, False), (16.5, True)])
def test_how_near_is_near_grows_with_the_level(distance_px: float, is_found: bool) -> None:
    # Ten pixels on the finest level; on level 5, 1.2⁵ = 2.49 times as large, √249 = 15.8 px (ORB-SLAM2).
    first, second, F, epipole_px, _ = two_views(0, pose(0.02, 0.01, 0.5))
    first, second = (replace(t, right_px=np.full_like(t.right_px, -1.0)) for t in (first, second))
    turn_rad = np.linspace(0, 2 * np.pi, len(second.px))
    around = epipole_px + distance_px * np.stack((np.cos(turn_rad), np.sin(turn_rad)), axis=1)
    second = replace(second, px=around.astype(np.float32), octave=np.full(len(turn_rad), 5, np.int32))
    assert (len(search_epipolar(F, first, second, SCALES.factors, epipole_px)[0]) > 0) == is_found


def test_no_usable_keypoints_and_no_line_give_no_matches() -> None:
    first, second, F, epipole_px, _ = two_views(0, pose(0.2))
    nobody = replace(second, usable=np.zeros(len(second.px), bool))
    assert len(search_epipolar(F, first, nobody, SCALES.factors, epipole_px)[0]) == 0
    assert len(search_epipolar(F, nobody, first, SCALES.factors, epipole_px)[0]) == 0
    assert len(search_epipolar(np.zeros((3, 3)), first, second, SCALES.factors, epipole_px)[0]) == 0
