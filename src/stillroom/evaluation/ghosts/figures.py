"""The figures by which a dense map is judged."""

from dataclasses import asdict, dataclass, field
from typing import Any

from stillroom.evaluation.trajectory_errors import Statistics
from stillroom.geometry.arrays import Bool


@dataclass(frozen=True)
class GhostFigure:
    """What of a map is left behind by somebody who was there for a while.

    Attributes:
        n_points: Points of the map.
        n_ghosts: Those that are ghosts.
        n_suspects: Those that would be by what speaks against them alone; the others of these were cleared.
        is_ghost: Which (N,).
    """

    n_points: int
    n_ghosts: int
    n_suspects: int
    is_ghost: Bool = field(repr=False)

    @classmethod
    def of(cls, is_ghost: Bool, n_suspects: int) -> "GhostFigure":
        """Count the ghosts (N,)."""
        return cls(len(is_ghost), int(is_ghost.sum()), n_suspects, is_ghost)

    @property
    def share(self) -> float:
        """Ghosts per point, 0 to 1; 0 for a map without points, which completeness blames."""
        return self.n_ghosts / self.n_points if self.n_points else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the figure for a JSON file."""
        counts = {"n_points": self.n_points, "n_ghosts": self.n_ghosts, "n_suspects": self.n_suspects}
        return counts | {"share": self.share}


@dataclass(frozen=True)
class CompletenessFigure:
    """How much of a surface a map holds.

    Attributes:
        n_points: Points of the surface.
        n_found: Those near which the map has a point.
        within_m: How near [m].
        is_found: Which (N,).
    """

    n_points: int
    n_found: int
    within_m: float
    is_found: Bool = field(repr=False)

    @property
    def share(self) -> float:
        """Found per point of the surface, 0 to 1; 0 where there is no surface to find."""
        return self.n_found / self.n_points if self.n_points else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the figure for a JSON file."""
        return {"n_points": self.n_points, "n_found": self.n_found, "within_m": self.within_m, "share": self.share}


@dataclass(frozen=True)
class SurfaceFigure:
    """How far a map's points lie from the true surface.

    Attributes:
        error_m: Distances [m] of the points that are no ghosts; None where there are none.
        n_astray: Points that lie off the surface though nobody was there: noise, and wrong poses.
    """

    error_m: Statistics | None
    n_astray: int

    def to_dict(self) -> dict[str, Any]:
        """Return the figure for a JSON file."""
        return asdict(self)
