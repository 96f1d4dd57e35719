"""Count what is to be written once and may have been written again.

Each line says how often a regular expression matches in the sources, and in which files. One is the aim, or none.

    python benchmarks/duplicates.py
    python benchmarks/duplicates.py ../other-checkout/src/stillroom
"""

import argparse
import ast
import re
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[1] / "src" / "stillroom"
MAX_PARAMETERS = 7

PATTERNS = {
    "camera numbers put together by hand": r"np\.array\(\s*\[\s*(camera\.fx,|\*intrinsics,)",
    "distortion evaluated": r"^\s*radial = 1\.0 \+ r2 \*",
    "projection, levels and windows assembled": r"\bQueries\(\s*projection\.px",
    "nearest pixels of points by hand": r"np\.rint\((?:\w+\.)*(raw_px|points_px|px)(\[:, 0\])?\)\.astype\(np\.int64\)",
    "ellipses made for OpenCV": r"cv2\.getStructuringElement\(",
    "squares made for OpenCV": r"np\.ones\(\((?:2 \* \w+ \+ 1|side|3), (?:2 \* \w+ \+ 1|side|3)\), dtype=np\.uint8\)",
    "masks grown": r"cv2\.dilate\([^)]*(view\(np\.uint8\)|mask|moving|movable|pixels)",
    "optical flow": r"cv2\.calcOpticalFlowPyrLK\(",
    "robust estimators set up": r"cv2\.UsacParams\(\)$",
    "static by both sieves": r"(?:frame|motion)\.is_static & (?:\w+\.)*(?:frame|motion)\.is_static",
}


def main() -> None:
    """Print the counts, one to a line, and the files that the matches lie in."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="?", type=Path, default=SOURCES)
    sources = parser.parse_args().sources
    texts = {path.relative_to(sources): path.read_text() for path in sorted(sources.rglob("*.py"))}
    if not texts:
        parser.error(f"{sources}: no Python files in it; name a folder of sources")
    for what, pattern in PATTERNS.items():
        found = {path: len(re.findall(pattern, text, re.MULTILINE)) for path, text in texts.items()}
        report(what, found)
    report(f"kernels of more than {MAX_PARAMETERS} parameters", {path: wide(text) for path, text in texts.items()})


def wide(text: str) -> int:
    """Return how many compiled functions of a source have too many parameters."""
    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    compiled = [node for node in functions if any("njit" in ast.unparse(mark) for mark in node.decorator_list)]
    return sum(len(node.args.posonlyargs + node.args.args) > MAX_PARAMETERS for node in compiled)


def report(what: str, found: dict[Path, int]) -> None:
    """Print a count and where it comes from."""
    places = ", ".join(f"{path}×{n}" if n > 1 else str(path) for path, n in found.items() if n)
    print(f"{sum(found.values()):3d}  {what}" + (f": {places}" if places else ""))


if __name__ == "__main__":
    main()
