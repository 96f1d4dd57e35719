"""What work is measured by where a clock would be noise: the lines of Python that run."""

import gc
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any


def n_lines(work: Callable[[], object]) -> int:
    """Return how many lines of Python run on this thread, one of a loop as often as it runs; a kernel is a single one.

    The same work takes the same lines each time, once what is made at first use has been made.
    """
    count = 0

    def note(_: FrameType, event: str, __: object) -> Any:
        nonlocal count
        count += event == "line"
        return note

    before = sys.gettrace()
    gc.collect()
    gc.disable()  # what it frees may run something, whenever it comes
    sys.settrace(note)
    try:
        work()
    finally:
        sys.settrace(before)
        gc.enable()
    return count
