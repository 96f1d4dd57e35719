"""A walk round a block that ends where it began, mapped with drift: the map does not know that it is the same place."""

from dataclasses import dataclass

import numpy as np
from small_world import CAMERA, SCALES, SmallMap, SmallWorld

from stillroom.data.map import Map
from stillroom.data.sensor import Sensor
from stillroom.features.places.growth import GrowthConfig
from stillroom.features.places.place_index import PlaceMemory
from stillroom.features.places.vocabulary import Vocabulary
from stillroom.geometry import se3, sim3
from stillroom.loops.verification import Loop
from stillroom_train.vocabulary import train

RADIUS_M = 5.0


def poses_of_ring(n: int, laps: float, radius_m: float = RADIUS_M) -> np.ndarray:
    """T_world_cam (N, 4, 4) of cameras on a circle, looking outward, the first one at the origin."""
    poses = []
    for angle in np.linspace(0.0, 2.0 * np.pi * laps, n):
        T_centre_cam = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, angle, 0.0]))
        T_centre_cam[:3, 3] = radius_m * T_centre_cam[:3, 2]
        poses.append(T_centre_cam)
    return se3.inverse(poses[0]) @ np.array(poses)


def ring_world(seed: int, n: int, radius_m: float = RADIUS_M) -> SmallWorld:
    """Points on a thick cylinder around the ring, each with a random descriptor."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.uniform(0, 2 * np.pi, n), radius_m + rng.uniform(2.0, 4.0, n)
    centre_m = np.array([0.0, 0.0, -radius_m])
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

    def scales(self) -> np.ndarray:
        """How long a metre around each keyframe is in the map, by the points that it sees; NaN of a culled one."""
        world, found = self.map, []
        for k, T_true in enumerate(self.T_true):
            own = world.points_of(k)
            seen_m = self.small.world.points_m[self.small.seen[k][own >= 0]]
            far = np.linalg.norm(world.points.position_m[own[own >= 0]] - world.keyframes.T_world_cam[k, :3, 3], axis=1)
            found.append(np.median(far / np.linalg.norm(seen_m - T_true[:3, 3], axis=1)) if len(far) else np.nan)
        return np.array(found)

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


def monocular_ring(
    seed: int = 0, n: int = 44, laps: float = 1.15, drift: float = 0.2, unit: float = 0.4, radius_m: float = RADIUS_M
) -> Ring:
    """Map the walk without depth: lengths are in a unit of the map, which grows evenly, in the end by e to `drift`."""
    world, T_true = ring_world(seed, round(600 * radius_m), radius_m), poses_of_ring(n, laps, radius_m)
    small = SmallMap(world, Map(SCALES, Sensor.MONOCULAR))
    first_round = int(np.ceil(n / laps))
    for k, pose in enumerate(T_true):
        if k == first_round - 6:
            forgotten = np.unique(np.concatenate(small.seen[: n // 5]))
            small.id_of[forgotten] = -1
        small.add(pose, noise_px=0.3, flips=8, depth_share=0.0)
    stretch(small.map, unit, drift)
    places = PlaceMemory(vocabulary_of(world), small.map)
    places.remember_all()
    return Ring(small, T_true, places)


def stretch(world: Map, unit: float, drift: float) -> None:
    """Let a map drift in scale evenly along the way: at each keyframe about its camera, where images do not tell."""
    T, n = world.keyframes.T_world_cam.copy(), len(world.keyframes)
    S = np.empty_like(T)
    S[0] = sim3.of(T[0], unit)
    step = sim3.exp(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, drift / (n - 1)]]))[0]
    for k in range(1, n):
        S[k] = S[k - 1] @ se3.inverse(T[k - 1]) @ T[k] @ step
    rows = world.oldest_observations(np.arange(len(world.points)))
    motion = (S @ se3.inverse(T))[world.keypoints.keyframe[rows]]
    world.points.position_m[:] = np.einsum("nij,nj->ni", motion[:, :3, :3], world.points.position_m) + motion[:, :3, 3]
    world.keyframes.T_world_cam[:] = sim3.rigid(S)
    world.refresh_geometry(np.arange(len(world.points)))


def bend(world: Map, twist: np.ndarray) -> None:
    """Let a map drift evenly along the way, in the end by the whole twist; points go with who saw them first."""
    n = len(world.keyframes)
    drift = np.stack([se3.exp(twist * k / (n - 1)) for k in range(n)])
    rows = world.oldest_observations(np.arange(len(world.points)))
    motion = drift[world.keypoints.keyframe[rows]]
    world.points.position_m[:] = np.einsum("nij,nj->ni", motion[:, :3, :3], world.points.position_m) + motion[:, :3, 3]
    world.keyframes.T_world_cam[:] = drift @ world.keyframes.T_world_cam
    world.refresh_geometry(np.arange(len(world.points)))


def false_loop(made: Ring, keyframe: int, candidate: int) -> Loop:
    """A keyframe that is said to see what another one sees, near where it would be seen from there."""
    world = made.map
    T_world_cam = world.keyframes.T_world_cam[candidate] @ se3.exp(np.array([0.1, 0.0, 0.1, 0.0, 0.05, 0.0]))
    own = world.points_of(candidate)
    points = own[own >= 0]
    px = CAMERA.project(se3.transform(se3.inverse(T_world_cam), world.points.position_m[points]))
    rows = np.arange(world.rows(keyframe).start, world.rows(keyframe).stop)
    nearest = np.linalg.norm(world.keypoints.px[rows][None] - px[:, None], axis=2).argmin(axis=1)
    _, once = np.unique(nearest, return_index=True)
    return Loop(keyframe, candidate, T_world_cam, rows[nearest[once]], points[once].astype(np.int32), len(once))


def vocabulary_of(world: SmallWorld) -> Vocabulary:
    """A vocabulary of a world's own descriptors."""
    images = [world.descriptors[start : start + 100] for start in range(0, len(world.descriptors), 100)]
    return train(images, GrowthConfig(branching=8, depth=3, min_descriptors=8, iterations=3))
