"""Viewpoints of a cloud: chosen from the cloud and the poses of the camera that saw it."""

from dataclasses import dataclass, field, replace

import numpy as np

from stillroom.data.dense_cloud import DenseCloud
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, Bool, Floats
from stillroom.geometry.camera import Camera

FIELD_OF_VIEW = 0.70
"""Width of the default views' field of view as a tangent: a long lens, which keeps walls upright."""

MARGIN = 0.03
"""Share of the picture left free on each side of what is to be seen."""

INLYING = (0.1, 99.9)
"""Percentiles of the projections between which what is to be seen lies: outliers must not shrink the room."""

LEVEL = np.cos(np.radians(35.0))
"""Normals this near the cameras' upward direction say where up is."""

CEILING_SHARE = 0.01
"""Share of a cloud's points that a ceiling has at least."""


@dataclass(frozen=True)
class Viewpoint:
    """A virtual pinhole camera, and a clipping plane.

    Attributes:
        T_world_cam: Its pose (4, 4): x right, y down, z forward.
        camera: Its intrinsics and the size of the picture; without distortion.
        hidden: A plane (4,), n·p + d [m, world], beyond whose positive side nothing is drawn; None for no plane.
    """

    T_world_cam: F64
    camera: Camera
    hidden: F64 | None = field(default=None)

    def scaled(self, factor: int) -> "Viewpoint":
        """Return the same view on a picture that many times as large."""
        c = self.camera
        # Pixel centres lie at integers in both, so the principal point moves by half a pixel besides.
        camera = Camera(
            c.width * factor,
            c.height * factor,
            c.fx * factor,
            c.fy * factor,
            (c.cx + 0.5) * factor - 0.5,
            (c.cy + 0.5) * factor - 0.5,
        )
        return replace(self, camera=camera)

    def with_strip_below(self, height_px: int) -> "Viewpoint":
        """Return the same view with some more rows at the bottom, for a caption."""
        c = self.camera
        return replace(self, camera=Camera(c.width, c.height + height_px, c.fx, c.fy, c.cx, c.cy))

    def shows(self, positions_m: Floats) -> Bool:
        """Return which points (N, 3) [m, world] lie on the near side of the plane, (N,)."""
        if self.hidden is None:
            return np.ones(len(positions_m), dtype=np.bool_)
        return np.asarray(positions_m @ self.hidden[:3] + self.hidden[3] <= 0.0, dtype=np.bool_)


def default_view(
    cloud: DenseCloud,
    T_world_cam: F64,
    width_px: int = 960,
    height_px: int = 600,
    pitch_rad: float = 0.3,
    yaw_rad: float = 0.0,
) -> Viewpoint:
    """Look over the shoulder of the camera that saw a cloud: from behind and above it, at the middle of the scene.

    Args:
        cloud: What is to be seen whole.
        T_world_cam: The camera's poses (M, 4, 4); at least one.
        width_px, height_px: Size of the picture.
        pitch_rad: How steeply the view looks down.
        yaw_rad: By how much it goes round to the left of the camera [rad].

    Returns:
        The view, with a ceiling cut away where there is one.
    """
    up = upward(cloud.normals, T_world_cam)
    forward = level(T_world_cam[:, :3, 2].mean(axis=0), up)
    right = np.cross(forward, up)
    forward = np.cos(yaw_rad) * forward + np.sin(yaw_rad) * right
    looking = np.cos(pitch_rad) * forward - np.sin(pitch_rad) * up
    return _fitted(cloud, T_world_cam, looking, up, width_px, height_px)


def top_view(cloud: DenseCloud, T_world_cam: F64, width_px: int = 960, height_px: int = 600) -> Viewpoint:
    """Look straight down, the camera's forward direction upward in the picture; arguments as in `default_view`."""
    up = upward(cloud.normals, T_world_cam)
    forward = level(T_world_cam[:, :3, 2].mean(axis=0), up)
    return _fitted(cloud, T_world_cam, -up, forward, width_px, height_px)


def upward(normals: Floats, T_world_cam: F64) -> F64:
    """Return the unit vector (3,) [world] that points up.

    A hand-held camera is upright on average, but only within some degrees; floors and table tops are level.

    Args:
        normals: Unit normals of surfaces (N, 3) [world]; there may be none.
        T_world_cam: Poses of the camera (M, 4, 4); at least one.
    """
    up = _unit(-T_world_cam[:, :3, 1].mean(axis=0))
    for _ in range(5):
        of_floors = normals @ up > LEVEL
        if np.count_nonzero(of_floors) < 0.01 * max(1, len(normals)):
            break
        flat = normals[of_floors].astype(np.float64)
        # A high power of the cosine pulls towards the mode.
        up = _unit(((flat @ up)[:, None] ** 8 * flat).sum(axis=0))
    return up


def _fitted(
    cloud: DenseCloud, T_world_cam: F64, looking: F64, upright: F64, width_px: int, height_px: int
) -> Viewpoint:
    """Return the view along a direction that is far enough off to see all, and centred on it."""
    down = _unit(np.dot(upright, looking) * looking - upright)
    R_world_view = np.stack((np.cross(down, looking), down, looking), axis=1)
    hidden = _ceiling(cloud, T_world_cam)
    focal_px = width_px / FIELD_OF_VIEW
    camera = Camera(width_px, height_px, focal_px, focal_px, (width_px - 1) / 2.0, (height_px - 1) / 2.0)
    view = Viewpoint(se3.from_rotation_translation(R_world_view, T_world_cam[:, :3, 3].mean(axis=0)), camera, hidden)
    seen_m = cloud.positions_m[view.shows(cloud.positions_m)]
    if len(seen_m) == 0:
        return view
    eye_m = _eye(seen_m @ R_world_view, camera)
    return replace(view, T_world_cam=se3.from_rotation_translation(R_world_view, R_world_view @ eye_m))


def _eye(points_m: Floats, camera: Camera) -> F64:
    """Return from where (3,) [m] a camera has the points (N, 3) [m, both in its directions] in its picture.

    A point is within the picture's edges when x − ex ≤ a·(z − ez) and so on: four bounds on where the eye is, and
    the nearest place that satisfies all.
    """
    free = 1.0 - 2.0 * MARGIN
    z = points_m[:, 2].astype(np.float64)
    nearness, place = [], []
    for axis, size_px, focal_px in ((0, camera.width, camera.fx), (1, camera.height, camera.fy)):
        slope = free * size_px / (2.0 * focal_px)
        low = np.percentile(points_m[:, axis] + slope * z, INLYING[0])
        high = np.percentile(points_m[:, axis] - slope * z, INLYING[1])
        nearness.append((low - high) / (2.0 * slope))
        place.append((low + high) / 2.0)
    # Wider than high or the other way round: the picture's other axis has room to spare, and keeps its middle.
    ez = min(nearness)
    return np.array([place[0], place[1], ez])


def _ceiling(cloud: DenseCloud, T_world_cam: F64) -> F64 | None:
    """Return the level plane (4,) [world] under a ceiling, for points that look down from above the cameras."""
    up = upward(cloud.normals, T_world_cam)
    above_m = float(np.percentile(T_world_cam[:, :3, 3] @ up, 95.0)) + 0.3
    heights_m = cloud.positions_m @ up
    ceiling = (heights_m > above_m) & (cloud.normals @ up < -0.8)
    if np.count_nonzero(ceiling) < CEILING_SHARE * max(1, len(cloud)):
        return None
    return np.append(up, -(float(np.percentile(heights_m[ceiling], 10.0)) - 0.1))


def level(direction: F64, up: F64) -> F64:
    """Return the unit vector (3,) along the part of a direction (3,) that is perpendicular to the unit vector up."""
    across: F64 = direction - np.dot(direction, up) * up
    if np.linalg.norm(across) < 1e-6:  # Straight up or down: any level direction will do.
        across = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    return _unit(across)


def _unit(vector: Floats) -> F64:
    return np.asarray(vector, dtype=np.float64) / max(float(np.linalg.norm(vector)), 1e-12)
