"""Geometric verification of a loop: a motion that aligns the matched points."""

from dataclasses import dataclass

import numpy as np

from stillroom.data.map import Map
from stillroom.features.matching import consistent_rotation
from stillroom.features.places.place_index import PlaceIndex
from stillroom.features.places.vocabulary import match_by_branch
from stillroom.features.projection import Window, keyframe_targets, projected, search_around
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32, I64, Bool, Floats
from stillroom.geometry.camera import Camera
from stillroom.geometry.groups import SIMILAR
from stillroom.geometry.matched_clouds import fit_robustly
from stillroom.loops.freedom import Pairs, Sighting, freedom_of
from stillroom.protocols import Parts

_CHI2_RANSAC = 9.21
"""99 % at two degrees of freedom: the limit on the error of a pair in either image (ORB-SLAM2)."""


@dataclass(frozen=True)
class VerificationConfig:
    """What makes a candidate a loop (ORB-SLAM2's numbers; docs/reference.md#orb-slam2-loops).

    Attributes:
        min_matches: Matches of points by their descriptors.
        n_samples: Triples that RANSAC tries.
        min_inliers: Pairs that agree with one motion, before and after the search that it guides.
        window_px: Where that search looks, on the finest level.
        min_total: Points of the place and its surroundings that the keyframe must match finally.
        min_share: Least share of the visible ones that it must match.
    """

    min_matches: int = 20
    n_samples: int = 300
    min_inliers: int = 20
    window_px: float = 7.5
    min_total: int = 40
    min_share: float = 0.1

    def build(self, parts: Parts) -> "Verifier":
        """Return the verifier; the seed initialises its random generator."""
        return Verifier(self, parts)


@dataclass(frozen=True)
class Loop:
    """A keyframe that shows a known place.

    Attributes:
        keyframe: The keyframe.
        candidate: The keyframe that showed the place before.
        T_world_cam: Pose (4, 4) of the keyframe relative to the candidate's surroundings.
        rows: Rows of the keypoint table (M,), all of the keyframe.
        point_ids: The points of the place that they see (M,).
        n_visible: How many of the place's points should be seen.
        scale: Lengths of the candidate's surroundings in one of the keyframe's own; 1 in a metric map.
    """

    keyframe: int
    candidate: int
    T_world_cam: F64
    rows: I64
    point_ids: I32
    n_visible: int
    scale: float = 1.0

    def correction(self, world: Map) -> F64:
        """Return the motion (4, 4) of the coordinates around the keyframe that lays them on the place."""
        T_cam_world = se3.inverse(world.keyframes.T_world_cam[self.keyframe])
        T_cam_world[:3] *= self.scale
        corrected: F64 = self.T_world_cam @ T_cam_world
        return corrected


class Verifier:
    """Checks candidates for a loop, one by one."""

    def __init__(self, config: VerificationConfig, parts: Parts) -> None:
        self.config, self.camera, self.seed = config, parts.camera, parts.seed
        self._freedom = freedom_of(parts.world)

    def verify(self, keyframe: int, candidate: int, index: PlaceIndex, world: Map) -> Loop | None:
        """Return the loop that a keyframe closes with a candidate, or None where they do not show the same place.

        Args:
            keyframe: The new keyframe; it is in the index.
            candidate: A keyframe that looks like it; it is in the index too.
            index: Its direct index chooses the keypoints to compare.
            world: The map.
        """
        config = self.config
        pairs = self._by_descriptors(keyframe, candidate, index, world)
        if len(pairs) < config.min_matches:
            return None
        guess = self._by_ransac(pairs, keyframe, candidate, world)
        if guess is None:
            return None
        own = world.points_of(candidate)
        fix = self._search_and_fit(own[own >= 0], guess, keyframe, candidate, world)
        if fix is None or len(fix[1]) < config.min_inliers:
            return None
        group = [candidate, *world.covisibility.neighbours(candidate)]
        surroundings = world.points_seen_by(np.array(group))
        fix = self._search_and_fit(surroundings, fix[0], keyframe, candidate, world)
        if fix is None or len(fix[1]) < config.min_total:
            return None
        sighting, pairs = fix
        n_visible = int(projected(surroundings, sighting.T_cam_world, self.camera, world).visible.sum())
        if len(pairs) < config.min_share * n_visible:
            return None
        T_world_cam = se3.orthonormalize(se3.inverse(sighting.T_cam_world))
        return Loop(keyframe, candidate, T_world_cam, pairs.rows, pairs.point_ids, n_visible, sighting.scale)

    def _by_descriptors(self, keyframe: int, candidate: int, index: PlaceIndex, world: Map) -> Pairs:
        """Match the points of two keyframes through the direct index."""
        here, there = world.rows(keyframe), world.rows(candidate)
        table = world.keypoints
        nodes_here = np.where(table.point[here] >= 0, index.nodes(keyframe), -1).astype(np.int32)
        nodes_there = np.where(table.point[there] >= 0, index.nodes(candidate), -1).astype(np.int32)
        mine, theirs = match_by_branch(table.descriptors[here], nodes_here, table.descriptors[there], nodes_there)
        steady = consistent_rotation(table.angle_rad[here][mine], table.angle_rad[there][theirs])
        mine, theirs = mine[steady], theirs[steady]
        # Points that both observe already add nothing, and each point is used once.
        ids = table.point[there][theirs]
        other = table.point[here][mine] != ids
        return Pairs(here.start + mine.astype(np.int64), ids).keep(other)

    def _by_ransac(self, pairs: Pairs, keyframe: int, candidate: int, world: Map) -> Sighting | None:
        """Return how the keyframe sees the place by the motion that most pairs agree with."""
        table, points, poses = world.keypoints, world.points, world.keyframes.T_world_cam
        T_here_world, T_there_world = se3.inverse(poses[keyframe]), se3.inverse(poses[candidate])
        here_m = se3.transform(T_here_world, points.position_m[table.point[pairs.rows]])
        there_m = se3.transform(T_there_world, points.position_m[pairs.point_ids])
        n_levels, factor = world.scales.count, world.scales.factors
        # The keyframe's keypoint gives the scale for both sides: the same corner is found on about the same level.
        limit2 = _CHI2_RANSAC * factor[np.minimum(table.octave[pairs.rows], n_levels - 1)] ** 2
        seen_here, seen_there = table.px[pairs.rows], self._pixels(there_m)

        group = self._freedom.group

        def agrees(T_here_there: F64) -> Bool:
            forth = _errors2(T_here_there, there_m, seen_here, self.camera)
            back = _errors2(group.inverse(T_here_there), here_m, seen_there, self.camera)
            return np.asarray((forth < limit2) & (back < limit2))

        rng = np.random.default_rng((self.seed, keyframe, candidate))
        fit = fit_robustly(there_m, here_m, agrees, rng, self.config.n_samples, with_scale=group is SIMILAR)
        if fit is None or fit.n_inliers < self.config.min_inliers:
            return None
        return self._freedom.sighting(fit.T_target_source, T_there_world)

    def _pixels(self, points_cam_m: F64) -> F64:
        safe = np.column_stack((points_cam_m[:, :2], np.maximum(points_cam_m[:, 2], 1e-3)))
        return self.camera.project(safe)

    def _search_and_fit(
        self, ids: I32, guess: Sighting, keyframe: int, candidate: int, world: Map
    ) -> tuple[Sighting, Pairs] | None:
        """Search points (P,) in the keyframe around their projections, and fit the sighting to the matches."""
        pairs = self._search(ids, guess.T_cam_world, keyframe, world)
        if len(pairs) < self.config.min_inliers:
            return None
        fitted = self._freedom.refined(guess, pairs, keyframe, candidate, self.camera, world)
        return None if fitted is None else (fitted[0], pairs.keep(fitted[1]))

    def _search(self, ids: I32, T_cam_world: F64, keyframe: int, world: Map) -> Pairs:
        window, targets = Window(self.config.window_px), keyframe_targets(keyframe, world)
        found = search_around(ids, T_cam_world, self.camera, world, targets, window)
        return Pairs(world.rows(keyframe).start + found.target.astype(np.int64), found.point_ids)


def _errors2(T: F64, points_m: F64, seen_px: Floats, camera: Camera) -> F64:
    """Return how far off (S, N) [px²] points (N, 3), moved by (S, 4, 4), are from where they are seen."""
    moved = points_m @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    z = moved[..., 2]
    ahead = z > 0.05
    safe = np.where(ahead, z, 1.0)
    du = camera.fx * moved[..., 0] / safe + camera.cx - seen_px[:, 0]
    dv = camera.fy * moved[..., 1] / safe + camera.cy - seen_px[:, 1]
    return np.where(ahead, du * du + dv * dv, np.inf)
