"""Print what a frame of a rendered room costs in units, rendering and sensor noise included.

    OMP_NUM_THREADS=1 python benchmarks/rendering.py --bonn "$STILLROOM_DATA"/rgbd_bonn_crowd_first560

A unit is one `cv2.ORB_create(1000).detectAndCompute` on a real frame in the same process, taken in turn.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from stillroom_scenes.config import open_synthetic

ROOMS = ("walking,frames=300", "corridor,frames=600", "building,rooms=3,frames=600", "building,rooms=20,frames=600")
N_FRAMES = 40
A_FRAME = 300


def units(spec: str, gray: np.ndarray) -> float:
    """Return what a frame costs, the median over frames spread along the sequence."""
    orb, room = cv2.ORB_create(1000), open_synthetic(f"synthetic:{spec},cache=off")
    orb.detectAndCompute(gray, None)
    room.load(0)
    unit_s, load_s = [], []
    for index in np.linspace(0, len(room) - 1, N_FRAMES).astype(int).tolist():
        begin = time.thread_time()
        orb.detectAndCompute(gray, None)
        middle = time.thread_time()
        room.load(index)
        unit_s.append(middle - begin)
        load_s.append(time.thread_time() - middle)
    return float(np.median(load_s) / np.median(unit_s))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bonn", type=Path, required=True, help="folder of the Bonn stretch")
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    gray = cv2.imread(str(sorted((asked.bonn / "rgb").iterdir())[A_FRAME]), cv2.IMREAD_GRAYSCALE)
    for spec in ROOMS:
        print(f"{spec:28s} {units(spec, gray):.2f} units a frame", flush=True)


if __name__ == "__main__":
    main()
