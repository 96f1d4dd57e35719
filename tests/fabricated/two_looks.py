"""Two looks at one small world: the keypoints of the present one, and where the same points were in the first."""

from dataclasses import dataclass, replace

import numpy as np
from asked import ask
from building import parts
from flat_wall import in_box
from small_world import CAMERA, SCALES, SmallWorld, pose

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Box, Semantics
from stillroom.dynamics.paper_epipolar import PaperEpipolarConfig
from stillroom.geometry import se3
from stillroom.protocols import MatchSieve
from stillroom.schedule import Done

WORLD = SmallWorld.of(3, 700, near_m=1.2)
THEN, NOW = pose(), pose(0.12, -0.05, 0.03, turn=(0.01, -0.02, 0.015))
BOX = Box(200, 0, 419, 479, "person", 0.9)
CROWD = Semantics(480, 640, (BOX,))


@dataclass(frozen=True)
class Pair:
    """Two looks at one world: the present frame, and where its keypoints were before."""

    frame: Frame
    matches: Matches
    T_world_now: np.ndarray

    @property
    def inside(self) -> np.ndarray:
        """Which keypoints lie in the box."""
        return in_box(self.frame, BOX)

    def moved(self, keypoints: np.ndarray, by_px: float) -> "Pair":
        """Shift keypoints (K,) at right angles to their epipolar lines."""
        px = self.frame.keypoints.px.copy()
        px[keypoints] += (by_px * normals(self.matches.reference_px[keypoints], self.T_world_now)).astype(np.float32)
        return replace(self, frame=replace(self.frame, keypoints=replace(self.frame.keypoints, px=px)))

    def ask(
        self,
        stage: Stage = Stage.MOTION_MODEL,
        sieve: MatchSieve | None = None,
        matches: Matches | None = None,
        semantics: Semantics = CROWD,
    ) -> Motion:
        sieve = sieve or PaperEpipolarConfig().build(parts())
        matches = matches or self.matches
        return ask(sieve, stage, self.frame, matches, Done(semantics), np.eye(4), Map(SCALES))


def normals(then_px: np.ndarray, T_world_now: np.ndarray) -> np.ndarray:
    """Unit normals (N, 2) of the epipolar lines in the present image: each through two places of its point's ray."""
    T_now_then = np.linalg.inv(T_world_now) @ THEN
    ends = [
        CAMERA.project(se3.transform(T_now_then, CAMERA.back_project(then_px, np.full(len(then_px), z_m))))
        for z_m in (1.0, 9.0)
    ]
    along = ends[1] - ends[0]
    return np.stack((-along[:, 1], along[:, 0]), axis=1) / np.linalg.norm(along, axis=1, keepdims=True)


def static_pair(T_world_now: np.ndarray = NOW) -> Pair:
    """All stands still, without noise."""
    before, before_seen = WORLD.look(THEN, seed=1, index=6)
    now, now_seen = WORLD.look(T_world_now, seed=2, index=7)
    place = {int(point): k for k, point in enumerate(before_seen)}
    known = np.array([int(point) in place for point in now_seen])
    columns = {name: getattr(now.keypoints, name)[known] for name in vars(now.keypoints)}
    now = replace(now, keypoints=replace(now.keypoints, **columns), is_static=now.is_static[known])
    reference_px = before.keypoints.px[[place[int(point)] for point in now_seen[known]]]
    number = np.arange(len(now), dtype=np.int32)
    return Pair(now, Matches(number, number, reference_px), T_world_now)
