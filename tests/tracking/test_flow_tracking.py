"""Tracking between keyframes by flow: when it is used, what it carries, and where it leaves the frame to ORB."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from building import parts
from small_world import CAMERA, SmallMap, SmallWorld, no_semantics, pose

from stillroom.config import SlamConfig
from stillroom.data.frame import Frame
from stillroom.data.image import RgbdImage
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.result import FrameResult, Tracked, TrackingState
from stillroom.datasets.open import open_dataset
from stillroom.dynamics.chain import KeepAllMatches
from stillroom.geometry import se3
from stillroom.presets.registry import configure
from stillroom.protocols import Dataset
from stillroom.system import System, build
from stillroom.tracking.flow_tracking import FlowConfig, FlowTracking, OrbAlways, expected_shifts
from stillroom.tracking.tracker import TrackerConfig

N_FRAMES = 12
FLOW = ("tracking.between_keyframes=flow", "tracking.flow.calm_images=0")


@dataclass
class Run:
    system: System
    results: list[FrameResult] = field(default_factory=list)
    with_orb: list[int] = field(default_factory=list)


def run(dataset: Dataset, *overrides: str, method: str = "orb-slam2") -> Run:
    """A run over the first frames, and the frames whose keypoints were extracted."""
    config: SlamConfig = configure(method, None, list(overrides))
    done = Run(build(config, dataset.camera))
    extract = done.system.features.extract

    def extract_and_note(image: RgbdImage) -> Frame:
        done.with_orb.append(image.index)
        return extract(image)

    done.system.features = type("Noting", (), {"extract": staticmethod(extract_and_note)})()
    done.results = [done.system.process(dataset.load(i)) for i in range(N_FRAMES)]
    return done


@pytest.fixture(scope="module")
def room() -> Dataset:
    return open_dataset("synthetic:walking,cache=off")


@pytest.fixture(scope="module")
def by_flow(room: Dataset) -> Run:
    return run(room, *FLOW)


def test_by_default_every_frame_has_keypoints_of_its_own(room: Dataset) -> None:
    assert isinstance(TrackerConfig().build_flow(None, None, None), OrbAlways)
    assert run(room).with_orb == list(range(N_FRAMES))


def test_two_of_three_frames_do_without_them_and_no_keyframe_does(by_flow: Run) -> None:
    flown = [result for result in by_flow.results if result.index not in by_flow.with_orb]
    assert N_FRAMES // 3 <= len(flown) <= 2 * N_FRAMES // 3
    assert by_flow.with_orb[:2] == [0, 1], "there is no velocity before"
    assert max(np.diff([*by_flow.with_orb, N_FRAMES])) <= 3
    assert not any(result.is_keyframe for result in flown)
    assert all(result.state is TrackingState.OK for result in by_flow.results)


def test_the_poses_are_as_good(room: Dataset, by_flow: Run) -> None:
    T_world_first = room.truth(0).T_world_cam
    for result in by_flow.results:
        T_true = se3.inverse(T_world_first) @ room.truth(result.index).T_world_cam
        off = se3.inverse(T_true) @ result.T_world_cam
        assert np.linalg.norm(off[:3, 3]) < 0.02
        assert se3.angle_rad(off) < 0.01


def test_a_followed_keypoint_keeps_what_it_looked_like(by_flow: Run, room: Dataset) -> None:
    number = next(i for i in range(N_FRAMES) if i not in by_flow.with_orb)
    before, now = by_flow.results[number - 1].keypoints, by_flow.results[number].keypoints
    known = {row.tobytes(): k for k, row in enumerate(before.descriptors)}
    same = np.array([known[row.tobytes()] for row in now.descriptors])
    np.testing.assert_array_equal(now.octave, before.octave[same])
    np.testing.assert_array_equal(now.angle_rad, before.angle_rad[same])
    column, row = np.rint(now.raw_px).astype(int).T
    np.testing.assert_array_equal(now.depth_m, room.load(number).depth_m[row, column])
    np.testing.assert_array_equal(now.right_px, room.camera.right_coordinate(now.px[:, 0], now.depth_m))


@pytest.mark.parametrize("method", ["orb-slam2", "dynaslam"])
def test_the_same_input_gives_the_same_poses(room: Dataset, method: str) -> None:
    rest = () if method == "orb-slam2" else ("semantics.kind=truth",)
    first, second = (run(room, *FLOW, *rest, method=method) for _ in range(2))
    assert len(first.with_orb) < N_FRAMES
    assert first.with_orb == second.with_orb
    for one, other in zip(first.results, second.results, strict=True):
        assert one.T_world_cam.tobytes() == other.T_world_cam.tobytes()


def test_where_the_camera_turns_fast_it_is_as_if_flow_were_off(room: Dataset) -> None:
    off, never = run(room), run(room, *FLOW, "tracking.flow.max_turn_px=0.000001")
    assert never.with_orb == off.with_orb
    assert all(
        a.T_world_cam.tobytes() == b.T_world_cam.tobytes() for a, b in zip(off.results, never.results, strict=True)
    )


# By itself, in a small world.

WAS, IS = pose(), pose(0.04, -0.01, 0.02, turn=(0.01, -0.02, 0.01))


class Halving(KeepAllMatches):
    """Every second keypoint moves."""

    def judge(self, question: Question) -> Motion:
        motion = super().judge(question)
        return replace(motion, is_static=np.arange(len(motion.is_static)) % 2 == 0)


@dataclass
class Poses:
    """Expects a frame, and finds the poses that it is told to."""

    last: Tracked | None
    guess: np.ndarray
    n_asked: int = 0

    def expected(self, world: object) -> tuple[Tracked, np.ndarray] | None:
        return None if self.last is None else (self.last, self.guess)

    def locate_followed(
        self, frame: Frame, guess: np.ndarray, point_ids: np.ndarray, reference: int, *_: object
    ) -> Tracked:
        self.n_asked += 1
        motion = Motion.none(len(frame), frame.image.height, frame.image.width)
        return Tracked(frame, TrackingState.OK, se3.inverse(guess), point_ids, motion, reference)


class Rule:
    """A keyframe is due, or not."""

    def __init__(self, due: bool) -> None:
        self.due = due

    def is_due(self, tracked: Tracked, world: object) -> bool:
        return self.due


@pytest.fixture(scope="module")
def small() -> SmallMap:
    return SmallMap.of(SmallWorld.of(0), [WAS])


def last_of(small: SmallMap) -> Tracked:
    """The keyframe itself, with an image that can be followed: noise."""
    tracked = small.tracked(0)
    rgb = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    return replace(tracked, frame=replace(tracked.frame, image=replace(tracked.frame.image, rgb=rgb)))


def flow(poses: Poses, due: bool = False, **config: float) -> FlowTracking:
    return FlowTracking(FlowConfig(**{"calm_images": 0, **config}), poses, lambda frame, _: frame, Rule(due))


def test_the_shift_is_that_of_the_projection(small: SmallMap) -> None:
    last = small.tracked(0)
    seen, shift_px = expected_shifts(last, se3.inverse(IS), small.map)
    assert len(seen) > 300
    points_m = small.map.points.position_m[last.point_ids[seen]]
    camera = last.frame.camera
    before, now = (camera.project(se3.transform(se3.inverse(T), points_m)) for T in (WAS, IS))
    np.testing.assert_allclose(shift_px, now - before, atol=1e-3)


def test_a_point_that_two_keypoints_see_is_followed_once(small: SmallMap) -> None:
    last = small.tracked(0)
    first, second = np.flatnonzero(last.point_ids >= 0)[:2]
    point_ids = last.point_ids.copy()
    point_ids[second] = point_ids[first]
    seen, _ = expected_shifts(replace(last, point_ids=point_ids), se3.inverse(IS), small.map)
    assert first in seen
    assert second not in seen


def test_an_image_like_the_last_is_followed_at_most_so_often(small: SmallMap) -> None:
    last = last_of(small)
    poses = Poses(last, se3.inverse(WAS))
    part = flow(poses, max_images=2)
    said = [part.follow(last.frame.image, no_semantics(), small.map) for _ in range(6)]
    assert [one is not None for one in said] == [True, True, False] * 2
    assert poses.n_asked == 4
    kept = said[0]
    np.testing.assert_allclose(kept.frame.keypoints.raw_px, last.frame.keypoints.raw_px[_places(kept, last)], atol=0.1)


def test_it_waits_until_the_camera_was_calm_for_a_while(small: SmallMap) -> None:
    last, nobody = last_of(small), no_semantics()
    poses = Poses(last, se3.inverse(WAS))
    part = flow(poses, calm_images=2, max_images=9)
    still, turned = poses.guess, se3.inverse(pose(turn=(0.0, 0.1, 0.0)))
    said = []
    for guess in (still, still, still, turned, still, still, still):
        poses.guess = guess
        said.append(part.follow(last.frame.image, nobody, small.map) is not None)
    assert said == [False, False, True, False, False, False, True]


def _places(kept: Tracked, last: Tracked) -> np.ndarray:
    """Keypoints of the last frame that see the points of another."""
    of_point = {point: k for k, point in enumerate(last.point_ids)}
    return np.array([of_point[point] for point in kept.point_ids])


def test_it_leaves_the_frame_to_orb_where_it_must(small: SmallMap) -> None:
    last, nobody = last_of(small), no_semantics()
    same, other = last.frame.image, replace(last.frame.image, rgb=np.zeros_like(last.frame.image.rgb))
    still = se3.inverse(WAS)
    assert flow(Poses(last, still)).follow(same, nobody, small.map) is not None
    assert flow(Poses(None, still)).follow(same, nobody, small.map) is None  # lost, or no velocity
    assert flow(Poses(last, still), due=True).follow(same, nobody, small.map) is None  # a keyframe is due
    assert flow(Poses(last, still)).follow(other, nobody, small.map) is None  # nothing is found again
    assert flow(Poses(last, still), min_inliers=5000).follow(same, nobody, small.map) is None  # too few points
    late = replace(same, timestamp_s=same.timestamp_s + 0.1)
    assert flow(Poses(last, still)).follow(late, nobody, small.map) is None  # a slow camera
    turned = se3.inverse(pose(turn=(0.0, 0.1, 0.0)))
    assert flow(Poses(last, turned)).follow(same, nobody, small.map) is None  # turns fast


def test_the_tracker_asks_the_sieve_once_and_keeps_what_is_static() -> None:
    small = SmallMap.of(SmallWorld.of(0), [np.eye(4), pose(0.02)])
    tracker = TrackerConfig().build(parts(CAMERA, small.map), Halving())
    for k in range(2):
        tracker.remember(small.tracked(k), small.map)
    expected = tracker.expected(small.map)
    assert expected is not None
    last, guess = expected
    np.testing.assert_allclose(se3.inverse(guess), pose(0.04), atol=1e-6)
    frame, seen = small.world.look(pose(0.04), seed=9, noise_px=0.3, index=3)
    found = tracker.locate_followed(frame, guess, small.id_of[seen], last.reference_keyframe, no_semantics(), small.map)
    np.testing.assert_allclose(found.T_world_cam, pose(0.04), atol=0.005)
    assert found.n_inliers > 100
    assert not np.any(found.is_matched[1::2])
    np.testing.assert_array_equal(found.point_ids[found.is_matched], small.id_of[seen[found.is_matched]])
