"""Integrity of a map: every reference exists, and every number is valid."""

import tomllib
from collections.abc import Iterator

import numpy as np

from stillroom.data.map import Map
from stillroom.geometry.arrays import F64, I64, Bool, Floats
from stillroom.storage.schema import StoredMap

RIGID = 1e-6
"""How far a rotation may be from one whose columns are of length 1 and at right angles."""


def problems_of(stored: StoredMap) -> Iterator[str]:
    """Yield what is wrong with what a map file holds. What could make a run crash or hang comes first."""
    yield from problems_of_map(stored.world)
    yield from _problems_of_rest(stored)


def problems_of_map(world: Map) -> Iterator[str]:
    """Yield what is wrong with a map itself."""
    yield from _problems_of_keyframes(world)
    yield from _problems_of_links(world)
    yield from _problems_of_points(world)
    yield from _problems_of_covisibility(world)
    yield from _problems_of_loops(world)


def _problems_of_keyframes(world: Map) -> Iterator[str]:
    table, n = world.keyframes, len(world.keyframes)
    wild = np.flatnonzero((table.parent < -1) | (table.parent >= n))
    yield from (f"keyframe {k} has the parent {table.parent[k]}, which does not exist" for k in wild)
    if len(wild) == 0:
        yield from (f"culled keyframe {k} has no ancestor that is alive" for k in _hanging_nowhere(world))
    strange = np.flatnonzero((table.submap < 0) | (table.submap >= n))  # there are no more sub-maps than keyframes
    yield from (f"keyframe {k} is of sub-map {table.submap[k]}, which does not exist" for k in strange)
    poses = np.where(table.is_alive[:, None, None], table.T_world_cam, table.T_parent_cam)
    yield from (f"the pose of keyframe {k} is not rigid" for k in np.flatnonzero(~are_rigid(poses)))
    yield from (f"the time of keyframe {k} is not finite" for k in _not_finite(table.timestamp_s))


def _hanging_nowhere(world: Map) -> I64:
    """Return the culled keyframes without an ancestor that is alive.

    Those of a sub-map that a single camera began and that was dropped as a whole have none, and need none.
    """
    table = world.keyframes
    now = np.arange(len(table))
    for _ in range(len(table) + 1):
        culled = (now >= 0) & ~table.is_alive[now]
        if not culled.any():
            break
        now[culled] = table.parent[now[culled]]
    is_dropped = (now < 0) & ~np.isin(table.submap, table.submap[table.is_alive]) & (not world.sensor.is_metric)
    return np.flatnonzero(((now < 0) | ~table.is_alive[now]) & ~is_dropped)


def _problems_of_links(world: Map) -> Iterator[str]:
    table, points = world.keypoints, world.points
    seen = table.point
    wild = np.flatnonzero((seen < -1) | (seen >= len(points)))
    yield from (f"keypoint row {row} sees point {seen[row]}, which does not exist" for row in wild)
    if len(wild):
        return
    rows = np.flatnonzero(seen >= 0)
    yield from (
        f"keypoint row {row} sees point {seen[row]}, which is gone" for row in rows[~points.is_alive[seen[rows]]]
    )
    culled = rows[~world.keyframes.is_alive[table.keyframe[rows]]]
    yield from (f"keypoint row {row} of a culled keyframe sees a point" for row in culled)
    pairs = seen[rows].astype(np.int64) * len(world.keyframes) + table.keyframe[rows]
    if len(np.unique(pairs)) < len(pairs):
        yield "a keyframe sees a point twice"
    yield from _problems_of_lists(world, rows)


def _problems_of_lists(world: Map, rows: I64) -> Iterator[str]:
    """Walk the lists of all points at once, a step at a time."""
    table, points = world.keypoints, world.points
    ids = np.flatnonzero(points.is_alive)
    now, n_keyframes = points.first_row[ids].astype(np.int64), np.zeros(len(points), dtype=np.int64)
    n_observations = np.zeros(len(points), dtype=np.int64)
    for _ in range(len(world.keyframes) + 1):
        ids, now = ids[now >= 0], now[now >= 0]
        if len(ids) == 0:
            break
        astray = (now >= len(table)) | (table.point[np.minimum(now, len(table) - 1)] != ids)
        if astray.any():
            yield from (f"the list of point {i} leads to a keypoint that does not see it" for i in ids[astray])
            return
        n_keyframes[ids] += 1
        n_observations[ids] += np.where(table.right_px[now] >= 0, 2, 1)
        now = table.next_row[now].astype(np.int64)
    if len(ids):
        yield f"the list of point {ids[0]} does not end"
        return
    alive = np.flatnonzero(points.is_alive)
    wrong = (n_keyframes[alive] != points.n_keyframes[alive]) | (n_observations[alive] != points.n_observations[alive])
    yield from (f"point {i} is seen by other than the keyframes it counts" for i in alive[wrong])
    if n_keyframes.sum() != len(rows):
        yield f"{len(rows)} keypoints see a point, but {n_keyframes.sum()} are in the points' lists"


def _problems_of_points(world: Map) -> Iterator[str]:
    points, table = world.points, world.keypoints
    alive = np.flatnonzero(points.is_alive)
    for name in ("position_m", "normal", "min_distance_m", "max_distance_m"):
        yield from (f"{name} of point {i} is not finite" for i in alive[_not_finite(getattr(points, name)[alive])])
    for name in ("px", "angle_rad", "right_px", "depth_m"):
        yield from (f"{name} of keypoint row {row} is not finite" for row in _not_finite(getattr(table, name)))
    yield from (
        f"keypoint row {row} is of pyramid level {table.octave[row]}, which does not exist"
        for row in np.flatnonzero((table.octave < 0) | (table.octave >= world.scales.count))
    )


def _problems_of_loops(world: Map) -> Iterator[str]:
    n = len(world.keyframes)
    for known, returned in world.loop_edges:
        if not (0 <= known < n and 0 <= returned < n):
            yield f"a loop joins keyframes {known} and {returned}, which do not both exist"


def _not_finite(column: Floats) -> I64:
    """Return the rows that hold a number that is not finite."""
    return np.flatnonzero(~np.isfinite(column).all(axis=tuple(range(1, column.ndim))))


def _problems_of_covisibility(world: Map) -> Iterator[str]:
    edges, n = world.covisibility.edges(), len(world.keyframes)
    for older, newer, weight in edges.tolist():
        if not (0 <= older < newer < n and world.keyframes.is_alive[older] and world.keyframes.is_alive[newer]):
            yield f"covisibility joins keyframes {older} and {newer}, which are not both alive"
        elif weight <= 0:
            yield f"covisibility joins keyframes {older} and {newer} by {weight} points"


def are_rigid(poses: F64) -> Bool:
    """Return which of the poses (N, 4, 4) are rotations with translations, in finite numbers."""
    R = poses[:, :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
        good = np.isfinite(poses).all(axis=(1, 2)) & (off < RIGID) & (np.linalg.det(R) > 0)
    return np.asarray(good & (poses[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1))


def _problems_of_rest(stored: StoredMap) -> Iterator[str]:
    n_keyframes, first = len(stored.world.keyframes), 0
    for number, session in enumerate(stored.sessions):
        if not first <= session.first_keyframe <= n_keyframes:
            yield f"session {number} begins at keyframe {session.first_keyframe}, out of order"
        first = session.first_keyframe
        try:
            tomllib.loads(session.config)
        except tomllib.TOMLDecodeError as error:
            yield f"the config of session {number} is no TOML: {error}"
    for frame in stored.frames:
        where = f"frame {frame.image_index} of session {frame.session}"
        if not 0 <= frame.session < len(stored.sessions):
            yield f"{where} belongs to no session"
        if not 0 <= frame.reference_keyframe < n_keyframes:
            yield f"{where} refers to keyframe {frame.reference_keyframe}, which does not exist"
        if not np.isfinite(frame.timestamp_s):
            yield f"the time of {where} is not finite"
    poses = np.array([frame.T_reference_cam for frame in stored.frames]).reshape(-1, 4, 4)
    yield from (
        f"the pose of frame {stored.frames[i].image_index} is not rigid" for i in np.flatnonzero(~are_rigid(poses))
    )
