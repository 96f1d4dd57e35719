"""What is warned of during a run is kept, and is heard as before."""

import logging
import subprocess
import sys

from stillroom.pipeline.warned import MOST, kept_warnings

log = logging.getLogger("stillroom.somewhere")
ALONE = """
import logging
from stillroom.pipeline.warned import kept_warnings
kept, inner = [], []
with kept_warnings(kept), kept_warnings(inner):
    logging.getLogger("stillroom.x").warning("heard %s", "once")
    logging.getLogger("stillroom.x").info("never")
assert kept == inner == ["heard once"], (kept, inner)
logging.getLogger("stillroom.x").warning("later")
assert kept == ["heard once"]
"""


def test_warnings_are_kept_in_one_line_each(caplog) -> None:
    kept: list[str] = []
    with kept_warnings(kept):
        log.warning("first\nof %d", 2)
        log.info("not this")
        log.error("second")
    log.warning("after it")
    assert kept == ["first of 2", "second"]
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING] == [
        "first\nof 2",
        "second",
        "after it",
    ]


def test_a_flood_is_not_kept_whole() -> None:
    kept: list[str] = []
    with kept_warnings(kept):
        for n in range(MOST + 10):
            log.warning("%d", n)
    assert len(kept) == MOST


def test_who_set_up_no_log_hears_a_warning_once_as_ever() -> None:
    done = subprocess.run([sys.executable, "-c", ALONE], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines() == ["heard once", "later"]
