"""Print the SHA-256 of the trajectory and of the dense cloud that each method makes of each sequence.

What changes no figure changes no line of the output, so two outputs are compared with `diff`. Three sequences are real,
two are rendered; the corridor closes a loop. Sums may differ from processor to processor: compare on one machine.

    python benchmarks/identity.py > before.txt
    python benchmarks/identity.py > after.txt && diff before.txt after.txt
    python benchmarks/identity.py --methods oc-slam --sequences rgbd_dataset_freiburg1_xyz_first60

The real sequences are looked for in STILLROOM_DATA. All of it takes some twenty minutes on two cores.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

METHODS = ("orb-slam2", "oc-slam", "pspnet-slam", "dynaslam", "dynaslam-n", "dynaslam-g")
SEQUENCES = (
    "rgbd_dataset_freiburg1_xyz_first60",
    "rgbd_dataset_freiburg1_rpy_first150",
    "synthetic:carried",
    "rgbd_bonn_crowd_first560",
    "synthetic:corridor,frames=600",
)


def fingerprint(job: tuple[str, str, int]) -> str:
    """Return one line: the sequence, the method, the two sums (– without a dense map), and the figures for the eye."""
    from stillroom.datasets.open import open_dataset
    from stillroom.pipeline import RunOptions, run
    from stillroom.presets.registry import configure

    sequence, method, seed = job
    outcome = run(open_dataset(sequence), configure(method, seed=seed), RunOptions(root=None, pictures=0))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "trajectory.tum"
        outcome.system.trajectory().write_tum(path)
        trajectory = sha256(path.read_bytes()).hexdigest()
    outcome.system.dense_mapper.refresh()
    cloud, dense = outcome.system.dense_mapper.cloud(), "–"
    if cloud is not None:
        arrays = (cloud.positions_m, cloud.normals, cloud.rgb, cloud.weight)
        dense = sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()
    evaluation = outcome.evaluation
    error = "no ATE" if evaluation is None else f"ATE {evaluation.as_given.ate_se3_m.rmse:.6f} m"
    tracked = f"{outcome.n_tracked}/{outcome.n_given} tracked"
    return f"{sequence} {method} {trajectory} {dense} {error}, {tracked}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--sequences", default=" ".join(SEQUENCES), help="separated by spaces")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    asked = parser.parse_args()
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read by numpy when the processes import it
    jobs = [(s, m, asked.seed) for s in asked.sequences.split() for m in asked.methods.split(",")]
    with ProcessPoolExecutor(asked.jobs, get_context("spawn"), max_tasks_per_child=1) as pool:
        for line in pool.map(fingerprint, jobs):
            print(line, flush=True)


if __name__ == "__main__":
    main()
