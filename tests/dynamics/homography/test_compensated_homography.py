"""The sieve on rendered rooms, whose figures and boxes are known to the pixel."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from asked import ask as put
from building import parts
from small_world import CAMERA

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Semantics, nothing
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.dynamics.ants.search import PheromoneMapConfig, ReverseSearchConfig
from stillroom.dynamics.homography.compensation import CompensationConfig, aim, choose_probes
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig, CompensatedHomographySieve, fill
from stillroom.dynamics.homography.past import Past, view_of
from stillroom.errors import ConfigError
from stillroom.features.orb import OrbConfig
from stillroom.geometry import homography, se3
from stillroom.schedule import Done

CARRIED = "synthetic:carried,frames=220,cache=off"
FRAMES = (205, 208, 211, 214)
"""The box is carried across the room in these; a tenth of a second apart."""


@pytest.fixture(scope="module")
def seen() -> list[tuple[Frame, np.ndarray]]:
    """Frames with the true poses that they were taken from."""
    dataset = open_dataset(CARRIED)
    orb = OrbConfig().build(parts(dataset.camera))
    poses = dataset.groundtruth.T_world_cam
    return [(orb.extract(dataset.load(k)), se3.inverse(poses[k])) for k in FRAMES]


def ask(
    sieve: CompensatedHomographySieve,
    frame: Frame,
    T_cam_world: np.ndarray,
    known: Semantics | None = None,
    stage: Stage = Stage.LOCAL_MAP,
    matches: Matches | None = None,
    world: Map | None = None,
) -> Motion:
    matches = matches or Matches.of(np.full(len(frame), -1, np.int32))
    known = known or nothing(frame.image.height, frame.image.width)
    return put(sieve, stage, frame, matches, Done(known), T_cam_world, world or Map(frame.scales))


def run(config: CompensatedHomographyConfig, seen: list, seed: int = 0, known=lambda frame: None) -> list[Motion]:
    sieve = config.build(parts(seed=seed))
    return [ask(sieve, frame, T_cam_world, known(frame)) for frame, T_cam_world in seen]


def places(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Which keypoints lie on what may move, and which clear of it by 12 pixels."""
    column, row = np.rint(frame.keypoints.raw_px).astype(int).T
    around = cv2.dilate(frame.image.truth.movable.astype(np.uint8), np.ones((25, 25)))
    return frame.image.truth.movable[row, column], around[row, column] == 0


@pytest.mark.parametrize("search", ["reverse", "exhaustive"])
def test_what_moves_is_found_without_a_network_and_what_stands_is_left_alone(seen: list, search: str) -> None:
    hits, wrong, n_clear, outside = 0, 0, 0, 0
    for (frame, _), motion in zip(seen[1:], run(CompensatedHomographyConfig(search=search), seen)[1:], strict=True):
        on, clear = places(frame)
        hits += np.count_nonzero(~motion.is_static[on])
        wrong += np.count_nonzero(~motion.is_static[clear])
        n_clear += np.count_nonzero(clear)
        around = cv2.dilate(frame.image.truth.movable.astype(np.uint8), np.ones((41, 41))) > 0
        outside += np.count_nonzero(motion.moving & ~around)
        assert motion.moving.any()
    assert hits > 60
    assert wrong < 0.01 * n_clear
    assert outside < 0.01 * 3 * 640 * 480


def test_the_search_finds_what_testing_everything_does(seen: list) -> None:
    forgetful = ReverseSearchConfig(scent=PheromoneMapConfig(rho=0.8))  # three images are few
    config = CompensatedHomographyConfig(ants=forgetful)
    both = [run(replace(config, search=search), seen)[1:] for search in ("reverse", "exhaustive")]
    moving = [np.concatenate([~motion.is_static for motion in motions]) for motions in both]
    assert np.mean(moving[0][moving[1]]) > 0.9
    sieve = config.build(parts())
    for frame, T_cam_world in seen:
        ask(sieve, frame, T_cam_world)
    assert sieve.findings.found.share_tested < 0.7


def test_the_carried_box_is_found_though_no_network_names_it(seen: list) -> None:
    found = n = 0
    for (frame, _), motion in zip(seen[1:], run(CompensatedHomographyConfig(), seen)[1:], strict=True):
        box = next(box for box in frame.image.truth.boxes if box.label == "box")
        raw_px = frame.keypoints.raw_px
        inside = np.all((raw_px >= box.xyxy_px[:2]) & (raw_px <= box.xyxy_px[2:]), axis=1)
        inside &= frame.image.truth.movable_at(raw_px)
        found, n = found + np.count_nonzero(~motion.is_static[inside]), n + np.count_nonzero(inside)
    assert n > 50
    assert found > 0.8 * n


@pytest.mark.parametrize("path", ["serpentine", "ants"])
def test_the_same_seed_gives_the_same_verdicts(seen: list, path: str) -> None:
    config = CompensatedHomographyConfig()
    config = replace(config, ants=replace(config.ants, path=replace(config.ants.path, kind=path)))
    for first, second in zip(run(config, seen, 4), run(config, seen, 4), strict=True):
        np.testing.assert_array_equal(first.is_static, second.is_static)
        np.testing.assert_array_equal(first.moving, second.moving)


def test_a_poor_guess_of_the_pose_changes_little(seen: list) -> None:
    good = run(CompensatedHomographyConfig(), seen)[1:]
    sieve = CompensatedHomographyConfig().build(parts())
    off = se3.exp(np.array([0.02, -0.01, 0.01, 0.004, -0.008, 0.005]))
    for k, (frame, T_cam_world) in enumerate(seen):
        motion = ask(sieve, frame, off @ T_cam_world, stage=Stage.MOTION_MODEL)
        ask(sieve, frame, T_cam_world)
        if k > 0:
            assert np.mean(motion.is_static != good[k - 1].is_static) < 0.02


def test_all_stages_of_an_image_say_the_same_and_examine_it_once(seen: list) -> None:
    sieve = CompensatedHomographyConfig().build(parts())
    ask(sieve, *seen[0])
    frame, T_cam_world = seen[1]
    first = ask(sieve, frame, T_cam_world, stage=Stage.MOTION_MODEL)
    findings = sieve.findings
    second = ask(sieve, frame, T_cam_world, stage=Stage.LOCAL_MAP)
    assert sieve.findings is findings
    np.testing.assert_array_equal(first.is_static, second.is_static)
    assert not first.is_static.all()
    assert ask(sieve, frame, T_cam_world, stage=Stage.RELOCALIZATION).is_static.all()


def test_masks_go_whole_and_geometry_adds_what_they_lack(seen: list) -> None:
    mask = np.zeros((480, 640), dtype=bool)
    mask[:, :100] = True
    motions = run(CompensatedHomographyConfig(), seen, known=lambda frame: Semantics(480, 640, mask=mask))
    for k, ((frame, _), motion) in enumerate(zip(seen, motions, strict=True)):
        left = frame.keypoints.raw_px[:, 0] < 99
        assert not motion.is_static[left].any()
        assert motion.moving[:, :100].all()
        assert motion.moving[:, 110:].any() == (k > 0)
    assert motions[0].is_static[seen[0][0].keypoints.raw_px[:, 0] > 101].all(), "the first image has no past"
    assert mask.sum() == 480 * 100, "the mask itself is left as it was"


def test_off_where_too_few_matches_would_stay(seen: list) -> None:
    sieve = CompensatedHomographyConfig().build(parts())
    frame, T_cam_world = seen[0]
    ids = np.full(len(frame), -1, np.int32)
    ids[:50] = np.arange(50)
    everything = Semantics(480, 640, mask=np.ones((480, 640), dtype=bool))
    motion = ask(sieve, frame, T_cam_world, everything, matches=Matches.of(ids))
    assert motion.is_static.all()
    assert not motion.moving.any()


def test_an_empty_room_is_static() -> None:
    dataset = select(open_dataset("synthetic:empty,frames=40,cache=off"), "20:32")
    orb, sieve = OrbConfig().build(parts(dataset.camera)), CompensatedHomographyConfig().build(parts())
    poses = dataset.groundtruth.T_world_cam[20:32]
    wrong = n = 0
    for k in range(0, 12, 3):
        frame = orb.extract(dataset.load(k))
        motion = ask(sieve, frame, se3.inverse(poses[k]))
        wrong, n = wrong + np.count_nonzero(~motion.is_static), n + len(frame)
    assert sieve.findings is not None
    assert wrong < 0.003 * n


@pytest.mark.parametrize("said", [True, False])
def test_what_is_remembered_follows_a_map_that_jumps(seen: list, said: bool) -> None:
    """The pose then is a guess of the motion between the images; far off, nothing is found again."""
    stays, jumps = (CompensatedHomographyConfig().build(parts()) for _ in range(2))
    world, jump = Map(seen[0][0].scales), se3.exp(np.array([0.5, -0.2, 0.3, 0.1, 0.6, -0.2]))
    for k, (frame, T_cam_world) in enumerate(seen):
        expected = ask(stays, frame, T_cam_world)
        if k < 2:
            motion = ask(jumps, frame, T_cam_world, world=world)
        else:
            if said and not world.jumps:
                world.jumps.append(jump)
            motion = ask(jumps, frame, T_cam_world @ se3.inverse(jump), world=world)
        if k == 2 and not said:
            assert expected.moving.any()
            assert jumps.findings is None
            return
        np.testing.assert_array_equal(motion.is_static, expected.is_static)
        np.testing.assert_array_equal(motion.moving, expected.moving)
        if k > 0:
            found, right = jumps.findings.camera_motion, stays.findings.camera_motion
            np.testing.assert_allclose(found.T_then_now, right.T_then_now, atol=1e-6)
            np.testing.assert_allclose(found.H_now_then, right.H_now_then, atol=1e-6, rtol=1e-6)


def test_the_motion_and_the_homography_are_the_true_ones(seen: list) -> None:
    sieve = CompensatedHomographyConfig().build(parts())
    for frame, T_cam_world in seen[:2]:
        ask(sieve, frame, T_cam_world)
    found = sieve.findings.camera_motion
    true = seen[0][1] @ se3.inverse(seen[1][1])
    error = se3.inverse(true) @ found.T_then_now
    assert np.linalg.norm(error[:3, 3]) < 0.01
    assert se3.angle_rad(error) < 0.004
    assert found.fit is not None
    assert found.fit.rms_px < 1.5
    moved = homography.apply(found.H_now_then, found.then_px[found.fit.is_inlier])
    assert np.median(np.linalg.norm(moved - found.now_px[found.fit.is_inlier], axis=1)) < 1.5


def test_compensation_is_better_than_the_plain_homography_on_the_same_pairs(seen: list) -> None:
    rms = {}
    for refine in (False, True):
        compensation = CompensationConfig(magsac=False, refine=refine)
        sieve = CompensatedHomographyConfig(compensation=compensation).build(parts())
        for frame, T_cam_world in seen:
            ask(sieve, frame, T_cam_world)
        rms[refine] = np.median(
            homography.transfer_errors_px(
                sieve.findings.camera_motion.H_now_then,
                sieve.findings.camera_motion.then_px,
                sieve.findings.camera_motion.now_px,
            )
        )
    assert rms[True] < rms[False]


def test_the_past_reaches_back_as_far_as_asked(seen: list) -> None:
    frame = seen[0][0]
    past, view = Past(0.1), view_of(frame.image)
    for k in range(20):
        now = replace(frame, image=replace(frame.image, index=k, timestamp_s=k / 30))
        expected = [] if k == 0 else [0] if k == 1 else [max(0, k - 3), k - 1]
        assert [image.index for image in past.before(now)] == expected
        past.remember(now, view, np.eye(4))
        past.remember(now, view, np.eye(4))
        assert [image.index for image in past.before(now)] == expected
    late = replace(frame, image=replace(frame.image, index=99, timestamp_s=9.0))
    assert past.before(late) == []


def test_a_community_fills_what_is_near_it_in_the_image_and_in_depth() -> None:
    rng = np.random.default_rng(2)
    depth_m = rng.choice([0.0, 1.0, 1.1, 2.0], (60, 80)).astype(np.float32)
    hull = np.zeros((60, 80), np.uint8)
    hull[5:55, 10:80] = 1
    members_px, members_m = rng.uniform((0, 0), (79, 59), (9, 2)), rng.choice([0.0, 1.0, 2.0], 9)
    filled = np.zeros((60, 80), dtype=bool)
    fill(hull, members_px, members_m, 12.0, 0.15, depth_m, filled)
    for row in range(60):
        for column in range(80):
            z = depth_m[row, column]
            near = [m for p, m in zip(members_px, members_m, strict=True) if np.hypot(*(p - (column, row))) <= 12.0]
            expected = hull[row, column] and any(z == 0 or (m > 0 and abs(z - m) <= 0.15) for m in near)
            assert filled[row, column] == bool(expected)
    assert 300 < filled.sum() < 3000


def test_probes_are_spread_and_those_with_depth_come_first() -> None:
    rng = np.random.default_rng(0)
    px = np.vstack((rng.uniform(0, 40, (500, 2)), rng.uniform((0, 0), (640, 480), (300, 2))))
    has_depth, usable = rng.random(800) < 0.5, rng.random(800) < 0.8
    chosen = choose_probes(px, has_depth, usable, 150)
    assert len(chosen) == len(set(chosen.tolist())) == 150
    assert usable[chosen].all()
    assert np.all(px[chosen] < 40, axis=1).sum() < 10, "a crowd in one cell does not crowd out the others"
    cell = (px // 40).astype(int) @ (1, 1000)
    for one in np.unique(cell[chosen]):
        taken = chosen[cell[chosen] == one]
        left = np.setdiff1d(np.flatnonzero((cell == one) & usable), taken)
        assert not (has_depth[left].any() and not has_depth[taken].all())
    assert len(choose_probes(px, has_depth, np.zeros(800, dtype=bool), 150)) == 0


def test_probes_are_those_of_plain_sorting() -> None:
    rng = np.random.default_rng(1)
    px = rng.uniform((0, 0), (640, 480), (700, 2)).astype(np.float32)
    for n in (0, 1, 150, 200, 650, 1000):
        has_depth, usable = rng.random(700) < 0.7, rng.random(700) < 0.8
        candidates = np.flatnonzero(usable)
        cell = (px[candidates] // 40).astype(int) @ (1, 1000)
        order = np.lexsort((~has_depth[candidates], cell))
        rank = np.arange(len(order)) - np.searchsorted(cell[order], cell[order])
        expected = np.sort(candidates[order[np.argsort(rank, kind="stable")[:n]]])
        np.testing.assert_array_equal(choose_probes(px, has_depth, usable, n), expected)


@pytest.mark.parametrize("times", [2, 6])
def test_probes_are_searched_where_the_guess_moves_them(times: int) -> None:
    rng = np.random.default_rng(2)
    camera = replace(CAMERA, distortion=(0.1, -0.2, 0.002, -0.003, 0.05))
    raw_px = rng.uniform((20, 20), (620, 460), (50, 2)).astype(np.float32)
    px, T = camera.undistort(raw_px), se3.exp(np.array([0.1, -0.05, 0.2, 0.02, -0.03, 0.01]))
    depth_m = np.where(rng.random(50) < 0.2, 0.0, rng.uniform(1, 4, 50)).astype(np.float32)
    now_half_px, start_px = np.empty((2, 50, 2), np.float32)
    aim(px, raw_px, depth_m, 2.5, T, camera.lens, times, now_half_px, start_px)
    points = se3.transform(T, camera.back_project(px, np.where(depth_m > 0, depth_m, 2.5)))
    start_raw_px = camera.distort(camera.project(points))
    np.testing.assert_allclose(now_half_px, (raw_px + 0.5) / times - 0.5, atol=1e-4)
    np.testing.assert_allclose(start_px, (start_raw_px + 0.5) / times - 0.5, atol=1e-4)


def test_an_unknown_search_is_refused() -> None:
    with pytest.raises(ConfigError, match="search' is 'random'; it must be one of reverse, exhaustive"):
        CompensatedHomographyConfig(search="random").build(parts())
