"""The sparse map as a picture, from above and at a slant: points, keyframes, the camera's path (Figures 11A, 12A)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.data.trajectory import Trajectory
from stillroom.geometry.arrays import F64, Floats
from stillroom.viz.cloud.view import level, upward
from stillroom.viz.style import FAINT, KEYFRAMES, TRUTH, picture

SIZE_IN = (12.0, 4.8)
"""Of the picture, 150 pixels to the inch."""

HEIGHTS = ("#24476e", "#1b7fc4", "#43b0a0", "#e9b949", "#e0533d")
"""Colours of points, from the lowest or oldest to the highest or newest."""

PITCH_RAD, YAW_RAD = 0.55, 0.5
"""How steeply the second panel looks down, and by how much it is turned to the side."""

INLYING = (1.0, 99.0)
"""Percentiles of the points that the panels show at least."""

FRUSTUM = np.array([[0, 0, 0], [-0.8, -0.6, 1], [0.8, -0.6, 1], [0.8, 0.6, 1], [-0.8, 0.6, 1]])
"""A camera's centre and the corners of its image (5, 3), camera frame, 1 deep."""

STROKE = (0, 1, 2, 0, 3, 4, 0, 2, 3, 0, 4, 1)
"""In which order its corners are joined by one line."""

FRUSTUM_SIZE = 0.035
"""Depth of a keyframe's frustum, as a share of the scene's size."""


@dataclass(frozen=True)
class _Axes:
    """A world that stands upright: x to the right of the first keyframe, y forward, z up from the lowest points."""

    R_upright_world: F64
    origin_m: F64

    @classmethod
    def of(cls, points_m: Floats, T_world_keyframes: F64) -> "_Axes":
        up = upward(np.zeros((0, 3)), T_world_keyframes)
        forward = level(T_world_keyframes[:, :3, 2].mean(axis=0), up)
        R = np.stack((np.cross(forward, up), forward, up))
        start_m = T_world_keyframes[0, :3, 3].copy()
        if len(points_m):
            floor_m = float(np.percentile(points_m @ up, INLYING[0]))
            start_m += (floor_m - float(start_m @ up)) * up
        return cls(R, start_m)

    def upright(self, points_m: Floats) -> F64:
        """Take points (..., 3) of the world here."""
        return np.asarray((points_m - self.origin_m) @ self.R_upright_world.T, dtype=np.float64)


def draw_sparse_map(
    path: Path,
    points_m: Floats,
    T_world_keyframes: F64,
    trajectory: Trajectory | None = None,
    age_s: Floats | None = None,
    title: str = "",
) -> None:
    """Draw a sparse map from above and at a slant.

    Args:
        path: The file to write: PNG, 1800 by 720 pixels, or SVG or PDF by its suffix.
        points_m: Map points (P, 3) [m, world].
        T_world_keyframes: Poses of the keyframes (K, 4, 4), in order of time; at least one.
        trajectory: The camera's path, if it is to be drawn; where it is up to scale, so are the axes.
        age_s: When each point was first seen (P,) [s]; points are coloured by it. None: by their height.
        title: Shown above.

    Raises:
        StillroomError: The file cannot be written.
    """
    axes = _Axes.of(points_m, T_world_keyframes)
    points = axes.upright(np.asarray(points_m, dtype=np.float64).reshape(-1, 3))
    centers = axes.upright(T_world_keyframes[:, :3, 3])
    low, high = _extent(points, centers)
    size_m = FRUSTUM_SIZE * float(np.linalg.norm(high - low))
    corners_m = np.einsum("kij,cj->kci", T_world_keyframes[:, :3, :3], size_m * FRUSTUM[list(STROKE)])
    frusta = axes.upright(corners_m + T_world_keyframes[:, None, :3, 3])
    walked = np.zeros((0, 3)) if trajectory is None else axes.upright(trajectory.positions_m)
    unit = "m" if trajectory is None or trajectory.is_metric else "units of the map"
    values, label = (points[:, 2], f"height [{unit}]") if age_s is None else (np.asarray(age_s), "first seen [s]")
    with picture(path, *SIZE_IN) as figure:
        above, slanted = figure.subplots(1, 2, width_ratios=(1.0, 1.3))
        _draw(above, points, values, frusta, walked)
        above.set(xlabel=f"right [{unit}]", ylabel=f"forward [{unit}]", title=title)
        _limit(above, low, high)
        oblique = _oblique()
        _draw_ground(slanted, low, high, oblique)
        dots = _draw(slanted, points @ oblique.T, values, frusta @ oblique.T, walked @ oblique.T)
        _limit(slanted, *_extent(points @ oblique.T, centers @ oblique.T))
        slanted.set_axis_off()
        bar = figure.colorbar(dots, ax=slanted, shrink=0.55, aspect=28, pad=0.01, label=label)
        bar.outline.set_visible(False)
        handles, labels = above.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower left", ncols=3)


def _draw(axes: Any, points: F64, values: Floats, frusta: F64, walked: F64) -> Any:
    """Draw points (P, 3), keyframes (K, 12, 3) and a path (M, 3); the third coordinate says what lies before what."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap

    order = np.argsort(points[:, 2], kind="stable")
    low, high = np.percentile(values, INLYING) if len(values) else (0.0, 1.0)
    dots = axes.scatter(
        points[order, 0],
        points[order, 1],
        c=values[order],
        s=6.0,
        lw=0,
        alpha=0.85,
        cmap=LinearSegmentedColormap.from_list("heights", HEIGHTS),
        vmin=low,
        vmax=max(high, low + 1e-3),
        zorder=2,
        label=f"{len(points):,} points".replace(",", "\u202f"),
    )
    axes.add_collection(LineCollection(list(frusta[..., :2]), colors=KEYFRAMES, lw=0.6, alpha=0.6, zorder=3))
    axes.plot([], [], color=KEYFRAMES, lw=1.2, label=f"{len(frusta)} keyframes")
    if len(walked):
        axes.plot(walked[:, 0], walked[:, 1], color=TRUTH, lw=1.3, zorder=4, label="camera")
    return dots


def _draw_ground(axes: Any, low: F64, high: F64, oblique: F64) -> None:
    """Draw a grid of 1 m on the ground."""
    from matplotlib.collections import LineCollection

    lines = []
    for along, across in ((0, 1), (1, 0)):
        for place in np.arange(np.ceil(low[along]), high[along] + 1e-9):
            ends = np.zeros((2, 3))
            ends[:, along] = place
            ends[:, across] = low[across], high[across]
            lines.append((ends @ oblique.T)[:, :2])
    axes.add_collection(LineCollection(lines, colors=FAINT, lw=0.8, zorder=1))


def _limit(axes: Any, low: F64, high: F64) -> None:
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal", adjustable="box")


def _oblique() -> F64:
    """Return the rotation (3, 3) from the upright world to the slanted panel: right, up, towards the eye."""
    sin_y, cos_y, sin_p, cos_p = np.sin(YAW_RAD), np.cos(YAW_RAD), np.sin(PITCH_RAD), np.cos(PITCH_RAD)
    right = np.array([cos_y, sin_y, 0.0])
    away = np.array([-sin_y * cos_p, cos_y * cos_p, -sin_p])
    return np.stack((right, np.cross(right, away), -away))


def _extent(points: F64, centers: F64) -> tuple[F64, F64]:
    """Return the corners (3,), (3,) of the box that is shown: nearly all points, all keyframes, and some air."""
    most = np.percentile(points, INLYING, axis=0) if len(points) else centers
    low = np.minimum(most.min(axis=0), centers.min(axis=0))
    high = np.maximum(most.max(axis=0), centers.max(axis=0))
    air = 0.07 * np.maximum(high - low, 0.5)
    return low - air, high + air
