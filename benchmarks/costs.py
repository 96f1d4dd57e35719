"""Print where a frame's milliseconds go: networks, kernels, OpenCV, numpy and the rest of C, and Python itself.

A profiler watches the second run of each method, after everything is loaded. It slows down Python most, so the share of
Python is an upper bound; `stillroom bench speed` has the times of the stages without a profiler.

    python benchmarks/costs.py
    python benchmarks/costs.py --methods oc-slam --frames 200:320 --top 20

The sequence is looked for in STILLROOM_DATA.
"""

import argparse
import cProfile
import os
import pstats
import sys
from collections import Counter

METHODS = ("orb-slam2", "oc-slam", "pspnet-slam", "dynaslam")
NETWORKS, KERNELS, OPENCV, OTHER_C, PYTHON = "networks", "kernels", "OpenCV", "numpy and other C", "Python"
KINDS = (NETWORKS, KERNELS, OPENCV, OTHER_C, PYTHON)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequence", default="rgbd_bonn_crowd_first560")
    parser.add_argument("--frames", default="200:320")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--top", type=int, default=8, help="costs to print of each method")
    asked = parser.parse_args()
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read by numpy when it is imported
    for method in asked.methods.split(","):
        run_method(asked, method)
        profiler = cProfile.Profile()
        n_frames = run_method(asked, method, profiler)
        report(method, profiler, n_frames, asked.top)


def run_method(asked: argparse.Namespace, method: str, profiler: cProfile.Profile | None = None) -> int:
    """Run a method, its images loaded before; return how many images it was given."""
    from stillroom.datasets.open import open_dataset
    from stillroom.datasets.selection import select
    from stillroom.presets.registry import configure
    from stillroom.system import build

    dataset = select(open_dataset(asked.sequence), asked.frames)
    system = build(configure(method), dataset.camera)
    images = [dataset.load(place) for place in range(len(dataset))]
    if profiler is not None:
        profiler.enable()
    for image in images:
        system.process(image)
    system.close()
    if profiler is not None:
        profiler.disable()
    return len(images)


def kernel_places() -> set[tuple[str, int, str]]:
    """Return file, line and name of each kernel: numba tells the profiler of a call as if its source were run."""
    from numba.core.registry import CPUDispatcher

    modules = [module for name, module in sys.modules.items() if name.split(".")[0] == "stillroom"]
    kernels = {value for module in modules for value in vars(module).values() if isinstance(value, CPUDispatcher)}
    codes = [kernel.py_func.__code__ for kernel in kernels]
    return {(code.co_filename, code.co_firstlineno, code.co_name) for code in codes}


def report(method: str, profiler: cProfile.Profile, n_frames: int, top: int) -> None:
    """Print the milliseconds of each kind of code, and the largest costs."""
    kinds: Counter[str] = Counter()
    costs: Counter[tuple[str, str]] = Counter()
    places = kernel_places()
    for place, (_, _, own_s, _, _) in pstats.Stats(profiler).stats.items():  # type: ignore[attr-defined]
        file, _, name = place
        kind = KERNELS if place in places else kind_of(file, name)
        kinds[kind] += 1000.0 * own_s / n_frames
        costs[kind, f"{file.rpartition('/')[2]} {name}".removeprefix("~ ")] += 1000.0 * own_s / n_frames
    whole = sum(kinds.values())
    print(f"{method}: {whole:.1f} ms a frame under the profiler, {n_frames} frames")
    for kind in KINDS:
        print(f"  {kind:20s}{kinds[kind]:7.2f} ms  {kinds[kind] / whole:5.0%}")
    for (kind, name), cost_ms in costs.most_common(top):
        print(f"    {cost_ms:7.2f} ms  {kind}: {name}")


def kind_of(file: str, name: str) -> str:
    """Return what kind of code a function of the profiler's statistics is."""
    if file != "~":
        return PYTHON
    if "onnxruntime" in name:
        return NETWORKS
    return OPENCV if not name.startswith(("<built-in", "<method")) else OTHER_C


if __name__ == "__main__":
    main()
