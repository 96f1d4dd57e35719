"""Put a clock on the parts of a system without the system knowing."""

from typing import Any, TypeVar, cast

from stillroom.evaluation.timing import StageClock

T = TypeVar("T")


class _Timed:
    """Stands for a part; some of its methods are timed, all else is the part's own."""

    def __init__(self, part: object, clock: StageClock, stages: dict[str, str]) -> None:
        self._part = part
        for method, stage in stages.items():
            setattr(self, method, clock.timed(stage, getattr(part, method)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._part, name)


def timed_part(part: T, clock: StageClock, **stages: str) -> T:
    """Return the part with some methods timed: `timed_part(mapper, clock, refine="mapping")`.

    Calls from outside are timed, not those that the part makes to itself.
    """
    return cast(T, _Timed(part, clock, stages))
