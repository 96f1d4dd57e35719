"""PSPNet-SLAM's geometry as printed: which points are judged, how, and what becomes of the keypoints."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from asked import ask as put
from building import parts
from flat_wall import before_the_wall, points_on_the_wall, wall_depth
from small_world import CAMERA, SCALES, pose

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.result import Tracked, TrackingState
from stillroom.data.semantics import Box, Semantics, nothing
from stillroom.dynamics.ants.search import ReverseSearchConfig, exhaustive
from stillroom.dynamics.asking import Asking
from stillroom.dynamics.multiview.multiview_kernels import BORDER, DYNAMIC, STATIC, STEEP, UNSEEN
from stillroom.dynamics.multiview.multiview_sieve import PaperMultiViewConfig
from stillroom.dynamics.projected.occlusion import OcclusionConfig
from stillroom.dynamics.projected.paper_ants import PaperAntsConfig, PaperAntsSieve
from stillroom.geometry import homography, se3
from stillroom.schedule import Done
from stillroom.testing.sieve_contract import check_sieve

WALL = points_on_the_wall(n=1500)
THEN, NOW = pose(), pose(0.04, 0.01, 0.02, turn=(0.01, -0.02, 0.01))
FIGURE = Box(260.0, 120.0, 420.0, 460.0, "person", 1.0)
WIDE = replace(PaperAntsConfig().ants, radius_px=60.0)
"""A path that misses little of a small world."""


def frame_at(T_world_cam: np.ndarray, index: int, figure: Box | None = None, figure_m: float = 1.5) -> Frame:
    frame, _ = WALL.look(T_world_cam, seed=index, index=index)
    return before_the_wall(frame, T_world_cam, figure, figure_m)


def ask(
    sieve: PaperAntsSieve,
    frame: Frame,
    T_world_cam: np.ndarray,
    known: Semantics | None = None,
    stage: Stage = Stage.LOCAL_MAP,
) -> Motion:
    """Put a question; after that of the local map the frame is remembered."""
    unmatched = Matches.of(np.full(len(frame), -1, np.int32))
    known = known or nothing(CAMERA.height, CAMERA.width)
    return put(sieve, stage, frame, unmatched, Done(known), se3.inverse(T_world_cam), Map(SCALES))


def walked_in(
    config: PaperAntsConfig, figure_m: float = 1.5, figure: Box = FIGURE
) -> tuple[PaperAntsSieve, Motion, Frame]:
    """A figure stands before the wall that was empty a frame ago."""
    sieve = config.build(parts())
    ask(sieve, frame_at(THEN, 0), THEN)
    frame = frame_at(NOW, 1, figure, figure_m)
    return sieve, ask(sieve, frame, NOW), frame


def test_the_points_judged_are_the_previous_frames_carried_by_the_homography() -> None:
    config = PaperAntsConfig(search="all")
    sieve = config.build(parts())
    before = [frame_at(pose(-0.05), 0), frame_at(THEN, 1)]
    ask(sieve, before[0], pose(-0.05))
    ask(sieve, before[1], THEN)
    frame = frame_at(NOW, 2)
    ask(sieve, frame, NOW)
    projected = sieve.projected
    assert projected is not None
    assert projected.previous.frame is before[1], "the very last one"
    kp, H = before[1].keypoints, projected.moved.fit.H_second_first
    expected = cv2.perspectiveTransform(kp.px[:, None].astype(np.float64), H)[:, 0]
    inside = np.all((expected >= 1) & (expected <= (638, 478)), axis=1)
    judged = np.zeros(len(kp), bool)
    judged[projected.test.keypoint] = True
    # All of them, but those that are carried out of the image, or to its rim where the last image had no depth.
    assert judged[inside].mean() > 0.97
    assert not judged[~np.all((expected >= -0.6) & (expected <= (639.6, 479.6)), axis=1)].any()
    np.testing.assert_allclose(projected.test.raw_px, expected[projected.test.keypoint], atol=1e-6)
    # Their depth is the wall's, as the present camera is away from it.
    T_now_then = se3.inverse(NOW) @ THEN
    true_m = se3.transform(T_now_then, CAMERA.back_project(kp.px, kp.depth_m))[:, 2]
    np.testing.assert_allclose(projected.test.points.z_m, true_m[projected.test.keypoint], atol=0.01)
    assert projected.found.is_tested.all()
    assert not projected.found.is_dynamic.any(), "the wall stands still"


def test_depth_is_read_in_the_compensation_frame() -> None:
    """Where the last image knew no depth at x, the compensation frame knows none at x′, and nothing is tested."""
    sieve = PaperAntsConfig(search="all").build(parts())
    earlier = frame_at(THEN, 0)
    depth_m = earlier.image.depth_m.copy()
    depth_m[:, :320] = 0.0
    ask(sieve, replace(earlier, image=replace(earlier.image, depth_m=depth_m)), THEN)
    ask(sieve, frame_at(NOW, 1), NOW)
    assert sieve.projected is not None
    numbers = sieve.projected.test.keypoint
    assert len(numbers) > 300
    assert earlier.keypoints.px[numbers, 0].min() > 317


def test_who_walked_in_is_dynamic_and_the_wall_is_not() -> None:
    sieve, motion, frame = walked_in(PaperAntsConfig(ants=WIDE))
    x, y = frame.keypoints.raw_px.T
    # A window and a patch of twenty pixels say nothing within twenty of an outline.
    inner = (x > 285) & (x < 395) & (y > 145) & (y < 435)
    outer = (x < 235) | (x > 445) | (y < 95)
    assert np.mean(~motion.is_static[inner]) > 0.9
    assert motion.is_static[outer].all()
    assert len(sieve.projected.found.hulls) == 1
    hull = cv2.convexHull(sieve.projected.found.hulls[0].astype(np.float32))
    inside = np.array([cv2.pointPolygonTest(hull, (float(a), float(b)), True) > 1.0 for a, b in zip(x, y, strict=True)])
    assert not motion.is_static[inside].any()
    assert motion.moving[300, 340]
    assert not motion.moving[:, :220].any()


def test_the_test_is_dynaslams_with_its_papers_numbers() -> None:
    paper, ours = PaperMultiViewConfig().test, OcclusionConfig()
    for name in ("max_parallax_deg", "tau_m", "far_m", "window_px", "patch_px", "patch_std_m"):
        assert getattr(ours, name) == getattr(paper, name)
    assert ours.reference_far_m == paper.keyframes.far_m
    assert (ours.tau_m, ours.max_parallax_deg) == (0.4, 30.0)


@pytest.mark.parametrize("nearer_m", [0.1, 0.3, 0.5, 1.0])
def test_every_verdict_is_that_of_the_text(nearer_m: float) -> None:
    """z_proj − z′ > τ with the nearest nearer depth in the window, unless the patch around it varies."""
    sieve, _, frame = walked_in(PaperAntsConfig(search="all"), 3.0 - nearer_m)
    test, depth_m = sieve.projected.test, frame.image.depth_m
    seen = 0
    for k in np.random.default_rng(0).permutation(len(test.keypoint))[:150]:
        u, v = np.floor(test.raw_px[k] + 0.5).astype(int)
        z = test.points.z_m[k]
        window = sorted(
            ((dx * dx + dy * dy, dy, dx) for dy in range(-20, 21) for dx in range(-20, 21)),
        )
        known = [
            (r, depth_m[v + dy, u + dx])
            for r, dy, dx in window
            if 0 <= v + dy < 480 and 0 <= u + dx < 640 and depth_m[v + dy, u + dx] < z
        ]
        if not known or z - known[0][1] <= 0.4:
            expected = {STATIC}
        else:
            # Of equally near ones any may be taken.
            expected = set()
            for r, dy, dx in window:
                row, column = v + dy, u + dx
                if r == known[0][0] and 0 <= row < 480 and 0 <= column < 640 and depth_m[row, column] < z:
                    patch = depth_m[max(0, row - 20) : row + 21, max(0, column - 20) : column + 21].astype(np.float64)
                    expected.add(BORDER if patch.var() > 0.001 else DYNAMIC)
        assert test.verdict[k] in expected
        seen += expected == {DYNAMIC}
    assert (seen > 10) == (nearer_m > 0.4)


def test_a_point_seen_from_far_to_the_side_is_not_tested() -> None:
    """The poses say that the camera moved 2 m beside a wall 3 m off: more than 30° at most points."""
    sieve, from_m = PaperAntsConfig(search="all").build(parts()), pose(-2.0)
    ask(sieve, frame_at(THEN, 0), from_m)
    ask(sieve, frame_at(NOW, 1), NOW)
    test = sieve.projected.test
    points_m = se3.transform(from_m, test.points.cam_m)
    before, now = from_m[:3, 3] - points_m, NOW[:3, 3] - points_m
    cosine = np.sum(before * now, axis=1) / np.linalg.norm(before, axis=1) / np.linalg.norm(now, axis=1)
    angle_deg = np.degrees(np.arccos(cosine))
    np.testing.assert_array_equal(test.verdict == STEEP, angle_deg > 30.0)
    assert 0.2 < np.mean(test.verdict == STEEP) < 0.9


@pytest.mark.parametrize("seed", range(3))
def test_the_ants_verdicts_equal_the_exhaustive_tests_on_what_they_visit(seed: int) -> None:
    answers = {}
    for search in ("reverse-ants", "all"):
        sieve = PaperAntsConfig(search=search).build(parts(seed=seed))
        ask(sieve, frame_at(THEN, 0), THEN)
        ask(sieve, frame_at(NOW, 1, FIGURE), NOW)
        answers[search] = sieve.projected
    ants, every = answers["reverse-ants"], answers["all"]
    np.testing.assert_array_equal(ants.test.keypoint, every.test.keypoint)
    visited = ants.found.is_tested
    assert 0.1 < visited.mean() < 0.9
    assert ants.found.is_dynamic.any()
    np.testing.assert_array_equal(ants.test.verdict[visited], every.test.verdict[visited])
    np.testing.assert_array_equal(ants.found.is_dynamic, every.found.is_dynamic & visited)
    assert np.all(ants.test.verdict[~visited] == UNSEEN)
    np.testing.assert_array_equal(exhaustive(every.test.raw_px, every.test), every.found.is_dynamic)
    # The colony's path goes from the uppermost row of cells to the lowest, once through every node.
    path = ants.found.path_px
    assert len(np.unique(path, axis=0)) == len(path)
    assert path[0, 1] < 90 < 390 < path[-1, 1]


def test_keypoints_matched_with_a_lone_dynamic_point_go_too() -> None:
    """No community is large enough to have a hull."""
    config = PaperAntsConfig(search="all", ants=replace(ReverseSearchConfig(), min_community=10**6))
    sieve, motion, _ = walked_in(config, figure_m=2.4)
    projected = sieve.projected
    assert projected.found.is_dynamic.any()
    assert not projected.found.hulls
    assert not motion.moving.any()
    dynamic = np.zeros(len(projected.previous.frame), bool)
    dynamic[projected.test.keypoint[projected.found.is_dynamic]] = True
    gone = {
        int(now) for then, now in zip(projected.moved.previous, projected.moved.present, strict=True) if dynamic[then]
    }
    assert set(np.flatnonzero(~motion.is_static).tolist()) == gone
    assert gone


def test_masks_are_dynamic_and_what_they_cover_is_not_carried() -> None:
    sieve = PaperAntsConfig(search="all").build(parts())
    mask = np.zeros((480, 640), bool)
    mask[:, :200] = True
    known = Semantics(480, 640, mask=mask)
    earlier, frame = frame_at(THEN, 0), frame_at(NOW, 1)
    ask(sieve, earlier, THEN, known)
    motion = ask(sieve, frame, NOW, known)
    np.testing.assert_array_equal(motion.is_static, frame.keypoints.raw_px[:, 0] > 199.5)
    np.testing.assert_array_equal(motion.moving, mask)
    assert earlier.keypoints.px[sieve.projected.test.keypoint, 0].min() > 199


def test_without_low_cost_tracking_the_stages_before_use_masks_alone() -> None:
    sieve = PaperAntsConfig(ants=WIDE).build(parts())
    ask(sieve, frame_at(THEN, 0), THEN)
    frame, known = frame_at(NOW, 1, FIGURE), nothing(480, 640)
    assert ask(sieve, frame, NOW, known, Stage.MOTION_MODEL).is_static.all()
    assert sieve.projected is None
    late = ask(sieve, frame, NOW, known)
    assert not late.is_static.all()
    quick = PaperAntsConfig(ants=WIDE).build(parts())
    ask(quick, frame_at(THEN, 0), THEN)
    early = ask(quick, frame, NOW, known, Stage.LOW_COST)
    np.testing.assert_array_equal(early.is_static, late.is_static)
    kept = quick.projected
    np.testing.assert_array_equal(ask(quick, frame, NOW, known, Stage.MOTION_MODEL).is_static, late.is_static)
    ask(quick, frame, NOW, known)
    assert quick.projected is kept, "once an image, while the pose stays"


def test_nothing_is_compared_over_a_gap_or_before_there_are_two_frames() -> None:
    sieve = PaperAntsConfig().build(parts())
    assert ask(sieve, frame_at(THEN, 0), THEN).is_static.all()
    assert sieve.projected is None
    ask(sieve, frame_at(NOW, 60, FIGURE), NOW)
    assert sieve.projected is None, "two seconds later"


def test_what_the_network_finds_in_a_keyframe_is_taken_up() -> None:
    sieve, world = PaperAntsConfig().build(parts()), Map(SCALES)
    led = Asking(sieve, world)
    frame = frame_at(THEN, 0)
    unmatched = Matches.of(np.full(len(frame), -1, np.int32))
    blind = Done(nothing(480, 640))
    motion = led.judge(Question(Stage.LOCAL_MAP, frame, unmatched, blind, se3.inverse(THEN), world))
    tracked = Tracked(frame, TrackingState.OK, THEN, np.arange(len(frame), dtype=np.int32), motion, -1)
    mask = np.zeros((480, 640), bool)
    mask[:, 400:] = True
    again = led.seen(tracked, Semantics(480, 640, mask=mask))
    masked = frame.keypoints.raw_px[:, 0] > 399.5
    np.testing.assert_array_equal(again.motion.is_static, ~masked)
    np.testing.assert_array_equal(again.point_ids < 0, masked)
    led.remember(frame, se3.inverse(THEN), 0)
    ask(sieve, frame_at(NOW, 1), NOW)
    assert frame.keypoints.px[sieve.projected.test.keypoint, 0].max() < 401


def test_it_keeps_the_contract() -> None:
    answers = check_sieve(PaperAntsConfig().build)
    assert any(not answer.motion.is_static.all() for answer in answers[-10:])


def test_on_the_wall_the_homography_predicts_what_the_camera_sees() -> None:
    """The compensation frame's depth at x′ is what the previous camera measured: the wall is a plane."""
    sieve, _, frame = walked_in(PaperAntsConfig(search="all"))
    moved = sieve.projected.moved
    inside = np.zeros((480, 640), bool)
    inside[40:440, 40:600] = True
    earlier_m = wall_depth(CAMERA, THEN)
    assert np.ptp(earlier_m) < 1e-3
    assert np.all(np.abs(moved.depth_m[inside] - 3.0) < 1e-3)
    H = moved.fit.H_second_first
    corner = homography.apply(H, np.array([[320.0, 240.0]]))[0]
    point = CAMERA.back_project(np.array([[320.0, 240.0]]), np.array([3.0]))
    by_pose = CAMERA.project(se3.transform(se3.inverse(NOW) @ THEN, point))[0]
    np.testing.assert_allclose(corner, by_pose, atol=0.05)
    assert frame.image.depth_m[300, 340] == pytest.approx(1.5)
