"""The plain answer: whatever may move is taken to move."""

from dataclasses import dataclass

import numpy as np

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import F64
from stillroom.protocols import Pending


@dataclass(frozen=True)
class WholeBoxesConfig:
    """All of a box or mask is thrown away.

    Attributes:
        min_matches: The sieve is off where fewer matches than this would stay.
    """

    min_matches: int = 20

    def build(self, seed: int = 0) -> "WholeBoxes":
        """Return the sieve."""
        return WholeBoxes(self)


class WholeBoxes:
    """Sieve 2 that throws away everything movable."""

    def __init__(self, config: WholeBoxesConfig) -> None:
        """Keep the configuration."""
        self.config = config

    def judge(
        self,
        stage: Stage,
        frame: Frame,
        matches: Matches,
        semantics: Pending[Semantics],
        T_cam_world: F64,
        world: Map,
    ) -> Motion:
        """Return that everything movable moves, unless tracking could not go on without it."""
        movable = semantics.result()
        inside = movable.movable_at(frame.keypoints.raw_px)
        stay = int(np.count_nonzero(~inside[matches.keypoint]))
        if stage is Stage.RELOCALIZATION or (stay < self.config.min_matches <= len(matches)):
            return Motion.none(len(frame), frame.image.height, frame.image.width)
        return Motion(~inside, movable.movable)
