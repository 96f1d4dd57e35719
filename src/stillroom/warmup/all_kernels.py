"""All kernels, and their compilation: by running every part once, on a synthetic scene."""

import hashlib
import logging
import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import llvmlite.binding as llvm
import numba
from numba.core import event
from numba.core.registry import CPUDispatcher

from stillroom.compiled import is_kept, kernel_cache
from stillroom.warmup.processes import WORTH_IT, compile_in_processes, missing, n_processes

logger = logging.getLogger(__name__)
PACKAGES = "stillroom", "stillroom_scenes"
"""Packages whose kernels count: the core, and the renderer where a room is rendered."""


# A stamp file in the kernel cache: all kernels are compiled.


def is_warm(renderer: bool = False) -> bool:
    """Return whether a warm-up of these sources has been done on this machine.

    Args:
        renderer: Whether the synthetic room's kernels are needed too.
    """
    folder = kernel_cache()
    try:
        return folder is not None and (folder / _stamp(renderer)).exists()
    except OSError:  # a folder that this user may not look into
        return False


def leave_stamps(renderer: bool) -> None:
    """Write the stamp of a warm-up, if its kernels are kept; arguments as in `is_warm`."""
    folder = kernel_cache()
    if folder is None or not is_kept():
        return
    for which in {False, renderer}:
        stamp = folder / _stamp(which)
        try:
            stamp.parent.mkdir(parents=True, exist_ok=True)
            stamp.touch()
        except OSError as error:
            logger.info("%s: cannot be written (%s); kernels are compiled again each time", stamp, error)


def _stamp(renderer: bool) -> str:
    """Return the name of the file whose presence says that this machine has compiled these sources."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for package in PACKAGES:
        for path in sorted((root.parent / package).rglob("*.py")):
            digest.update(f"{path.relative_to(root.parent)}\n".encode() + path.read_bytes())
    digest.update(f"{root} {numba.__version__} {platform.python_version()} {llvm.get_host_cpu_name()}".encode())
    return f"warm-{digest.hexdigest()[:24]}{'-renderer' if renderer else ''}"


class WarmUpProgress(Protocol):
    """Callback for the kernel that is being compiled."""

    def __call__(self, kernel: str, done: int, total: int) -> None:
        """Report that at least `done` of `total` kernels are compiled and this one is next; "" at the end."""


@dataclass(frozen=True)
class WarmUp:
    """The result of a warm-up.

    Attributes:
        n_kernels: Kernels that are compiled now.
        n_compiled: How many of them were compiled; the others came from the cache.
        seconds: How long it took [s].
    """

    n_kernels: int
    n_compiled: int
    seconds: float


def warm_up(progress: WarmUpProgress | None = None, renderer: bool = False) -> WarmUp:
    """Compile all kernels, or load them where they are in the cache.

    Args:
        progress: Called for each kernel.
        renderer: Whether to compile the synthetic room's kernels too.
    """
    from stillroom.warmup import work  # imports every part; whoever asks whether all is warm needs none

    start_s = time.perf_counter()
    compiled = _compile_listed(progress, renderer)
    with _listening(progress, len(compiled)) as compiled_alone:
        work.do_everything()
        if renderer:
            work.render()
    n_kernels = len(kernels())
    if progress is not None:
        progress("", n_kernels, n_kernels)
    leave_stamps(renderer)
    return WarmUp(n_kernels, len({*compiled, *compiled_alone}), time.perf_counter() - start_s)


def _compile_listed(progress: WarmUpProgress | None, renderer: bool) -> set[str]:
    """Compile what is known to be needed in several processes, where there are cores; return what was compiled."""
    left = missing(PACKAGES if renderer else PACKAGES[:1])
    compiled: set[str] = set()
    if n_processes() < 2 or len(left) < WORTH_IT:
        return compiled
    n_all, n_done = len(kernels()), len(kernels()) - len(left)

    def done(name: str, names: list[str]) -> None:
        nonlocal n_done
        n_done += 1
        compiled.update(_shortened(each) for each in names)
        if progress is not None:
            progress(_shortened(name), n_done, n_all)

    compile_in_processes(left, done, n_processes())
    return compiled & set(kernels())  # numba compiles functions of its own, too


def kernels() -> dict[str, Any]:
    """Return the kernels of all modules that are loaded, by `module.name` without the package's."""
    found: dict[str, Any] = {}
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in PACKAGES:
            own = (value for value in vars(module).values() if isinstance(value, CPUDispatcher))
            found |= {_name(kernel): kernel for kernel in own}
    return found


def _name(kernel: Any) -> str:
    return _shortened(f"{kernel.py_func.__module__}.{kernel.py_func.__name__}")


def _shortened(name: str) -> str:
    return name.removeprefix("stillroom.")


@contextmanager
def _listening(progress: WarmUpProgress | None, n_compiled: int) -> Iterator[list[str]]:
    """Yield a list that receives the name of each kernel that numba compiles, and report them; some are compiled."""
    compiled: list[str] = []

    class Listener(event.Listener):  # type: ignore[misc] # numba has no types
        def on_start(self, started: Any) -> None:
            name = _name(started.data["dispatcher"])
            known = kernels()
            if name in known:
                if progress is not None:
                    n_ready = sum(bool(kernel.signatures) for kernel in known.values())
                    progress(name, max(n_ready, n_compiled), len(known))
                compiled.append(name)

        def on_end(self, ended: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield compiled
