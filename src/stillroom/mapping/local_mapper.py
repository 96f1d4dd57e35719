"""Local mapping (ORB-SLAM2): the update of the map for a new keyframe."""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.map import Map
from stillroom.data.result import FirstView, Tracked
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, I64
from stillroom.geometry.camera import Camera
from stillroom.mapping.culling import TRIAL, Trial, cull_keyframes, cull_points, on_trial
from stillroom.mapping.fusing import fuse_neighbourhood
from stillroom.mapping.new_points import PairLimits, by_triangulation, from_depth
from stillroom.optimize.bundle import BundleAdjuster, BundleConfig, BundleProblem, BundleResult
from stillroom.optimize.observations import of_keypoints
from stillroom.protocols import Parts

# Bundle adjustment of a part of the map: a keyframe, its covisible ones and all that they see, or the whole map.


def adjust_locally(keyframe: int, max_keyframes: int, camera: Camera, adjust: BundleAdjuster, world: Map) -> None:
    """Adjust a keyframe, its strongest neighbours and their points; others that see these points are fixed.

    Observations that do not fit afterwards are removed.
    """
    with world.lock:
        around = world.covisibility.neighbours(keyframe, max_keyframes - 1)
    adjust_these([keyframe, *around], camera, adjust, world)


def adjust_all(camera: Camera, adjust: BundleAdjuster, world: Map) -> None:
    """Adjust all keyframes but the first of each sub-map, and all points; observations that do not fit are removed."""
    adjust_these([int(keyframe) for keyframe in world.alive_keyframes()], camera, adjust, world)


def adjust_these(free: list[int], camera: Camera, adjust: BundleAdjuster, world: Map) -> None:
    """Adjust some keyframes and their points; others that see these are fixed, and so is a sub-map's first."""
    if not free:
        return
    with world.lock:
        part = _part_around(free, world)
    if part is None:
        return
    result = adjust(part.problem, camera)  # without the lock: tracking goes on, and may add a keyframe
    with world.lock:
        part.commit(result, world)


@dataclass(frozen=True)
class _Part:
    """A part of the map to adjust: copies of what it takes, and where the result belongs.

    Attributes:
        problem: What to adjust.
        moved: Which of its keyframes (M,) move.
        keyframes: Their ids (M,).
        point_ids, rows: Its points (P,) and observations (O,).
    """

    problem: BundleProblem
    moved: I64
    keyframes: I64
    point_ids: I32
    rows: I32

    def commit(self, result: BundleResult, world: Map) -> None:
        """Write the result to the map, and remove observations that do not fit."""
        points = world.points
        world.keyframes.T_world_cam[self.keyframes] = se3.inverse(result.T_cam_world[self.moved])
        points.position_m[self.point_ids] = result.points_world_m
        world.remove_observations(self.rows[~result.is_inlier])
        world.refresh_geometry(self.point_ids[points.is_alive[self.point_ids]])


def _part_around(free: list[int], world: Map) -> _Part | None:
    """Copy what adjusting some keyframes takes; None where there is nothing to adjust."""
    table, keyframes = world.keypoints, world.keyframes
    point_ids = world.points_seen_by(np.array(free))
    place, rows = world.observations(point_ids)
    asked = np.zeros(len(keyframes), dtype=np.bool_)
    asked[free] = True
    involved, *seen = _seen_in(
        rows,
        _Rows(table.keyframe, table.px, table.right_px, table.octave, table.p_static),
        len(keyframes),
        world.scales.inverse_variances,
    )
    is_fixed = ~asked[involved] | (keyframes.parent[involved] < 0)
    if is_fixed.all() or len(rows) == 0:
        return None
    if not is_fixed.any():
        is_fixed[0] = True  # One keyframe must be fixed (gauge freedom): the oldest.
    problem = BundleProblem(
        T_cam_world=se3.inverse(keyframes.T_world_cam[involved]),
        is_fixed=is_fixed,
        points_world_m=world.points.position_m[point_ids],
        obs_keyframe=seen[0],
        obs_point=place,
        observed_px=seen[1],
        weights=seen[2],
        p_static=seen[3],
    )
    moved = np.flatnonzero(~is_fixed)
    return _Part(problem, moved, involved[moved], point_ids, rows)


class _Rows(NamedTuple):
    """Columns of the keypoint table."""

    keyframe: I32
    px: F32
    right_px: F32
    octave: I32
    p_static: F32


@njit(nogil=True, cache=True)
def _seen_in(rows: I32, table: _Rows, n_keyframes: int, inverse_variances: F64) -> tuple[I64, I64, F64, F64, F64]:
    """Return the keyframes of rows (O,), oldest first, which of them each row is in, and what that saw.

    Returns:
        Keyframes (M,), an index into them (O,), and as `BundleProblem` has them: u, v, u_right (O, 3) [px], inverse
        variances (O, 3) [1/px²], and the probability to be static (O,).
    """
    index_of = np.full(n_keyframes, -1, np.int64)
    for row in rows:
        index_of[table.keyframe[row]] = 0
    keyframes = np.flatnonzero(index_of == 0)
    for i in range(len(keyframes)):
        index_of[keyframes[i]] = i
    inside, p_static = np.empty(len(rows), np.int64), np.empty(len(rows))
    for i in range(len(rows)):
        inside[i], p_static[i] = index_of[table.keyframe[rows[i]]], table.p_static[rows[i]]
    seen_px, weights = of_keypoints(rows, table.px, table.octave, table.right_px, inverse_variances)
    return keyframes, inside, seen_px, weights, p_static


@dataclass(frozen=True)
class LocalMapperConfig:
    """Local mapping.

    Attributes:
        th_depth: Points nearer than this many baselines are close: made from depth, counted for redundancy.
        n_neighbours: Covisible keyframes to triangulate with.
        largest_cosine: Of the parallax of a point that is triangulated without depth, at most (ORB-SLAM2: 1.15°).
        most_turned_deg: By how much the orientations of its keypoints may differ, less the camera's roll; 180: by any
            angle, as in ORB-SLAM2.
        n_fused: Covisible keyframes whose points are searched in a new one, and the reverse.
        trial_keyframes: A new point is tested for so many keyframes …
        min_observations: … and must then have more than so many observations; one with depth counts as two.
        max_bundle_keyframes: Keyframes that local bundle adjustment moves, at most.
        cull_keyframes: Whether redundant keyframes are removed.
        max_final_keyframes: When the run ends, the whole map is adjusted once more if it has no more keyframes than
            this; 0 leaves it as it is, as ORB-SLAM2 does.
        max_final_keyframes_looped: The same for a map in which loops were closed. Where no place was seen twice, a
            large map gains nothing by it; where one was, the loop improves the path before it too.
        bundle: The optimiser around a new keyframe, and of the whole map without loops.
        looped_bundle: That of a whole map with loops. It starts almost undamped: damping slows the large-scale
            deformation first.
    """

    th_depth: float = bounded(40.0, above=0)
    n_neighbours: int = bounded(5, least=0)
    largest_cosine: float = bounded(PairLimits.largest_cosine, above=0, most=1)
    most_turned_deg: float = bounded(180.0, above=0, most=180)
    n_fused: int = bounded(10, least=0)
    trial_keyframes: int = bounded(TRIAL.keyframes, least=1)
    min_observations: int = bounded(TRIAL.min_observations, least=0)
    max_bundle_keyframes: int = bounded(20, least=1)
    cull_keyframes: bool = True
    max_final_keyframes: int = bounded(200, least=0)
    max_final_keyframes_looped: int = bounded(1000, least=0)
    bundle: BundleConfig = field(default_factory=BundleConfig)
    looped_bundle: BundleConfig = field(default_factory=lambda: BundleConfig(first_damping=1e-8))

    def build(self, parts: Parts) -> "LocalMapper":
        """Return the mapper of a map."""
        return LocalMapper(self, parts.camera, parts.world)


class LocalMapper:
    """Adds keyframes to a map and refines the map around them."""

    def __init__(self, config: LocalMapperConfig, camera: Camera, world: Map) -> None:
        """Start with the recent points that an earlier run left."""
        self.config, self.camera, self.world = config, camera, world
        self._adjust, self._adjust_looped = config.bundle.build(), config.looped_bundle.build()
        # With a single camera all points count as close.
        self._close_depth_m = config.th_depth * camera.baseline_m if world.sensor.is_metric else np.inf
        self._limits = PairLimits(config.largest_cosine, math.radians(config.most_turned_deg))
        self._trial = Trial(config.trial_keyframes, config.min_observations)
        self._on_trial = on_trial(world, self._trial)
        self._has_inserted = False

    def insert(self, tracked: Tracked) -> int:
        """Add a frame as a keyframe, with points from the depth of its static keypoints; return its id.

        With it the first image of a map that a single camera begins, and the points of both.
        """
        self._has_inserted = True
        if tracked.first_view is not None:
            tracked = self._with_first(tracked, tracked.first_view)
        assert tracked.T_world_cam is not None
        # Points may have been joined or removed since they were matched, while tracking waited for a worker.
        point_ids = self.world.current_ids(tracked.point_ids)
        keyframe = self.world.add_keyframe(
            tracked.frame,
            tracked.T_world_cam,
            point_ids,
            tracked.is_static,
            tracked.reference_keyframe,
            tracked.motion.p_static,
        )
        new = from_depth(keyframe, tracked, self._close_depth_m, self.world)
        self._on_trial = np.append(self._on_trial, new)
        self.world.connect(keyframe)
        return keyframe

    def _with_first(self, tracked: Tracked, view: FirstView) -> Tracked:
        """Add the first keyframe of a map and its points; return the frame of the second one, which sees them."""
        first, world = view.tracked, self.world
        assert first.T_world_cam is not None
        keyframe = world.add_keyframe(
            first.frame,
            first.T_world_cam,
            first.point_ids,
            first.is_static,
            first.reference_keyframe,
            first.motion.p_static,
        )
        new = world.add_points(view.points_world_m, world.rows(keyframe).start + view.keypoint.astype(np.int64))
        self._on_trial = np.append(self._on_trial, new)
        point_ids = tracked.point_ids.copy()
        point_ids[view.matched] = new
        return replace(tracked, point_ids=point_ids, reference_keyframe=keyframe)

    def refine(self, keyframe: int) -> None:
        """Cull, triangulate, fuse, adjust and cull around a new keyframe."""
        world = self.world
        with world.lock:
            seen = world.points_of(keyframe)
            world.refresh(seen[seen >= 0])
            self._on_trial = cull_points(self._on_trial, keyframe, world, self._trial)
            neighbours = world.covisibility.neighbours(keyframe, self.config.n_neighbours)
        if not neighbours:
            return
        with world.lock:
            new = by_triangulation(keyframe, neighbours, self.camera, world, self._limits)
            self._on_trial = np.append(self._on_trial, new)
        with world.lock:
            fuse_neighbourhood(keyframe, self.camera, world, self.config.n_fused)
        adjust_locally(keyframe, self.config.max_bundle_keyframes, self.camera, self._adjust, world)
        if self.config.cull_keyframes:
            with world.lock:
                cull_keyframes(keyframe, self._close_depth_m, world)

    def adjust(self, keyframes: list[int]) -> None:
        """Adjust keyframes whose keypoints were put elsewhere, and the points that they see."""
        adjust_these(keyframes, self.camera, self._adjust, self.world)

    def finish(self) -> None:
        """Run full bundle adjustment: observations of later keyframes improve the earlier ones.

        A map to which nothing was added stays as it is. Differs from ORB-SLAM2, which does this after a loop only.
        """
        config, has_loops = self.config, bool(self.world.loop_edges)
        most = config.max_final_keyframes_looped if has_loops else config.max_final_keyframes
        if self._has_inserted and len(self.world.alive_keyframes()) <= most:
            adjust_all(self.camera, self._adjust_looped if has_loops else self._adjust, self.world)
