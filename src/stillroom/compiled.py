"""The decorator of all kernels: numba's `njit`, with the machine code in the user's cache.

Numba has one folder for the whole process, `numba.config.CACHE_DIR`, and reads it when a function is decorated. It is
set here only while a kernel of Stillroom is decorated, so that functions of others are cached where they were before.
Where another program has set it, by `NUMBA_CACHE_DIR` or in `numba.config`, kernels are kept there.

Where that folder cannot be made or written, the kernels that already lie in it are read, and others are compiled into a
temporary folder that ends with the process.
"""

import atexit
import functools
import importlib
import inspect
import logging
import os
import pickle
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numba
from numba.core import event
from numba.core.runtime import rtsys

from stillroom.data.locations import cache_folder
from stillroom.errors import ConfigError
from stillroom.version import __version__

if sys.platform != "win32":
    import fcntl

logger = logging.getLogger(__name__)
# The version is part of the path because numba asks only of a kernel's own file whether it changed, not of the files of
# those it calls.
_BELOW_CACHE = Path("numba") / __version__
_lock = threading.RLock()


def njit(signature_or_function: Any = None, **options: Any) -> Any:
    """Compile like `numba.njit`, with the same arguments, and cache the machine code in `kernel_cache()`.

    Returns:
        The kernel where a function is given, else a decorator.
    """
    if inspect.isfunction(signature_or_function):
        return njit(**options)(signature_or_function)

    def decorate(function: Any) -> Any:
        if not options.get("cache"):
            return numba.njit(signature_or_function, **options)(function)
        with _cache_in_place() as is_there:
            kernel = numba.njit(signature_or_function, **options | {"cache": is_there})(function)
            return _with_safe_cache(kernel) if is_there else kernel

    return decorate


def _with_safe_cache(kernel: Any) -> Any:
    """Return a kernel whose cache never ends a program: what cannot be read is compiled again, or kept for now only.

    An entry names the classes of the kernel's arguments. One that was written before such a class was renamed or moved
    cannot be read any more; numba would raise what `pickle` does.

    Numba's own `load_overload` makes the whole compiler ready first, which takes a third of a second; whoever compiles
    does so by itself.
    """
    cache = kernel._cache
    save = cache.save_overload

    def load_overload(signature: Any, target: Any) -> Any:
        _make_linkable(target)
        try:
            with cache._guard_against_spurious_io_errors():
                return _checked(cache._load_overload(signature, target), signature)
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError) as error:
            logger.info("%s: a cached kernel is out of date (%s); it is compiled again", cache.cache_path, error)
            cache.flush()
            return None

    def save_overload(signature: Any, data: Any) -> None:
        try:
            with _one_at_a_time(Path(cache.cache_path)):
                save(signature, data)
        except OSError as error:
            _say_not_kept(str(cache.cache_path), error.strerror or str(error))

    cache.load_overload, cache.save_overload = load_overload, save_overload
    return kernel


def _checked(loaded: Any, signature: Any) -> Any:
    """Return machine code from the cache, if it is for these arguments; None where another process was in between."""
    arguments = getattr(signature, "args", signature)
    return loaded if loaded is None or tuple(loaded.signature.args) == tuple(arguments) else None


@contextmanager
def _one_at_a_time(folder: Path) -> Iterator[None]:
    """Keep other processes from writing kernels there while this is open, as far as the system can lock a file.

    Numba reads the list of a kernel's files, chooses a name that is free, and writes both: of two processes with other
    arguments at the same time, one would take the other's machine code for its own.
    """
    if sys.platform == "win32":  # which has no such locks
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("ab") as file:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        yield  # closing the file lets go


def cached_signatures(kernel: Any) -> set[Any]:
    """Return for which arguments, as tuples of numba's types, a kernel's machine code is in the cache."""
    cache = kernel._cache
    if not hasattr(cache, "_cache_file"):  # a kernel that is not cached, as nothing can be written
        return set()
    try:
        keys = list(cache._cache_file._load_index())
    except (AttributeError, ImportError, EOFError, OSError, pickle.UnpicklingError):  # out of date: see above
        return set()
    codegen = kernel.targetctx.codegen()
    return {key[0] for key in keys if key == cache._index_key(key[0], codegen)}


@functools.cache
def _make_linkable(target: Any) -> None:
    """Make ready, once, all that machine code from the cache may name: memory with counts, and the seeds of hashes."""
    rtsys.initialize(target)
    importlib.import_module("numba.cpython.hashing")


@functools.cache
def _say_not_kept(folder: str, reason: str) -> None:
    logger.warning("%s: a compiled kernel cannot be written (%s); it is compiled again next time", folder, reason)


@contextmanager
def said_when_compiling() -> Iterator[None]:
    """Say once in a process, in the log, that a kernel is compiled while this is open: the first run takes minutes."""

    class Listener(event.Listener):  # type: ignore[misc] # numba has no types
        def on_start(self, started: Any) -> None:
            module = started.data["dispatcher"].py_func.__module__
            if module.partition(".")[0] == "stillroom":
                _say_once()

        def on_end(self, ended: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield


@functools.cache
def _say_once() -> None:
    logger.warning("compiling kernels, which takes a minute or two, once; 'stillroom warmup' does it beforehand")


def kernel_cache() -> Path | None:
    """Return the folder in which compiled kernels are kept, which need not exist yet; None where there is no home."""
    return Path(numba.config.CACHE_DIR) if numba.config.CACHE_DIR else _our_folder()


def working_folder() -> Path | None:
    """Return the folder in which this process keeps kernels: `kernel_cache()`, or one for now; None without any."""
    return _working_folder(kernel_cache())


def is_kept() -> bool:
    """Return whether kernels that are compiled now are kept in `kernel_cache()`; makes that folder if need be."""
    kept = kernel_cache()
    return kept is not None and _working_folder(kept) == kept


@functools.cache
def _our_folder() -> Path | None:
    """Return the folder in the user's cache, as of the first call, for kernels are decorated once."""
    try:
        return cache_folder() / _BELOW_CACHE
    except ConfigError:
        return None


@contextmanager
def _cache_in_place() -> Iterator[bool]:
    """Let numba cache where kernels are kept while this is open; yield whether there is such a folder."""
    with _lock:
        before = numba.config.CACHE_DIR
        folder = _working_folder(kernel_cache())
        numba.config.CACHE_DIR = before if folder is None else str(folder)
        try:
            yield folder is not None
        finally:
            numba.config.CACHE_DIR = before


@functools.cache
def _working_folder(kept: Path | None) -> Path | None:
    """Return `kept`, or a temporary folder with what is in it where it cannot be written, or None where neither can."""
    if kept is None:
        return _substitute(None, "there is no home folder")
    try:
        _check_writable(kept)
    except OSError as error:
        return _substitute(kept, f"{kept} cannot be written ({error})")
    return kept


def _check_writable(folder: Path) -> None:
    """Make the folder, and try to write there.

    Raises:
        OSError: It, or a folder in it, cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()
    for below in folder.iterdir():
        # Numba makes a folder for each folder of sources; another user, such as root, may have made this one.
        if below.is_dir() and not os.access(below, os.W_OK | os.X_OK):
            raise PermissionError(f"{below.name} in it belongs to another user")


def _substitute(kept: Path | None, reason: str) -> Path | None:
    """Return a new temporary folder with what can be read in `kept`, and say so; None where there can be none."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="stillroom-kernels-"))
    except OSError as error:
        logger.warning("%s, nor is there a temporary folder (%s): compiled kernels are not kept", reason, error)
        return None
    atexit.register(_remove, folder, os.getpid())
    n_found = 0 if kept is None else _link_files(kept, folder)
    # A cache that was filled before it was locked is as it should be.
    level = logging.INFO if n_found else logging.WARNING
    logger.log(level, "%s: kernels that are compiled now are kept for this process alone", reason)
    return folder


def _link_files(kept: Path, folder: Path) -> int:
    """Link or copy all files of one folder into another, and return how many.

    Numba writes by replacing whole files, so that a link is replaced and what it leads to stays as it is.
    """
    n_found = 0
    for place, _, names in os.walk(kept):
        to = folder / Path(place).relative_to(kept)
        to.mkdir(exist_ok=True)
        for name in names:
            try:
                (to / name).symlink_to(Path(place, name).absolute())
            except OSError:  # a system without links
                shutil.copyfile(Path(place, name), to / name)
            n_found += 1
    return n_found


def _remove(folder: Path, owner: int) -> None:
    """Remove the folder, unless this is a fork of the process that made it."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)
