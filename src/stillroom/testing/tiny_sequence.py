"""A sequence of a few tiny frames, written to disk in the TUM layout: for tests that open files."""

from pathlib import Path

import cv2
import numpy as np

from stillroom.data.trajectory import Trajectory
from stillroom.datasets.camera_file import write_camera
from stillroom.geometry import se3
from stillroom.geometry.arrays import U8, U16
from stillroom.geometry.camera import Camera
from stillroom.testing.dataset_contract import KnownPixel

TINY_CAMERA = Camera(width=64, height=48, fx=60.0, fy=61.0, cx=31.5, cy=23.5, depth_factor=1000.0, bf=4.5)
START_S = 1305031229.5
RATE_HZ = 30.0
DEPTH_LAG_S = 0.004
PATCH_RGB = (200, 30, 60)


def write_tiny_sequence(folder: Path, frames: int = 6, camera: Camera = TINY_CAMERA) -> tuple[KnownPixel, ...]:
    """Write `rgb.txt`, `depth.txt`, their PNG images, `groundtruth.txt` and `camera.toml` into a new folder.

    Frame k is noise with a reddish patch, whose depth is 1.5 m + k · 0.1 m, in its upper left corner; the last row
    has no depth. The camera moves along x, 1 cm a frame.

    Returns:
        A known pixel of each frame, for `check_dataset`.
    """
    known: list[KnownPixel] = []
    rgb_lines, depth_lines = ["# color images", "# timestamp filename"], ["# depth maps", "# timestamp filename"]
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    times_s = START_S + np.arange(frames) / RATE_HZ
    for k, time_s in enumerate(times_s):
        rgb, units = _tiny_frame(k, camera)
        for name, stamp_s, lines, pixels in (
            ("rgb", time_s, rgb_lines, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)),
            ("depth", time_s + DEPTH_LAG_S, depth_lines, units),
        ):
            file = f"{name}/{stamp_s:.6f}.png"
            (folder / file).write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
            lines.append(f"{stamp_s:.6f} {file}")
        known.append(KnownPixel(k, 3, 5, PATCH_RGB, units[3, 5] / camera.depth_factor))
        known.append(KnownPixel(k, camera.height - 1, 5, tuple(rgb[-1, 5].tolist()), 0.0))
    (folder / "rgb.txt").write_text("\n".join(rgb_lines) + "\n", encoding="utf-8")
    (folder / "depth.txt").write_text("\n".join(depth_lines) + "\n", encoding="utf-8")
    T_world_cam = np.tile(se3.identity(), (frames, 1, 1))
    T_world_cam[:, 0, 3] = 0.01 * np.arange(frames)
    Trajectory(times_s, T_world_cam).write_tum(folder / "groundtruth.txt")
    write_camera(camera, folder / "camera.toml")
    return tuple(known)


def _tiny_frame(k: int, camera: Camera) -> tuple[U8, U16]:
    rng = np.random.default_rng(k)
    rgb = rng.integers(0, 255, (camera.height, camera.width, 3), dtype=np.uint8)
    rgb[:8, :8] = PATCH_RGB
    units = np.full((camera.height, camera.width), 2.0 * camera.depth_factor, dtype=np.uint16)
    units[:8, :8] = round((1.5 + 0.1 * k) * camera.depth_factor)
    units[-1] = 0
    return rgb, units
