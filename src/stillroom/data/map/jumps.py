"""A closed loop moves the newest part of the map at once; whoever remembers where things were must move along."""

import numpy as np

from stillroom.data.map.map import Map
from stillroom.geometry.arrays import F64


class JumpFollower:
    """Returns each jump of a map once."""

    def __init__(self) -> None:
        """Start in a map that has not jumped yet, or whose jumps nothing here remembers."""
        self._n_followed: int | None = None

    def missed(self, world: Map) -> F64 | None:
        """Return the motion (4, 4) of the world's coordinates since this was asked last; None where there was none."""
        n_followed = len(world.jumps) if self._n_followed is None else self._n_followed
        self._n_followed = len(world.jumps)
        missed = world.jumps[n_followed:]
        if not missed:
            return None
        T_new_old = np.eye(4)
        for jump in missed:
            T_new_old = jump @ T_new_old
        return T_new_old
