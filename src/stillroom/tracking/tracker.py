"""The three stages of ORB-SLAM2's tracking, with the match sieve called at each."""

from dataclasses import dataclass, field, replace

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.result import Recovery, Tracked, TrackingState
from stillroom.data.semantics import Semantics
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32
from stillroom.geometry.camera import Camera
from stillroom.optimize.pose import PoseOptimizerConfig
from stillroom.protocols import KeypointSieve, MatchSieve, Parts, Pending, QuickTracking
from stillroom.tracking import correspondences
from stillroom.tracking.depth_clock import with_depth_in_time
from stillroom.tracking.flow_tracking import FlowConfig, FlowTracking, KeyframeRule, OrbAlways
from stillroom.tracking.last_frame import LastFrame
from stillroom.tracking.low_cost import NoLowCost
from stillroom.tracking.readout_check import RowsFound
from stillroom.tracking.shutter import (
    GLOBAL,
    ROLLING,
    DepthNoiseConfig,
    GlobalShutter,
    PoseFit,
    RollingShutter,
    RollingShutterConfig,
    expected_velocity,
    turn_rad_s,
)
from stillroom.tracking.start import DepthStart, Start

MAX_KEYFRAMES = 80
_NEIGHBOURS = 10
BETWEEN_KEYFRAMES = ("orb", "flow")


@dataclass(frozen=True)
class LocalMap:
    """Keyframes that share points with a frame, their neighbours, and all their points.

    Attributes:
        reference: The keyframe that shares most points.
        keyframes: Their ids.
        points: Points that they see (P,) int32, in order of id.
    """

    reference: int
    keyframes: tuple[int, ...]
    points: I32


def local_map_of(point_ids: I32, fallback: int, world: Map) -> LocalMap:
    """Gather the local map of a frame (ORB-SLAM2: UpdateLocalKeyFrames, UpdateLocalPoints).

    Args:
        point_ids: Points that the frame sees (N,), −1 for none.
        fallback: Keyframe to use when none of them is seen by any.
        world: The map.
    """
    votes = world.count_shared(point_ids)
    voters = np.flatnonzero(votes)
    if len(voters) == 0:
        voters = np.array([fallback])
        votes[fallback] = 1
    voters = voters[np.argsort(-votes[voters], kind="stable")][:MAX_KEYFRAMES]
    chosen = dict.fromkeys(int(voter) for voter in voters)
    for voter in list(chosen):
        if len(chosen) >= MAX_KEYFRAMES:
            break
        for neighbour in world.covisibility.neighbours(voter, _NEIGHBOURS):
            if neighbour not in chosen:
                chosen[neighbour] = None
                break
    return LocalMap(int(voters[0]), tuple(chosen), world.points_seen_by(np.array(list(chosen))))


@dataclass(frozen=True)
class TrackerConfig:
    """When tracking accepts a pose (ORB-SLAM2's numbers; docs/reference.md#orb-slam2-tracking).

    Attributes:
        min_initial_keypoints: Static keypoints with depth that a first frame must have.
        window_px: Search window of the motion-model stage; doubled when too little is found.
        min_matches: Matches that the motion-model stage needs.
        min_keyframe_matches: Matches that the reference-keyframe stage needs.
        min_coarse_inliers: Inliers that either of them needs.
        min_inliers: Inliers that the local-map stage needs.
        min_inliers_recovered: The same for a second after tracking was lost.
        local_window: Factor on the search window of the local-map stage. ORB-SLAM2 has 3; with 5 matches are kept in a
            fast rotation.
        between_keyframes: orb, keypoints of its own for every frame; or flow, where tracking follows those of the last
            frame between keyframes.
        flow: When and how it does.
        pose: How poses are found.
        shutter: global, all rows of an image are taken to be read at once; or rolling, one after the other in the
            camera's `readout_s`: each frame then has a velocity, found with its pose.
        rolling: What is expected of that velocity.
        depth: How much depth counts.
    """

    min_initial_keypoints: int = bounded(200, least=0)
    window_px: float = bounded(15.0, above=0)
    min_matches: int = bounded(20, least=0)
    min_keyframe_matches: int = bounded(15, least=0)
    min_coarse_inliers: int = bounded(10, least=0)
    min_inliers: int = bounded(30, least=0)
    min_inliers_recovered: int = bounded(50, least=0)
    local_window: float = bounded(5.0, above=0)
    between_keyframes: str = bounded("orb", one_of=BETWEEN_KEYFRAMES)
    flow: FlowConfig = field(default_factory=FlowConfig)
    pose: PoseOptimizerConfig = field(default_factory=PoseOptimizerConfig)
    shutter: str = bounded(GLOBAL, one_of=(GLOBAL, ROLLING))
    rolling: RollingShutterConfig = field(default_factory=RollingShutterConfig)
    depth: DepthNoiseConfig = field(default_factory=DepthNoiseConfig)

    def build(
        self, parts: Parts, sieve: MatchSieve, quick: QuickTracking | None = None, start: Start | None = None
    ) -> "Tracker":
        """Return a tracker that calls the sieve.

        Args:
            parts: The parts.
            sieve: The sieve.
            quick: Low-cost tracking, from whose pose it starts; none by default.
            start: How a map begins; by default with the depth of one frame.
        """
        start = start or DepthStart(self.min_initial_keypoints, sieve)
        return Tracker(self, sieve, quick or NoLowCost(), self._build_fit(parts.camera), start)

    def _build_fit(self, camera: Camera) -> PoseFit:
        """Return how poses are found from matches."""
        rolls = self.shutter == ROLLING and camera.readout_s > 0.0
        return RollingShutter(self.rolling, self.pose, camera.readout_s) if rolls else GlobalShutter(self.pose)

    def build_flow(
        self, tracker: "Tracker", keypoint_sieve: KeypointSieve, keyframes: KeyframeRule
    ) -> FlowTracking | OrbAlways:
        """Return what tracks frames by flow for a tracker, or never does."""
        if self.between_keyframes == "orb":
            return OrbAlways()
        return FlowTracking(self.flow, tracker, keypoint_sieve, keyframes)


@dataclass(frozen=True)
class _Fix:
    """A pose and its inliers."""

    T_cam_world: F64
    point_ids: I32
    motion: Motion
    rejected: I32
    velocity: F64 | None = None

    @property
    def n_inliers(self) -> int:
        return int((self.point_ids >= 0).sum())


class Tracker:
    """Tracks the camera from frame to frame. Called in order, one frame after the other.

    Attributes:
        start: How a map begins.
        pose: How poses are found from matches.
    """

    def __init__(
        self, config: TrackerConfig, sieve: MatchSieve, quick: QuickTracking, pose: PoseFit, start: Start
    ) -> None:
        """Start without earlier frames."""
        self.start = start
        self.config, self.sieve, self.quick, self.pose = config, sieve, quick, pose
        self._last = LastFrame()

    def track(self, frame: Frame, semantics: Pending[Semantics], world: Map) -> Tracked:
        """Return the frame with its pose, if known; its state says whether it is.

        Args:
            frame: The frame, after sieve 1.
            semantics: What is potentially dynamic in it.
            world: The map.
        """
        if world.is_empty:
            return self.start.start(frame, semantics, world)
        last = self._last.as_known_now(world)
        guess, fix = self._last.expected_next(last), None
        if last is not None and guess is not None:
            moved = self._in_time(frame, guess, world)
            guess = self.quick.localize(moved, last, guess, semantics, world)  # low-cost tracking, where there is any
            fix = self._with_motion_model(moved, last, guess, semantics, world)
            frame = frame if fix is None else moved  # a guess that failed says nothing of the rows
        if fix is None and last is not None:
            fix = self._with_reference_keyframe(frame, last, semantics, world)
            if fix is not None:
                frame = self._with_depth_in_time(frame, fix.T_cam_world, world)
        if fix is None or last is None:
            return _lost(frame, self._last.reference_keyframe)
        frame = self.pose.at_mid_frame(frame, fix.velocity)
        return self._with_local_map(frame, fix, last.reference_keyframe, semantics, world)

    def locate(
        self,
        frame: Frame,
        T_cam_world: F64,
        point_ids: I32,
        semantics: Pending[Semantics],
        world: Map,
        recovery: Recovery,
    ) -> Tracked:
        """Refine a relocalized pose against the local map.

        Args:
            frame: The frame.
            T_cam_world: Its pose (4, 4).
            point_ids: The matched points (N,) of that pose.
            semantics: What is potentially dynamic in it.
            world: The map.
            recovery: How the frame was relocalized.
        """
        matches = Matches.of(point_ids)
        motion = self.sieve.judge(Question(Stage.RELOCALIZATION, frame, matches, semantics, T_cam_world, world))
        fix = _Fix(T_cam_world, np.where(motion.is_static, point_ids, np.int32(-1)), motion, np.zeros(0, np.int32))
        tracked = self._with_local_map(frame, fix, self._last.reference_keyframe, semantics, world)
        if tracked.n_inliers < self.config.min_inliers_recovered:
            return _lost(frame, tracked.reference_keyframe, tracked.motion)
        return replace(tracked, recovery=recovery)

    def expected(self, world: Map) -> tuple[Tracked, F64] | None:
        """Return the last frame as known now, and the motion model's guess `T_cam_world` (4, 4) of the next one.

        Args:
            world: The map.

        Returns:
            None where either is unknown, and for a second after tracking was lost.
        """
        last = self._last.as_known_now(world)
        guess = self._last.expected_next(last)
        return None if last is None or guess is None or self._last.is_recovering else (last, guess)

    def locate_followed(
        self, frame: Frame, guess: F64, point_ids: I32, reference: int, semantics: Pending[Semantics], world: Map
    ) -> Tracked:
        """Return a frame whose keypoints see known points with its pose; nothing else is searched.

        Args:
            frame: The frame, after sieve 1.
            guess: Its pose as expected (4, 4).
            point_ids: The points (N,) that its keypoints see.
            reference: Reference keyframe of the frame before it.
            semantics: What is potentially dynamic in it.
            world: The map.
        """
        frame = self._in_time(frame, guess, world)
        usable = Matches.of(np.where(frame.is_static, point_ids, np.int32(-1)))
        unasked = Motion.none(len(frame), frame.image.height, frame.image.width)
        fix = self._fix(frame, guess, usable, unasked, world)
        frame = self.pose.at_mid_frame(frame, fix.velocity)
        matches = Matches.of(fix.point_ids)
        motion = self.sieve.judge(Question(Stage.LOCAL_MAP, frame, matches, semantics, fix.T_cam_world, world))
        kept = matches.keep(motion.is_static[matches.keypoint])
        if len(kept) < len(matches) or motion.p_static is not None:
            fix = self._fix(frame, fix.T_cam_world, kept, motion, world)
            frame = self.pose.at_mid_frame(frame, fix.velocity)
        world.points.n_visible[matches.point_id] += 1
        world.points.n_found[fix.point_ids[fix.point_ids >= 0]] += 1
        T_world_cam = se3.orthonormalize(se3.inverse(fix.T_cam_world))
        tracked = Tracked(frame, TrackingState.OK, T_world_cam, fix.point_ids, motion, _alive(reference, world))
        return self.pose.learn(tracked, world)

    def remember(self, tracked: Tracked, world: Map) -> None:
        """Store the result of a frame, after mapping, for the next one."""
        self.pose.remember(tracked, world)
        self._last.remember(tracked, world)

    @property
    def rows(self) -> RowsFound | None:
        """What the recording says of the camera's readout; None where nothing is asked, or known yet."""
        return self.pose.found

    def put_back(self) -> list[int]:
        """Return keyframes whose keypoints were put back to where they were seen since the last call."""
        return self.pose.put_back()

    def found_again(self, world: Map) -> dict[int, F64]:
        """Find earlier images again where there is reason to; return their `T_world_cam` (4, 4) by image index."""
        return self.pose.found_again(world)

    def _in_time(self, frame: Frame, guess: F64, world: Map) -> Frame:
        """Return a frame with its keypoints where, and at the depth that, they are expected to have at mid-frame."""
        moved = self.pose.at_mid_frame(frame, self.pose.expected(guess, self._last.before(frame, world)))
        return self._with_depth_in_time(moved, guess, world)

    def _with_depth_in_time(self, frame: Frame, T_cam_world: F64, world: Map) -> Frame:
        after_s = self.config.depth.after_s(frame)
        if after_s == 0.0:
            return frame
        return with_depth_in_time(frame, after_s, expected_velocity(T_cam_world, self._last.before(frame, world)))

    def _with_motion_model(
        self, frame: Frame, last: Tracked, guess: F64, semantics: Pending[Semantics], world: Map
    ) -> _Fix | None:
        for widen in (1.0, 2.0):
            matches = correspondences.with_last_frame(frame, last, guess, world, widen * self.config.window_px)
            motion = self.sieve.judge(Question(Stage.MOTION_MODEL, frame, matches, semantics, guess, world))
            matches = matches.keep(motion.is_static[matches.keypoint])
            if len(matches) >= self.config.min_matches:
                fix = self._fix(frame, guess, matches, motion, world)
                return fix if fix.n_inliers >= self.config.min_coarse_inliers else None
        return None

    def _with_reference_keyframe(
        self, frame: Frame, last: Tracked, semantics: Pending[Semantics], world: Map
    ) -> _Fix | None:
        assert last.T_world_cam is not None
        keyframe = _alive(last.reference_keyframe, world)
        matches = correspondences.with_keyframe(frame, keyframe, world)
        guess = se3.inverse(last.T_world_cam)
        motion = self.sieve.judge(Question(Stage.REFERENCE_KEYFRAME, frame, matches, semantics, guess, world))
        matches = matches.keep(motion.is_static[matches.keypoint])
        if len(matches) < self.config.min_keyframe_matches:
            return None
        # The guess is the last pose, which says nothing of how fast the camera turns.
        fix = self._fix(frame, guess, matches, motion, world, tells_turn=False)
        return fix if fix.n_inliers >= self.config.min_coarse_inliers else None

    def _with_local_map(
        self, frame: Frame, fix: _Fix, reference: int, semantics: Pending[Semantics], world: Map
    ) -> Tracked:
        surroundings = local_map_of(fix.point_ids, reference, world)
        missing = world.without(surroundings.points, np.concatenate((fix.point_ids, fix.rejected)))
        found, visible = correspondences.with_points(
            frame, missing, fix.point_ids < 0, fix.T_cam_world, world, self.config.local_window
        )
        point_ids = fix.point_ids.copy()
        point_ids[found.keypoint] = found.point_id
        matches = Matches.of(point_ids)
        motion = self.sieve.judge(Question(Stage.LOCAL_MAP, frame, matches, semantics, fix.T_cam_world, world))
        matches = matches.keep(motion.is_static[matches.keypoint])
        refined = self._fix(frame, fix.T_cam_world, matches, motion, world)
        points = world.points
        n_inliers = count_sights(visible, fix.point_ids, refined.point_ids, points.n_visible, points.n_found)
        if n_inliers < self._inliers_needed():
            return _lost(frame, surroundings.reference, motion)
        tracked = Tracked(
            self.pose.at_mid_frame(frame, refined.velocity),
            TrackingState.OK,
            se3.orthonormalize(se3.inverse(refined.T_cam_world)),
            refined.point_ids,
            motion,
            surroundings.reference,
        )
        return self.pose.learn(tracked, world)

    def _inliers_needed(self) -> int:
        return self.config.min_inliers_recovered if self._last.is_recovering else self.config.min_inliers

    def _fix(
        self, frame: Frame, guess: F64, matches: Matches, motion: Motion, world: Map, *, tells_turn: bool = True
    ) -> _Fix:
        """Optimise the pose over the matches and return it with its inliers; the guess may tell how fast it turns."""
        turn = np.inf
        if tells_turn and self.config.depth.heeds_turn:
            turn = turn_rad_s(guess, self._last.before(frame, world))
        depth = self.config.depth.terms(turn, frame.camera)
        fitted = self.pose.fit(frame, guess, matches, world.points.position_m, motion.p_static, depth)
        point_ids = np.full(len(frame), -1, dtype=np.int32)
        inlier = fitted.is_inlier
        point_ids[matches.keypoint[inlier]] = matches.point_id[inlier]
        return _Fix(fitted.T_cam_world, point_ids, motion, matches.point_id[~inlier], fitted.velocity)


@njit(nogil=True, cache=True)
def count_sights(visible: I32, seen: I32, found: I32, n_visible: I32, n_found: I32) -> int:
    """Count points that should be visible (V,) or were seen (N,), and those that were found (N,); return how many were.

    −1 is skipped. `n_visible` and `n_found` (P,) are those of the map.
    """
    for p in visible:
        n_visible[p] += 1
    n = 0
    for i in range(len(seen)):
        if seen[i] >= 0:
            n_visible[seen[i]] += 1
        if found[i] >= 0:
            n_found[found[i]] += 1
            n += 1
    return n


def _alive(keyframe: int, world: Map) -> int:
    """Return a keyframe, or the nearest of its ancestors that was not culled."""
    while not world.keyframes.is_alive[keyframe]:
        keyframe = int(world.keyframes.parent[keyframe])
    return keyframe


def _lost(frame: Frame, reference: int, motion: Motion | None = None) -> Tracked:
    motion = motion or Motion.none(len(frame), frame.image.height, frame.image.width)
    nothing = np.full(len(frame), -1, dtype=np.int32)
    return Tracked(frame, TrackingState.LOST, None, nothing, motion, reference)
