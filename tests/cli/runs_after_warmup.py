"""A program: warm up, run everything, and print as JSON which kernels the warm-up had not made ready.

In a process of its own, because other tests have called kernels in theirs.
"""

import importlib
import json
import pkgutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import stillroom
import stillroom_scenes
from stillroom.config import SlamConfig
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.dense.export.formats import FORMATS, ExportConfig, chosen_formats
from stillroom.dense.inpainting import InpaintingConfig
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig
from stillroom.dynamics.multiview.multiview_sieve import MultiViewConfig
from stillroom.pipeline.plots import draw_maps
from stillroom.presets.registry import OWN, method
from stillroom.semantics.truth import TrueSemanticsConfig
from stillroom.system import build
from stillroom.tracking.shutter import ROLLING
from stillroom.warmup import kernels, warm_up

BASELINE = method("orb-slam2").config
THOROUGH = "oc-slam"
"""The method whose maps are drawn, exported and painted from: kernels see no difference between maps."""

RUNS = (
    *(own.config for own in OWN),
    replace(BASELINE, method="multiview", dynamics=MultiViewConfig()),
    replace(BASELINE, method="homography", dynamics=CompensatedHomographyConfig()),
)


def run(config: SlamConfig, folder: Path) -> int:
    """Run a method over rendered frames; do all that can be done with the maps of one. Return the dense map's size."""
    rolling = ",readout_ms=20" if config.tracking.shutter == ROLLING else ""
    sequence = select(open_dataset(f"synthetic:walking,frames=90{rolling}"), "0:60:3")
    system = build(
        config, sequence.camera, TrueSemanticsConfig().build()
    )  # the renderer's boxes: no weights are needed
    painter, thorough = InpaintingConfig().build(sequence.camera), config.method == THOROUGH
    for index in range(len(sequence)):
        image = sequence.load(index)
        pose = system.process(image).T_world_cam
        if thorough and pose is not None and image.truth is not None:
            cloud = system.dense_mapper.cloud() if index == len(sequence) - 1 else None
            painter.paint(image, pose, image.truth.movable, system.map, cloud)
            painter.remember(system.results[-1].reference_keyframe, image, image.truth.movable)
    system.map.keyframes.T_world_cam[0, 0, 3] += 0.05
    system.dense_mapper.refresh()
    cloud = system.dense_mapper.cloud()
    if thorough and cloud is not None:
        draw_maps(folder, system, cloud, config.method)
        for name in chosen_formats(["all"]):
            FORMATS[name](cloud, folder, ExportConfig())
    return 0 if cloud is None else len(cloud)


def cold(known: dict[str, Any]) -> set[str]:
    """Return the kernels that are not ready; what ready ones alone call is part of their machine code."""
    ready = {name for name, kernel in known.items() if kernel.signatures}
    while inner := {called for name in ready for called in called_by(known[name], known)} - ready:
        ready |= inner
    return set(known) - ready


def called_by(kernel: Any, known: dict[str, Any]) -> set[str]:
    names = {id(each): name for name, each in known.items()}
    used = (kernel.py_func.__globals__.get(word) for word in kernel.py_func.__code__.co_names)
    return {names[id(value)] for value in used if id(value) in names}


def main() -> None:
    warm_up(renderer=True)
    for package in (stillroom, stillroom_scenes):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            importlib.import_module(module.name)
    known = kernels()
    before = {name: set(kernel.signatures) for name, kernel in known.items()}
    not_ready = cold(known)
    with tempfile.TemporaryDirectory() as folder:
        n_points = {config.method: run(config, Path(folder)) for config in RUNS}
    # A run that calls a kernel with types of its own loads or compiles one more version of it.
    late = {name for name, kernel in kernels().items() if set(kernel.signatures) - before[name]}
    json.dump({"cold": sorted(not_ready), "late": sorted(late), "n_points": n_points}, sys.stdout)


if __name__ == "__main__":
    main()
