"""How long a run takes from the start of its process to its first pose, for each preset; and a warm-up from nothing.

    python benchmarks/start.py SEQUENCE --frames 200:202
    python benchmarks/start.py --cold

Seconds on the clock and of the processor, medians over fresh processes; kernels are in the cache, but for `--cold`,
which compiles them into an empty folder. Aimed at: at most 2.5 s to the first pose.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time

METHODS = ("orb-slam2", "oc-slam", "pspnet-slam", "dynaslam")
FIRST_POSE = """
import os, time
import stillroom.cli.main as command
import stillroom.session.slam as session
honest = session.Slam.process

def process(self, image):
    result = honest(self, image)
    assert result.T_world_cam is not None, "the first image has no pose"
    print(time.monotonic(), time.process_time(), flush=True)
    os._exit(0)

session.Slam.process = process
command.main()
"""


def first_pose_s(words: list[str]) -> tuple[float, float]:
    """Return the seconds to the first pose, on the clock and of the processor."""
    start_s = time.monotonic()
    done = subprocess.run([sys.executable, "-c", FIRST_POSE, *words], check=True, capture_output=True, text=True)
    at_s, cpu_s = map(float, done.stdout.split()[-2:])
    return at_s - start_s, cpu_s


def warm_up_s() -> float:
    """Return the seconds of a warm-up with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        start_s = time.monotonic()
        words = [sys.executable, "-m", "stillroom.cli.main", "warmup"]
        subprocess.run(words, check=True, env=os.environ | {"NUMBA_CACHE_DIR": folder})
        return time.monotonic() - start_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence", nargs="?", help="as for stillroom run")
    parser.add_argument("--frames", default=":2")
    parser.add_argument("--methods", nargs="+", default=METHODS)
    parser.add_argument("--runs", type=int, default=5, help="processes for each line")
    parser.add_argument("--cold", action="store_true", help="measure a warm-up with an empty cache instead")
    options = parser.parse_args()
    if options.cold or options.sequence is None:
        print(f"warm-up from nothing: {warm_up_s():.1f} s")
        return
    for method in options.methods:
        with tempfile.TemporaryDirectory() as folder:
            words = ["run", options.sequence, "--frames", options.frames, "--method", method, "--out"]
            first_pose_s([*words, f"{folder}/warm"])  # fills the cache where it is not full
            times = [first_pose_s([*words, f"{folder}/{number}"]) for number in range(options.runs)]
        on_the_clock_s, of_the_processor_s = (statistics.median(each) for each in zip(*times, strict=True))
        print(f"{method:12s}{on_the_clock_s:7.2f} s to the first pose, {of_the_processor_s:.2f} s of the processor")


if __name__ == "__main__":
    main()
