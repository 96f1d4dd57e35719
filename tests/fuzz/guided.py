"""Damage that coverage guides, where `atheris` is installed: `python tests/fuzz/guided.py list --seconds 300`.

The readers and the judgement are those of `test_readers.py`. A file that does harm is kept in the folder that
`STILLROOM_FUZZ_KEEP` names, by default the current one; put it into `found/<reader>/`, and the default tests read it.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
INSTRUMENTED = [
    *("stillroom.bounds", "stillroom.config", "stillroom.data.text", "stillroom.data.trajectory"),
    *("stillroom.datasets", "stillroom.presets.registry", "stillroom_train.darknet", "tarfile", "tomllib", "zipfile"),
]
"""What reads in Python. Kernels must not be instrumented: numba could not compile them."""


def main() -> None:
    """Fuzz a reader for a time; leave with an error where a file does harm."""
    try:
        import atheris
    except ModuleNotFoundError:
        sys.exit("atheris is not installed: pip install atheris; tests/fuzz/test_readers.py needs none")
    sys.path[:0] = [str(HERE), str(HERE.parent / "fabricated")]
    with atheris.instrument_imports(include=INSTRUMENTED):
        from test_readers import READERS, read_or_refuse

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=READERS)
    parser.add_argument("--seconds", type=int, default=300)
    asked = parser.parse_args()
    kept = Path(os.environ.get("STILLROOM_FUZZ_KEEP", "."))
    kept.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder, corpus = Path(name, "folder"), Path(name, "corpus")
        (folder / "inside").mkdir(parents=True)
        corpus.mkdir()
        reader = READERS[asked.kind]
        (corpus / "sound").write_bytes(reader.example(folder / "inside"))
        limits = [f"-max_total_time={asked.seconds}", "-timeout=20", "-rss_limit_mb=2000", f"-artifact_prefix={kept}/"]
        atheris.Setup(
            [sys.argv[0], *limits, str(corpus)], lambda content: read_or_refuse(reader, content, folder) and None
        )
        atheris.Fuzz()


if __name__ == "__main__":
    main()
