"""What a map has jumped since it was asked last."""

import numpy as np
from small_world import SCALES, pose

from stillroom.data.map import Map
from stillroom.data.map.jumps import JumpFollower

FIRST, SECOND = pose(1.0, turn=(0.0, 1.0, 0.0)), pose(0.0, 2.0, turn=(0.3, 0.0, 0.0))


def test_jumps_are_told_once_and_put_together_in_their_order() -> None:
    world, follower = Map(SCALES), JumpFollower()
    assert follower.missed(world) is None
    world.jumps += [FIRST, SECOND]
    T_new_old = follower.missed(world)
    np.testing.assert_allclose(T_new_old, SECOND @ FIRST, atol=1e-12)
    assert follower.missed(world) is None


def test_jumps_from_before_anything_was_remembered_are_not_told() -> None:
    world, follower = Map(SCALES), JumpFollower()
    world.jumps.append(FIRST)
    assert follower.missed(world) is None
    world.jumps.append(SECOND)
    np.testing.assert_allclose(follower.missed(world), SECOND, atol=1e-12)
