"""When submitted work runs. The threads of the papers are one possible schedule."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Done(Generic[T]):
    """A result that is already available."""

    value: T

    def result(self) -> T:
        """Return the result."""
        return self.value


class InOrder:
    """Run work at once, on the caller's thread: the same input gives the same trajectory, byte for byte."""

    def submit(self, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Done[T]:
        """Run the work now and return its result."""
        return Done(work(*args, **kwargs))

    def close(self) -> None:
        """Do nothing: all work is done when `submit` returns."""
