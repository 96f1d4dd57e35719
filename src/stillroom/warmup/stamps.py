"""Where compiled kernels are kept, and a mark there that all of them are."""

import hashlib
import logging
import platform
from pathlib import Path

import llvmlite.binding as llvm
import numba

logger = logging.getLogger(__name__)


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


def leave_stamps(renderer: bool) -> None:
    """Note that a warm-up has been done; arguments as in `is_warm`."""
    for which in {False, renderer}:
        stamp = _stamp(which)
        if stamp is None:
            continue
        try:
            stamp.parent.mkdir(parents=True, exist_ok=True)
            stamp.touch()
        except OSError as error:
            logger.info("%s: cannot be written (%s); kernels are compiled anew each time", stamp, error)


def _stamp(renderer: bool) -> Path | None:
    """Return the file whose presence says that this machine has compiled these sources."""
    folder = kernel_cache()
    if folder is None:
        return None
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)}\n".encode() + path.read_bytes())
    digest.update(f"{root} {numba.__version__} {platform.python_version()} {llvm.get_host_cpu_name()}".encode())
    return folder / f"warm-{digest.hexdigest()[:24]}{'-renderer' if renderer else ''}"
