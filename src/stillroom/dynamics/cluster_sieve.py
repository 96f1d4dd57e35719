"""OC-SLAM's combined mismatch rejection (2.5): boxes and clusters together decide what is dynamic."""

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.clusters import Clusters
from stillroom.data.frame import Frame
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.dynamics.asking import ImageMemory
from stillroom.dynamics.cluster_evidence import Belief, ClusterSamples, MovingPixels, Sampler
from stillroom.dynamics.depth_history import DepthHistory, DepthHistoryConfig
from stillroom.dynamics.epipolar_sieve import EpipolarConfig
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, Bool
from stillroom.geometry.camera import Lens
from stillroom.geometry.pixels import values_at
from stillroom.protocols import Parts

SAME_M, SAME_RAD = 0.01, 0.003
"""Poses this close to each other give the same result: a centimetre at three metres."""


@dataclass(frozen=True)
class ClusterSieveConfig:
    """The sieve of the whole `oc-slam` preset (OC-SLAM 2.5).

    A cluster has pairs: its matches, which fail when they leave their epipolar line or their map point's place, and
    its points, which fail when earlier depth images saw through where they are now. More than half failing is evidence
    for motion, less than half against it; the evidence is accumulated over images as log-odds.

    Differs from the paper: depth pairs stand beside the matches, because a cluster that has just appeared has no
    matches; one image does not decide alone; and a box is prior evidence, no proof. The rule as printed is
    `dynamics.kind = "paper-clusters"`.

    Attributes:
        boxes: The sieve for keypoints in boxes.
        history: The earlier depth images that clusters are compared with. The oldest bounds how long a thing counts as
            moving after it came to rest: less than in boxes, because it may be a chair.
        gain: What one image can add to the log-odds when all pairs agree.
        suspicion: What a box adds to the log-odds of a cluster that it covers.
        limit: Largest log-odds, which bounds the weight of earlier images.
        min_known_share: Share of a cluster's points that must be visible in earlier images before they count.
        min_pairs: Matches that a cluster needs before they count.
        max_step_m, max_step_share: A match fails when it lies farther than this, or this share of its depth, from its
            map point.
        fades_in_s: Time in which unsupported log-odds fall to 1/e.
        reach_m: How far a cluster may move in depth between two images.
        margin_px: What lies this close to a moving cluster and on no plane or other cluster moves too.
        max_turn_rad_s: While the camera turns faster than this, nothing is evidence for motion: depth that lags behind
            colour makes the room move.
        weighted: Whether keypoints on a cluster that stays count as much as it is likely to stay, in poses and bundle
            adjustment (`Motion.p_static`), in place of yes and no.
    """

    needs_depth_image: ClassVar[bool] = True

    boxes: EpipolarConfig = field(default_factory=EpipolarConfig)
    history: DepthHistoryConfig = field(default_factory=lambda: DepthHistoryConfig(ages_s=(0.3, 0.6, 1.2, 2.4)))
    gain: float = 1.5
    suspicion: float = 0.5
    limit: float = bounded(4.0, above=0)
    min_known_share: float = 0.2
    min_pairs: int = 5
    max_step_m: float = 0.06
    max_step_share: float = 0.03
    fades_in_s: float = bounded(2.0, above=0)
    reach_m: float = 0.3
    margin_px: int = bounded(8, least=0, pixels=1)
    max_turn_rad_s: float = bounded(1e3, above=0)
    weighted: bool = False

    def build(self, parts: Parts) -> "ClusterSieve":
        """Return the sieve."""
        return ClusterSieve(self, parts.seed)


@dataclass(frozen=True)
class _Past:
    """Evidence of earlier images on the clusters of one image, at a pose.

    Attributes:
        inherited: Log-odds inherited from the last image (K,).
        failing: Share of their points in former free space (K,), ½ where unknown.
    """

    inherited: F64
    failing: F64


class ClusterSieve:
    """Sieve 2 of the whole `oc-slam`."""

    def __init__(self, config: ClusterSieveConfig, seed: int = 0) -> None:
        """Start without earlier images."""
        self.config = config
        self._boxes = config.boxes.build()
        self._history = DepthHistory(config.history)
        self._sampler = Sampler()
        self._belief = Belief(config.fades_in_s, config.reach_m)
        self._pixels = MovingPixels(config.margin_px)
        self._past: ImageMemory[_Past] = ImageMemory(SAME_M, SAME_RAD)
        self._believed: ImageMemory[tuple[Clusters, F64]] = ImageMemory()
        self._last: tuple[float, F64] | None = None

    def judge(self, question: Question) -> Motion:
        """Classify boxes and clusters, and every keypoint by what it lies on."""
        motion, known, frame = self._boxes.judge(question), question.known, question.frame
        clusters = known.clusters
        if clusters is None:
            return motion
        belief = self._believe(question, clusters)
        self._believed.keep(frame.image, question.T_cam_world, (clusters, belief))
        moving = self._pixels.of(clusters, belief, known.movable)
        # In boxes their own sieve decides.
        moves = values_at(moving, frame.keypoints.raw_px) & ~question.may_move
        label = clusters.labels_at(frame.keypoints.raw_px)  # of −2 or −1 where there is no cluster
        moves |= np.append(belief > 0, (False, False))[label]
        p_static = None
        if self.config.weighted:
            likely = np.append(1.0 / (1.0 + np.exp(belief)), (1.0, 1.0)).astype(np.float32)[label]
            p_static = np.where(question.may_move, np.float32(0.5) * likely, likely)
        return Motion(motion.is_static & ~moves, moving, p_static=p_static)

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Store the depth image and the log-odds."""
        self._last = frame.timestamp_s, se3.inverse(T_cam_world)
        believed = self._believed.of(frame.image)
        if believed is not None:
            self._belief.remember(frame, *believed, T_cam_world)
            self._history.remember(frame, T_cam_world)
        self._boxes.remember(frame, T_cam_world, keyframe)

    def corrected(self, T_new_old: F64) -> None:
        """Correct the stored poses."""
        if self._last is not None:
            self._last = self._last[0], T_new_old @ self._last[1]
        self._boxes.corrected(T_new_old)
        self._history.follow(T_new_old)
        self._belief.follow(T_new_old)
        self._past.forget()

    def _believe(self, question: Question, clusters: Clusters) -> F64:
        """Return the log-odds (K,) that each cluster moves."""
        config, past = self.config, self._past_of(question, clusters)
        failing = 2.0 * past.failing - 1.0
        failing += np.maximum(0.0, 2.0 * self._failing_pairs(question, clusters) - 1.0)
        if self._turn_rad_s(question) > config.max_turn_rad_s:
            failing = np.minimum(failing, 0.0)
        belief = past.inherited + config.gain * failing + config.suspicion * (clusters.box >= 0)
        return np.asarray(np.clip(belief, -config.limit, config.limit))

    def _turn_rad_s(self, question: Question) -> float:
        """Return how fast the camera has turned since the last frame that was remembered [rad/s]."""
        if self._last is None or question.frame.timestamp_s <= self._last[0]:
            return 0.0
        time_s, T_world_last = self._last
        turn_rad = float(se3.angle_rad(question.T_cam_world @ T_world_last))
        return turn_rad / (question.frame.timestamp_s - time_s)

    def _past_of(self, question: Question, clusters: Clusters) -> "_Past":
        """Return the evidence of earlier images; cached for nearly the same pose."""
        frame, T_cam_world = question.frame, question.T_cam_world
        past = self._past.near(frame.image, T_cam_world)
        if past is None:
            samples = self._sampler.take(frame, clusters)
            inherited = self._belief.of(samples, len(clusters), T_cam_world, frame.camera, frame.timestamp_s)
            failing = self._failing_points(frame, clusters, samples, T_cam_world)
            past = self._past.keep(frame.image, T_cam_world, _Past(inherited, failing))
        return past

    def _failing_points(self, frame: Frame, clusters: Clusters, samples: ClusterSamples, T_cam_world: F64) -> F64:
        """Return the share (K,) of each cluster's points that lie in former free space; ½ where unknown."""
        evidence = self._history.evidence(frame.camera, samples.in_world(T_cam_world), frame.timestamp_s)
        fails = evidence.empty > 0
        holds = ~fails & (evidence.agrees > 0)
        n = len(clusters)
        failing, holding = samples.count(n, fails), samples.count(n, holds)
        judged = failing + holding >= np.maximum(4.0, self.config.min_known_share * samples.count(n))
        return np.where(judged, failing / np.maximum(failing + holding, 1.0), 0.5)

    def _failing_pairs(self, question: Question, clusters: Clusters) -> F64:
        """Return the share (K,) of each cluster's matches that fail; ½ where there are too few."""
        frame, matches = question.frame, question.matches
        cluster = clusters.labels_at(frame.keypoints.raw_px[matches.keypoint]).astype(np.int64)
        on = cluster >= 0
        cluster, pairs = cluster[on], matches.keep(on)
        if len(pairs) == 0:
            return np.full(len(clusters), 0.5)
        kp, config, positions_m = frame.keypoints, self.config, question.world.points.position_m
        fails = has_stepped(
            pairs.keypoint,
            pairs.point_id,
            kp.px,
            kp.depth_m,
            positions_m,
            question.T_cam_world,
            frame.camera.lens,
            np.float32(config.max_step_m),
            np.float32(config.max_step_share),
        )
        fails |= self._boxes.is_off_its_line(replace(question, stage=Stage.LOCAL_MAP), pairs)
        n = np.bincount(cluster, minlength=len(clusters))
        share = np.bincount(cluster, fails, minlength=len(clusters)) / np.maximum(n, 1)
        return np.where(n >= self.config.min_pairs, share, 0.5)


@njit(nogil=True, cache=True)
def has_stepped(
    keypoint: I32,
    point_id: I32,
    px: F32,
    depth_m: F32,
    position_m: F64,
    T_cam_world: F64,
    lens: Lens,
    max_step_m: float,
    max_step_share: float,
) -> Bool:
    """Return which matches (M,) lie farther from their map points than a step; see `ClusterSieveConfig`.

    Args:
        keypoint, point_id: The matches (M,).
        px, depth_m: Undistorted pixels (N, 2) and depths (N,) [m] of the frame's keypoints.
        position_m: Positions of the map's points (P, 3) [m, world].
        T_cam_world: Pose of the frame (4, 4).
        lens: Of its camera.
        max_step_m, max_step_share: The larger of the first and this share of the depth is no step [m].
    """
    T, fails = T_cam_world, np.empty(len(keypoint), dtype=np.bool_)
    for i in range(len(keypoint)):
        seen_m = depth_m[keypoint[i]]
        z = np.float64(seen_m)
        X, Y, Z = position_m[point_id[i], 0], position_m[point_id[i], 1], position_m[point_id[i], 2]
        dx = T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3] - (px[keypoint[i], 0] - lens.cx) / lens.fx * z
        dy = T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3] - (px[keypoint[i], 1] - lens.cy) / lens.fy * z
        dz = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3] - z
        step_m = max(max_step_m, max_step_share * seen_m)
        fails[i] = z > 0.0 and math.sqrt(dx * dx + dy * dy + dz * dz) > step_m
    return fails
