"""Correcting the map for a loop: fuse the place, and distribute the error over the loop."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillroom.data.map import Map
from stillroom.features.matching import NEAR_BITS
from stillroom.features.projection import Window, keyframe_targets, search_around
from stillroom.geometry import se3, sim3
from stillroom.geometry.arrays import F64, I32, I64, Ints
from stillroom.geometry.camera import Camera
from stillroom.loops.freedom import Freedom, freedom_of
from stillroom.loops.moves import Places, follow_keyframes, move, rescale_culled
from stillroom.loops.verification import Loop
from stillroom.optimize.pose_graph import PoseGraph, PoseGraphOptimizer

WINDOW = Window(4.0, levels_above=0, max_bits=NEAR_BITS)
TYPICAL_SHARED = 100.0
LEAST_SHARED = 15.0


# The essential graph: few edges that carry the shape of the whole map (ORB-SLAM, Mur-Artal et al. 2015, III-D).


def essential_edges(world: Map, min_weight: int | None) -> I64:
    """Return the edges (E, 2) between alive keyframes: spanning tree, strong covisibility, and the loops closed so far.

    Args:
        world: The map.
        min_weight: Shared points from which on covisibility is strong (ORB-SLAM2: 100); None leaves it out.
    """
    table, children = world.keyframes, world.alive_keyframes()
    parents = table.parent[children].astype(np.int64)
    while True:
        culled = np.flatnonzero((parents >= 0) & ~table.is_alive[parents])
        if len(culled) == 0:
            break
        parents[culled] = table.parent[parents[culled]]
    tree = np.column_stack((parents, children))[parents >= 0]
    loops = np.array(world.loop_edges, dtype=np.int64).reshape(-1, 2)
    kinds = [tree, loops]
    if min_weight is not None:
        weighted = world.covisibility.edges().astype(np.int64)
        kinds.append(weighted[weighted[:, 2] >= min_weight, :2])
    edges = np.sort(np.concatenate(kinds), axis=1)
    return np.unique(edges[table.is_alive[edges].all(axis=1)], axis=0)


def shared_points(edges: I64, world: Map) -> F64:
    """Return how many points the keyframes of each edge (E, 2) share, (E,)."""
    return np.array([world.covisibility.weight(int(first), int(second)) for first, second in edges], dtype=np.float64)


def paths_from(keyframe: int, edges: I64, world: Map, unit: float = 1.0) -> F64:
    """Return the length [m] of the shortest path through the graph to each keyframe (K,); infinite where there is none.

    An edge is as long as its keyframes are apart, and a rotation of one radian counts as a metre: both cause drift.

    Args:
        keyframe: Where paths start.
        edges: The graph (E, 2).
        world: The map.
        unit: How long a metre is in the map; see `Freedom.unit`.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    poses = world.keyframes.T_world_cam
    apart = se3.inverse(poses[edges[:, 0]]) @ poses[edges[:, 1]]
    length_m = np.linalg.norm(apart[:, :3, 3], axis=1) / unit + se3.angle_rad(apart)
    n = len(world.keyframes)
    graph = coo_matrix((length_m + 1e-9, (edges[:, 0], edges[:, 1])), shape=(n, n)).tocsr()
    lengths_m: F64 = dijkstra(graph, directed=False, indices=keyframe)
    return lengths_m


# Fusing duplicate points when a place is seen again; the place's own points stay (ORB-SLAM2: SearchAndFuse).


def take_over(point_ids: I32, rows: Ints, world: Map) -> None:
    """Link rows (M,) to points (M,): the points that they observed before are replaced everywhere."""
    other = world.keypoints.point[rows]
    fresh = other < 0
    world.observe(point_ids[fresh], rows[fresh])
    old, new = other[~fresh], point_ids[~fresh]
    # Each point at most once on either side, so that no chain of replacements forms.
    _, first = np.unique(old, return_index=True)
    keep = np.zeros(len(old), dtype=np.bool_)
    keep[first] = True
    keep &= ~np.isin(old, new) & (old != new)
    world.replace_points(old[keep], new[keep])


def fuse_place(point_ids: I32, keyframe: int, camera: Camera, world: Map) -> None:
    """Search the points (P,) of a place in a keyframe with a corrected pose, and add the observations."""
    points = world.points
    own = world.points_of(keyframe)
    is_seen = np.zeros(len(points), dtype=np.bool_)
    is_seen[own[own >= 0]] = True
    ids = point_ids[~is_seen[point_ids] & points.is_alive[point_ids]]
    T_cam_world = se3.inverse(world.keyframes.T_world_cam[keyframe])
    found = search_around(ids, T_cam_world, camera, world, keyframe_targets(keyframe, world), WINDOW)
    take_over(found.point_ids, world.rows(keyframe).start + found.target.astype(np.int64), world)


@dataclass(frozen=True)
class Correction:
    """A correction of the map.

    Attributes:
        keyframes: Keyframes that were optimised, a whole connected component (N,).
        around: Those of them that observe the place, then or now (A,).
        moved_m, turned_rad: How far the keyframe that closed the loop was moved and turned; a metre as `Freedom.unit`
            has it.
        rescaled: The logarithm of what lengths around it were multiplied by; 0 in a metric map.
    """

    keyframes: I64
    around: I64
    moved_m: float
    turned_rad: float
    rescaled: float = 0.0


def close_loop(
    loop: Loop, world: Map, camera: Camera, optimize: PoseGraphOptimizer, essential_weight: int = 100
) -> Correction:
    """Correct the map for a loop: ORB-SLAM2's CorrectLoop, with the scale fixed in a metric map.

    The keyframe and its covisible ones get the poses that the loop implies, the place's points are fused into them,
    and a pose graph distributes the error over all keyframes. Points follow the keyframe that saw them first, and take
    part in its change of scale.
    """
    before, freedom = Places.of(world), freedom_of(world)
    edges = essential_edges(world, essential_weight)
    measured = se3.inverse(before.T_world_cam[edges[:, 0]]) @ before.T_world_cam[edges[:, 1]]
    shared = shared_points(edges, world)
    place = [loop.candidate, *world.covisibility.neighbours(loop.candidate)]
    group = [k for k in (loop.keyframe, *world.covisibility.neighbours(loop.keyframe)) if k not in place]
    move(group, loop.correction(world), loop.scale, world)
    known = {k: set(world.covisibility.neighbours(k)) for k in group}
    fuse_group(loop, place, group, camera, world)
    new = [(k, other) for k in group for other in world.covisibility.neighbours(k) if other not in known[k]]
    new = list(dict.fromkeys([(loop.keyframe, loop.candidate), *(pair for pair in new if pair[1] not in group)]))
    added = np.array(new, dtype=np.int64)
    nodes = sim3.of(world.keyframes.T_world_cam, before.growth(world))
    graph_edges = np.concatenate((edges, added))
    keyframes = connected_to(loop.keyframe, graph_edges, world)
    graph = _graph(
        graph_edges,
        np.concatenate((measured, freedom.group.inverse(nodes[added[:, 0]]) @ nodes[added[:, 1]])),
        np.concatenate((shared, shared_points(added, world))),
        keyframes,
        nodes,
        freedom,
        world,
    )
    freedom.place(keyframes, optimize(graph).T_world_node, before, world)
    rescale_culled(before, world)
    world.loop_edges.append((loop.candidate, loop.keyframe))
    alive = np.flatnonzero(world.points.is_alive)
    follow_keyframes(alive, before, world)
    world.refresh_geometry(alive)
    T_old_new = se3.inverse(before.T_world_cam[loop.keyframe]) @ loop.T_world_cam
    unit = freedom.unit(loop.candidate, world)
    return Correction(
        keyframes=keyframes,
        around=np.intersect1d([*place, *group], keyframes),
        moved_m=float(np.linalg.norm(T_old_new[:3, 3])) / unit,
        turned_rad=float(se3.angle_rad(T_old_new)),
        rescaled=float(np.log(loop.scale)),
    )


def fuse_group(loop: Loop, place: Sequence[int], group: Sequence[int], camera: Camera, world: Map) -> None:
    """Fuse the points of a place into a group of keyframes with corrected poses; update their covisibility."""
    take_over(loop.point_ids, loop.rows, world)
    points = world.points_seen_by(np.array(place))
    for keyframe in group:
        fuse_place(points, keyframe, camera, world)
    seen = world.points_seen_by(np.array([*place, *group]))
    world.refresh(seen[world.points.is_alive[seen]])
    for keyframe in group:
        world.connect(keyframe)


def connected_to(keyframe: int, edges: I64, world: Map) -> I64:
    """Return the alive keyframes (N,) that edges (E, 2) join with one, itself among them, the oldest first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n = len(world.keyframes)
    graph = coo_matrix((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    return np.flatnonzero((part == part[keyframe]) & world.keyframes.is_alive)


def _graph(
    edges: I64, measured: F64, shared: F64, keyframes: I64, nodes: F64, freedom: Freedom, world: Map
) -> PoseGraph:
    """Return the pose graph of some keyframes (N,); the oldest of them is fixed."""
    node = np.full(len(nodes), -1, dtype=np.int64)
    node[keyframes] = np.arange(len(keyframes))
    used = (node[edges] >= 0).all(axis=1)
    is_fixed = np.zeros(len(keyframes), dtype=np.bool_)
    is_fixed[0] = True
    relative = np.maximum(shared[used], LEAST_SHARED) / TYPICAL_SHARED
    information = freedom.information(relative, edges[used, 1], world)
    first, second = node[edges[used]].T
    return PoseGraph(nodes[keyframes], is_fixed, first, second, measured[used], information, freedom.group)
