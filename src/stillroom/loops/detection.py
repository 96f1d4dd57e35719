"""Loop candidates by appearance (ORB-SLAM2: DetectLoop)."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.map import Covisibility, Map
from stillroom.features.places.place_index import PlaceMemory, Resemblance, best_places
from stillroom.protocols import Parts

# One image may look like another by chance; several in a row with candidates in one neighbourhood hardly do.


class ConsistentGroups:
    """Follows candidate places from keyframe to keyframe (ORB-SLAM2: DetectLoop, covisibility consistency)."""

    def __init__(self, needed: int = 3) -> None:
        """Start empty; a place must be a candidate of `needed` keyframes in a row."""
        self.needed = needed
        self._groups: list[tuple[frozenset[int], int]] = []

    def confirmed(self, candidates: Iterable[int], covisibility: Covisibility) -> list[int]:
        """Take the candidates of the next keyframe; return those that are consistent often enough, in order.

        A candidate's group, itself and its covisible keyframes, continues a group of the keyframe before when they
        share a member.
        """
        followed: list[tuple[frozenset[int], int]] = []
        enough = []
        for candidate in candidates:
            group = frozenset([candidate, *covisibility.neighbours(candidate)])
            length = 1 + max((length for earlier, length in self._groups if not group.isdisjoint(earlier)), default=0)
            followed.append((group, length))
            if length >= self.needed:
                enough.append(candidate)
        self._groups = followed
        return enough

    def forget(self) -> None:
        """Start again."""
        self._groups = []


@dataclass(frozen=True)
class DetectionConfig:
    """When appearance makes a candidate (ORB-SLAM2's numbers; docs/reference.md#orb-slam2-loops).

    Attributes:
        pause_keyframes: No loops for this many keyframes at the start, and after a loop.
        consistent_keyframes: Consecutive keyframes that must agree on a place.
        max_candidates: Most candidate places of a keyframe that are verified.
    """

    pause_keyframes: int = bounded(10, least=0)
    consistent_keyframes: int = bounded(3, least=1)
    max_candidates: int = bounded(3, least=1)

    def build(self, parts: Parts, places: PlaceMemory) -> "LoopDetector":
        """Return the detector of a map."""
        return LoopDetector(self, places, parts.world)


class LoopDetector:
    """Called with every new keyframe, in order."""

    def __init__(self, config: DetectionConfig, places: PlaceMemory, world: Map) -> None:
        """Start empty."""
        self.config, self.places, self.world = config, places, world
        self._groups = ConsistentGroups(config.consistent_keyframes)
        self._quiet_until = config.pause_keyframes

    def candidates(self, keyframe: int) -> list[int]:
        """Return the keyframes that may show the same place, by appearance; the likeliest first."""
        if keyframe < self._quiet_until or keyframe not in self.places.index:
            return []
        neighbours = self.world.covisibility.neighbours(keyframe)
        found = self.places.index.query(self.places.index.bag(keyframe))
        score = np.zeros(len(self.world.keyframes))
        score[found.keyframes] = found.scores
        bar = float(score[neighbours].min(initial=1.0)) if neighbours else 0.0
        elsewhere = self.world.keyframes.is_alive[found.keyframes].copy()
        elsewhere &= self.world.keyframes.submap[found.keyframes] == self.world.keyframes.submap[keyframe]
        elsewhere &= ~np.isin(found.keyframes, [keyframe, *neighbours])
        others = Resemblance(found.keyframes[elsewhere], found.scores[elsewhere], found.n_common[elsewhere])
        alike = best_places(others, self.world.covisibility, bar)[: self.config.max_candidates]
        return self._groups.confirmed((int(candidate) for candidate in alike), self.world.covisibility)

    def pause(self, keyframe: int) -> None:
        """Start again a few keyframes after this one."""
        self._groups.forget()
        self._quiet_until = keyframe + self.config.pause_keyframes
