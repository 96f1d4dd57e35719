"""What is remembered of the last seconds moves along when the map jumps."""

import numpy as np
from small_world import SCALES, pose

from stillroom.data.map import Map
from stillroom.data.map.jumps import JumpFollower


class Memory:
    """Remembers one place (3,) [m, world]."""

    def __init__(self) -> None:
        self.place_m = np.array([1.0, 2.0, 3.0])

    def follow(self, T_new_old: np.ndarray) -> None:
        self.place_m = T_new_old[:3, :3] @ self.place_m + T_new_old[:3, 3]


FIRST, SECOND = pose(1.0, turn=(0.0, 1.0, 0.0)), pose(0.0, 2.0, turn=(0.3, 0.0, 0.0))


def moved(place_m: np.ndarray, *jumps: np.ndarray) -> np.ndarray:
    for jump in jumps:
        place_m = jump[:3, :3] @ place_m + jump[:3, 3]
    return place_m


def test_each_jump_is_followed_once_in_order_by_every_memory() -> None:
    world, follower, memories = Map(SCALES), JumpFollower(), [Memory(), Memory()]
    assert not follower.follow(world, memories)
    world.jumps += [FIRST, SECOND]
    assert follower.follow(world, memories)
    assert not follower.follow(world, memories)
    for memory in memories:
        np.testing.assert_allclose(memory.place_m, moved(np.array([1.0, 2.0, 3.0]), FIRST, SECOND), atol=1e-12)


def test_jumps_from_before_anything_was_remembered_are_not_followed() -> None:
    world, memory = Map(SCALES), Memory()
    world.jumps.append(FIRST)
    follower = JumpFollower()
    assert not follower.follow(world, [memory])
    world.jumps.append(SECOND)
    assert follower.follow(world, [memory])
    np.testing.assert_allclose(memory.place_m, moved(np.array([1.0, 2.0, 3.0]), SECOND), atol=1e-12)
