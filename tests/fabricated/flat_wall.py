"""Depth images of a flat wall, worked out from the geometry alone, and of things that stand before it."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from small_world import BLACK, SmallWorld

from stillroom.data.frame import Frame
from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box
from stillroom.geometry.camera import Camera

WALL_M = 3.0
"""The wall is the plane z = 3 m of the world."""


@lru_cache
def _rays(camera: Camera) -> np.ndarray:
    """Rays (H * W, 2) at unit depth of the pixels as taken: by OpenCV's own words, not by the camera's."""
    row, column = np.mgrid[: camera.height, : camera.width]
    raw_px = np.stack((column.ravel(), row.ravel()), axis=1).astype(np.float64)
    return cv2.undistortPoints(raw_px[:, None], camera.K, np.array(camera.distortion)).reshape(-1, 2)


def wall_depth(camera: Camera, T_world_cam: np.ndarray) -> np.ndarray:
    """Depth (H, W) float32 [m] of the wall in the image as taken: where each pixel's ray meets the plane."""
    forward = _rays(camera) @ T_world_cam[2, :2] + T_world_cam[2, 2]
    depth_m = (WALL_M - T_world_cam[2, 3]) / forward
    return depth_m.reshape(camera.height, camera.width).astype(np.float32)


def points_on_the_wall(seed: int = 0, n: int = 600) -> SmallWorld:
    """Described points on the wall."""
    return SmallWorld.of(seed, n, near_m=WALL_M, far_m=WALL_M)


def before_the_wall(frame: Frame, T_world_cam: np.ndarray, figure: Box | None = None, figure_m: float = 1.5) -> Frame:
    """Give a frame its depth image; keypoints in `figure` and its pixels come to lie nearer than the wall."""
    depth_m = wall_depth(frame.camera, T_world_cam)
    keypoints = frame.keypoints
    if figure is not None:
        x0, y0, x1, y1 = (int(edge) for edge in figure.xyxy_px)
        depth_m[y0 : y1 + 1, x0 : x1 + 1] = figure_m
        there = np.where(in_box(frame, figure), np.float32(figure_m), keypoints.depth_m)
        keypoints = replace(keypoints, depth_m=there, right_px=frame.camera.right_coordinate(keypoints.px[:, 0], there))
    image = RgbdImage(frame.image.timestamp_s, BLACK, depth_m, frame.image.index)
    return replace(frame, image=image, keypoints=keypoints)


def in_box(frame: Frame, box: Box) -> np.ndarray:
    """Which keypoints (N,) lie in a box, one after the other."""
    x0, y0, x1, y1 = box.xyxy_px
    raw_px = np.rint(frame.keypoints.raw_px)
    return np.array([x0 <= x <= x1 and y0 <= y <= y1 for x, y in raw_px])
