"""Track a camera from arrays in memory, as they come from a driver.

    python examples/own_frames.py [SEQUENCE]

Writes trajectory.tum and room.ply into the working folder. Replace `my_driver` by your camera's.
"""

import sys
from collections.abc import Iterator

import cv2
import numpy as np

import stillroom as sr
from stillroom.protocols import Dataset

SEQUENCE = "synthetic:walking,frames=40,fps=10"


def my_driver(dataset: Dataset) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Yield what many cameras give: time [s], colours (H, W, 3) uint8 in OpenCV's order, depth (H, W) uint16 [mm]."""
    for image in dataset:
        bgr = cv2.cvtColor(image.rgb, cv2.COLOR_RGB2BGR)
        yield image.timestamp_s, bgr, np.rint(image.depth_m * 1000).astype(np.uint16)


def main(sequence: str) -> None:
    dataset = sr.open_dataset(sequence)
    with sr.Slam("oc-slam", camera=dataset.camera, seed=0) as slam:
        for time_s, bgr, depth_mm in my_driver(dataset):
            rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
            depth_m = depth_mm.astype(np.float32) / 1000  # 0 stays 0: unknown
            result = slam.process(sr.RgbdImage(timestamp_s=time_s, rgb=rgb, depth_m=depth_m))
            if result.T_world_cam is None:
                print(f"{time_s:8.3f} s: lost")
            else:
                x, y, z = result.T_world_cam[:3, 3]
                print(f"{time_s:8.3f} s: at {x:+.3f} {y:+.3f} {z:+.3f} m, {result.motion.moving.mean():4.0%} moves")
    # After `close`, which the end of `with` calls, the poses are final.
    slam.trajectory().write_tum("trajectory.tum")
    slam.dense_cloud().write("room.ply")
    print(f"{len(slam.trajectory())} poses in trajectory.tum, {len(slam.dense_cloud())} points in room.ply")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else SEQUENCE)
