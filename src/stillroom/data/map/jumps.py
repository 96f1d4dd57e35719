"""A closed loop moves the newest part of the map at once; whoever remembers where things were must move along."""

from collections.abc import Iterable
from typing import Protocol

import numpy as np

from stillroom.data.map.map import Map
from stillroom.geometry.arrays import F64


class Remembers(Protocol):
    """Keeps poses of the last seconds in the map's coordinates."""

    def follow(self, T_new_old: F64) -> None:
        """Move what is remembered by a motion (4, 4) of the world's coordinates."""


class JumpFollower:
    """Lets memories of the last seconds follow the map's jumps, each once."""

    def __init__(self) -> None:
        """Start in a map that has not jumped yet, or whose jumps nothing here remembers."""
        self._n_followed: int | None = None

    def follow(self, world: Map, memories: Iterable[Remembers]) -> bool:
        """Move memories by what the map has jumped since this was asked last; return whether it did."""
        n_followed = len(world.jumps) if self._n_followed is None else self._n_followed
        self._n_followed = len(world.jumps)
        missed = world.jumps[n_followed:]
        if not missed:
            return False
        T_new_old = np.eye(4)
        for jump in missed:
            T_new_old = jump @ T_new_old
        for memory in memories:
            memory.follow(T_new_old)
        return True
