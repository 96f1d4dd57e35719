"""The figures of one dense map."""

from dataclasses import dataclass
from typing import Any

from stillroom.evaluation.ghosts import CompletenessFigure, GhostFigure, SurfaceFigure
from stillroom.evaluation.report import percent

HEADER = ("dense map", "points", "ghosts", "suspects", "complete", "error median", "astray")
"""Names of the columns of `MapFigures.row`."""
NONE = "–"


@dataclass(frozen=True)
class MapFigures:
    """The figures of one map.

    Attributes:
        name: What was done about moving things.
        ghosts: What they left behind.
        complete: How much of the room it holds.
        surface: How exact the rest is; None on real data.
    """

    name: str
    ghosts: GhostFigure
    complete: CompletenessFigure
    surface: SurfaceFigure | None = None

    def row(self) -> tuple[str, ...]:
        """Return the cells under `HEADER`."""
        ghosts, error, astray = self.ghosts, NONE, NONE
        suspects = ghosts.n_suspects / ghosts.n_points if ghosts.n_points else 0.0
        if self.surface is not None:
            astray = percent(self.surface.n_astray / ghosts.n_points if ghosts.n_points else 0.0)
            error = NONE if self.surface.error_m is None else f"{self.surface.error_m.median * 1e3:.1f} mm"
        shares = f"{ghosts.share * 100:.2f} %", percent(suspects), percent(self.complete.share)
        return (self.name, str(ghosts.n_points), *shares, error, astray)

    def to_dict(self) -> dict[str, Any]:
        """Return the figures for a JSON file."""
        surface = None if self.surface is None else self.surface.to_dict()
        figures = {"ghosts": self.ghosts.to_dict(), "completeness": self.complete.to_dict(), "surface": surface}
        return {"map": self.name} | figures
