"""A closed loop moves the newest part of the map at once; every part that stores poses must be corrected too."""

import numpy as np

from stillroom.data.map.map import Map
from stillroom.geometry.arrays import F64


class JumpFollower:
    """Returns each jump of a map once."""

    def __init__(self) -> None:
        """Start with the map as it is: no correction before this moment is reported."""
        self._n_followed: int | None = None

    def missed(self, world: Map) -> F64 | None:
        """Return the motion (4, 4) of the world's coordinates since the last call; None where there was none."""
        n_followed = len(world.jumps) if self._n_followed is None else self._n_followed
        self._n_followed = len(world.jumps)
        missed = world.jumps[n_followed:]
        if not missed:
            return None
        T_new_old = np.eye(4)
        for jump in missed:
            T_new_old = jump @ T_new_old
        return T_new_old
