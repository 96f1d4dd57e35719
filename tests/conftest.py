"""Where the real data lies, and a count of what ran with it.

Sequences and weights that lie beside the checkout are used where no others are named. The variables are set when this
file is read, so that what tests start inherits them.
"""

import ctypes
import gc
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import pytest
from longest_first import LONGEST_FIRST

cv2.setNumThreads(1)

ROOT = Path(__file__).parents[1]
BONN = "rgbd_bonn_crowd_first560"
FREIBURG1 = "rgbd_dataset_freiburg1_rpy_first150"
FREIBURG1_XYZ = "rgbd_dataset_freiburg1_xyz_first60"


for _variable, _kind in (("STILLROOM_DATA", "data"), ("STILLROOM_MODELS", "models")):
    _beside = ROOT.parent / "shared" / _kind
    if not os.environ.get(_variable) and _beside.is_dir():
        os.environ[_variable] = str(_beside)

C = ctypes.CDLL(None) if sys.platform == "linux" else None
"""The C library."""
REAL = {variable: os.environ.get(variable) for variable in ("STILLROOM_DATA", "STILLROOM_MODELS")}
"""Read once: tests set the variables for themselves."""


def _required(variable: str, relative: str) -> Path:
    named = REAL[variable]
    if not named or not (Path(named) / relative).exists():
        pytest.skip(f"{relative} not found; set {variable} to the folder that holds it")
    return Path(named) / relative


@pytest.fixture(scope="session")
def bonn() -> Path:
    """The Bonn stretch: 560 real frames with people in them."""
    return _required("STILLROOM_DATA", BONN)


@pytest.fixture(scope="session")
def freiburg1() -> Path:
    """The fr1 stretch: 150 real frames, static, hand-held rotations."""
    return _required("STILLROOM_DATA", FREIBURG1)


@pytest.fixture(scope="session")
def freiburg1_xyz() -> Path:
    """The other fr1 stretch: 60 real frames, static, hand-held translations."""
    return _required("STILLROOM_DATA", FREIBURG1_XYZ)


@pytest.fixture(scope="session")
def yolo_weights() -> Path:
    """The folder with YOLO-Fastest's cfg, weights and names."""
    return _required("STILLROOM_MODELS", "yolo_fastest")


@pytest.fixture(scope="session")
def deeplab() -> Path:
    """DeepLabv3 on MobileNetV2, an ONNX file with the 21 VOC classes."""
    return _required("STILLROOM_MODELS", "deeplabv3_mobilenetv2_voc.onnx")


@pytest.fixture(scope="session")
def mobilenet_backbone() -> Path:
    """That network's backbone, an .npz file."""
    return _required("STILLROOM_MODELS", "mobilenetv2_voc_backbone.npz")


@pytest.fixture(scope="session")
def person_masks() -> Path:
    """370 pictures of people with pixel masks."""
    return _required("STILLROOM_DATA", "person_masks")


@pytest.fixture(scope="session")
def euroc_v101() -> Path:
    """The EuRoC stretch of pairs: 95 of V1_01, the vehicle at rest."""
    return _required("STILLROOM_DATA", "euroc_v101_stereo_first95")


@pytest.fixture(scope="session")
def euroc_mh05() -> Path:
    """The EuRoC stretch of one camera: 200 images of MH_05."""
    return _required("STILLROOM_DATA", "euroc_mh05_mono_first200")


@pytest.fixture(scope="session")
def kitti() -> Path:
    """The KITTI stretch: 51 pairs, 60 m."""
    return _required("STILLROOM_DATA", "kitti_stereo_51")


REAL_FIXTURES = {"bonn", "freiburg1", "freiburg1_xyz", "yolo_weights", "deeplab", "mobilenet_backbone", "person_masks"}
REAL_FIXTURES |= {"euroc_v101", "euroc_mh05", "kitti"}


@pytest.fixture(scope="module", autouse=True)
def _nothing_is_kept() -> Iterator[None]:
    """Let go of what a file's tests made for each other: rendered frames, maps and networks would add up."""
    yield
    for module in list(sys.modules.values()):
        if str(ROOT / "tests") in str(getattr(module, "__file__", None)):
            _clear_caches(module.__name__, vars(module))
    gc.collect()
    if hasattr(C, "malloc_trim"):  # glibc's: what is free goes back to the system, else a worker stays at its largest
        C.malloc_trim(0)


def _clear_caches(module: str, names: Mapping[str, Any]) -> None:
    for made in list(names.values()):
        if getattr(made, "__module__", None) == module:
            if hasattr(made, "cache_clear"):
                made.cache_clear()
            elif isinstance(made, type):
                _clear_caches(module, vars(made))


def pytest_configure(config: pytest.Config) -> None:
    """Let files be handed out in the order of collection, where xdist would begin with those of most tests."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_collection_finish() -> None:
    """Leave what is loaded now out of all later searches for garbage: half a million objects, for each file's end."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what needs real data, by the fixtures it asks for, and put the longest files first."""
    place = {ROOT / "tests" / name: k for k, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: place.get(item.path, len(place)))
    for item in items:
        if REAL_FIXTURES & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.real)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print how many real-data tests ran and how many were skipped, and why."""
    ran = skipped = 0
    for outcome, reports in terminalreporter.stats.items():
        for report in reports:
            if "real" not in getattr(report, "keywords", {}):
                continue
            if outcome == "skipped":
                skipped += 1
            elif outcome in {"passed", "failed"} and report.when == "call":
                ran += 1
    terminalreporter.write_line(f"real-data tests: {ran} ran, {skipped} skipped")
