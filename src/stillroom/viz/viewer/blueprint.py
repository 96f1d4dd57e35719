"""How the viewer's window is divided."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from stillroom.data.dense_cloud import DenseCloud
from stillroom.geometry.arrays import F64, Floats
from stillroom.viz.cloud.view import default_view
from stillroom.viz.viewer import entities as at
from stillroom.viz.viewer.recording import IMAGE
from stillroom.viz.viewer.scene import STAGE_COLORS

PAPER = (247, 248, 250)
"""Background of the room, light as that of the plots: their colours for trajectories suit both."""

SLOWEST_MS = 150.0
"""End of the axis of times at first [ms]: the first image, which loads and compiles, would leave the others no room."""

YAW_RAD = 0.35
"""How far the eye stands to the side of the camera."""

WIDTH, HEIGHT = 0.85, 0.42
"""Half of the picture of the room, as tangents: a little less than rerun's lens shows."""

MOST = 97.0
"""Percentage of the cloud that is to be seen; all keyframes are."""


@dataclass(frozen=True)
class Eye:
    """From where the room is seen at first [m, world]; by default over the shoulder of the first keyframe.

    Attributes:
        position_m: Where the eye is (3,).
        target_m: What it looks at and turns around (3,).
        up: Which way is up (3,).
    """

    position_m: tuple[float, ...] = (-1.0, -1.2, -1.6)
    target_m: tuple[float, ...] = (0.1, 0.15, 1.6)
    up: tuple[float, ...] = (0.0, -1.0, 0.0)

    @classmethod
    def of(cls, cloud: DenseCloud | None, T_world_keyframes: F64) -> "Eye":
        """Return the eye that sees a cloud and keyframes (K, 4, 4) from behind; the default where either is none."""
        if cloud is None or len(cloud) == 0 or len(T_world_keyframes) == 0:
            return cls()
        T_world_eye = default_view(cloud, T_world_keyframes, yaw_rad=YAW_RAD).T_world_cam
        target_m, forward = np.median(cloud.positions_m, axis=0).astype(np.float64), T_world_eye[:3, 2]
        seen = _distances_m(cloud.positions_m - target_m, T_world_eye)
        keyframes = _distances_m(T_world_keyframes[:, :3, 3] - target_m, T_world_eye)
        position_m = target_m - max(float(np.percentile(seen, MOST)), float(keyframes.max())) * forward
        return cls(tuple(position_m.tolist()), tuple(target_m.tolist()), tuple((-T_world_eye[:3, 1]).tolist()))


def _distances_m(offset_m: Floats, T_world_eye: F64) -> F64:
    """Return how far (N,) the eye must be from its target to see each point (N, 3), relative to it [m]."""
    x_m, y_m, z_m = (offset_m @ T_world_eye[:3, :3]).T
    return np.asarray(np.maximum(np.abs(x_m) / WIDTH, np.abs(y_m) / HEIGHT) - z_m, dtype=np.float64)


def arranged(rr: Any, has_clusters: bool, has_images: bool = True, eye: Eye | None = None) -> Any:
    """Return the blueprint: the images on the left, the room on the right, below it the plots and the state.

    Args:
        rr: The rerun module.
        has_clusters: Whether the method clusters depth clouds, which then have a view of their own.
        has_images: Whether there are images at all.
        eye: From where the room is seen at first.
    """
    rrb = rr.blueprint
    images = [_image(rrb, "Image: static green, dynamic red", at.KEYPOINTS, at.BOXES, at.MASKS)]
    if has_clusters:
        images.append(_image(rrb, "Clusters of the depth cloud", at.CLUSTERS, at.BOXES))
    stages = [f"+ {at.STAGES}/{name}" for name in STAGE_COLORS]
    axis = rrb.ScalarAxis(range=(0.0, SLOWEST_MS))
    plots = rrb.Horizontal(
        _plot(rrb, "Time of each stage [ms]", at.STAGES, stages, axis_y=axis),
        _plot(rrb, "Keypoints and matches", at.COUNTS, [f"+ {at.COUNTS}/**"]),
    )
    state = rrb.StateTimelineView(origin=at.STATE, name="Tracking")
    right = rrb.Vertical(_room(rr, eye or Eye()), plots, state, row_shares=[6, 3.3, 1.2])
    left = rrb.Vertical(*images)
    whole = rrb.Horizontal(left, right, column_shares=[2, 3]) if has_images else right
    return rrb.Blueprint(
        whole,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=IMAGE, play_state="following", fps=30.0),
        auto_views=False,
        auto_layout=False,
    )


def _image(rrb: Any, name: str, *overlays: str) -> Any:
    shown = [f"+ {at.CAMERA_IMAGE}", *(f"+ {overlay}/**" for overlay in overlays)]
    return rrb.Spatial2DView(origin=at.CAMERA_IMAGE, contents=shown, name=name)


def _room(rr: Any, eye: Eye) -> Any:
    rrb = rr.blueprint
    in_image = (at.KEYPOINTS, at.BOXES, at.MASKS, at.CLUSTERS)
    return rrb.Spatial3DView(
        origin=at.WORLD,
        contents=[f"+ {at.WORLD}/**", *(f"- {overlay}/**" for overlay in in_image)],
        name="Room: camera, trajectory, ground truth, keyframes, sparse and dense map",
        background=PAPER,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye.position_m, look_target=eye.target_m, eye_up=eye.up),
    )


def _plot(rrb: Any, name: str, origin: str, contents: list[str], **axes: Any) -> Any:
    legend = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=True)
    return rrb.TimeSeriesView(origin=origin, contents=contents, name=name, plot_legend=legend, **axes)
