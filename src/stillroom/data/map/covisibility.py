"""Which keyframes see the same points."""

import numpy as np

from stillroom.geometry.arrays import I32, Ints


class Covisibility:
    """A weighted graph over keyframes; the weight is the number of points that both see (ORB-SLAM2).

    Attributes:
        min_weight: Edges weaker than this are left out unless a keyframe would have none.
        unsaved: Keyframes whose edges changed since the map was last written to disk: whoever writes it empties it.
    """

    def __init__(self, min_weight: int = 15) -> None:
        """Start empty; edges weaker than `min_weight` are left out unless a keyframe would have none."""
        self.min_weight = min_weight
        self.unsaved: set[int] = set()
        self._weights: dict[int, dict[int, int]] = {}
        self._ordered: dict[int, list[int]] = {}

    def connect(self, keyframe: int, counts: I32) -> None:
        """Replace the edges of a keyframe.

        Args:
            keyframe: Its id.
            counts: Points shared with each keyframe (K,); the entry of the keyframe itself is ignored.
        """
        self.unsaved.add(keyframe)
        counts = counts.copy()
        counts[keyframe] = 0
        strong = np.flatnonzero(counts >= self.min_weight)
        if len(strong) == 0 and counts.max(initial=0) > 0:
            strong = np.array([int(np.argmax(counts))])
        for other in self._weights.get(keyframe, {}):
            self._weights[other].pop(keyframe, None)
            self._ordered.pop(other, None)
        self._ordered.pop(keyframe, None)
        self._weights[keyframe] = {int(other): int(counts[other]) for other in strong}
        for other, weight in self._weights[keyframe].items():
            self._weights.setdefault(other, {})[keyframe] = weight
            self._ordered.pop(other, None)

    def remove(self, keyframe: int) -> None:
        """Forget a keyframe."""
        self.unsaved.add(keyframe)
        self._ordered.pop(keyframe, None)
        for other in self._weights.pop(keyframe, {}):
            self._weights[other].pop(keyframe, None)
            self._ordered.pop(other, None)

    def neighbours(self, keyframe: int, at_most: int | None = None) -> list[int]:
        """Return connected keyframes, strongest first; of equal ones the newest first."""
        if keyframe not in self._ordered:
            edges = self._weights.get(keyframe, {})
            self._ordered[keyframe] = sorted(edges, key=lambda other: (-edges[other], -other))
        return self._ordered[keyframe][:at_most]

    def weight(self, first: int, second: int) -> int:
        """Return how many points two keyframes share, 0 when not connected."""
        return self._weights.get(first, {}).get(second, 0)

    def edges(self) -> I32:
        """Return all edges (E, 3) in order: the older keyframe, the newer one, the weight."""
        found = [(a, b, weight) for a, others in self._weights.items() for b, weight in others.items() if a < b]
        return np.array(sorted(found), dtype=np.int32).reshape(-1, 3)

    def edges_of(self, keyframe: int) -> dict[int, int]:
        """Return the weight of each edge of a keyframe, by the other keyframe."""
        return dict(self._weights.get(keyframe, {}))

    def restore(self, edges: Ints) -> None:
        """Take the edges (E, 3) that `edges` once returned in place of those there are."""
        self.unsaved.update(self._weights)
        self._weights, self._ordered = {}, {}
        for a, b, weight in edges.tolist():
            self._weights.setdefault(a, {})[b] = weight
            self._weights.setdefault(b, {})[a] = weight
        self.unsaved.update(self._weights)
