"""From keyframes that share words to a few places worth a closer look (ORB-SLAM2's two queries)."""

import numpy as np

from stillroom.data.map import Covisibility
from stillroom.features.places.place_index import Resemblance
from stillroom.geometry.arrays import I32

COMMON_SHARE = 0.8
"""A candidate has at least this share of the most words that any keyframe shares with the image."""
SCORE_SHARE = 0.75
"""A group's score is at least this share of the best group's."""
_NEIGHBOURS = 10


def best_places(found: Resemblance, covisibility: Covisibility, min_score: float = 0.0) -> I32:
    """Return the keyframes (C,) that stand for the most similar places, the best place first.

    Scores of covisible keyframes add up to that of a place, for which its best keyframe then stands.

    Args:
        found: What the index answered.
        covisibility: Which keyframes see the same.
        min_score: A keyframe must be as alike as this; loop closing asks for what its neighbours reach.
    """
    if len(found) == 0:
        return np.zeros(0, dtype=np.int32)
    enough = (found.n_common >= COMMON_SHARE * found.n_common.max()) & (found.scores >= min_score)
    scores = {int(found.keyframes[i]): float(found.scores[i]) for i in np.flatnonzero(enough)}
    totals: dict[int, float] = {}
    for keyframe in scores:
        group = [keyframe, *(other for other in covisibility.neighbours(keyframe, _NEIGHBOURS) if other in scores)]
        total = sum(scores[member] for member in group)
        best = max(group, key=lambda member: (scores[member], -member))
        totals[best] = max(total, totals.get(best, 0.0))
    bar = SCORE_SHARE * max(totals.values(), default=0.0)
    kept = [keyframe for keyframe, total in totals.items() if total >= bar]
    return np.array(sorted(kept, key=lambda keyframe: (-totals[keyframe], keyframe)), dtype=np.int32)
