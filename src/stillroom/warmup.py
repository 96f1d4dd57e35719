"""Compile every kernel once, with the types that real runs use.

Numba compiles a kernel when it is first called, which takes about a minute and a half for all of them, and keeps the
machine code in the folder `NUMBA_CACHE_DIR`: by default `stillroom/numba` in the user's cache.
"""

import hashlib
import logging
import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import cv2
import llvmlite.binding as llvm
import numba
import numpy as np
from numba.core import event
from numba.core.registry import CPUDispatcher

from stillroom.config import SlamConfig
from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box, Semantics
from stillroom.datasets.open import open_dataset
from stillroom.geometry.arrays import U8
from stillroom.geometry.camera import Camera
from stillroom.methods.registry import OWN
from stillroom.semantics.nothing import NothingConfig
from stillroom.semantics.truth import TruthConfig
from stillroom.system import build

logger = logging.getLogger(__name__)

PACKAGE = "stillroom"
RENDERED = ("synthetic:walking,frames=2,cache=off", "synthetic:walking,frames=1,cache=off,noise=off")
CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_factor=5000.0, bf=40.0)
N_FRAMES = 14
STEP_PX = 16
WALL_M = 2.0
PERSON = Box(260.0, 120.0, 380.0, 400.0, "person", confidence=1.0)


class WarmUpProgress(Protocol):
    """Told which kernel is being compiled."""

    def __call__(self, kernel: str, done: int, total: int) -> None:
        """Take note that at least `done` of `total` kernels are ready and this one is next; "" at the end."""


@dataclass(frozen=True)
class WarmUp:
    """What a warm-up did.

    Attributes:
        n_kernels: Kernels that are ready now.
        n_compiled: How many of them were compiled; the others came from the cache.
        seconds: How long it took [s].
    """

    n_kernels: int
    n_compiled: int
    seconds: float


def kernel_cache() -> Path | None:
    """Return the folder in which numba keeps machine code; None where it does so beside the sources."""
    return Path(numba.config.CACHE_DIR) if numba.config.CACHE_DIR else None


def is_warm(renderer: bool = False) -> bool:
    """Tell whether a warm-up of these sources has been done on this machine.

    Args:
        renderer: Whether the synthetic room's kernels are asked for too.
    """
    stamp = _stamp(renderer)
    return stamp is not None and stamp.exists()


def warm_up(progress: WarmUpProgress | None = None, renderer: bool = False) -> WarmUp:
    """Compile all kernels, or load them where they are in the cache, by tracking a few frames of a made-up wall.

    Args:
        progress: Told of each kernel.
        renderer: Whether to compile the synthetic room's kernels too.
    """
    start_s = time.perf_counter()
    with _listening(progress) as compiled:
        for method in OWN:
            _track_wall(method.config)
        for name in RENDERED if renderer else ():
            room = open_dataset(name)
            for index in range(len(room)):
                room.load(index)
    n_kernels = len(kernels())
    if progress is not None:
        progress("", n_kernels, n_kernels)
    _leave_stamps(renderer)
    return WarmUp(n_kernels, len(set(compiled)), time.perf_counter() - start_s)


def kernels() -> dict[str, Any]:
    """Return the kernels of all modules that are loaded, by `module.name` without the package's."""
    found: dict[str, Any] = {}
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == PACKAGE:
            own = (value for value in vars(module).values() if isinstance(value, CPUDispatcher))
            found |= {_name(kernel): kernel for kernel in own}
    return found


def _name(kernel: Any) -> str:
    return f"{kernel.py_func.__module__}.{kernel.py_func.__name__}".removeprefix(f"{PACKAGE}.")


@contextmanager
def _listening(progress: WarmUpProgress | None) -> Iterator[list[str]]:
    """Give a list that grows by the name of each kernel that numba compiles, and report them."""
    compiled: list[str] = []

    class Listener(event.Listener):  # type: ignore[misc] # numba has no types
        def on_start(self, started: Any) -> None:
            name = _name(started.data["dispatcher"])
            known = kernels()
            if name in known:
                if progress is not None:
                    progress(name, sum(bool(kernel.signatures) for kernel in known.values()), len(known))
                compiled.append(name)

        def on_end(self, ended: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield compiled


def _track_wall(config: SlamConfig) -> None:
    """Track the wall with a method; the detector, if any, is replaced by one that finds the box."""
    if not isinstance(config.semantics, NothingConfig):
        config = replace(config, semantics=TruthConfig())
    slam = build(config, CAMERA)
    for image in wall_images():
        slam.process(image)
    slam.close()


def wall_images() -> Iterator[RgbdImage]:
    """Yield images of a textured wall that a camera glides along, with a box before it that a detector would find."""
    texture = _texture(CAMERA.height, CAMERA.width + STEP_PX * N_FRAMES)
    depth_m = np.full((CAMERA.height, CAMERA.width), WALL_M, dtype=np.float32)
    truth = Semantics(CAMERA.height, CAMERA.width, (PERSON,))
    for index in range(N_FRAMES):
        rgb = np.ascontiguousarray(texture[:, index * STEP_PX :][:, : CAMERA.width])
        yield RgbdImage(index, index / 30.0, rgb, depth_m, truth)


def _texture(height: int, width: int) -> U8:
    """Return noise (H, W, 3) with corners of every size."""
    rng = np.random.default_rng(0)
    sizes_px = (8, 16, 32, 64)
    layers = [
        cv2.resize(
            rng.integers(0, 256 // len(sizes_px), (height // size + 1, width // size + 1), dtype=np.uint8),
            (width, height),
            interpolation=cv2.INTER_NEAREST,
        )
        for size in sizes_px
    ]
    gray = np.sum(layers, axis=0).astype(np.uint8)
    return np.repeat(gray[:, :, None], 3, axis=2)


def _stamp(renderer: bool) -> Path | None:
    """Return the file whose presence says that this machine has compiled these sources."""
    folder = kernel_cache()
    if folder is None:
        return None
    digest = hashlib.sha256()
    root = Path(__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)}\n".encode() + path.read_bytes())
    digest.update(f"{root} {numba.__version__} {platform.python_version()} {llvm.get_host_cpu_name()}".encode())
    return folder / f"warm-{digest.hexdigest()[:24]}{'-renderer' if renderer else ''}"


def _leave_stamps(renderer: bool) -> None:
    for which in {False, renderer}:
        stamp = _stamp(which)
        if stamp is None:
            continue
        try:
            stamp.parent.mkdir(parents=True, exist_ok=True)
            stamp.touch()
        except OSError as error:
            logger.info("%s: cannot be written (%s); kernels are compiled anew each time", stamp, error)
