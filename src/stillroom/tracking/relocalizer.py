"""Recovery after tracking was lost: relocalization by places or by the last keyframes, or a new sub-map."""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.result import Recovery, Tracked, TrackingState
from stillroom.data.semantics import Semantics
from stillroom.features.matching import consistent_rotation
from stillroom.features.places.place_index import PlaceMemory
from stillroom.features.places.vocabulary import Bag, match_by_branch
from stillroom.features.projection import Window, search_around
from stillroom.geometry.arrays import F64, I32, Bool
from stillroom.optimize import observations
from stillroom.optimize.pose import PoseOptimizerConfig
from stillroom.protocols import Parts, Pending
from stillroom.tracking.correspondences import targets_of, with_keyframe
from stillroom.tracking.start import Lost
from stillroom.tracking.tracker import Tracker

MATCHING_RATIO = 0.75


# From a candidate keyframe to a pose: matching, PnP by RANSAC, optimisation, guided search (ORB-SLAM2).


@dataclass(frozen=True)
class RecognitionConfig:
    """When a place counts as recognised (ORB-SLAM2's numbers; docs/reference.md#orb-slam2-relocalization).

    Attributes:
        min_matches: Matches by words that a keyframe needs.
        reprojection_px: RANSAC's tolerance.
        n_samples: Samples that RANSAC draws at most.
        min_ransac_inliers: Points that must agree with RANSAC's pose, and with the one refined from them.
        wide_px, wide_bits: Window on the finest level, and largest distance of descriptors, of the first search around
            projections.
        narrow_px, narrow_bits: The same of the second, once `narrow_from` points agree.
        narrow_from: See there.
        min_inliers: Fewest inliers finally.
        pose: The optimiser.
    """

    min_matches: int = 15
    reprojection_px: float = bounded(4.0, above=0, pixels=1)
    n_samples: int = 300
    min_ransac_inliers: int = 10
    wide_px: float = 10.0
    wide_bits: int = 100
    narrow_px: float = 3.0
    narrow_bits: int = 64
    narrow_from: int = 30
    min_inliers: int = 50
    pose: PoseOptimizerConfig = field(default_factory=PoseOptimizerConfig)

    def build(self, parts: Parts) -> "Recognizer":
        """Return the recogniser; the seed initialises its random generator."""
        return Recognizer(self, parts.seed)


@dataclass(frozen=True)
class RecognizedPose:
    """A pose and its inliers.

    Attributes:
        T_cam_world: The pose (4, 4).
        point_ids: Map point of each keypoint (N,) int32; −1 where none.
    """

    T_cam_world: F64
    point_ids: I32

    @property
    def n_inliers(self) -> int:
        """Number of points that agree."""
        return int((self.point_ids >= 0).sum())


class Recognizer:
    """Estimates the pose of a frame relative to a candidate keyframe."""

    def __init__(self, config: RecognitionConfig, seed: int) -> None:
        """Store the parts."""
        self.config, self.seed = config, seed
        self._optimize = config.pose.build()

    def recognise(self, frame: Frame, bag: Bag, keyframe: int, nodes: I32, world: Map) -> RecognizedPose | None:
        """Return the pose of a frame by the points of a keyframe and its neighbours; None where too few agree.

        Differs from ORB-SLAM2: the guided search includes the points of the keyframe's neighbours.

        Args:
            frame: The frame.
            bag: Its bag of words.
            keyframe: The candidate keyframe.
            nodes: The branch of each of its keypoints.
            world: The map.
        """
        config = self.config
        matches = by_words(frame, bag, keyframe, nodes, world)
        if len(matches) < config.min_matches:
            return None
        solved = solve_pnp(
            frame, matches, world, config.reprojection_px, config.n_samples, config.min_ransac_inliers, self.seed
        )
        if solved is None:
            return None
        found = self.fit(frame, solved[0], matches.keep(solved[1]), world)
        if found.n_inliers < config.min_ransac_inliers:
            return None
        group = [keyframe, *world.covisibility.neighbours(keyframe, 10)]
        surroundings = world.points_seen_by(np.array(group))
        if found.n_inliers < config.min_inliers:
            found = self._search(frame, found, surroundings, config.wide_px, config.wide_bits, world)
        if config.narrow_from <= found.n_inliers < config.min_inliers:
            found = self._search(frame, found, surroundings, config.narrow_px, config.narrow_bits, world)
        return found if found.n_inliers >= config.min_inliers else None

    def fit(self, frame: Frame, T_cam_world: F64, matches: Matches, world: Map) -> RecognizedPose:
        """Optimise a pose (4, 4) over matches, and keep those that agree with it."""
        keypoints = frame.keypoints
        right_px = keypoints.right_px[matches.keypoint]
        estimate = self._optimize(
            T_cam_world,
            world.points.position_m[matches.point_id],
            observations.observed_px(keypoints.px[matches.keypoint], right_px),
            observations.weights(keypoints.octave[matches.keypoint], right_px, frame.scales.inverse_variances),
            frame.camera,
        )
        inlier = estimate.is_inlier
        point_ids = np.full(len(frame), -1, dtype=np.int32)
        point_ids[matches.keypoint[inlier]] = matches.point_id[inlier]
        return RecognizedPose(estimate.T_cam_world, point_ids)

    def _search(
        self, frame: Frame, found: RecognizedPose, ids: I32, radius_px: float, max_bits: int, world: Map
    ) -> RecognizedPose:
        """Search more of the points (P,) around their projections, and fit the pose to all matches."""
        missing = ids[~np.isin(ids, found.point_ids)]
        more = around_projections(
            frame, found.T_cam_world, missing, found.point_ids < 0, Window(radius_px, max_bits=max_bits), world
        )
        point_ids = found.point_ids.copy()
        point_ids[more.keypoint] = more.point_id
        return self.fit(frame, found.T_cam_world, Matches.of(point_ids), world)


def by_words(frame: Frame, bag: Bag, keyframe: int, nodes: I32, world: Map) -> Matches:
    """Match a frame with the points of a keyframe, branch by branch of the vocabulary."""
    rows = world.rows(keyframe)
    point = world.keypoints.point[rows]
    mine, theirs = match_by_branch(
        frame.keypoints.descriptors,
        np.where(frame.is_static, bag.nodes, np.int32(-1)),
        world.keypoints.descriptors[rows],
        np.where(point >= 0, nodes, np.int32(-1)),
        ratio=MATCHING_RATIO,
    )
    steady = consistent_rotation(world.keypoints.angle_rad[rows][theirs], frame.keypoints.angle_rad[mine])
    return Matches(mine, point[theirs], world.keypoints.px[rows][theirs]).keep(steady)


def around_projections(frame: Frame, T_cam_world: F64, ids: I32, free: Bool, window: Window, world: Map) -> Matches:
    """Search points (P,) among the free keypoints (N,) around their projections at a pose (4, 4)."""
    targets = targets_of(frame, free & frame.is_static)
    found = search_around(ids, T_cam_world, frame.camera, world, targets, window, frame.scales)
    unknown_px = np.full((len(found.target), 2), np.nan, dtype=np.float32)
    return Matches(found.target, found.point_ids, unknown_px)


def solve_pnp(
    frame: Frame, matches: Matches, world: Map, reprojection_px: float, n_samples: int, min_inliers: int, seed: int
) -> tuple[F64, Bool] | None:
    """Solve for `T_cam_world` (4, 4) by EPnP in RANSAC; return it with its inliers (M,), or None."""
    points_m = world.points.position_m[matches.point_id]
    centre_m = points_m.mean(axis=0)  # sub-maps may lie far from the origin
    cv2.setRNGSeed(seed)
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        points_m - centre_m,
        frame.keypoints.px[matches.keypoint].astype(np.float64),
        frame.camera.K,
        np.zeros(4),
        iterationsCount=n_samples,
        reprojectionError=reprojection_px,
        confidence=0.99,
        flags=cv2.SOLVEPNP_EPNP,
    )
    if not found or inliers is None or len(inliers) < min_inliers:
        return None
    T_cam_world = np.eye(4)
    T_cam_world[:3, :3] = cv2.Rodrigues(rotation)[0]
    T_cam_world[:3, 3] = translation[:, 0] - T_cam_world[:3, :3] @ centre_m
    is_inlier = np.zeros(len(matches), dtype=np.bool_)
    is_inlier[inliers[:, 0]] = True
    return T_cam_world, is_inlier


@dataclass(frozen=True)
class RelocalizerConfig:
    """Relocalization, and when to begin a sub-map.

    Attributes:
        n_places: Candidate places to try.
        recognition: When one counts as recognised.
        n_keyframes: Newest keyframes to try where no place was recognised.
        min_matches: Matches that such a keyframe needs.
        reprojection_px: RANSAC's tolerance with them.
        min_inliers: Points that must agree with such a pose before it is refined.
        patience: Frames with enough keypoints that are not recognised before a sub-map is begun; 0: never.
    """

    n_places: int = bounded(5, least=0)
    recognition: RecognitionConfig = field(default_factory=RecognitionConfig)
    n_keyframes: int = bounded(10, least=0)
    min_matches: int = bounded(20, least=0)
    reprojection_px: float = bounded(4.0, above=0, pixels=1)
    min_inliers: int = bounded(15, least=0)
    patience: int = bounded(20, least=0)

    def build(self, parts: Parts, tracker: Tracker, places: PlaceMemory) -> "Relocalizer":
        """Return a relocalizer that queries the place index and refines poses with the tracker."""
        return Relocalizer(self, parts, tracker, places)


class Relocalizer:
    """Called with every frame on which tracking failed. Sieves do not reject meanwhile (`Stage.RELOCALIZATION`).

    The most similar place is tried first, independent of the last pose: matching, PnP, a guided search. Then the newest
    keyframes, each with all its descriptors: after a short gap they work better than words.
    """

    def __init__(self, config: RelocalizerConfig, parts: Parts, tracker: Tracker, places: PlaceMemory) -> None:
        """Store the parts."""
        self.config, self.tracker, self.places, self.seed = config, tracker, places, parts.seed
        self._recognizer = config.recognition.build(parts)
        self._lost: Lost | None = None

    def recover(self, tracked: Tracked, semantics: Pending[Semantics], world: Map) -> Tracked:
        """Return the lost frame with a pose, or unchanged if it is not recognised.

        After some failures a frame with enough keypoints begins a sub-map.
        """
        found = self.by_place(tracked, semantics, world) or self._by_last_keyframes(tracked, semantics, world)
        if found is None:
            lost = self._lost = self._still_lost(tracked, world)
            found = self._new_submap(tracked, lost, semantics, world)
            found = found or self._started_again(tracked, lost, semantics, world)
        if not found.lost:
            self._lost = None
        return found

    def by_place(self, tracked: Tracked, semantics: Pending[Semantics], world: Map) -> Tracked | None:
        """Return the frame where a place was recognised."""
        frame, index = tracked.frame, self.places.index
        bag = self.places.bag_of_frame(frame)
        for keyframe in self.places.candidates(bag, at_most=self.config.n_places):
            if int(keyframe) not in index:
                continue  # culled by another thread meanwhile
            nodes = index.nodes(int(keyframe))
            found = self._recognizer.recognise(frame, bag, int(keyframe), nodes, world)
            located = None if found is None else self._located(tracked, found, semantics, world, Recovery.PLACE)
            if located is not None:
                return located
        return None

    def _by_last_keyframes(self, tracked: Tracked, semantics: Pending[Semantics], world: Map) -> Tracked | None:
        config = self.config
        for keyframe in world.alive_keyframes()[::-1][: config.n_keyframes]:
            matches = with_keyframe(tracked.frame, int(keyframe), world)
            if len(matches) < config.min_matches:
                continue
            solved = solve_pnp(
                tracked.frame, matches, world, config.reprojection_px, 300, config.min_inliers, self.seed
            )
            if solved is None:
                continue
            T_cam_world, inlier = solved
            point_ids = np.full(len(tracked.frame), -1, dtype=np.int32)
            point_ids[matches.keypoint[inlier]] = matches.point_id[inlier]
            found = RecognizedPose(T_cam_world, point_ids)
            located = self._located(tracked, found, semantics, world, Recovery.LAST_KEYFRAMES)
            if located is not None:
                return located
        return None

    def _located(
        self, tracked: Tracked, found: RecognizedPose, semantics: Pending[Semantics], world: Map, recovery: Recovery
    ) -> Tracked | None:
        """Return the frame at a pose that its local map confirms."""
        located = self.tracker.locate(tracked.frame, found.T_cam_world, found.point_ids, semantics, world, recovery)
        return None if located.lost else located

    def _still_lost(self, tracked: Tracked, world: Map) -> Lost:
        """Return for how long tracking has been lost with one more image, whose place was not recognised."""
        # The first image that is lost still knows its reference keyframe.
        since = int(world.keyframes.submap[tracked.reference_keyframe]), tracked.frame.timestamp_s
        lost = self._lost or Lost(*since)
        return replace(lost, n_in_vain=lost.n_in_vain + self.tracker.start.may_begin(tracked.frame))

    def _started_again(self, tracked: Tracked, lost: Lost, semantics: Pending[Semantics], world: Map) -> Tracked:
        """Return the lost frame; where its map is dropped, as one that may begin another."""
        if not self.tracker.start.starts_again(lost, world) or not world.is_empty:
            return tracked
        return self.tracker.start.start(tracked.frame, semantics, world)

    def _new_submap(self, tracked: Tracked, lost: Lost, semantics: Pending[Semantics], world: Map) -> Tracked | None:
        """Return the frame as the first of a sub-map, when that is due and it has enough keypoints."""
        if self.config.patience == 0:
            return None
        frame = tracked.frame
        if not self.tracker.start.may_begin(frame):
            return None
        if lost.n_in_vain <= self.config.patience:
            return None
        started = self.tracker.start.start(frame, semantics, world)
        if started.state is not TrackingState.OK:
            return None
        return replace(started, recovery=Recovery.NEW_SUBMAP)
