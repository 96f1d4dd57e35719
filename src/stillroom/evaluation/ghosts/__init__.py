"""How clean and how complete a dense map is: what figures left behind in it, and how much of the room it holds.

A map is a set of points, as any method leaves it. It is held against one of two things:

- `truth`: rendered sequences, whose surfaces are known exactly;
- `free_space`: real sequences in which the room is first seen empty. What those first images saw through is free; a
  map made of the later images that has points there holds ghosts.
"""

from stillroom.evaluation.ghosts.completeness import completeness
from stillroom.evaluation.ghosts.figures import CompletenessFigure, GhostFigure, SurfaceFigure
from stillroom.evaluation.ghosts.free_space import FreeSpaceConfig, empty_room, ghosts_in_free_space, seen_again
from stillroom.evaluation.ghosts.gathering import Gatherer
from stillroom.evaluation.ghosts.truth import TrueScene, TruthConfig, ghosts_by_truth
from stillroom.evaluation.ghosts.views import DepthView, Sightings, settled, sightings

__all__ = [
    "CompletenessFigure",
    "DepthView",
    "FreeSpaceConfig",
    "Gatherer",
    "GhostFigure",
    "Sightings",
    "SurfaceFigure",
    "TrueScene",
    "TruthConfig",
    "completeness",
    "empty_room",
    "ghosts_by_truth",
    "ghosts_in_free_space",
    "seen_again",
    "settled",
    "sightings",
]
