"""Things that stand and go before a flat wall, with the clusters they would fall into; the camera is still."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from asked import ask
from flat_wall import before_the_wall, points_on_the_wall
from small_world import BLACK, SmallMap, pose

from stillroom.data.clusters import PLANE, UNKNOWN, Clusters
from stillroom.data.frame import Frame
from stillroom.data.image import RgbdImage
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Box, Semantics
from stillroom.geometry import se3
from stillroom.protocols import MatchSieve
from stillroom.schedule import Done

WALL = points_on_the_wall(5, 900)
HOME = pose()
STEP_S = 0.1


@dataclass(frozen=True)
class Thing:
    """A flat thing that faces the camera: where its left upper corner is [px], how large, how far away."""

    x: int
    y: int
    width: int = 120
    height: int = 240
    depth_m: float = 1.5

    @property
    def window(self) -> tuple[slice, slice]:
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    @property
    def box(self) -> Box:
        return Box(self.x, self.y, self.x + self.width - 1, self.y + self.height - 1, "person", 0.9)


def clusters_of(labels: np.ndarray, box: Sequence[int]) -> Clusters:
    """Clusters of a label image; which box covers each (K,)."""
    n, nowhere = len(box), np.zeros((len(box), 3), dtype=np.float32)
    size = np.array([(labels == k).sum() for k in range(n)], dtype=np.int32)
    planes = np.array([[0.0, 0.0, -1.0, 3.0]], dtype=np.float32)
    return Clusters(labels, size, nowhere, nowhere, nowhere, np.array(box, dtype=np.int32), planes)


@lru_cache
def empty_wall() -> tuple[Frame, np.ndarray]:
    """Return the wall seen from home, and which point of it each keypoint is (N,)."""
    frame, points = WALL.look(HOME, seed=9)
    return before_the_wall(frame, HOME), points


def seen(things: Sequence[Thing], time_s: float, boxes: Sequence[int] = (), rim_px: int = 0) -> tuple[Frame, Semantics]:
    """Return a frame and what is known of it.

    Args:
        things: What stands before the wall; each is a cluster, the wall a plane.
        time_s: When.
        boxes: Which of the things a detector sees.
        rim_px: How wide a rim around each thing belongs to nothing.
    """
    frame, _ = empty_wall()
    depth_m, labels = frame.image.depth_m.copy(), np.full((480, 640), PLANE, dtype=np.int16)
    for thing in things:
        y, x = thing.window
        around = slice(max(0, y.start - rim_px), y.stop + rim_px), slice(max(0, x.start - rim_px), x.stop + rim_px)
        labels[around] = UNKNOWN
    for k, thing in enumerate(things):
        depth_m[thing.window], labels[thing.window] = thing.depth_m, k
    column, row = np.rint(frame.keypoints.raw_px).astype(int).T
    keypoints = replace(frame.keypoints, depth_m=depth_m[row, column])
    image = RgbdImage(time_s, BLACK, depth_m, round(time_s * 30))
    covered = [list(boxes).index(k) if k in boxes else -1 for k in range(len(things))]
    semantics = Semantics(480, 640, tuple(things[k].box for k in boxes), clusters=clusters_of(labels, covered))
    return replace(frame, image=image, keypoints=keypoints), semantics


def on(frame: Frame, thing: Thing) -> np.ndarray:
    """Which keypoints (N,) lie on a thing, one after the other."""
    y, x = thing.window
    raw_px = np.rint(frame.keypoints.raw_px)
    return np.array([x.start <= u < x.stop and y.start <= v < y.stop for u, v in raw_px])


@dataclass
class Play:
    """A sieve that is shown things over time, ten images a second, all keypoints on the wall matched with the map."""

    sieve: MatchSieve
    time_s: float = 1.0
    small: SmallMap = field(default_factory=lambda: SmallMap.of(WALL, [HOME]))

    def show(
        self,
        *things: Thing,
        boxes: Sequence[int] = (),
        rim_px: int = 0,
        stage: Stage = Stage.LOCAL_MAP,
        matched: Callable[[Frame], np.ndarray] | None = None,
        T_world_cam: np.ndarray = HOME,
    ) -> tuple[Motion, Frame]:
        """Show the next image and return the verdict; matched keypoints are those on no thing if not said."""
        self.time_s += STEP_S
        frame, semantics = seen(things, self.time_s, boxes, rim_px)
        return self.ask(frame, semantics, stage, matched, T_world_cam), frame

    def ask(
        self,
        frame: Frame,
        semantics: Semantics,
        stage: Stage = Stage.LOCAL_MAP,
        matched: Callable[[Frame], np.ndarray] | None = None,
        T_world_cam: np.ndarray = HOME,
    ) -> Motion:
        clusters = semantics.clusters
        if matched is not None:
            use = matched(frame)
        elif clusters is not None:
            use = clusters.labels_at(frame.keypoints.raw_px) == PLANE
        else:
            use = ~semantics.movable_at(frame.keypoints.raw_px)
        matches = Matches.of(np.where(use, self.small.id_of[empty_wall()[1]], -1))
        world = self.small.map
        return ask(self.sieve, stage, frame, matches, Done(semantics), se3.inverse(T_world_cam), world)

    def during(self, seconds: float, *things: Thing, boxes: Sequence[int] = ()) -> tuple[Motion, Frame]:
        """Show the same for a while and return the last verdict."""
        for _ in range(round(seconds / STEP_S)):
            last = self.show(*things, boxes=boxes)
        return last


def share(motion: Motion, thing: Thing) -> float:
    """Return the share of a thing's pixels that move."""
    return float(motion.moving[thing.window].mean())
