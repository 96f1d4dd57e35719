"""When submitted work runs. The papers' threads are a schedule, not a structure."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Done(Generic[T]):
    """An answer that is already there."""

    value: T

    def result(self) -> T:
        """Return the answer."""
        return self.value


class InOrder:
    """Run work at once, on the caller's thread: the same input gives the same trajectory, byte for byte."""

    def submit(self, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Done[T]:
        """Run the work now and return its answer."""
        return Done(work(*args, **kwargs))

    def close(self) -> None:
        """Do nothing: all work is done when `submit` returns."""
