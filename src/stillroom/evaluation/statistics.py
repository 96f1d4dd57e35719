"""The six numbers that TUM's tools print of a list of errors, and the spread of one figure over several runs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import Floats


@dataclass(frozen=True)
class Statistics:
    """Errors in six numbers, in the unit of the errors. `std` divides by N, as TUM's tools and evo do."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float

    @classmethod
    def of(cls, errors: Floats) -> "Statistics":
        """Sum up errors (N,), N ≥ 1."""
        return cls(
            rmse=float(np.sqrt(np.mean(np.square(errors)))),
            mean=float(np.mean(errors)),
            median=float(np.median(errors)),
            std=float(np.std(errors)),
            min=float(np.min(errors)),
            max=float(np.max(errors)),
        )


@dataclass(frozen=True)
class Spread:
    """One figure over several runs: what a result must be quoted with (docs/reference.md#comparing-figures)."""

    median: float
    mean: float
    min: float
    max: float
    n_runs: int

    @classmethod
    def of(cls, figures: Sequence[float]) -> "Spread":
        """Sum up the figures of at least one run."""
        values = np.asarray(figures, dtype=np.float64)
        return cls(
            median=float(np.median(values)),
            mean=float(np.mean(values)),
            min=float(np.min(values)),
            max=float(np.max(values)),
            n_runs=len(values),
        )


def improvement_percent(baseline: float, figure: float) -> float | None:
    """Return how far a figure lies below a baseline's, (1 − β/α)·100 [%]; None where the baseline is 0."""
    return (1.0 - figure / baseline) * 100.0 if baseline else None
