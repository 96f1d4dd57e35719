"""The part of the map around the camera."""

from dataclasses import dataclass

import numpy as np

from stillroom.data.map import Map
from stillroom.geometry.arrays import I32

MAX_KEYFRAMES = 80
_NEIGHBOURS = 10


@dataclass(frozen=True)
class LocalMap:
    """Keyframes that share points with a frame, their neighbours, and all that they see.

    Attributes:
        reference: The keyframe that shares most points.
        keyframes: Their ids.
        points: Points that they see (P,) int32, in order of id.
    """

    reference: int
    keyframes: tuple[int, ...]
    points: I32


def select(point_ids: I32, fallback: int, world: Map) -> LocalMap:
    """Gather the local map of a frame (ORB-SLAM2: UpdateLocalKeyFrames, UpdateLocalPoints).

    Args:
        point_ids: Points that the frame sees (N,), −1 for none.
        fallback: Keyframe to use when none of them is seen by any.
        world: The map.
    """
    votes = world.count_shared(point_ids)
    voters = np.flatnonzero(votes)
    if len(voters) == 0:
        voters = np.array([fallback])
        votes[fallback] = 1
    voters = voters[np.argsort(-votes[voters], kind="stable")][:MAX_KEYFRAMES]
    chosen = dict.fromkeys(int(voter) for voter in voters)
    for voter in list(chosen):
        if len(chosen) >= MAX_KEYFRAMES:
            break
        for neighbour in world.covisibility.neighbours(voter, _NEIGHBOURS):
            if neighbour not in chosen:
                chosen[neighbour] = None
                break
    return LocalMap(int(voters[0]), tuple(chosen), world.points_seen_by(np.array(list(chosen))))
