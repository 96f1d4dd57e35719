"""The trajectories of a map: what its sessions tracked, as the map now says it was."""

from pathlib import Path

import numpy as np

from stillroom.data.map import submaps
from stillroom.data.trajectory import Trajectory
from stillroom.storage.stored import StoredMap


def trajectories(stored: StoredMap) -> list[Trajectory]:
    """Return the trajectory of each session: each frame on its reference keyframe, wherever that is now.

    What hangs on a sub-map that was not joined to the main one is left out.
    """
    world, found = stored.world, []
    main = submaps.main(world)
    for number in range(len(stored.sessions)):
        frames = [f for f in stored.frames if f.session == number]
        frames = [f for f in frames if world.keyframes.submap[f.reference_keyframe] == main]
        frames.sort(key=lambda frame: frame.timestamp_s)
        poses = [world.keyframe_pose(frame.reference_keyframe) @ frame.T_reference_cam for frame in frames]
        found.append(_trajectory([frame.timestamp_s for frame in frames], poses))
    return found


def keyframe_trajectories(stored: StoredMap) -> list[Trajectory]:
    """Return the poses of the keyframes that each session made, of those that the main sub-map has still."""
    world = stored.world
    alive = world.alive_keyframes()
    alive = alive[world.keyframes.submap[alive] == submaps.main(world)]
    edges = [session.first_keyframe for session in stored.sessions]
    found = []
    for first, end in zip(edges, [*edges[1:], len(world.keyframes)], strict=True):
        own = alive[(alive >= first) & (alive < end)]
        own = own[np.argsort(world.keyframes.timestamp_s[own], kind="stable")]
        found.append(Trajectory(world.keyframes.timestamp_s[own], world.keyframes.T_world_cam[own]))
    return found


def write_trajectories(stored: StoredMap, folder: Path) -> list[tuple[Path, int]]:
    """Write them in the TUM format; with several sessions, whose times may overlap, a file for each.

    Returns:
        Each file, and how many poses are in it.
    """
    written = []
    kinds = {"trajectory": trajectories(stored), "keyframes": keyframe_trajectories(stored)}
    for name, found in kinds.items():
        for number, trajectory in enumerate(found):
            path = folder / (f"{name}.tum" if len(found) == 1 else f"{name}_{number}.tum")
            trajectory.write_tum(path)
            written.append((path, len(trajectory)))
    return written


def _trajectory(timestamps_s: list[float], poses: list[np.ndarray]) -> Trajectory:
    return Trajectory(np.array(timestamps_s, dtype=np.float64), np.array(poses, dtype=np.float64).reshape(-1, 4, 4))
