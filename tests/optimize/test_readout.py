"""The readout from what frames see of a map: on made-up rooms whose map may be sheared, and its velocities."""

import numpy as np
import pytest
from optimize_problems import CAMERA
from scipy.linalg import expm

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.optimize.readout import (
    FrameEvidence,
    RowsSeen,
    add_equations,
    agreed,
    eliminate,
    of_frame,
    of_one_shear,
    velocities,
)

N_FRAMES, RATE_HZ = 120, 30.0
SQUARED = 4


def generators(twist: F64) -> F64:
    """Twists (…, 6) as what they generate, (…, 4, 4)."""
    generator = np.zeros((*twist.shape[:-1], 4, 4))
    a, b, c = np.moveaxis(twist[..., 3:], -1, 0)
    generator[..., 0, 1], generator[..., 0, 2], generator[..., 1, 2] = -c, b, -a
    generator[..., 1, 0], generator[..., 2, 0], generator[..., 2, 1] = c, -b, a
    generator[..., :3, 3] = twist[..., :3]
    return generator


def matrix(twist: F64) -> F64:
    """exp of twists (…, 6) as matrices (…, 4, 4): scaled, by its series, and squared; scipy's takes far longer."""
    small, term = generators(twist) / 2**SQUARED, np.eye(4)
    found = term
    for order in range(1, 9):
        term = term @ small / order
        found = found + term
    for _ in range(SQUARED):
        found = found @ found
    return np.asarray(found)


def each(T: F64, points: F64) -> F64:
    """Points (N, 3), each moved by its own matrix (N, 4, 4)."""
    return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3])


def poses(times_s: F64) -> F64:
    """A hand that turns and sways, T_world_cam (N, 4, 4)."""
    swings = np.array([0.05, 0.03, 0.02, 0.10, 0.15, 0.05])
    speeds, phases = np.array([2.0, 3.1, 2.6, 5.0, 4.1, 6.3]), np.arange(6)
    return matrix(swings * np.sin(speeds * times_s[:, None] + phases))


def frames(
    readout_s: float, shear: F64, noise_px: float = 0.4, wrong: float = 0.05, seed: int = 0, n: int = N_FRAMES
) -> list[RowsSeen]:
    """What frames see of a wall of points of different depths, row by row; the map is sheared by a twist."""
    rng = np.random.default_rng(seed)
    times_s = np.arange(n) / RATE_HZ
    world = np.column_stack((rng.uniform(-3, 3, 600), rng.uniform(-2, 2, 600), rng.uniform(2, 5, 600)))
    seen = []
    for time_s in times_s:
        px = CAMERA.project(se3.transform(se3.inverse(poses(np.array([time_s]))[0]), world))
        inside = (np.abs(px - (320, 240)) < (300, 220)).all(axis=1)
        share = (px[inside, 1] + 0.5) / CAMERA.height - 0.5
        x = each(se3.inverse(poses(time_s + share * readout_s)), world[inside])
        x = each(matrix(share[:, None] * shear), x)
        px = CAMERA.project(x) + noise_px * rng.normal(size=(len(x), 2))
        px[rng.random(len(px)) < wrong] += 15.0
        observed = np.column_stack((px, px[:, 0] - CAMERA.bf / x[:, 2]))
        seen.append(RowsSeen(float(time_s), world[inside], observed, np.ones((len(x), 3)), share))
    return seen


def evidence(seen: list[RowsSeen], start_s: float = 0.02) -> list[FrameEvidence]:
    times_s = np.array([frame.time_s for frame in seen])
    T = poses(times_s)
    velocity = velocities(times_s, T)
    found = [
        of_frame(frame, se3.inverse(T[i]), velocity[i], CAMERA, start_s)
        for i, frame in enumerate(seen)
        if np.isfinite(velocity[i]).all()
    ]
    return [one for one in found if one is not None]


def test_exponentials_here_are_those_of_scipy() -> None:
    twists = np.random.default_rng(5).uniform(-0.5, 0.5, (50, 6))
    np.testing.assert_allclose(matrix(twists), expm(generators(twists)), rtol=0, atol=1e-13)


def test_velocities_are_those_of_the_motion() -> None:
    times_s = np.sort(np.random.default_rng(1).uniform(-0.004, 0.004, 60) + np.arange(60) / RATE_HZ)
    found = velocities(times_s, poses(times_s))
    assert np.isnan(found[:2]).all()
    assert np.isnan(found[-2:]).all()
    for i in range(2, 58):
        before, after = poses(times_s[i] + np.array([-1e-5, 1e-5]))
        step = se3.inverse(after) @ before  # exp(2e-5 ν)
        exact = np.concatenate((step[:3, 3], [step[2, 1], step[0, 2], step[1, 0]])) / 2e-5
        np.testing.assert_allclose(found[i], exact, atol=0.004)


def test_no_velocity_is_taken_across_a_gap() -> None:
    times_s = np.arange(20) / RATE_HZ
    times_s[10:] += 0.5
    known = np.isfinite(velocities(times_s, poses(times_s))).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(known), [*range(2, 8), *range(12, 18)])
    assert np.isnan(velocities(times_s[:4], poses(times_s[:4]))).all()


@pytest.mark.parametrize("shear", [np.zeros(6), np.array([0.003, -0.004, 0.001, 0.015, -0.01, 0.012])])
@pytest.mark.parametrize("readout_s", [0.0, 0.030])
def test_the_readout_is_found_whatever_the_shear_of_the_map(readout_s: float, shear: F64) -> None:
    found = agreed(evidence(frames(readout_s, shear)))
    assert abs(found.readout_s - readout_s) < 0.001
    assert abs(found.readout_s - readout_s) < 3.0 * found.sigma_s
    assert found.sigma_s < 0.001
    assert found.n_frames == N_FRAMES - 4


def test_its_uncertainty_is_that_of_repeated_trials() -> None:
    none = np.zeros(6)
    trials = [agreed(evidence(frames(0.02, none, noise_px=1.0, wrong=0.0, seed=seed, n=44))) for seed in range(12)]
    scatter_s = np.std([trial.readout_s for trial in trials])
    claimed_s = np.median([trial.sigma_s for trial in trials])
    assert 0.4 * scatter_s < claimed_s < 3.0 * scatter_s


def test_where_to_start_matters_little() -> None:
    seen = frames(0.025, np.zeros(6))
    low, high = (agreed(evidence(seen, start_s)).readout_s for start_s in (0.0, 0.05))
    assert abs(low - high) < 0.0005


def test_some_frames_that_are_wrong_change_little() -> None:
    said = evidence(frames(0.025, np.zeros(6)))
    spoilt = [one._replace(slope=-3.0 * one.slope) if 40 <= i < 50 else one for i, one in enumerate(said)]
    assert abs(agreed(spoilt).readout_s - 0.025) < 0.003


def test_a_camera_at_rest_tells_nothing_and_says_so() -> None:
    seen = frames(0.0, np.zeros(6))
    rng = np.random.default_rng(3)
    still = [
        of_frame(seen[0], se3.inverse(poses(np.zeros(1))[0]), 1e-3 * rng.normal(size=6), CAMERA, 0.02)
        for _ in range(60)
    ]
    found = agreed([one for one in still if one is not None])
    assert found.sigma_s > 0.01
    assert found.speed_px_s < 5.0


def test_a_frame_that_sees_too_little_says_nothing() -> None:
    seen = frames(0.0, np.zeros(6))[0]
    few = RowsSeen(seen.time_s, *(part[:20] for part in seen[1:]))
    assert of_frame(few, np.eye(4), np.full(6, 0.1), CAMERA, 0.02) is None


@pytest.mark.parametrize("unknowns", [(0, 6), (1, 7)])
def test_what_is_left_after_elimination_is_the_schur_complement(unknowns: tuple[int, int]) -> None:
    rng = np.random.default_rng(8)
    J, e = rng.normal(size=(30, 12)), rng.normal(size=30)
    H, b = J.T @ J, J.T @ e
    gone, left = np.arange(*unknowns), np.delete(np.arange(12), np.arange(*unknowns))
    pull = H[np.ix_(left, gone)] @ np.linalg.inv(H[np.ix_(gone, gone)])
    expected = H[np.ix_(left, left)] - pull @ H[np.ix_(gone, left)], b[left] - pull @ b[gone]
    eliminate(H, b, *unknowns)
    np.testing.assert_allclose(H[np.ix_(left, left)], expected[0], atol=1e-10)
    np.testing.assert_allclose(b[left], expected[1], atol=1e-10)


def test_an_unknown_of_which_nothing_is_known_is_left_out() -> None:
    H, b = np.diag([2.0, 0.0, 3.0]), np.array([1.0, 0.0, 3.0])
    eliminate(H, b, 0, 2)
    assert H[2, 2] == 3.0
    assert b[2] == 3.0


def test_a_readout_found_with_pose_and_twist_is_that_of_least_squares() -> None:
    """Of equations of pose and twist, twist = ρ ν + b, with b near 0: ρ as numpy solves for all of them at once."""
    rng = np.random.default_rng(9)
    J, e, velocity = rng.normal(size=(60, 12)), rng.normal(size=60), rng.normal(size=6)
    information, slope = np.zeros((7, 7)), np.zeros(7)
    add_equations(np.tril(J.T @ J), J.T @ e, np.zeros(6), velocity, information, slope)
    by_all = np.column_stack((J[:, :6], J[:, 6:] @ velocity, J[:, 6:]))
    prior = np.zeros((6, 13))
    prior[:, 7:] = np.diag(1.0 / np.repeat((0.02, 0.02), 3))
    rows = np.concatenate((by_all, prior))
    expected = np.linalg.lstsq(rows, -np.concatenate((e, np.zeros(6))), rcond=None)[0]
    readout_s, certainty = of_one_shear(information, slope)
    assert readout_s == pytest.approx(expected[6], rel=1e-8)
    assert certainty == pytest.approx(1.0 / np.linalg.inv(rows.T @ rows)[6, 6], rel=1e-8)
