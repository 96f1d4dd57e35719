"""A map with an eventful life, and what it means for two maps to be the same."""

from dataclasses import dataclass, field

import numpy as np
from small_world import SmallMap, SmallWorld, pose

from stillroom.data.map import Map
from stillroom.geometry import se3
from stillroom.storage.schema import FrameNote, Session

COUNTS = ("n_visible", "n_found")
POINT_COLUMNS = (
    "position_m",
    "descriptors",
    "normal",
    "min_distance_m",
    "max_distance_m",
    "first_row",
    "n_observations",
    "n_keyframes",
    "first_keyframe",
)
KEYPOINT_COLUMNS = (
    "keyframe",
    "px",
    "octave",
    "angle_rad",
    "right_px",
    "depth_m",
    "descriptors",
    "is_static",
    "point",
    "next_row",
)
KEYFRAME_COLUMNS = ("timestamp_s", "image_index", "first_row", "n_rows", "is_alive", "parent", "submap", "T_world_cam")


@dataclass
class EventfulLife:
    """Does to a map what tracking, mapping and loop closing do, at random."""

    seed: int
    n_points: int = 250
    small: SmallMap = field(init=False)
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.small = SmallMap(SmallWorld.of(self.seed, n=self.n_points))
        for _ in range(5):
            self.add_keyframe()

    @property
    def world(self) -> Map:
        return self.small.map

    def happen(self, n: int) -> None:
        """Let `n` things happen."""
        deeds = [
            self.add_keyframe,
            self.remove_keyframe,
            self.remove_points,
            self.replace_points,
            self.remove_observations,
            self.observe,
            self.adjust,
            self.find,
            self.connect,
            self.refresh,
            self.close_loop,
        ]
        for _ in range(n):
            deeds[self.rng.integers(len(deeds))]()

    def add_keyframe(self) -> None:
        gone = np.flatnonzero(self.small.id_of >= 0)
        gone = gone[~self.world.points.is_alive[self.small.id_of[gone]]]
        self.small.id_of[gone] = -1
        x, y = self.rng.uniform(-0.3, 0.3, 2)
        self.small.add(pose(x=x, y=y), depth_share=0.7)

    def remove_keyframe(self) -> None:
        alive = self.world.alive_keyframes()
        if len(alive) > 3:
            self.world.remove_keyframe(int(self.rng.choice(alive[1:])))

    def some_points(self, n: int) -> np.ndarray:
        alive = np.flatnonzero(self.world.points.is_alive)
        return self.rng.permutation(alive)[:n]

    def remove_points(self) -> None:
        self.world.remove_points(self.some_points(5))

    def replace_points(self) -> None:
        chosen = self.some_points(12)
        half = len(chosen) // 2
        self.world.replace_points(chosen[:half], chosen[half : 2 * half])

    def remove_observations(self) -> None:
        rows = np.flatnonzero(self.world.keypoints.point >= 0)
        self.world.remove_observations(self.rng.permutation(rows)[:20])

    def observe(self) -> None:
        """Let keyframes see points that others saw before, as fusing does."""
        table = self.world.keypoints
        free = np.flatnonzero((table.point < 0) & self.world.keyframes.is_alive[table.keyframe])
        rows = self.rng.permutation(free)[:10]
        points = self.some_points(len(rows)).astype(np.int32)
        self.world.observe(points, rows[: len(points)])

    def adjust(self) -> None:
        moved, world = self.some_points(40), self.world
        world.points.position_m[moved] += self.rng.normal(scale=0.01, size=(len(moved), 3))
        keyframe = int(self.rng.choice(world.alive_keyframes()))
        step = se3.exp(self.rng.normal(scale=0.01, size=6))
        world.keyframes.T_world_cam[keyframe] = step @ world.keyframes.T_world_cam[keyframe]
        world.refresh_geometry(moved)

    def find(self) -> None:
        seen = self.some_points(30)
        self.world.points.n_visible[seen] += 1
        self.world.points.n_found[seen[:15]] += 1

    def connect(self) -> None:
        self.world.connect(int(self.rng.choice(self.world.alive_keyframes())))

    def refresh(self) -> None:
        self.world.refresh(self.some_points(20).astype(np.int32))

    def close_loop(self) -> None:
        first, second = (int(k) for k in self.rng.permutation(self.world.alive_keyframes())[:2])
        self.world.loop_edges.append((first, second))
        self.world.keyframes.submap[second] = self.rng.integers(3)


def session(first_keyframe: int = 0, name: str = "room") -> Session:
    """A session with something in every field."""
    when, config = "2026-01-02T03:04:05+01:00", 'seed = 7\nname = "é"'
    return Session(
        first_keyframe, when, "0.1", "abc", name, "oc-slam", 7, "mine.vocabulary", "0123456789abcdef", config
    )


def notes(n: int, number: int = 0, first: int = 0) -> list[FrameNote]:
    """Frames `first` and on of a session, all on keyframe 0."""
    poses = [se3.exp(np.full(6, 0.01 * (i + number))) for i in range(n)]
    return [FrameNote(number, first + i, (first + i) / 30.0, 0, poses[i]) for i in range(n)]


def assert_same_map(found: Map, expected: Map, with_counts: bool = True) -> None:
    """Everything that means something is the same, to the last bit; what is left of the dead means nothing."""
    assert found.scales == expected.scales
    for name in ("keyframes", "keypoints", "points"):
        assert len(getattr(found, name)) == len(getattr(expected, name)), name
    for name in KEYFRAME_COLUMNS:
        np.testing.assert_array_equal(getattr(found.keyframes, name), getattr(expected.keyframes, name), name)
    culled = ~expected.keyframes.is_alive
    np.testing.assert_array_equal(found.keyframes.T_parent_cam[culled], expected.keyframes.T_parent_cam[culled])
    rows = expected.keyframes.is_alive[expected.keypoints.keyframe]
    for name in KEYPOINT_COLUMNS:
        column = getattr(found.keypoints, name)
        np.testing.assert_array_equal(column[rows], getattr(expected.keypoints, name)[rows], name)
        assert column.dtype == getattr(expected.keypoints, name).dtype
    assert not np.any(found.keypoints.point[~rows] >= 0)
    alive = expected.points.is_alive
    np.testing.assert_array_equal(found.points.is_alive, alive)
    for name in (*POINT_COLUMNS, *(COUNTS if with_counts else ())):
        np.testing.assert_array_equal(getattr(found.points, name)[alive], getattr(expected.points, name)[alive], name)
    np.testing.assert_array_equal(found.covisibility.edges(), expected.covisibility.edges())
    assert found.loop_edges == expected.loop_edges
