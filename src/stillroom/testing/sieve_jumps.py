"""The contract of every `MatchSieve` when the map jumps: a correction moves it at once.

In a test of your own::

    from stillroom.testing.sieve_jumps import check_follows_jumps

    def test_my_sieve_follows():
        check_follows_jumps(MySieveConfig().build)  # anything that builds a fresh one of parts
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from stillroom.config import SlamConfig
from stillroom.data.frame import Frame
from stillroom.data.image import Image
from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.dynamics.asking import Asking
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset, MatchSieve, Parts
from stillroom.system import build as build_system
from stillroom.testing.true_clusters import true_clusters

WALKING, FRAMES = "synthetic:walking,frames=20,fps=8,cache=off", "4:20"
"""Two seconds; figures walk in from both sides. The map jumps in the middle, when both are in view."""
SEED = 3
FAR = (0.7, -0.4, 1.1, 0.2, 0.9, -0.3)
"""Twist of the jump: as far as a loop ever moved a map, and farther [m, rad]."""


def check_follows_jumps(build: Callable[[Parts], MatchSieve], dataset: Dataset | None = None) -> int:
    """Check that a sieve gives the same results on a map that jumps as on one that does not.

    The camera is tracked through a short rendered sequence with the sieve. A second instance gets the same questions on
    the same map, which is moved from the middle of the sequence on, with an entry in `Map.jumps`.

    Args:
        build: Returns a new sieve, built of parts.
        dataset: A rendered sequence of some 16 frames without loops; by default the package's own.

    Returns:
        Number of results after the jump in which something is dynamic.

    Raises:
        AssertionError: The sieve compares with data from before the jump without correcting its poses.
    """
    dataset = dataset or select(open_dataset(WALKING), FRAMES)
    first = dataset.load(0).index
    tracking = _JumpingTracking(build, jump_at=first + len(dataset) // 2)
    system = build_system(SlamConfig(dynamics=tracking), dataset.camera, _OneBoxAndClusters(dataset.camera))
    for place in range(len(dataset)):
        system.process(dataset.load(place))
    system.close()
    assert not system.map.jumps, "the sequence closes a loop; choose another one"
    return tracking.n_moving


class _OneBoxAndClusters:
    """Returns the first box only, as a detector that misses people would, and the clusters of a depth cloud."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera

    def __call__(self, image: Image) -> Semantics:
        assert image.truth is not None, f"image {image.index} has no ground truth: the sequence must be a rendered one"
        clusters = true_clusters(image, self.camera)
        return Semantics(image.height, image.width, image.truth.boxes[:1], clusters=clusters)


class _JumpingTracking:
    """Replaces the tracker's sieve: passes each question to the sieve, and to a second instance after the jump."""

    def __init__(self, build: Callable[[Parts], MatchSieve], jump_at: int) -> None:
        self.build_one, self.jump_at, self.n_moving = build, jump_at, 0
        self.jump = se3.exp(np.array(FAR))

    def build(self, parts: Parts) -> MatchSieve:
        self.world, seeded = parts.world, replace(parts, seed=SEED)
        self.sieve, self.twin = (Asking(self.build_one(seeded), parts.world) for _ in range(2))
        return self

    def judge(self, question: Question) -> Motion:
        index = question.frame.image.index
        motion = self.sieve.judge(question)
        if index < self.jump_at:
            other = self.twin.judge(question)
        else:
            self.n_moving += bool(motion.moving.any())
            with _jumped(self.world, self.jump):
                other = self.twin.judge(replace(question, T_cam_world=question.T_cam_world @ se3.inverse(self.jump)))
        where = f"image {index}, {question.stage.name}: after the map jumped at {self.jump_at}, the sieve"
        n = int(np.count_nonzero(motion.is_static != other.is_static))
        assert n == 0, f"{where} says otherwise of {n} keypoints"
        n = int(np.count_nonzero(motion.moving != other.moving))
        assert n == 0, f"{where} says otherwise of {n} pixels"
        return motion

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        self.sieve.remember(frame, T_cam_world, keyframe)
        if frame.image.index < self.jump_at:
            self.twin.remember(frame, T_cam_world, keyframe)
            return
        with _jumped(self.world, self.jump):
            self.twin.remember(frame, T_cam_world @ se3.inverse(self.jump), keyframe)

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: the sieve and the second instance have their own life cycle."""


@contextmanager
def _jumped(world: Map, T_new_old: F64) -> Iterator[None]:
    """Move a map for a while, as by a correction that moves all of it by a motion (4, 4)."""
    columns = world.keyframes.T_world_cam, world.points.position_m, world.points.normal
    before = [column.copy() for column in columns]
    columns[0][:] = T_new_old @ before[0]
    columns[1][:] = se3.transform(T_new_old, before[1])
    columns[2][:] = before[2] @ T_new_old[:3, :3].T
    world.jumps.append(T_new_old)
    try:
        yield
    finally:
        world.jumps.pop()
        for column, values in zip(columns, before, strict=True):
            column[:] = values
