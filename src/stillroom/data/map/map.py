"""The map: keyframes, their keypoints, and the points that they see."""

import threading

import numpy as np

from stillroom.compiled import njit
from stillroom.data.frame import Frame, ScaleLevels
from stillroom.data.map import links
from stillroom.data.map.map_lock import MapLock
from stillroom.data.map.tables import KeyframeTable, KeypointTable, PointTable
from stillroom.data.sensor import Sensor
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64, I32, I64, Bool, Ints
from stillroom.geometry.hamming import words

# Sets of points without a pass over the whole map: members are marked with a number that is new for each set.


class Marks(threading.local):
    """Marks of the calling thread, so that tracking and mapping may ask at the same time.

    Clearing a flag for every point would cost more with every keyframe; an old mark is simply another number.
    """

    def __init__(self) -> None:
        """Start without marks."""
        self._marks: I64 = np.zeros(0, dtype=np.int64)
        self._number = 0

    def fresh(self, n_points: int) -> tuple[I64, int]:
        """Return marks of at least `n_points` points, and a number that none of them has."""
        if len(self._marks) < n_points:
            self._marks = np.zeros(2 * n_points, dtype=np.int64)
        self._number += 1
        return self._marks, self._number


@njit(nogil=True, cache=True)
def collect(keyframes: I64, first_row: I64, n_rows: I64, row_point: I32, marks: I64, number: int, found: I32) -> int:
    """Write each point that any of the keyframes sees into `found` once, in the order met; return how many."""
    n = 0
    for i in range(len(keyframes)):
        start = first_row[keyframes[i]]
        for row in range(start, start + n_rows[keyframes[i]]):
            point = row_point[row]
            if point >= 0 and marks[point] != number:
                marks[point] = number
                found[n] = point
                n += 1
    return n


@njit(nogil=True, cache=True)
def keep_others(point_ids: I32, excluded: I32, marks: I64, number: int, kept: I32) -> int:
    """Write the points that are not excluded into `kept`, in order; return how many. −1 is skipped in both."""
    for i in range(len(excluded)):
        if excluded[i] >= 0:
            marks[excluded[i]] = number
    n = 0
    for i in range(len(point_ids)):
        if point_ids[i] >= 0 and marks[point_ids[i]] != number:
            kept[n] = point_ids[i]
            n += 1
    return n


# Which keyframes see the same points.


class Covisibility:
    """A weighted graph over keyframes; the weight is the number of points that both see (ORB-SLAM2).

    Attributes:
        min_weight: Edges weaker than this are left out unless a keyframe would have none.
        unsaved: Keyframes whose edges changed since the map was last written to disk; the writer clears it.
    """

    def __init__(self, min_weight: int = 15) -> None:
        """Start empty; edges weaker than `min_weight` are left out unless a keyframe would have none."""
        self.min_weight = min_weight
        self.unsaved: set[int] = set()
        self._weights: dict[int, dict[int, int]] = {}
        self._ordered: dict[int, list[int]] = {}

    def connect(self, keyframe: int, counts: I32) -> None:
        """Replace the edges of a keyframe.

        Args:
            keyframe: Its id.
            counts: Points shared with each keyframe (K,); the entry of the keyframe itself is ignored.
        """
        self.unsaved.add(keyframe)
        counts = counts.copy()
        counts[keyframe] = 0
        strong = np.flatnonzero(counts >= self.min_weight)
        if len(strong) == 0 and counts.max(initial=0) > 0:
            strong = np.array([int(np.argmax(counts))])
        for other in self._weights.get(keyframe, {}):
            self._weights[other].pop(keyframe, None)
            self._ordered.pop(other, None)
        self._ordered.pop(keyframe, None)
        self._weights[keyframe] = {int(other): int(counts[other]) for other in strong}
        for other, weight in self._weights[keyframe].items():
            self._weights.setdefault(other, {})[keyframe] = weight
            self._ordered.pop(other, None)

    def remove(self, keyframe: int) -> None:
        """Forget a keyframe."""
        self.unsaved.add(keyframe)
        self._ordered.pop(keyframe, None)
        for other in self._weights.pop(keyframe, {}):
            self._weights[other].pop(keyframe, None)
            self._ordered.pop(other, None)

    def neighbours(self, keyframe: int, at_most: int | None = None) -> list[int]:
        """Return connected keyframes, strongest first; of equal ones the newest first."""
        if keyframe not in self._ordered:
            edges = self._weights.get(keyframe, {})
            self._ordered[keyframe] = sorted(edges, key=lambda other: (-edges[other], -other))
        return self._ordered[keyframe][:at_most]

    def weight(self, first: int, second: int) -> int:
        """Return how many points two keyframes share, 0 when not connected."""
        return self._weights.get(first, {}).get(second, 0)

    def edges(self) -> I32:
        """Return all edges (E, 3) in order: the older keyframe, the newer one, the weight."""
        found = [(a, b, weight) for a, others in self._weights.items() for b, weight in others.items() if a < b]
        return np.array(sorted(found), dtype=np.int32).reshape(-1, 3)

    def edges_of(self, keyframe: int) -> dict[int, int]:
        """Return the weight of each edge of a keyframe, by the other keyframe."""
        return dict(self._weights.get(keyframe, {}))

    def restore(self, edges: Ints) -> None:
        """Take the edges (E, 3) that `edges` once returned in place of those there are."""
        self.unsaved.update(self._weights)
        self._weights, self._ordered = {}, {}
        for a, b, weight in edges.tolist():
            self._weights.setdefault(a, {})[b] = weight
            self._weights.setdefault(b, {})[a] = weight
        self.unsaved.update(self._weights)


class Map:
    """Three tables and the links between them. Ids are row numbers and are never used again.

    Attributes:
        scales: The pyramid of the keypoints.
        sensor: What kind of camera its keyframes are of; lengths are in metres where that is metric.
        keyframes, keypoints, points: The tables; see `tables`.
        covisibility: Which keyframes see the same points.
        lock: Held while a thread reads or changes the map, where others may too.
        jumps: Motions (4, 4) of the world's coordinates around the newest keyframe, each from one correction
            of the map; see `jumps.JumpFollower`. They are rigid, also where the scale of the map was corrected.
        loop_edges: Keyframes that closed loops: the one that knew the place, the one that came back.
        moved_keypoints: Keyframes whose keypoints were moved since the map was last written to disk; the writer clears
            it.
    """

    def __init__(self, scales: ScaleLevels, sensor: Sensor = Sensor.RGBD) -> None:
        """Start empty."""
        self.scales, self.sensor = scales, sensor
        self.keyframes = KeyframeTable(capacity=64)
        self.keypoints = KeypointTable(capacity=65536)
        self.points = PointTable(capacity=16384)
        self.covisibility = Covisibility()
        self.lock = MapLock()
        self.jumps: list[F64] = []
        self.loop_edges: list[tuple[int, int]] = []
        self.moved_keypoints: set[int] = set()
        self._n_submaps = 0
        self._marks = Marks()

    # Keyframes

    def add_keyframe(
        self,
        frame: Frame,
        T_world_cam: F64,
        point_ids: I32,
        is_static: Bool,
        parent: int,
        p_static: F32 | None = None,
    ) -> int:
        """Add a frame as a keyframe that sees the given points.

        Args:
            frame: The frame; its image is not kept.
            T_world_cam: Pose (4, 4).
            point_ids: Point that each keypoint sees (N,), −1 for none.
            is_static: Which keypoints (N,) are static; the others never create or observe a point.
            parent: Its parent in the spanning tree; −1 for the first keyframe of a sub-map.
            p_static: Probability that each keypoint is static (N,); 1 where not given.

        Returns:
            The id of the new keyframe.
        """
        keyframe, kp = len(self.keyframes), frame.keypoints
        rows = self.keypoints.append(
            len(frame),
            keyframe=keyframe,
            px=kp.px,
            octave=kp.octave,
            angle_rad=kp.angle_rad,
            right_px=kp.right_px,
            depth_m=kp.depth_m,
            descriptors=kp.descriptors,
            is_static=is_static,
            p_static=1.0 if p_static is None else p_static,
        )
        self.keyframes.append(
            1,
            T_world_cam=T_world_cam,
            timestamp_s=frame.timestamp_s,
            image_index=frame.image.index,
            first_row=rows.start,
            n_rows=len(frame),
            parent=parent,
            T_parent_cam=np.eye(4),
            submap=self.keyframes.submap[parent] if parent >= 0 else self.n_submaps,
        )
        seen = np.flatnonzero((point_ids >= 0) & is_static)
        self.observe(point_ids[seen], rows.start + seen)
        return keyframe

    @property
    def n_submaps(self) -> int:
        """Number of sub-maps created so far; ids are never reused."""
        self._n_submaps = max(self._n_submaps, int(self.keyframes.submap.max(initial=-1)) + 1)
        return self._n_submaps

    @property
    def lists(self) -> links.Links:
        """The observations, as kernels take them; views are invalid after a table grows."""
        table = self.keypoints
        return links.Links(table.point, table.next_row, table.keyframe, self.points.first_row)

    def rows(self, keyframe: int) -> slice:
        """Return where the keyframe's keypoints lie in the keypoint table."""
        start = int(self.keyframes.first_row[keyframe])
        return slice(start, start + int(self.keyframes.n_rows[keyframe]))

    def points_of(self, keyframe: int) -> I32:
        """Return the point that each keypoint of a keyframe sees (N,), −1 for none."""
        return self.keypoints.point[self.rows(keyframe)]

    def points_seen_by(self, keyframes: Ints) -> I32:
        """Return the points (P,) that any of the keyframes (K,) sees, in order of id."""
        table, ids = self.keyframes, np.asarray(keyframes, dtype=np.int64)
        found = np.empty(int(table.n_rows[ids].sum()), dtype=np.int32)
        scratch = self._marks.fresh(len(self.points))
        n = collect(ids, table.first_row, table.n_rows, self.keypoints.point, *scratch, found)
        return np.sort(found[:n])

    def without(self, point_ids: I32, excluded: I32) -> I32:
        """Return those of points (P,) that are not among others (Q,), in their order; −1 is skipped in both."""
        kept = np.empty(len(point_ids), dtype=np.int32)
        n = keep_others(point_ids, excluded, *self._marks.fresh(len(self.points)), kept)
        return kept[:n]

    @property
    def is_empty(self) -> bool:
        """Whether there is no keyframe: none was made yet, or what was begun was dropped."""
        return not self.keyframes.is_alive.any()

    def alive_keyframes(self) -> I64:
        """Return the ids of the keyframes that were not culled, oldest first."""
        return np.flatnonzero(self.keyframes.is_alive)

    def remove_keyframe(self, keyframe: int) -> None:
        """Cull a keyframe: its observations are removed; frames that refer to it keep a pose by its parent, if any."""
        parent = int(self.keyframes.parent[keyframe])
        if parent >= 0:
            self.keyframes.T_parent_cam[keyframe] = self.noted_in(parent, self.keyframes.T_world_cam[keyframe])
        self.keyframes.is_alive[keyframe] = False
        rows = self.rows(keyframe)
        self.remove_observations(np.arange(rows.start, rows.stop))
        self.covisibility.remove(keyframe)

    def keyframe_pose(self, keyframe: int) -> F64:
        """Return `T_world_cam` (4, 4) of a keyframe as known now, alive or culled."""
        table = self.keyframes
        with self.lock:
            alive = keyframe
            T_kept_cam: F64 | None = None
            # The first of a sub-map that was dropped has no parent.
            while not table.is_alive[alive] and table.parent[alive] >= 0:
                T_parent_cam = table.T_parent_cam[alive].copy()
                alive = int(table.parent[alive])
                T_parent_cam[:3, 3] *= table.scale[alive]
                T_kept_cam = T_parent_cam if T_kept_cam is None else T_parent_cam @ T_kept_cam
            T_world_alive: F64 = table.T_world_cam[alive].copy()
        return T_world_alive if T_kept_cam is None else T_world_alive @ T_kept_cam

    def keyframe_poses(self, keyframes: I64) -> F64:
        """Return `T_world_cam` (N, 4, 4) of keyframes (N,) as known now, alive or culled."""
        with self.lock:
            T_world_cam: F64 = self.keyframes.T_world_cam[keyframes]
            for i in np.flatnonzero(~self.keyframes.is_alive[keyframes]):
                T_world_cam[i] = self.keyframe_pose(int(keyframes[i]))
        return T_world_cam

    def noted_in(self, keyframe: int, T_world_cam: F64) -> F64:
        """Return a pose (4, 4) relative to a keyframe, to be kept: in lengths as they were when that was added."""
        with self.lock:
            T_keyframe_cam = se3.inverse(self.keyframe_pose(keyframe)) @ T_world_cam
            T_keyframe_cam[:3, 3] /= self.keyframes.scale[keyframe]
        return T_keyframe_cam

    def placed_by(self, keyframe: int, T_keyframe_cam: F64) -> F64:
        """Return `T_world_cam` (4, 4), as known now, of a pose that was noted in a keyframe (`noted_in`)."""
        T_now = T_keyframe_cam.copy()
        with self.lock:
            T_now[:3, 3] *= self.keyframes.scale[keyframe]
            pose: F64 = self.keyframe_pose(keyframe) @ T_now
        return pose

    def connect(self, keyframe: int) -> None:
        """Update the covisibility edges of a keyframe."""
        self.covisibility.connect(keyframe, self.count_shared(self.points_of(keyframe)))

    def count_shared(self, point_ids: I32) -> I32:
        """Count how many of the points (−1 is skipped) each keyframe sees, (K,)."""
        counts: I32 = links.count_by_keyframe(
            point_ids,
            self.keypoints.next_row,
            self.points.first_row,
            self.keypoints.keyframe,
            len(self.keyframes),
        )
        return counts

    # Points

    def add_points(self, positions_m: F64, rows: Ints, refresh: bool = True) -> I32:
        """Add points (N, 3) [m, world], each seen by one row (N,) that sees nothing yet; return their ids.

        Without `refresh` the caller refreshes them when they have more views.
        """
        first_keyframe = self.keypoints.keyframe[rows]
        new = self.points.append(len(rows), position_m=positions_m, first_keyframe=first_keyframe)
        ids = np.arange(new.start, new.stop, dtype=np.int32)
        self.observe(ids, rows)
        if refresh:
            self.refresh(ids)
        return ids

    def observe(self, point_ids: Ints, rows: Ints) -> int:
        """Add observations of points (N,) by rows (N,); a keyframe observes a point once. Return their number."""
        table, counts = self.keypoints, self._counts
        points, seeing = np.asarray(point_ids, dtype=np.int32), np.asarray(rows, dtype=np.int64)
        return int(links.link(points, seeing, self.lists, table.right_px, counts, self._unsaved))

    def remove_observations(self, rows: Ints) -> None:
        """Remove the observations of rows (N,); points with at most two observations left are removed.

        One with depth counts as two (docs/reference.md#orb-slam2-mapping), so one view that is left is never enough.
        """
        touched = np.unique(self.keypoints.point[rows])
        self._unlink(rows)
        touched = touched[touched >= 0]
        self.remove_points(touched[self.points.n_observations[touched] <= 2])

    def remove_points(self, point_ids: Ints) -> None:
        """Remove points (N,) and their observations."""
        self._unlink(self.observations(point_ids)[1])
        self.points.is_alive[point_ids] = False
        self.points.is_unsaved[point_ids] = True

    def replace_points(self, old_ids: Ints, new_ids: Ints) -> None:
        """Move the observations of old points (N,) to new ones (N,), which are others; the old points are removed."""
        old, new = np.asarray(old_ids, dtype=np.int64), np.asarray(new_ids, dtype=np.int64)
        links.replace(old, new, *self.changeable)

    def current_ids(self, point_ids: I32) -> I32:
        """Return the ids that replaced points (N,); −1 for those that were removed."""
        points = self.points
        ids: I32 = links.current_ids(np.asarray(point_ids, dtype=np.int32), points.is_alive, points.replaced_by)
        return ids

    def observations(self, point_ids: Ints) -> tuple[I32, I32]:
        """Return all observations of points (N,): place in `point_ids` (M,) and keypoint row (M,)."""
        place, rows = links.gather(
            np.asarray(point_ids, dtype=np.int32),
            self.keypoints.next_row,
            self.points.first_row,
            self.points.n_keyframes,
        )
        return place, rows

    def oldest_observations(self, point_ids: Ints) -> I32:
        """Return the keypoint row (N,) that saw each point (N,) first; −1 for a point that nothing sees."""
        rows: I32 = links.oldest_rows(
            np.asarray(point_ids, dtype=np.int32), self.keypoints.next_row, self.points.first_row
        )
        return rows

    def refresh(self, point_ids: Ints) -> None:
        """Choose typical descriptors and viewing geometry of points (N,) again, after their views changed."""
        ids = np.asarray(point_ids, dtype=np.int32)
        table, points = self.keypoints, self.points
        chosen = np.empty(len(ids), dtype=np.int32)
        links.typical_descriptors(ids, table.next_row, points.first_row, words(table.descriptors), chosen)
        seen = chosen >= 0
        points.descriptors[ids[seen]] = table.descriptors[chosen[seen]]
        self.refresh_geometry(ids)

    def refresh_geometry(self, point_ids: Ints) -> None:
        """Update viewing direction and distances of points (N,) after they or their keyframes moved."""
        points = self.points
        points.is_unsaved[point_ids] = True
        links.viewing_geometry(
            np.asarray(point_ids, dtype=np.int32),
            self.lists,
            self.keypoints.octave,
            self.keyframes.T_world_cam,
            self.scales.factors,
            links.Viewing(points.position_m, points.normal, points.min_distance_m, points.max_distance_m),
        )

    @property
    def changeable(self) -> tuple[links.Links, F32, links.Counts, links.Unsaved, links.Found]:
        """What kernels take that join points; views are invalid after a table grows."""
        points = self.points
        found = links.Found(points.n_visible, points.n_found, points.is_alive, points.replaced_by)
        return self.lists, self.keypoints.right_px, self._counts, self._unsaved, found

    @property
    def _counts(self) -> links.Counts:
        return links.Counts(self.points.n_observations, self.points.n_keyframes)

    @property
    def _unsaved(self) -> links.Unsaved:
        return links.Unsaved(self.points.is_unsaved, self.keyframes.is_unsaved)

    def _unlink(self, rows: Ints) -> None:
        losing, right_px = np.asarray(rows, dtype=np.int64), self.keypoints.right_px
        links.unlink(losing, self.lists, right_px, self._counts, self._unsaved)
