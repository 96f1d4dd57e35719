"""Make a map of a room, keep it in a file, and find the camera in it again.

    python examples/map_and_localize.py [SEQUENCE]

The first half of the sequence makes the map; the second half is tracked against it, as on another day, and nothing is
written into it then. `stillroom map info FILE` shows the contents of a map file.
"""

import sys
import tempfile
from pathlib import Path

import stillroom as sr

SEQUENCE = "synthetic:walking,frames=40,fps=10"


def main(sequence: str) -> None:
    dataset = sr.open_dataset(sequence)
    half = len(dataset) // 2
    file = Path(tempfile.mkdtemp(prefix="stillroom-")) / "room.stillmap"

    # The map is written as it grows: a crash loses nothing that was mapped.
    with sr.Slam("oc-slam", camera=dataset.camera, map=file) as slam:
        for place in range(half):
            result = slam.process(dataset.load(place))
    print(f"{file}: {result.n_keyframes} keyframes, {file.stat().st_size / 1e6:.1f} MB")

    found = 0
    with sr.Slam("oc-slam", camera=dataset.camera, map=file, map_use="localize") as slam:
        for place in range(half, len(dataset)):
            result = slam.process(dataset.load(place))
            if result.T_world_cam is not None:
                found += 1
                x, y, z = result.T_world_cam[:3, 3]
                print(f"{result.index:4}: in the map at {x:+.3f} {y:+.3f} {z:+.3f} m, {result.n_inliers} inliers")
            else:
                print(f"{result.index:4}: not relocalized yet")
    print(f"{found} of {len(dataset) - half} frames found in the map")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else SEQUENCE)
