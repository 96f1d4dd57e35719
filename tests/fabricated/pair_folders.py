"""Small sequences in EuRoC's and KITTI's layouts: a textured wall, seen by a rectified pair that moves sideways."""

from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT, F, CX, CY = 188, 120, 110.0, 93.0, 60.0
BASELINE_M, WALL_M = 0.11, 2.42
DISPARITY_PX = 5  # F · BASELINE_M / WALL_M
STEP_PX, STEP_NS, START_NS = 2, 50_000_000, 1_403_715_273_262_142_976
STEP_M = STEP_PX * WALL_M / F
T_BODY_LEFT = np.array([[0.0, -1.0, 0.0, 0.02], [1.0, 0.0, 0.0, -0.06], [0.0, 0.0, 1.0, 0.01], [0.0, 0.0, 0.0, 1.0]])
"""A quarter turn about the axis of view, and a lever arm of 6.4 cm."""


def wall(frame: int, side: int = 0) -> np.ndarray:
    """What the left (0) or right (1) camera sees in a frame."""
    noise = np.random.default_rng(7).integers(0, 255, (HEIGHT, 400), dtype=np.uint8)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.6), None, 0, 255, cv2.NORM_MINMAX)
    first = 20 + STEP_PX * frame + DISPARITY_PX * side
    return np.ascontiguousarray(texture[:, first : first + WIDTH])


def sensor_yaml(T_body_cam: np.ndarray, distortion: str = "[0.0, 0.0, 0.0, 0.0]") -> str:
    rows = ",\n         ".join(", ".join(f"{value:.12g}" for value in row) for row in T_body_cam)
    return (
        "# General sensor definitions.\nsensor_type: camera\ncomment: a wall, pinhole\n\n"
        f"# Sensor extrinsics wrt. the body-frame.\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{rows}]\n\n"
        f"rate_hz: 20\nresolution: [{WIDTH}, {HEIGHT}]\ncamera_model: pinhole\n"
        f"intrinsics: [{F}, {F}, {CX}, {CY}] #fu, fv, cu, cv\n"
        f"distortion_model: radial-tangential\ndistortion_coefficients: {distortion}\n"
    )


def right_of(T_body_left: np.ndarray) -> np.ndarray:
    aside = np.eye(4)
    aside[0, 3] = BASELINE_M
    return T_body_left @ aside


def stamps(frames: int) -> list[int]:
    return [START_NS + STEP_NS * k for k in range(frames)]


def write_euroc(folder: Path, frames: int = 6, cameras: int = 2, states: bool = False) -> Path:
    """Write a sequence; its ground truth is that of the body, in TUM's format or as EuRoC's states."""
    for side in range(cameras):
        place = folder / "mav0" / f"cam{side}"
        (place / "data").mkdir(parents=True)
        rows = ["#timestamp [ns],filename"]
        for k, stamp in enumerate(stamps(frames)):
            cv2.imwrite(str(place / "data" / f"{stamp}.png"), wall(k, side))
            rows.append(f"{stamp},{stamp}.png")
        (place / "data.csv").write_text("\n".join(rows) + "\n")
        T = T_BODY_LEFT if side == 0 else right_of(T_BODY_LEFT)
        (place / "sensor.yaml").write_text(("%YAML:1.0\n" if side else "") + sensor_yaml(T))
    if states:
        place = folder / "mav0" / "state_groundtruth_estimate0"
        place.mkdir()
        rows = ["#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v"]
        rows += [f"{stamp},{k * STEP_M},0,0,0.5,0.5,-0.5,0.5,0,0,0" for k, stamp in enumerate(stamps(frames))]
        (place / "data.csv").write_text("\n".join(rows) + "\n")
    else:
        rows = [
            f"{stamp // 10**9}.{stamp % 10**9:09d} {k * STEP_M} 0 0 0.5 -0.5 0.5 0.5"
            for k, stamp in enumerate(stamps(frames))
        ]
        (folder / "groundtruth.txt").write_text("\n".join(rows) + "\n")
    return folder


def write_kitti(folder: Path, frames: int = 6, named: bool = True) -> Path:
    """Write a sequence; its calibration has names before the matrices, or none."""
    for side in (0, 1):
        (folder / f"image_{side}").mkdir(parents=True)
        for k in range(frames):
            cv2.imwrite(str(folder / f"image_{side}" / f"{k:06d}.png"), wall(k, side))
    rows = [f"{F} 0 {CX} {-F * BASELINE_M * side} 0 {F} {CY} 0 0 0 1 0" for side in (0, 1)]
    (folder / "calib.txt").write_text("\n".join(f"P{k}: {row}" if named else row for k, row in enumerate(rows)) + "\n")
    (folder / "times.txt").write_text("\n".join(f"{0.1 * k:.6e}" for k in range(frames)) + "\n")
    (folder / "poses.txt").write_text("\n".join(f"1 0 0 {k * STEP_M} 0 1 0 0 0 0 1 0" for k in range(frames)) + "\n")
    return folder
