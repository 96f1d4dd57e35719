"""Print what the costly pieces of work cost, in ms of CPU time and in units, at the sizes that a run meets.

A unit is one `cv2.ORB_create(1000).detectAndCompute` on the same frames in the same process, taken in turn with the
rest. Without a sequence the frames are rendered, and a unit is then dearer or cheaper than on real frames.

    OMP_NUM_THREADS=1 python benchmarks/kernels.py "$STILLROOM_DATA"/rgbd_bonn_crowd_first560
"""

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np

from stillroom.data.map import Map
from stillroom.datasets.open import open_dataset
from stillroom.features.matching import Queries, Targets, match_anywhere, search_windows
from stillroom.features.orb import OrbConfig
from stillroom.geometry import se3
from stillroom.geometry.camera import Camera
from stillroom.optimize.bundle import BundleAdjuster, BundleConfig, BundleProblem
from stillroom.optimize.pose import PoseOptimizer
from stillroom.protocols import Parts

CAMERA = Camera(640, 480, 542.8, 541.1, 315.6, 237.8)
ROUNDS = 20
POSE_OBSERVATIONS = 500
FREE, FIXED, POINTS, OBSERVATIONS = 20, 10, 2571, 14828
KEYPOINTS = 1500


def observed(T: np.ndarray, points_m: np.ndarray, rng: np.random.Generator, wrong: float) -> tuple:
    """Measure points with noise: u, v, u_right (N, 3) [px] and weights (N, 3); 80 % have a right coordinate."""
    n = len(points_m)
    points_cam = np.einsum("nij,nj->ni", T[:, :3, :3], points_m) + T[:, :3, 3]
    px = CAMERA.project(points_cam)
    sigma = 1.2 ** rng.integers(0, 8, n)
    seen = np.column_stack((px, px[:, 0] - CAMERA.bf / points_cam[:, 2])) + rng.normal(size=(n, 3)) * sigma[:, None]
    weights = np.repeat(1.0 / sigma[:, None] ** 2, 3, axis=1)
    has_right = rng.random(n) < 0.8
    weights[~has_right, 2], seen[~has_right, 2] = 0.0, -1.0
    seen[rng.random(n) < wrong, :2] += 40.0
    return seen, weights


def twist(rng: np.random.Generator, metres: float, radians: float) -> np.ndarray:
    return se3.exp(np.concatenate((metres * rng.normal(size=3), radians * rng.normal(size=3))))


def room_points(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.column_stack((rng.uniform(-2, 2, n), rng.uniform(-1.3, 1.3, n), rng.uniform(2.5, 6.0, n)))


def pose_only(seed: int) -> Callable[[], object]:
    rng = np.random.default_rng(seed)
    points_m, T_true = room_points(rng, POSE_OBSERVATIONS), twist(rng, 0.2, 0.05)
    seen, weights = observed(np.tile(T_true, (len(points_m), 1, 1)), points_m, rng, wrong=0.1)
    guess, optimize = twist(rng, 0.03, 0.01) @ T_true, PoseOptimizer()
    return lambda: optimize(guess, points_m, seen, weights, CAMERA)


def bundle(seed: int, config: BundleConfig) -> Callable[[], object]:
    rng = np.random.default_rng(seed)
    points_m = room_points(rng, POINTS)
    T = np.stack([twist(rng, 0.3, 0.05) for _ in range(FREE + FIXED)])
    pairs = rng.permutation(len(T) * POINTS)[:OBSERVATIONS]
    keyframe, point = np.divmod(pairs, POINTS)
    seen, weights = observed(T[keyframe], points_m[point], rng, wrong=0.03)
    is_fixed = np.arange(len(T)) >= FREE
    start = np.stack(
        [pose if held else twist(rng, 0.004, 0.002) @ pose for pose, held in zip(T, is_fixed, strict=True)]
    )
    rough_m = points_m + 0.01 * rng.normal(size=points_m.shape)
    problem = BundleProblem(start, is_fixed, rough_m, keyframe.astype(np.int32), point.astype(np.int32), seen, weights)
    adjust = BundleAdjuster(config)
    return lambda: adjust(problem, CAMERA)


def searches(seed: int) -> dict[str, Callable[[], object]]:
    rng = np.random.default_rng(seed)
    px = (rng.random((KEYPOINTS, 2)) * [640, 480]).astype(np.float32)
    octave = rng.integers(0, 8, KEYPOINTS).astype(np.int32)
    descriptors = rng.integers(0, 256, (KEYPOINTS, 32), dtype=np.uint8)
    right_px = np.full(KEYPOINTS, -1.0, dtype=np.float32)
    shuffled = rng.permutation(KEYPOINTS)
    everything = np.ones(KEYPOINTS, dtype=np.bool_)
    targets = Targets(px[shuffled], octave[shuffled], right_px, descriptors[shuffled], everything)
    radius_px = np.full(KEYPOINTS, 15.0, dtype=np.float32)
    queries = Queries(px, radius_px, octave - 1, octave + 1, right_px, descriptors)
    return {
        f"windowed search, {KEYPOINTS} × {KEYPOINTS}": lambda: search_windows(queries, targets),
        f"search anywhere, {KEYPOINTS} × {KEYPOINTS}": lambda: match_anywhere(descriptors, targets.descriptors),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence", nargs="?", default="synthetic:walking")
    cv2.setNumThreads(1)
    dataset = open_dataset(parser.parse_args().sequence)
    images = [dataset.load(int(index)) for index in np.linspace(0, len(dataset) - 1, ROUNDS)]
    orb, camera = cv2.ORB_create(1000), dataset.camera
    extractor = OrbConfig().build(Parts(camera, Map(OrbConfig().scales(camera))))
    to_the_end = BundleConfig(min_relative_decrease=0.0)
    size = f"{FREE} + {FIXED} keyframes, {POINTS} points, {OBSERVATIONS} observations"
    work: dict[str, Callable[[int], Callable[[], object]]] = {
        "one unit": lambda k: lambda: orb.detectAndCompute(images[k].gray, None),
        "features of a frame": lambda k: lambda: extractor.extract(images[k]),
        f"pose-only, {POSE_OBSERVATIONS} observations": pose_only,
        f"bundle, {size}": lambda k: bundle(k, BundleConfig()),
        "  the same, all 15 iterations": lambda k: bundle(k, to_the_end),
        **{name: (lambda k, name=name: searches(k)[name]) for name in searches(0)},
    }
    times_ms = measure(work)
    unit_ms = float(np.mean(times_ms["one unit"]))
    print(f"{dataset.name}, {ROUNDS} rounds, CPU time of one thread")
    print(f"{'':80s} {'median ms':>9s} {'p95 ms':>8s} {'units':>7s}")
    for name, taken_ms in times_ms.items():
        middle_ms, high_ms = np.median(taken_ms), np.percentile(taken_ms, 95)
        print(f"{name:80s} {middle_ms:9.2f} {high_ms:8.2f} {np.mean(taken_ms) / unit_ms:7.2f}")


def measure(work: dict[str, Callable[[int], Callable[[], object]]]) -> dict[str, list[float]]:
    """Run each piece of work once a round, in turn, after a round that does not count."""
    times_ms: dict[str, list[float]] = {name: [] for name in work}
    for k in (0, *range(ROUNDS)):
        for name, prepare in work.items():
            call = prepare(k)
            start_ns = time.thread_time_ns()
            call()
            times_ms[name].append((time.thread_time_ns() - start_ns) * 1e-6)
    return {name: taken_ms[1:] for name, taken_ms in times_ms.items()}


if __name__ == "__main__":
    main()
