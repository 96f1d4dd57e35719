"""A run of `oc-slam` on a rendered sequence, its moving pixels held against what the renderer knows."""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.datasets.selection import select
from stillroom.geometry import se3
from stillroom.presets.registry import configure
from stillroom.system import build
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.room import FrameTruth, SyntheticRoom
from stillroom_scenes.scene.people.figures import Figure, HandledObject

REST_S = 3.0
"""So long after it was let go a thing may still be taken for a moving one."""


@dataclass
class Count:
    """Pixels with depth: how many truly move, are said to, and both."""

    true: int = 0
    said: int = 0
    both: int = 0

    @property
    def precision(self) -> float:
        return self.both / self.said if self.said else 1.0

    @property
    def recall(self) -> float:
        return self.both / self.true if self.true else 1.0

    def add(self, said: np.ndarray, true: np.ndarray) -> None:
        self.true += int(true.sum())
        self.said += int(said.sum())
        self.both += int((said & true).sum())


@dataclass(eq=False)
class Seen:
    """One tracked image: its time, which pixels are said to move (H, W), what each shows, which have depth.

    `handled` are the pixels of figures, and of what they handle just then.
    """

    time_s: float
    said: np.ndarray
    instance: np.ndarray
    known: np.ndarray
    handled: np.ndarray


@dataclass(eq=False)
class MaskedRun:
    """All that came of a run.

    Attributes:
        room: Where.
        truths: What the renderer knows of each image that was given.
        images: Those that were tracked.
        cloud: The dense map, in the renderer's world.
    """

    room: SyntheticRoom
    truths: tuple[FrameTruth, ...]
    images: list[Seen] = field(default_factory=list)
    cloud: DenseCloud | None = None

    def of_figures(self) -> Count:
        """Against all figures, and what they handle just then: what a detector is told of."""
        count = Count()
        for image in self.images:
            count.add(image.said & image.known, image.handled & image.known)
        return count

    def of_what_goes(self) -> Count:
        """Against what has gone a way within the last second; other figures, and what was let go lately, are no matter.

        What stands from the beginning, and what no class names, cannot be known to be able to move.
        """
        figures, things = self.room.scene.figures, self.room.scene.objects
        count = Count()
        for image in self.images:
            goes, may = np.zeros(256, dtype=bool), np.zeros(256, dtype=bool)
            for thing in (*figures, *things):
                goes[thing.instance] = all(_way_m(thing, image.time_s, back_s) > 0.1 * back_s for back_s in (0.5, 1.0))
            may[[figure.instance for figure in figures]] = True
            for thing in things:
                may[thing.instance] = thing.handling.taken_s < image.time_s < thing.handling.left_s + REST_S
                goes[thing.instance] &= thing.is_moving(image.time_s)
            count.add(image.said & image.known & (goes | ~may)[image.instance], goes[image.instance] & image.known)
        return count

    def share_of(self, instances: range, from_s: float, to_s: float) -> float:
        """Return the share of some instances' pixels that are said to move between two times."""
        count = Count()
        for image in self.images:
            if from_s <= image.time_s < to_s:
                count.add(image.said & image.known, np.isin(image.instance, instances) & image.known)
        assert count.true > 0, "nothing of them is seen in that time"
        return count.recall


def _way_m(thing: Figure | HandledObject, time_s: float, back_s: float) -> float:
    before, now = thing.place(max(0.0, time_s - back_s)), thing.place(time_s)
    return float(np.linalg.norm(now[:3, 3] - before[:3, 3]))


@lru_cache(maxsize=1)
def truths_of(spec: str, frames: str) -> tuple[FrameTruth, ...]:
    """What the renderer knows of some frames."""
    room = open_synthetic(spec)
    return tuple(room.truth(index) for index in range(len(room))[slice(*map(int, frames.split(":")))])


def masked_run(spec: str, detector: str, frames: str) -> MaskedRun:
    """Run `oc-slam` with a detector, `truth` or `nothing`, over some frames of a sequence, `a:b:step`."""
    room, truths = open_synthetic(spec), truths_of(spec, frames)
    shown = select(room, frames)
    newest = _Newest()
    config = configure("oc-slam", None, [f"semantics.kind={detector}"], seed=0)
    system = build(config, room.camera, observer=newest)
    run = MaskedRun(room, truths)
    for place, truth in enumerate(truths):
        image = shown.load(place)
        system.process(image)
        if not newest.tracked.lost:
            said = newest.tracked.motion.moving.copy()
            run.images.append(Seen(image.timestamp_s, said, truth.instance, image.depth_m > 0, truth.moving))
    system.dense_mapper.refresh()
    cloud = system.dense_mapper.cloud()
    assert cloud is not None
    # The run's world is its first camera.
    run.cloud = replace(cloud, positions_m=se3.transform(truths[0].T_world_cam, cloud.positions_m.astype(np.float64)))
    return run


class _Newest:
    tracked: Tracked

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        self.tracked = tracked
