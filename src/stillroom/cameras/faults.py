"""What may go wrong with a camera, for tests of what comes after it."""

from dataclasses import dataclass, field
from math import isfinite

from stillroom.errors import ConfigError

USAGE = "write it like ?missing=3,4&late=9:0.5&gone=20; there is: missing, doubled, swapped, unreadable, late, gone"


@dataclass(frozen=True)
class Faults:
    """Faults of a camera. Images are named by their numbers.

    Attributes:
        missing: These were taken and never arrive.
        doubled: These arrive twice.
        swapped: Each of these arrives after the one that follows it.
        unreadable: These cannot be used: `FrameError`.
        late: Each of these is waited for this long [s].
        gone_after: The cable is pulled out once this one has arrived: `CameraError`; None where it never is.
    """

    missing: frozenset[int] = frozenset()
    doubled: frozenset[int] = frozenset()
    swapped: frozenset[int] = frozenset()
    unreadable: frozenset[int] = frozenset()
    late: dict[int, float] = field(default_factory=dict)
    gone_after: int | None = None

    @classmethod
    def read(cls, text: str) -> "Faults":
        """Return those of a text like "missing=3,4&late=9:0.5&gone=20".

        Raises:
            ConfigError: It is malformed.
        """
        values: dict[str, str] = {}
        for part in filter(None, text.split("&")):
            name, sign, value = part.partition("=")
            if not sign or name in values:
                raise ConfigError(f"?{text}: '{part}' is no fault of a camera, or stands there twice; {USAGE}")
            values[name] = value
        try:
            found = cls(
                missing=_numbers(values.pop("missing", "")),
                doubled=_numbers(values.pop("doubled", "")),
                swapped=_numbers(values.pop("swapped", "")),
                unreadable=_numbers(values.pop("unreadable", "")),
                late=_waits_s(values.pop("late", "")),
                gone_after=_last(values.pop("gone", None)),
            )
        except ValueError as error:
            raise ConfigError(f"?{text}: {error}; {USAGE}") from None
        if values:
            raise ConfigError(f"?{text}: a camera has no fault '{next(iter(values))}'; {USAGE}")
        return found

    def order(self, n_images: int) -> list[int]:
        """Return the numbers of the images in the order in which they arrive."""
        numbers = list(range(n_images))
        for number in sorted(self.swapped, reverse=True):
            if 0 <= number < n_images - 1:
                numbers.remove(number)
                numbers.insert(numbers.index(number + 1) + 1, number)
        return [each for number in numbers for each in self._arrivals(number)]

    def _arrivals(self, number: int) -> list[int]:
        return [] if number in self.missing else [number, number] if number in self.doubled else [number]


def _numbers(text: str) -> frozenset[int]:
    return frozenset(int(word) for word in text.split(",") if word)


def _last(text: str | None) -> int | None:
    return None if text is None else int(text)


def _waits_s(text: str) -> dict[int, float]:
    waits_s: dict[int, float] = {}
    for word in filter(None, text.split(",")):
        number, _, wait_s = word.partition(":")
        waits_s[int(number)] = float(wait_s)
        if not (isfinite(waits_s[int(number)]) and waits_s[int(number)] >= 0):
            raise ValueError(f"'{word}' is no image and its delay in seconds")
    return waits_s
