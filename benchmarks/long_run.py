"""Print what a frame costs, in ms of CPU time, as the map grows: by thousands of a walk through six rooms and back.

OMP_NUM_THREADS=1 python benchmarks/long_run.py
OMP_NUM_THREADS=1 python benchmarks/long_run.py --frames 2000
"""

import argparse
import time

import cv2
import numpy as np

from stillroom.evaluation.timing import peak_memory_mb
from stillroom.presets.registry import configure
from stillroom.system import build
from stillroom_scenes.config import open_synthetic

A_PART = 1000


def main() -> None:
    """Track the walk; rendering is left out of the time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", default="orb-slam2")
    parser.add_argument("--frames", type=int, default=10_000, help="of 10,000")
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    room = open_synthetic("synthetic:rooms,cache=off")
    system = build(configure(asked.method), room.camera)
    spent_ms, lost = [], 0
    for index in range(min(asked.frames, len(room))):
        image = room.load(index)
        begin = time.thread_time()
        lost += system.process(image).T_world_cam is None
        spent_ms.append(1e3 * (time.thread_time() - begin))
        if (index + 1) % A_PART == 0:
            print(
                f"{index + 1:6d} frames: {np.mean(spent_ms[-A_PART:]):.1f} ms a frame, "
                f"{len(system.map.points)} points, {lost} lost, {peak_memory_mb():.0f} MB at most",
                flush=True,
            )


if __name__ == "__main__":
    main()
