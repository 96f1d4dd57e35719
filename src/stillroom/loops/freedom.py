"""What drifts in a map, so that a loop has to put it right: in a metric map poses, in one up to scale the scale too.

Everything in which the loops of the two kinds of maps differ is here: a place is seen again under a rigid motion or
under a similarity, and the pose graph is one over SE(3) or Sim(3) (Strasdat et al., RSS 2010; ORB-SLAM, Mur-Artal et
al. 2015, section VII; docs/reference.md#orb-slam2-loops).
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from stillroom.data.map import Map
from stillroom.data.sensor import Sensor
from stillroom.geometry import se3, sim3
from stillroom.geometry.arrays import F64, I32, I64, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.groups import RIGID, SIMILAR, MotionGroup
from stillroom.loops.moves import Places
from stillroom.optimize import observations
from stillroom.optimize.bundle import BundleResult
from stillroom.optimize.pose import PoseOptimizer
from stillroom.optimize.similarity import SharedPoints, SimilarityOptimizer

SIGMA_M, SIGMA_RAD = 0.01, 0.005
"""Standard deviations of the motion between keyframes that share a hundred points, related as at a depth of two
metres.
"""
TYPICAL_DEPTH_M = 2.0
LEAST_BOTH_WAYS = 20
"""Points that both keyframes must know, each in its own scale, for the scale between them (ORB-SLAM2)."""


@dataclass(frozen=True)
class Sighting:
    """How a keyframe sees a place.

    Attributes:
        T_cam_world: Its pose (4, 4) relative to the surroundings of the place.
        scale: Lengths of the place's surroundings in one of its own surroundings; 1 in a metric map.
    """

    T_cam_world: F64
    scale: float = 1.0


@dataclass(frozen=True)
class Pairs:
    """Keypoints of a keyframe, by their rows (M,) in the table, and the points (M,) of a place that they see."""

    rows: I64
    point_ids: I32

    def __len__(self) -> int:
        """Their number."""
        return len(self.rows)

    def keep(self, chosen: Bool) -> "Pairs":
        """Return some of them."""
        return Pairs(self.rows[chosen], self.point_ids[chosen])


class Freedom(Protocol):
    """What a loop may change of a map.

    Attributes:
        group: The kind of motion between two visits of a place, and of the pose graph.
    """

    group: MotionGroup

    def unit(self, keyframe: int, world: Map) -> float:
        """Return how long a metre of the settings is around a keyframe, in lengths of the map."""

    def sighting(self, T_here_there: F64, T_there_world: F64) -> Sighting:
        """Return how a keyframe sees a place, by the motion (4, 4) of the camera that saw it before to its own."""

    def refined(
        self, guess: Sighting, pairs: Pairs, keyframe: int, candidate: int, camera: Camera, world: Map
    ) -> tuple[Sighting, Bool] | None:
        """Fit a sighting to pairs, and return it with those (M,) that agree; None where they do not determine it.

        Args:
            guess: Where to start.
            pairs: What the keyframe sees of the place.
            keyframe, candidate: The keyframe, and the one that saw the place before.
            camera: The calibration.
            world: The map.
        """

    def information(self, shared: F64, second: I64, world: Map) -> F64:
        """Return the inverse variances (E, D) of edges of the pose graph.

        Args:
            shared: Points that the keyframes of each share, relative to a typical number (E,).
            second: The second keyframe of each (E,).
            world: The map.
        """

    def place(self, keyframes: I64, nodes: F64, before: Places, world: Map) -> None:
        """Write the nodes (N, 4, 4) of a pose graph to keyframes (N,) of the map."""

    def in_gauge(self, result: BundleResult, points_before_m: F64, is_fixed: Bool) -> BundleResult:
        """Return the result of a bundle adjustment with what it left undetermined as it was before.

        Args:
            result: The result.
            points_before_m: The points (P, 3) before.
            is_fixed: Which keyframes (K,) were held.
        """


class RigidFreedom:
    """That of a metric map: position and orientation."""

    group = RIGID

    def __init__(self) -> None:
        self._optimize = PoseOptimizer()

    def unit(self, keyframe: int, world: Map) -> float:
        """Return 1: lengths are metres."""
        return 1.0

    def sighting(self, T_here_there: F64, T_there_world: F64) -> Sighting:
        """Chain the motions."""
        return Sighting(T_here_there @ T_there_world)

    def refined(
        self, guess: Sighting, pairs: Pairs, keyframe: int, candidate: int, camera: Camera, world: Map
    ) -> tuple[Sighting, Bool] | None:
        """Optimise the pose."""
        table = world.keypoints
        right_px, octave = table.right_px[pairs.rows], table.octave[pairs.rows]
        estimate = self._optimize(
            guess.T_cam_world,
            world.points.position_m[pairs.point_ids],
            observations.observed_px(table.px[pairs.rows], right_px),
            observations.weights(octave, right_px, world.scales.inverse_variances),
            camera,
        )
        return Sighting(estimate.T_cam_world), estimate.is_inlier

    def information(self, shared: F64, second: I64, world: Map) -> F64:
        """Return that of translations [1/m²] and rotations [1/rad²]."""
        variance = np.repeat((SIGMA_M**2, SIGMA_RAD**2), 3)
        information: F64 = shared[:, None] / variance
        return information

    def place(self, keyframes: I64, nodes: F64, before: Places, world: Map) -> None:
        """Write the poses."""
        world.keyframes.T_world_cam[keyframes] = nodes

    def in_gauge(self, result: BundleResult, points_before_m: F64, is_fixed: Bool) -> BundleResult:
        """Return it as it is: depth determines the scale, and a keyframe that is held the rest."""
        return result


class SimilarFreedom:
    """That of a map up to scale: its scale drifts as well."""

    group = SIMILAR

    def __init__(self) -> None:
        self._optimize = SimilarityOptimizer()

    def unit(self, keyframe: int, world: Map) -> float:
        """Return half the median depth of what the keyframe sees: settings in metres suit a depth of two."""
        return depth_of(keyframe, world) / TYPICAL_DEPTH_M

    def sighting(self, T_here_there: F64, T_there_world: F64) -> Sighting:
        """Chain the motions; the pose is in lengths of the place."""
        return Sighting(sim3.rigid(_in_lengths_there(T_here_there)) @ T_there_world, 1.0 / _scale(T_here_there))

    def refined(
        self, guess: Sighting, pairs: Pairs, keyframe: int, candidate: int, camera: Camera, world: Map
    ) -> tuple[Sighting, Bool] | None:
        """Optimise the similarity by the errors in both images, as ORB-SLAM2's OptimizeSim3."""
        T_there_world = se3.inverse(world.keyframes.T_world_cam[candidate])
        points = _shared_points(pairs, keyframe, candidate, T_there_world, world)
        S_here_there = sim3.of(guess.T_cam_world @ se3.inverse(T_there_world), 1.0)
        S_here_there[:3] /= guess.scale
        estimate = self._optimize(S_here_there, points, camera)
        if np.count_nonzero(estimate.is_inlier & (points.second_weights > 0)) < LEAST_BOTH_WAYS:
            return None
        return self.sighting(estimate.S_first_second, T_there_world), estimate.is_inlier

    def information(self, shared: F64, second: I64, world: Map) -> F64:
        """Return that of translations, relative to the depth of what is seen, rotations, and logarithms of scales."""
        keyframes, place = np.unique(second, return_inverse=True)
        unit = np.array([self.unit(int(keyframe), world) for keyframe in keyframes])[place]
        sigma_scale = SIGMA_M / TYPICAL_DEPTH_M
        variance = np.repeat((SIGMA_M**2, SIGMA_RAD**2, sigma_scale**2), (3, 3, 1)) * np.ones((len(second), 1))
        variance[:, :3] *= unit[:, None] ** 2
        information: F64 = shared[:, None] / variance
        return information

    def place(self, keyframes: I64, nodes: F64, before: Places, world: Map) -> None:
        """Write the poses and, in `KeyframeTable.scale`, how lengths changed."""
        world.keyframes.T_world_cam[keyframes] = sim3.rigid(nodes)
        world.keyframes.scale[keyframes] = before.scale[keyframes] * sim3.scale(nodes)

    def in_gauge(self, result: BundleResult, points_before_m: F64, is_fixed: Bool) -> BundleResult:
        """Return it at the scale of before where a single keyframe was held: images do not determine it."""
        held = np.flatnonzero(is_fixed)
        if len(held) != 1 or len(points_before_m) == 0:
            return result
        centre_m = se3.inverse(result.T_cam_world[held[0]])[:3, 3]
        distances = [np.linalg.norm(points - centre_m, axis=1) for points in (points_before_m, result.points_world_m)]
        known = (distances[0] > 0) & (distances[1] > 0)
        if not known.any():
            return result
        growth = float(np.median(distances[0][known] / distances[1][known]))
        T_world_cam = se3.inverse(result.T_cam_world)
        T_world_cam[:, :3, 3] = centre_m + growth * (T_world_cam[:, :3, 3] - centre_m)
        T_cam_world = se3.inverse(T_world_cam)
        T_cam_world[held] = result.T_cam_world[held]
        points_m = centre_m + growth * (result.points_world_m - centre_m)
        return replace(result, T_cam_world=T_cam_world, points_world_m=points_m)


def freedom_of(world: Map) -> Freedom:
    """Return what loops may change of a map, by the sensor that made it."""
    return SimilarFreedom() if world.sensor is Sensor.MONOCULAR else RigidFreedom()


def depth_of(keyframe: int, world: Map) -> float:
    """Return the median depth of the points that a keyframe sees, in lengths of the map; 1 where it sees none."""
    own = world.points_of(keyframe)
    seen = world.points.position_m[own[own >= 0]]
    depth = (seen - world.keyframes.T_world_cam[keyframe, :3, 3]) @ world.keyframes.T_world_cam[keyframe, :3, 2]
    depth = depth[depth > 0]
    return float(np.median(depth)) if len(depth) else 1.0


def _scale(S: F64) -> float:
    return float(sim3.scale(S))


def _in_lengths_there(S_here_there: F64) -> F64:
    """Return a similarity whose target is measured in lengths of its source: of scale 1."""
    T = S_here_there.copy()
    T[:3] /= _scale(S_here_there)
    return T


def _shared_points(pairs: Pairs, keyframe: int, candidate: int, T_there_world: F64, world: Map) -> SharedPoints:
    """Return what the keyframe sees of the place, and which of it both know, each for itself."""
    table, positions_m = world.keypoints, world.points.position_m
    own = table.point[pairs.rows]
    T_here_world = se3.inverse(world.keyframes.T_world_cam[keyframe])
    rows = world.rows(candidate)
    row_of = np.full(len(world.points), -1, dtype=np.int64)
    seen_there = table.point[rows]
    row_of[seen_there[seen_there >= 0]] = rows.start + np.flatnonzero(seen_there >= 0)
    back = row_of[pairs.point_ids]
    both = (own >= 0) & (back >= 0) & (own != pairs.point_ids)
    inverse_variances = world.scales.inverse_variances
    return SharedPoints(
        of_second_m=se3.transform(T_there_world, positions_m[pairs.point_ids]),
        first_px=table.px[pairs.rows].astype(np.float64),
        first_weights=inverse_variances[table.octave[pairs.rows]],
        of_first_m=np.where(both[:, None], se3.transform(T_here_world, positions_m[own]), 0.0),
        second_px=table.px[back].astype(np.float64),
        second_weights=np.where(both, inverse_variances[table.octave[back]], 0.0),
    )
