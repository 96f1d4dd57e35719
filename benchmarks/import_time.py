"""How long `import stillroom` takes, and what the first use of its names adds: medians over fresh processes.

    python benchmarks/import_time.py --runs 20

Aimed at: at most 0.15 s for the import.
"""

import argparse
import statistics
import subprocess
import sys
import time

STEPS = {
    "python alone": "pass",
    "import stillroom": "import stillroom",
    "stillroom.Slam": "import stillroom; stillroom.Slam",
    "stillroom.open_dataset": "import stillroom; stillroom.open_dataset",
}


def median_ms(code: str, runs: int) -> float:
    times_ms = []
    for _ in range(runs):
        start_s = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True)
        times_ms.append((time.perf_counter() - start_s) * 1e3)
    return statistics.median(times_ms)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20, help="processes for each line")
    runs = parser.parse_args().runs
    alone_ms = 0.0
    for name, code in STEPS.items():
        took_ms = median_ms(code, runs)
        alone_ms = alone_ms or took_ms
        print(f"{name:24s}{took_ms:8.1f} ms  (+{took_ms - alone_ms:.1f} ms)")


if __name__ == "__main__":
    main()
