"""Rewrite `signatures.json`: warm up from nothing, in a cache of its own, and list what was compiled."""

import sys
import tempfile
from pathlib import Path
from typing import Any

import numba

from stillroom.compiled import cached_signatures
from stillroom.warmup.all_kernels import PACKAGES, kernels
from stillroom.warmup.listing import NAME, as_text, kernel_of


def main() -> None:
    """Write the list beside this module."""
    with tempfile.TemporaryDirectory(prefix="stillroom-kernels-", ignore_cleanup_errors=True) as folder:
        numba.config.CACHE_DIR = folder  # before the first kernel is decorated
        from stillroom.warmup import work

        work.do_everything()
        work.render()
        found = {_place(kernel): sorted(cached_signatures(kernel), key=str) for kernel in kernels().values()}
    Path(__file__).with_name(NAME).write_text(as_text(found), encoding="utf-8")


def _place(kernel: Any) -> str:
    """Return the module and name under which a kernel is found, usually those of its function."""
    own = f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"
    if kernel_of(own) is kernel:
        return own
    modules = sorted((name, vars(module)) for name, module in sys.modules.items() if name.partition(".")[0] in PACKAGES)
    return next(f"{name}.{inner}" for name, names in modules for inner, each in names.items() if each is kernel)


if __name__ == "__main__":
    main()
