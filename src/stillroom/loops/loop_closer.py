"""Loop closing: detect, verify, correct, and undo wrong loops (ORB-SLAM2's third thread)."""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.features.places.place_index import PlaceMemory
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.geometry.groups import SIMILAR
from stillroom.loops.correction import Correction, close_loop, essential_edges, paths_from
from stillroom.loops.detection import DetectionConfig
from stillroom.loops.freedom import freedom_of
from stillroom.loops.global_bundle import GlobalBundle
from stillroom.loops.verdict import LinkChange, Snapshot, Verdict, judge
from stillroom.loops.verification import Loop, VerificationConfig
from stillroom.optimize.bundle import BundleConfig
from stillroom.optimize.pose_graph import PoseGraphConfig
from stillroom.protocols import Parts

logger = logging.getLogger(__name__)
LARGEST_SCALE_DRIFT = 5.0
"""Of the logarithm: beyond, any position is explained."""


@dataclass(frozen=True)
class LoopsConfig:
    """Loop closing. In a map up to scale a metre is half the median depth of what the keyframe sees.

    Attributes:
        enabled: Whether loops are closed; OC-SLAM was evaluated without.
        detection, verification: What counts as a loop.
        drift_m, drift_rad: Drift allowed anywhere.
        drift_m_per_m, drift_rad_per_m: Drift allowed on each metre of the shortest known path between the two visits: a
            similar place that odometry puts further off is refused.
        drift_scale, drift_scale_per_m: The same for the logarithm of the scale, in a map up to scale; what a drift of
            scale does to positions is allowed too.
        sight_m, sight_rad: Images further apart than this show different things. Candidates that the allowed drift
            cannot explain are not verified.
        full_beyond_m, full_beyond_rad, full_beyond_scale: A loop with a larger error than this is followed by bundle
            adjustment of all keyframes; else of those that show the place, at a cost independent of the size of the
            map.
        essential_weight: Shared points from which on two keyframes are connected in the essential graph.
        max_lost_share: Largest share of the map's observations that may become outliers; beyond, the loop is undone.
        max_lost_share_of_one: The same for the worst keyframe.
        min_kept_share: Least share of the fused observations that must be inliers afterwards.
        abort_after: Full bundle adjustment ends early when this many keyframes were added meanwhile.
        graph, bundle: The optimisers. Adjustment starts almost undamped: the pose graph has brought it near the
            optimum, and damping slows the large-scale deformation first.
    """

    enabled: bool = True
    detection: DetectionConfig = field(default_factory=DetectionConfig)
    verification: VerificationConfig = field(default_factory=VerificationConfig)
    drift_m: float = 0.3
    drift_rad: float = 0.2
    drift_m_per_m: float = 0.1
    drift_rad_per_m: float = 0.03
    drift_scale: float = 0.1
    drift_scale_per_m: float = 0.02
    sight_m: float = 3.0
    sight_rad: float = 1.2
    full_beyond_m: float = 0.05
    full_beyond_rad: float = 0.02
    full_beyond_scale: float = 0.02
    essential_weight: int = 100
    max_lost_share: float = bounded(0.05, least=0, most=1)
    max_lost_share_of_one: float = bounded(0.4, least=0, most=1)
    min_kept_share: float = bounded(0.5, least=0, most=1)
    abort_after: int = 3
    graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    bundle: BundleConfig = field(default_factory=lambda: BundleConfig(first_damping=1e-8))

    def build(self, parts: Parts, places: PlaceMemory, after: Sequence[Callable[[], object]] = ()) -> "LoopClosing":
        """Return the loop closer of a map.

        Args:
            parts: What it is built of.
            places: The place index of the keyframes.
            after: Called when the map has been corrected, to update what depends on keyframe poses.
        """
        check(self, "loops")
        return LoopCloser(self, parts, places, after) if self.enabled else NoLoops()


class LoopClosing(Protocol):
    """Corrects the map when a place is seen again."""

    def close(self, keyframe: int) -> bool:
        """Check whether a keyframe, the newest, closes a loop, and correct the map; return whether it did."""


class NoLoops:
    """The null object: closes no loops."""

    def close(self, keyframe: int) -> bool:
        """Return that there was none."""
        return False


class LoopCloser:
    """Closes loops. Called with every new keyframe, in order, after local mapping.

    Attributes:
        closed: The loops that were closed.
        refused: Loops that were undone, with the reason.
    """

    def __init__(
        self,
        config: LoopsConfig,
        parts: Parts,
        places: PlaceMemory,
        after: Sequence[Callable[[], object]],
    ) -> None:
        """Start empty."""
        self.config, self.camera, self.world, self.places = config, parts.camera, parts.world, places
        self.closed: list[Loop] = []
        self.refused: list[tuple[Loop, Verdict]] = []
        self._detector = config.detection.build(parts, places)
        self._verifier = config.verification.build(parts)
        self._optimize, self._adjust = config.graph.build(), config.bundle.build()
        self._freedom = freedom_of(parts.world)
        self._after = tuple(after)

    def close(self, keyframe: int) -> bool:
        """Check whether a keyframe, the newest, closes a loop, and correct the map; return whether it did."""
        with self.world.lock:
            loop = self._found(keyframe)
        return loop is not None and self.correct(loop)

    def _found(self, keyframe: int) -> Loop | None:
        """Return the loop that a keyframe closes; None where it closes none."""
        if not self.world.keyframes.is_alive[keyframe]:
            return None
        for candidate in self._within_sight(keyframe, self._detector.candidates(keyframe)):
            loop = self._verifier.verify(keyframe, candidate, self.places.index, self.world)
            if loop is not None and self._is_plausible(loop):
                self._detector.pause(keyframe)
                return loop
        return None

    def _is_plausible(self, loop: Loop) -> bool:
        """Return whether the allowed drift explains the loop."""
        T_is_should = se3.inverse(self.world.keyframes.T_world_cam[loop.keyframe]) @ loop.T_world_cam
        edges = essential_edges(self.world, self.world.covisibility.min_weight)
        unit = self._freedom.unit(loop.keyframe, self.world)
        way_m = float(paths_from(loop.keyframe, edges, self.world, unit)[loop.candidate])
        T_is_should[:3, 3] /= unit
        scaled = abs(math.log(loop.scale))
        plausible = scaled <= self._scale_drift(way_m) and self._may_be_off(T_is_should, way_m, scaled)
        logger.info(
            "keyframe %d looks like %d: %d of %d points, off by %.3f m, %.3f rad and × %.3f after %.1f m: %s",
            loop.keyframe,
            loop.candidate,
            len(loop.rows),
            loop.n_visible,
            float(np.linalg.norm(T_is_should[:3, 3])),
            float(se3.angle_rad(T_is_should)),
            loop.scale,
            way_m,
            "plausible" if plausible else "refused",
        )
        return plausible

    def _within_sight(self, keyframe: int, candidates: list[int]) -> list[int]:
        """Return the candidates that may show what the keyframe shows, given the allowed drift."""
        if not candidates:
            return []
        poses, config = self.world.keyframes.T_world_cam, self.config
        unit = self._freedom.unit(keyframe, self.world)
        ways_m = paths_from(keyframe, essential_edges(self.world, None), self.world, unit)
        between = se3.inverse(poses[keyframe]) @ poses[np.array(candidates)]
        between[:, :3, 3] /= unit
        margin = config.sight_m, config.sight_rad
        return [
            k
            for k, T, way_m in zip(candidates, between, ways_m[candidates].tolist(), strict=True)
            if self._may_be_off(T, way_m, self._scale_drift(way_m), *margin)
        ]

    def _scale_drift(self, way_m: float) -> float:
        """Return how much the logarithm of the scale may have drifted along a path; 0 in a metric map."""
        if self._freedom.group is not SIMILAR:
            return 0.0
        return self.config.drift_scale + self.config.drift_scale_per_m * way_m

    def _may_be_off(
        self, T_is_should: F64, way_m: float, scaled: float, more_m: float = 0.0, more_rad: float = 0.0
    ) -> bool:
        """Return whether drift along a path, of which `scaled` of the scale, and a margin, explain a motion (4, 4)."""
        config = self.config
        off_m, off_rad = float(np.linalg.norm(T_is_should[:3, 3])), float(se3.angle_rad(T_is_should))
        drift_m_per_m = config.drift_m_per_m + math.expm1(min(scaled, LARGEST_SCALE_DRIFT))
        near = off_m <= config.drift_m + drift_m_per_m * way_m + more_m
        return near and off_rad <= config.drift_rad + config.drift_rad_per_m * way_m + more_rad

    def correct(self, loop: Loop) -> bool:
        """Correct the map for a loop; undo it where too many earlier inliers are lost."""
        world = self.world
        with world.lock.between_frames():
            before = Snapshot(world)
            correction = close_loop(loop, world, self.camera, self._optimize, self.config.essential_weight)
            links = LinkChange.since(before, world)
            bundle = self._bundle_after(correction)
            self._jump(loop, before.T_world_cam[loop.keyframe])
        n_keyframes = len(world.keyframes)
        result = bundle.solve(
            self.camera, self._adjust, lambda: len(world.keyframes) >= n_keyframes + self.config.abort_after
        )
        with world.lock.between_frames():
            T_world_corrected = world.keyframes.T_world_cam[loop.keyframe].copy()
            bundle.commit(result, world)
            verdict = judge(before, links, world, self.camera)
            right = self._accepts(verdict)
            if not right:
                before.restore(world)
            self._jump(loop, T_world_corrected)
        logger.info("loop %d – %d: %s, %s", loop.keyframe, loop.candidate, verdict, "closed" if right else "undone")
        if not right:
            self.refused.append((loop, verdict))
            return False
        self.closed.append(loop)
        for follow in self._after:
            follow()
        return True

    def _jump(self, loop: Loop, T_world_before: F64) -> None:
        """Record how far the keyframe has moved from a pose (4, 4), for all that stores poses of its surroundings."""
        self.world.jumps.append(self.world.keyframes.T_world_cam[loop.keyframe] @ se3.inverse(T_world_before))

    def _bundle_after(self, correction: Correction) -> GlobalBundle:
        config = self.config
        moved = correction.moved_m > config.full_beyond_m or correction.turned_rad > config.full_beyond_rad
        if moved or abs(correction.rescaled) > config.full_beyond_scale:
            return GlobalBundle(correction.keyframes, self.world)
        return GlobalBundle(correction.around, self.world, in_place=True)

    def _accepts(self, verdict: Verdict) -> bool:
        config = self.config
        return (
            verdict.lost_share <= config.max_lost_share
            and verdict.worst_share <= config.max_lost_share_of_one
            and verdict.kept_share >= config.min_kept_share
        )
