"""Merging sub-maps: when a keyframe of one shows a place of another, they become one."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.map import Map, submaps
from stillroom.features.places.place_index import PlaceMemory
from stillroom.geometry import se3
from stillroom.loops.correction import fuse_group
from stillroom.loops.freedom import freedom_of
from stillroom.loops.global_bundle import GlobalBundle
from stillroom.loops.verdict import LinkChange, Snapshot, judge
from stillroom.loops.verification import Loop, VerificationConfig
from stillroom.optimize.bundle import BundleConfig
from stillroom.protocols import Parts

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class JoiningConfig:
    """When sub-maps are merged.

    Attributes:
        enabled: Whether they are.
        n_places: Candidate places to try with each new keyframe.
        verification: What counts as the same place; as many points as relocalization requires.
        max_lost_share: Largest share of observations that may become outliers; beyond, the merge is undone.
        min_kept_share: Least share of the fused observations that must be inliers afterwards.
        bundle: The optimiser that adjusts both together.
    """

    enabled: bool = True
    n_places: int = bounded(5, least=1)
    verification: VerificationConfig = field(default_factory=lambda: VerificationConfig(min_total=50))
    max_lost_share: float = bounded(0.05, least=0, most=1)
    min_kept_share: float = bounded(0.5, least=0, most=1)
    bundle: BundleConfig = field(default_factory=BundleConfig)

    def build(self, parts: Parts, places: PlaceMemory, after: Sequence[Callable[[], object]] = ()) -> "SubmapJoiner":
        """Return the joiner of a map's sub-maps.

        Args:
            parts: What it is built of.
            places: The place index of the keyframes.
            after: Called when sub-maps were merged, to update what depends on keyframe poses.
        """
        return SubmapJoiner(self, parts, places, after)


class SubmapJoiner:
    """Called with every new keyframe, in order; costs nothing while there is a single sub-map.

    Attributes:
        joined: The loop behind each merge.
    """

    def __init__(
        self,
        config: JoiningConfig,
        parts: Parts,
        places: PlaceMemory,
        after: Sequence[Callable[[], object]],
    ) -> None:
        """Start without merges."""
        self.config, self.camera, self.world, self.places = config, parts.camera, parts.world, places
        self.joined: list[Loop] = []
        self._verifier = config.verification.build(parts)
        self._adjust = config.bundle.build()
        self._after = tuple(after)

    def join(self, keyframe: int) -> bool:
        """Check whether a keyframe shows a place of another sub-map; if so, merge the younger into the older."""
        if not self.config.enabled:
            return False
        with self.world.lock.between_frames():
            place = self._joined(keyframe)
        if place is None:
            return False
        self.joined.append(place)
        for follow in self._after:
            follow()
        return True

    def _joined(self, keyframe: int) -> Loop | None:
        """Merge where a keyframe shows a place of another sub-map, and return the place; None where it shows none."""
        table, index = self.world.keyframes, self.places.index
        if self.world.n_submaps < 2 or keyframe not in index:
            return None
        elsewhere = table.is_alive & (table.submap != table.submap[keyframe])
        if not elsewhere.any():
            return None
        for candidate in self.places.candidates(index.bag(keyframe), elsewhere, self.config.n_places):
            place = self._verifier.verify(keyframe, int(candidate), index, self.world)
            if place is not None and self._join(place):
                return place
        return None

    def _join(self, place: Loop) -> bool:
        """Merge for a place, and undo it where too many earlier inliers are lost."""
        world = self.world
        before = Snapshot(world)
        kept = lay_together(place, world)
        neighbours = world.covisibility.neighbours
        there = [place.candidate, *neighbours(place.candidate)]
        here = [place.keyframe, *neighbours(place.keyframe)]
        fuse_group(place, there, here, self.camera, world)
        links = LinkChange.since(before, world)
        members = np.flatnonzero(world.keyframes.is_alive & (world.keyframes.submap == kept))
        bundle = GlobalBundle(members, world)
        bundle.commit(bundle.solve(self.camera, self._adjust), world)
        verdict = judge(before, links, world, self.camera)
        right = verdict.lost_share <= self.config.max_lost_share
        right &= verdict.kept_share >= self.config.min_kept_share
        if right:
            T_world_old = before.T_world_cam[place.keyframe]
            world.jumps.append(world.keyframes.T_world_cam[place.keyframe] @ se3.inverse(T_world_old))
        else:
            before.restore(world)
        logger.info(
            "keyframe %d shows the place of %d in another sub-map, %d points: %s, %s",
            place.keyframe,
            place.candidate,
            len(place.rows),
            verdict,
            "joined" if right else "undone",
        )
        return right


def lay_together(place: Loop, world: Map) -> int:
    """Align the younger of two sub-maps with the older one by a place that both show; return the older one's id."""
    table = world.keyframes
    own, other = int(table.submap[place.keyframe]), int(table.submap[place.candidate])
    T_other_own = place.correction(world)
    if other < own:
        submaps.join(own, other, T_other_own, place.scale, place.candidate, world)
    else:
        T_own_other = freedom_of(world).group.inverse(T_other_own)
        submaps.join(other, own, T_own_other, 1.0 / place.scale, place.keyframe, world)
    return min(own, other)
