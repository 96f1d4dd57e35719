"""Write `signatures.json` anew: warm up from nothing, in a cache of its own, and list what was compiled."""

import tempfile
from pathlib import Path

import numba

from stillroom.compiled import cached_signatures
from stillroom.warmup.all_kernels import kernels
from stillroom.warmup.listing import NAME, as_text


def main() -> None:
    """Write the list beside this module."""
    with tempfile.TemporaryDirectory(prefix="stillroom-kernels-", ignore_cleanup_errors=True) as folder:
        numba.config.CACHE_DIR = folder  # before the first kernel is decorated
        from stillroom.warmup import work

        work.do_everything()
        work.render()
        names = {f"{each.py_func.__module__}.{each.py_func.__name__}": each for each in kernels().values()}
        text = as_text({name: sorted(cached_signatures(kernel), key=str) for name, kernel in names.items()})
    Path(__file__).with_name(NAME).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
