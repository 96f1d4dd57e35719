"""The sieves that let everything pass."""

import numpy as np
import pytest
from asked import ask
from small_world import CAMERA, SCALES, SmallWorld, no_semantics, pose

from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Stage
from stillroom.data.semantics import Box, Semantics
from stillroom.dynamics.chain import KeepAllConfig, KeepAllKeypoints
from stillroom.schedule import Done

FRAME, _ = SmallWorld.of(0, 60).look(pose())
CROWD = Done(Semantics(480, 640, (Box(0, 0, 639, 479, "person", 1.0),)))


def test_every_keypoint_passes_whatever_may_move() -> None:
    assert KeepAllKeypoints()(FRAME, CROWD) is FRAME


@pytest.mark.parametrize("stage", Stage)
@pytest.mark.parametrize("semantics", [no_semantics(), CROWD])
def test_nothing_moves_at_any_stage(stage: Stage, semantics: Done[Semantics]) -> None:
    sieve = KeepAllConfig().build()
    matches = Matches.of(np.arange(len(FRAME), dtype=np.int32))
    motion = ask(sieve, stage, FRAME, matches, semantics, np.eye(4), Map(SCALES))
    assert motion.is_static.shape == (len(FRAME),)
    assert motion.is_static.all()
    assert motion.moving.shape == (CAMERA.height, CAMERA.width)
    assert not motion.moving.any()
