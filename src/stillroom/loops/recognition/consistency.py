"""One image may look like another by chance; several in a row that lead to the same neighbourhood hardly do."""

from collections.abc import Iterable

from stillroom.data.map import Covisibility


class ConsistentGroups:
    """Follows candidate places from keyframe to keyframe (ORB-SLAM2: DetectLoop, covisibility consistency)."""

    def __init__(self, needed: int = 3) -> None:
        """Start without a past; a place must be met by `needed` keyframes in a row."""
        self.needed = needed
        self._groups: list[tuple[frozenset[int], int]] = []

    def confirmed(self, candidates: Iterable[int], covisibility: Covisibility) -> list[int]:
        """Take the candidates of the next keyframe; return those whose places it was led to often enough, in order.

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
