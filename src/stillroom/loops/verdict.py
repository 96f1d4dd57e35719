"""The consistency check after a loop: where too many earlier inliers became outliers, the loop is wrong."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64, Bool, Ints
from stillroom.geometry.camera import Camera
from stillroom.loops.moves import Places, apply_motions, carry_newer

_LINKS = ("point", "next_row")
_TO_WRITE = "is_unsaved"
_LEAST_OBSERVATIONS = 30
"""Fewest observations of a keyframe that is checked alone."""
_CHI2_2D, _CHI2_3D = 5.991, 7.815


# The map before a correction, so that a wrong loop can be undone.


class Snapshot:
    """What a correction may change of a map: poses, points and observations. Keypoints themselves never change."""

    def __init__(self, world: Map) -> None:
        """Copy it."""
        self._keyframes = _copy(world.keyframes.views)
        self._points = _copy(world.points.views)
        self._links = _copy({name: world.keypoints.views[name] for name in _LINKS})
        self._edges = world.covisibility.edges()
        self._loop_edges = list(world.loop_edges)

    @property
    def T_world_cam(self) -> F64:
        """The keyframes' poses in the snapshot (K, 4, 4)."""
        return self._keyframes["T_world_cam"]

    @property
    def places(self) -> Places:
        """Where the keyframes are in the snapshot."""
        return Places(self._keyframes["T_world_cam"], self._keyframes["scale"])

    @property
    def seen(self) -> tuple[I64, I64, F64]:
        """In the snapshot: rows with a point (O,), the point of each (O,), and positions of all points (P, 3) [m]."""
        rows = np.flatnonzero(self._links["point"] >= 0)
        return rows, self._links["point"][rows].astype(np.int64), self._points["position_m"]

    def restore(self, world: Map) -> None:
        """Restore the map. Keyframes and points that were added since stay, and move with their parents."""
        n_keyframes, n_points, n_rows = len(self.T_world_cam), len(self._points["is_alive"]), len(self._links["point"])
        table, points, keyframes = world.keypoints, world.points, world.keyframes
        is_new = (table.point >= n_points) | ((np.arange(len(table)) >= n_rows) & (table.point >= 0))
        rows = np.flatnonzero(is_new)
        seen = table.point[rows].copy()
        wrong = Places.of(world)
        for view, old in ((keyframes.views, self._keyframes), (points.views, self._points), (table.views, self._links)):
            for name, values in old.items():
                view[name][: len(values)] = values
        keyframes.is_unsaved[:], points.is_unsaved[:] = True, True
        for name in _LINKS:
            table.views[name][n_rows:] = -1
        points.first_row[n_points:] = -1
        points.n_observations[n_points:], points.n_keyframes[n_points:] = 0, 0
        world.observe(seen, rows)
        world.covisibility.restore(self._edges)
        world.loop_edges[:] = self._loop_edges
        self._carry_along(n_keyframes, n_points, wrong, world)

    def _carry_along(self, n_keyframes: int, n_points: int, wrong: Places, world: Map) -> None:
        """Move keyframes and points that were added since with their parents."""
        carry_newer(n_keyframes, wrong, world)
        for keyframe in range(n_keyframes, len(world.keyframes)):
            world.connect(keyframe)
        new = np.arange(n_points, len(world.points))
        apply_motions(new, wrong.motions(world)[world.points.first_keyframe[new]], world)
        world.refresh_geometry(new[world.points.is_alive[new]])


def _copy(views: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {name: view.copy() for name, view in views.items() if name != _TO_WRITE}


@dataclass(frozen=True)
class Verdict:
    """The consistency of a correction.

    Attributes:
        lost_share: Share of the inlier observations that became outliers.
        worst_share: The same of the keyframe that lost most.
        kept_share: Share of the observations added by the loop that are inliers.
    """

    lost_share: float
    worst_share: float
    kept_share: float


@dataclass(frozen=True)
class LinkChange:
    """What fusing points changed: rows with a point before and after, and rows with another point now.

    Attributes:
        rows, points: Rows (O,) that saw a point before, and which (O,) they see now.
        joined_rows, joined_points: Rows (J,) that see another point than before, or one for the first time.
    """

    rows: I64
    points: I64
    joined_rows: I64
    joined_points: I64

    @staticmethod
    def since(before: Snapshot, world: Map) -> "LinkChange":
        """Compare a map with its snapshot."""
        now = world.keypoints.point.astype(np.int64)
        then = np.full(len(now), -1, dtype=np.int64)
        rows, points, _ = before.seen
        then[rows] = points
        kept, joined = np.flatnonzero((then >= 0) & (now >= 0)), np.flatnonzero((now >= 0) & (now != then))
        return LinkChange(kept, now[kept], joined, now[joined])


def judge(before: Snapshot, links: LinkChange, world: Map, camera: Camera) -> Verdict:
    """Compare the map, corrected and adjusted, with its snapshot.

    Args:
        before: The map before the correction.
        links: The observations after fusing points, before bundle adjustment removed outliers.
        world: The map now.
        camera: The calibration.
    """
    rows, points, positions_m = before.seen
    fitted_before = np.zeros(len(world.keypoints), dtype=np.bool_)
    fitted_before[rows] = fits(rows, points, before.T_world_cam, positions_m, world, camera)
    counted = fitted_before[links.rows]
    rows, points = links.rows[counted], links.points[counted]
    poses, positions_m = world.keyframes.T_world_cam, world.points.position_m
    lost = ~fits(rows, points, poses, positions_m, world, camera)
    owner = world.keypoints.keyframe[rows]
    n_of = np.bincount(owner, minlength=1)
    large = n_of >= _LEAST_OBSERVATIONS
    worst = float((np.bincount(owner, weights=lost, minlength=1)[large] / n_of[large]).max(initial=0.0))
    kept = fits(links.joined_rows, links.joined_points, poses, positions_m, world, camera)
    return Verdict(_mean(lost), worst, _mean(kept))


def fits(rows: Ints, points: Ints, T_world_cam: F64, positions_m: F64, world: Map, camera: Camera) -> Bool:
    """Return which observations of points (O,) by rows (O,) are inliers at poses (K, 4, 4) and positions (P, 3) [m]."""
    table = world.keypoints
    T_cam_world = se3.inverse(T_world_cam)[table.keyframe[rows]]
    points_cam = np.einsum("nij,nj->ni", T_cam_world[:, :3, :3], positions_m[points]) + T_cam_world[:, :3, 3]
    z = points_cam[:, 2]
    ahead = z > 1e-3
    safe = np.where(ahead, z, 1.0)
    u = camera.fx * points_cam[:, 0] / safe + camera.cx
    v = camera.fy * points_cam[:, 1] / safe + camera.cy
    has_depth = table.right_px[rows] >= 0
    error2 = (u - table.px[rows, 0]) ** 2 + (v - table.px[rows, 1]) ** 2
    error2 += np.where(has_depth, (u - camera.bf / safe - table.right_px[rows]) ** 2, 0.0)
    error2 *= world.scales.inverse_variances[table.octave[rows]]
    return np.asarray(ahead & (error2 <= np.where(has_depth, _CHI2_3D, _CHI2_2D)))


def _mean(chosen: Bool) -> float:
    return float(chosen.mean()) if len(chosen) else 0.0
