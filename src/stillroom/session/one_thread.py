"""Settings of the whole process that runs need: set while any system is open, restored afterwards.

Libraries that split one small task over many threads lose more than they win here, and add up numbers in another order
on another machine. onnxruntime's sessions are made with one thread each, and need no setting of the process.
"""

import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack

import cv2
from threadpoolctl import threadpool_limits

SWITCH_INTERVAL_S = 0.0005
"""How long one Python thread may keep the others waiting."""

_lock = threading.Lock()
_holders = 0
_before = ExitStack()


def hold() -> Callable[[], None]:
    """Hold OpenCV and BLAS to one thread each, and let Python's threads take turns quickly.

    The first holder sets this, the last one to let go puts back what was before; holders may be on any threads.

    Returns:
        What lets go again; calling it more than once changes nothing.
    """
    global _holders
    with _lock:
        if _holders == 0:
            _set()
        _holders += 1
    held = [True]

    def release() -> None:
        global _holders
        with _lock:
            if held:
                held.clear()
                _holders -= 1
                if _holders == 0:
                    _before.close()

    return release


def _set() -> None:
    _before.callback(cv2.setNumThreads, cv2.getNumThreads())
    _before.callback(sys.setswitchinterval, sys.getswitchinterval())
    _before.enter_context(threadpool_limits(limits=1, user_api="blas"))
    cv2.setNumThreads(1)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
