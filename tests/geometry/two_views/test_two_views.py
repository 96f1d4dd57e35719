"""Two views of known scenes: planes, rooms and pure rotations, with noise and wrong pairs; oracles are OpenCV's."""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from plain_epipolar import fundamental_from_motion

from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.geometry.two_views.models import fit_both
from stillroom.geometry.two_views.reconstruction import Refusal, TwoViewLimits, TwoViews, reconstruct, triangulated
from stillroom.geometry.two_views.refinement import essential, refine, sampson2

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
K = CAMERA.K
LIMITS = TwoViewLimits()


@dataclass
class Scene:
    """Pairs of two views, which of them are right, the motion, and the points in the first camera's frame."""

    first_px: np.ndarray
    second_px: np.ndarray
    is_right: np.ndarray
    T_second_first: np.ndarray
    points: np.ndarray

    def reconstructed(self, seed: int = 0) -> TwoViews | Refusal:
        return reconstruct(self.first_px, self.second_px, K, LIMITS, seed)

    def error_deg(self, T: np.ndarray) -> tuple[float, float]:
        """How far rotation and direction of a motion are from the true ones."""
        true_t, t = self.T_second_first[:3, 3], T[:3, 3]
        cosine = t @ true_t / np.linalg.norm(t) / np.linalg.norm(true_t)
        turn = float(se3.angle_rad(T @ se3.inverse(self.T_second_first)))
        return np.degrees(turn), float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def scene(kind: str, seed: int, wrong: float = 0.25, noise_px: float = 0.7, n: int = 400) -> Scene:
    rng = np.random.default_rng(seed)
    px = rng.uniform((20, 20), (620, 460), (n, 2))
    depth = rng.uniform(1.2, 4.0, n)
    if kind.startswith("plane"):
        rays = CAMERA.back_project(px, np.ones(n))
        depth = 2.5 / (rays @ np.array([0.3, -0.2, 1.0]))
    if kind == "plane and a little":
        raised = rng.random(n) < 0.15
        depth[raised] *= rng.uniform(0.6, 0.85, raised.sum())
    points = CAMERA.back_project(px, depth)
    turn = rng.normal(size=3)
    turn *= 0.08 / np.linalg.norm(turn)
    t = np.zeros(3) if kind == "turn" else np.array([0.15, 0.05, 0.06])
    T = se3.exp(np.concatenate((np.zeros(3), 3.0 * turn if kind == "turn" else turn)))
    T[:3, 3] = t
    second_px = CAMERA.project(se3.transform(T, points)) + rng.normal(0, noise_px, px.shape)
    is_right = rng.random(n) >= wrong
    second_px[~is_right] = px[~is_right] + rng.uniform(-60, 60, (np.count_nonzero(~is_right), 2))
    return Scene(px + rng.normal(0, noise_px, px.shape), second_px, is_right, T, points)


@pytest.mark.parametrize("seed", range(6))
def test_a_room_is_found_as_well_as_opencv_finds_it(seed: int) -> None:
    it = scene("room", seed)
    found = it.reconstructed(seed)
    assert isinstance(found, TwoViews)
    E, mask = cv2.findEssentialMat(it.first_px, it.second_px, K, method=cv2.USAC_MAGSAC, prob=0.999, threshold=1.0)
    _, R, t, _ = cv2.recoverPose(E, it.first_px, it.second_px, K, mask=mask)
    turn, direction = it.error_deg(found.T_second_first)
    turn_cv, direction_cv = it.error_deg(se3.from_rotation_translation(R, t.ravel()))
    assert turn < max(0.15, 1.2 * turn_cv)
    assert direction < max(1.5, 1.2 * direction_cv)
    assert np.mean(found.has_point[it.is_right]) > 0.9
    assert np.mean(found.has_point[~it.is_right]) < 0.15  # some lie on their lines by chance
    unit = np.linalg.norm(it.T_second_first[:3, 3])
    here = found.has_point & it.is_right
    ratio = unit * found.points_first[here, 2] / it.points[here, 2]
    assert abs(np.median(ratio) - 1.0) < 0.05


@pytest.mark.parametrize("seed", range(6))
def test_a_plane_with_a_little_on_it_is_found_and_a_bare_one_never_wrongly(seed: int) -> None:
    """Two motions explain a plane; what stands on it tells them apart, though the homography calls it outliers."""
    almost = scene("plane and a little", seed)
    found = almost.reconstructed(seed)
    assert isinstance(found, TwoViews)
    turn, direction = almost.error_deg(found.T_second_first)
    assert turn < 0.5
    assert direction < 6.0
    bare = scene("plane", seed)
    found = bare.reconstructed(seed)
    if isinstance(found, TwoViews):
        assert found.by_homography
        assert bare.error_deg(found.T_second_first)[1] < 12.0
    else:
        assert found in (Refusal.AMBIGUOUS, Refusal.LITTLE_PARALLAX)


def test_most_bare_planes_are_ambiguous() -> None:
    refused = [scene("plane", seed).reconstructed(seed) for seed in range(12)]
    assert sum(one is Refusal.AMBIGUOUS for one in refused) >= 4


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("wrong", [0.0, 0.25, 0.4])
def test_a_pure_rotation_is_refused(seed: int, wrong: float) -> None:
    assert scene("turn", seed, wrong).reconstructed(seed) is Refusal.LITTLE_PARALLAX


def test_little_parallax_and_few_or_random_pairs_are_refused() -> None:
    it = scene("room", 0, wrong=0.0)
    T = it.T_second_first.copy()
    T[:3, 3] *= 0.05
    it.second_px = CAMERA.project(se3.transform(T, it.points)) + np.random.default_rng(0).normal(0, 0.7, (400, 2))
    assert it.reconstructed() is Refusal.LITTLE_PARALLAX
    assert reconstruct(it.first_px[:30], it.second_px[:30], K, LIMITS, 0) is Refusal.FEW_PAIRS
    random = np.random.default_rng(1).uniform((0, 0), (640, 480), (2, 300, 2))
    assert reconstruct(*random, K, LIMITS, 0) is Refusal.NO_MOTION
    same = np.full((300, 2), 100.0)
    assert reconstruct(same, same, K, LIMITS, 0) is Refusal.NO_MOTION


def test_the_same_seed_gives_the_same_answer() -> None:
    it = scene("room", 3)
    first, again = it.reconstructed(5), it.reconstructed(5)
    assert isinstance(first, TwoViews)
    assert isinstance(again, TwoViews)
    np.testing.assert_array_equal(first.T_second_first, again.T_second_first)


def test_scores_choose_the_homography_for_planes_and_turns_and_not_for_rooms() -> None:
    shares = {}
    for kind in ("plane", "turn", "room"):
        it = scene(kind, 0)
        fitted = fit_both(it.first_px, it.second_px, 1.0, 200, 0)
        assert fitted is not None
        H, F = fitted
        shares[kind] = H.score / (H.score + F.score)
        assert np.mean(F.is_inlier[it.is_right]) > 0.85
        if kind != "room":
            assert np.mean(H.is_inlier[it.is_right]) > 0.85
            by_opencv, _ = cv2.findHomography(it.first_px, it.second_px, cv2.USAC_MAGSAC, 2.0)
            corners = np.array([[[50.0, 50.0]], [[590.0, 50.0]], [[590.0, 430.0]], [[50.0, 430.0]]])
            ours, theirs = (cv2.perspectiveTransform(corners, M) for M in (H.matrix, by_opencv))
            np.testing.assert_allclose(ours, theirs, atol=1.0)
    assert shares["plane"] > LIMITS.homography_share
    assert shares["turn"] > LIMITS.homography_share
    assert shares["room"] < LIMITS.homography_share


def rays(px: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(CAMERA.back_project(px, np.ones(len(px)))[:, :2])


def test_points_are_those_of_least_reprojection_error() -> None:
    it = scene("room", 1, wrong=0.0, noise_px=1.0)
    T = it.T_second_first
    first, second = rays(it.first_px), rays(it.second_px)
    E = essential(T)
    ours = np.array([triangulated(T, E, *a, *b) for a, b in zip(first, second, strict=True)])
    moved_first, moved_second = cv2.correctMatches(E, first[None], second[None])
    theirs = cv2.triangulatePoints(np.eye(4)[:3], T[:3], moved_first[0].T, moved_second[0].T)
    np.testing.assert_allclose(ours, (theirs[:3] / theirs[3]).T, rtol=1e-6, atol=1e-6)


def test_distances_are_opencvs_sampson_distances() -> None:
    it = scene("room", 2, n=40)
    E = essential(it.T_second_first)
    first, second = rays(it.first_px), rays(it.second_px)
    np.testing.assert_allclose(E, fundamental_from_motion(it.T_second_first, np.eye(3)), atol=1e-12)
    for a, b in zip(first, second, strict=True):
        expected = cv2.sampsonDistance(np.append(a, 1.0)[:, None], np.append(b, 1.0)[:, None], E)
        assert sampson2(E, *a, *b) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_a_motion_is_refined_to_where_no_small_change_makes_it_better(seed: int) -> None:
    """The cost is Geman and McClure's of the Sampson error, as scipy finds its least from the same start."""
    from scipy.optimize import minimize

    it = scene("room", seed)
    first, second, sigma = rays(it.first_px), rays(it.second_px), 1.0 / CAMERA.fx
    T = it.T_second_first.copy()
    T[:3, 3] /= np.linalg.norm(T[:3, 3])
    start = se3.exp(np.array([0.1, -0.05, 0.02, 0.01, -0.01, 0.02])) @ T
    start[:3, 3] /= np.linalg.norm(start[:3, 3])

    def cost(step: np.ndarray, at: np.ndarray) -> float:
        moved = se3.exp(np.concatenate((np.zeros(3), step[:3]))) @ at
        moved[:3, 3] = at[:3, 3] + step[3:]
        moved[:3, 3] /= np.linalg.norm(moved[:3, 3])
        E = essential(moved)
        e2 = np.array([sampson2(E, *a, *b) for a, b in zip(first, second, strict=True)]) / sigma**2
        return float(np.sum(e2 / (1.0 + e2 / 3.0)))

    ours = refine(start, first, second, sigma, 60)
    best = minimize(cost, np.zeros(6), args=(ours,), method="BFGS", options={"gtol": 1e-4})
    assert cost(np.zeros(6), ours) <= best.fun * (1 + 1e-4)
    assert cost(np.zeros(6), ours) < cost(np.zeros(6), start) / 2
