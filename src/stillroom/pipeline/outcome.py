"""What a run came to."""

from dataclasses import dataclass, field
from pathlib import Path

from stillroom.evaluation.report import Evaluation
from stillroom.evaluation.timing import StageClock
from stillroom.system import Slam


@dataclass
class RunOutcome:
    """What a run came to.

    Attributes:
        method: Its name.
        folder: Where its results lie; None where nothing was to be written.
        slam: The system after the last frame: trajectories, results of all frames, the map.
        clock: What the stages cost.
        evaluation: Its figures; None without ground truth, or with a trajectory that cannot be compared to it.
        n_given: Images that the run was given, those that cannot be read among them.
        interrupted: Whether it was stopped before the last image.
        bad: Number and time [s] of each image that cannot be read.
        pictures: What was drawn.
        map_file: Where the map was kept; None where it was not.
    """

    method: str
    folder: Path | None
    slam: Slam
    clock: StageClock
    evaluation: Evaluation | None = None
    n_given: int = 0
    interrupted: bool = False
    bad: list[tuple[int, float]] = field(default_factory=list)
    pictures: tuple[Path, ...] = ()
    map_file: Path | None = None

    @property
    def n_bad(self) -> int:
        """Images that cannot be read."""
        return len(self.bad)

    @property
    def n_tracked(self) -> int:
        """Images that have a pose; those in sub-maps that were never joined have none in the trajectory."""
        return sum(result.T_world_cam is not None for result in self.slam.results) - self.n_apart

    @property
    def n_apart(self) -> int:
        """Images that were tracked in sub-maps that were never joined with the main one."""
        return len(self.slam.apart())
