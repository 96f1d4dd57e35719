"""A walk round a block that ends where it began, mapped with drift: the map does not know that it is the same place."""

from dataclasses import dataclass

import numpy as np
from small_world import SmallMap, SmallWorld

from stillroom.data.map import Map
from stillroom.features.places.growth import GrowthConfig
from stillroom.features.places.place_index import PlaceMemory
from stillroom.features.places.vocabulary import Vocabulary
from stillroom.geometry import se3
from stillroom_train.vocabulary import train

RADIUS_M = 5.0


def poses_of_ring(n: int, laps: float) -> np.ndarray:
    """T_world_cam (N, 4, 4) of cameras on a circle, looking outward, the first one at the origin."""
    poses = []
    for angle in np.linspace(0.0, 2.0 * np.pi * laps, n):
        T_centre_cam = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, angle, 0.0]))
        T_centre_cam[:3, 3] = RADIUS_M * T_centre_cam[:3, 2]
        poses.append(T_centre_cam)
    return se3.inverse(poses[0]) @ np.array(poses)


def ring_world(seed: int, n: int) -> SmallWorld:
    """Points on a thick cylinder around the ring, each with a random descriptor."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.uniform(0, 2 * np.pi, n), RADIUS_M + rng.uniform(2.0, 4.0, n)
    centre_m = np.array([0.0, 0.0, -RADIUS_M])
    points = np.column_stack((radius * np.sin(angle), rng.uniform(-1.5, 1.5, n), radius * np.cos(angle))) + centre_m
    return SmallWorld(
        points,
        rng.integers(0, 256, (n, 32), dtype=np.uint8),
        rng.uniform(-np.pi, np.pi, n),
        3.0 * rng.uniform(1.0, 3.0, n),
    )


@dataclass
class Ring:
    """The map of a walk, where its keyframes truly are, and the last keyframe before the place comes again."""

    small: SmallMap
    T_true: np.ndarray
    places: PlaceMemory

    @property
    def map(self) -> Map:
        return self.small.map

    @property
    def last(self) -> int:
        return len(self.T_true) - 1

    def errors_m(self) -> np.ndarray:
        """How far each keyframe is from the truth, the first one laid upon it."""
        T_first = self.map.keyframes.T_world_cam[0]
        moved = self.T_true[0] @ se3.inverse(T_first) @ self.map.keyframes.T_world_cam
        return np.linalg.norm(moved[:, :3, 3] - self.T_true[:, :3, 3], axis=1)


def ring(
    seed: int = 0, n: int = 44, laps: float = 1.15, drift_m: float = 0.8, drift_rad: float = 0.15, noise_px: float = 0.3
) -> Ring:
    """Map the walk; on the second lap everything is new to the map, and it lies off by the drift."""
    world, T_true = ring_world(seed, 3000), poses_of_ring(n, laps)
    small = SmallMap(world)
    first_round = int(np.ceil(n / laps))
    for k, pose in enumerate(T_true):
        if k == first_round - 6:
            forgotten = np.unique(np.concatenate(small.seen[:8]))
            small.id_of[forgotten] = -1
        small.add(pose, noise_px=noise_px, flips=8)
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(2, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    bend(small.map, np.concatenate((drift_m * axis[0], drift_rad * axis[1])))
    vocabulary = vocabulary_of(world)
    places = PlaceMemory(vocabulary, small.map)
    places.remember_all()
    return Ring(small, T_true, places)


def bend(world: Map, twist: np.ndarray) -> None:
    """Let a map drift evenly along the way, in the end by the whole twist; points go with who saw them first."""
    n = len(world.keyframes)
    drift = np.stack([se3.exp(twist * k / (n - 1)) for k in range(n)])
    rows = world.oldest_observations(np.arange(len(world.points)))
    motion = drift[world.keypoints.keyframe[rows]]
    world.points.position_m[:] = np.einsum("nij,nj->ni", motion[:, :3, :3], world.points.position_m) + motion[:, :3, 3]
    world.keyframes.T_world_cam[:] = drift @ world.keyframes.T_world_cam
    world.refresh_geometry(np.arange(len(world.points)))


def vocabulary_of(world: SmallWorld) -> Vocabulary:
    """A vocabulary of a world's own descriptors."""
    images = [world.descriptors[start : start + 100] for start in range(0, len(world.descriptors), 100)]
    return train(images, GrowthConfig(branching=8, depth=3, min_descriptors=8, iterations=3))
