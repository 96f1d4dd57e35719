"""Compilation of the listed kernels in several processes: numba compiles one kernel at a time in each.

A process of its own is started for each core, told which kernel is next, and ends when it is told no more. Callees are
compiled before their callers, so that no two processes compile the same one.
"""

import json
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba.core import errors, event

from stillroom.compiled import cached_signatures, working_folder
from stillroom.warmup.listing import kernel_of, listed

logger = logging.getLogger(__name__)
MOST_PROCESSES = 8
"""Each takes a quarter of a gigabyte, and the longest chains of kernels leave little to do for more of them."""
WORTH_IT = 8
"""Kernels from which on starting processes is quicker than compiling alone."""
SERVE = "from stillroom.warmup.processes import serve; serve()"

Done = Callable[[str, list[str]], None]
"""Called with a kernel that is ready, and the names of those that were compiled for it."""


def n_processes() -> int:
    """Return how many processes compile: as many as cores that this one may use, within bounds."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, MOST_PROCESSES)


def missing(packages: tuple[str, ...]) -> dict[str, Any]:
    """Return the listed kernels of some packages that are not in the cache with all their signatures, by name."""
    found = {}
    for name, signatures in listed().items():
        kernel = kernel_of(name) if name.partition(".")[0] in packages else None
        if kernel is not None and not set(signatures) <= cached_signatures(kernel):
            found[name] = kernel
    return found


def compile_in_processes(kernels: Mapping[str, Any], done: Done, processes: int) -> None:
    """Compile kernels into the cache. What fails is left for whoever calls the kernel, who then hears of it.

    Args:
        kernels: The kernels, by module and name.
        done: Called for each kernel, from one thread at a time.
        processes: How many to start.
    """
    folder = working_folder()
    if folder is None:
        return
    queue, saying = _Queue(kernels), threading.Lock()

    def lead(process: "subprocess.Popen[str]") -> None:
        while (name := queue.take()) is not None:
            compiled = _asked(process, name)
            queue.finish(name)
            if compiled is None:
                logger.info("a process that compiles kernels ended early, at %s", name)
                return
            with saying:
                done(name, compiled)

    with _started(processes, folder) as started, ThreadPoolExecutor(len(started)) as threads:
        try:
            for leading in [threads.submit(lead, process) for process in started]:
                leading.result()
        except BaseException:
            queue.end()
            for process in started:
                process.kill()
            raise


def _asked(process: "subprocess.Popen[str]", name: str) -> list[str] | None:
    """Let a process compile a kernel; return the names of those it compiled, or None if it is no longer there."""
    assert process.stdin is not None, "it was opened with a pipe"
    assert process.stdout is not None, "it was opened with a pipe"
    try:
        process.stdin.write(f"{name}\n")
        process.stdin.flush()
    except OSError:
        return None
    line = process.stdout.readline()
    return list(json.loads(line)) if line.endswith("\n") else None


@contextmanager
def _started(n: int, folder: Path) -> Iterator[list["subprocess.Popen[str]"]]:
    """Start processes that import what this one does and share its cache; they end with the block."""
    variables = {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    processes: list[subprocess.Popen[str]] = []
    try:
        for _ in range(n):
            processes.append(
                subprocess.Popen(
                    [sys.executable, "-c", SERVE],
                    env=os.environ | variables,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,  # what fails there fails here again, and is heard of then
                    text=True,
                    encoding="utf-8",
                    start_new_session=True,  # Ctrl-C is this process's to hear
                )
            )
        yield processes
    finally:
        for process in processes:
            with process:  # closes the pipes, at which it ends, and waits
                pass


def serve() -> None:
    """Compile each kernel that is named on stdin, and answer on stdout which were compiled; end when stdin does."""
    signatures, compiled = listed(), list[str]()

    class Listener(event.Listener):  # type: ignore[misc] # numba has no types
        def on_start(self, started: Any) -> None:
            function = started.data["dispatcher"].py_func
            compiled.append(f"{function.__module__}.{function.__name__}")

        def on_end(self, ended: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        for line in sys.stdin:
            kernel = kernel_of(line.strip())
            for signature in signatures.get(line.strip(), ()):
                try:
                    kernel.compile(signature)
                except errors.NumbaError as error:
                    logger.info("%s: the list of signatures is out of date (%s)", line.strip(), error)
            sys.stdout.write(json.dumps(compiled) + "\n")
            sys.stdout.flush()
            compiled.clear()


class _Queue:
    """Kernels in the order in which they may be compiled: none before those that it calls, long ones first."""

    def __init__(self, kernels: Mapping[str, Any]) -> None:
        self._changed = threading.Condition()
        names = {id(kernel): name for name, kernel in kernels.items()}
        self._calls = {name: _called(kernel, names) - {name} for name, kernel in kernels.items()}
        self._left = sorted(kernels, key=lambda name: (-len(kernels[name].py_func.__code__.co_code), name))
        self._busy: set[str] = set()

    def take(self) -> str | None:
        """Return the next kernel, once there is one that calls nothing that is yet to be compiled; None at the end."""
        with self._changed:
            while self._left:
                waited_for = {*self._left, *self._busy}
                ready = (name for name in self._left if not self._calls[name] & waited_for)
                # Kernels that call each other in a circle wait for nobody.
                name = next(ready, None if self._busy else self._left[0])
                if name is not None:
                    self._left.remove(name)
                    self._busy.add(name)
                    return name
                self._changed.wait()
            return None

    def finish(self, name: str) -> None:
        """Note that a kernel which was taken is done with."""
        with self._changed:
            self._busy.discard(name)
            self._changed.notify_all()

    def end(self) -> None:
        """Give out no more."""
        with self._changed:
            self._left.clear()
            self._changed.notify_all()


def _called(kernel: Any, names: Mapping[int, str]) -> set[str]:
    function = kernel.py_func
    found = (function.__globals__.get(word) for word in function.__code__.co_names)
    return {names[id(each)] for each in found if id(each) in names}
