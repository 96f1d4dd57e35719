"""Finding the camera again when it was lost: by places, by the last keyframes, or by starting a new piece of map."""

from dataclasses import dataclass, field, replace

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.map import Map
from stillroom.data.result import Recovery, Tracked, TrackingState
from stillroom.data.semantics import Semantics
from stillroom.features.places.place_memory import PlaceMemory
from stillroom.protocols import Parts, Pending
from stillroom.tracking.correspondences import with_keyframe
from stillroom.tracking.recognition import Found, RecognitionConfig, solve_pnp
from stillroom.tracking.tracker import Tracker


@dataclass(frozen=True)
class RelocalizerConfig:
    """How a lost camera is found.

    Attributes:
        n_places: Places that look alike to try.
        recognition: When one is taken for recognised.
        n_keyframes: Newest keyframes to try where no place was recognised.
        min_matches: Matches that such a keyframe needs.
        reprojection_px: RANSAC's tolerance with them.
        min_inliers: Points that must agree with such a pose before it is refined.
        patience: Frames that show enough and are not recognised before a sub-map is begun; 0: never.
    """

    n_places: int = bounded(5, least=0)
    recognition: RecognitionConfig = field(default_factory=RecognitionConfig)
    n_keyframes: int = bounded(10, least=0)
    min_matches: int = bounded(20, least=0)
    reprojection_px: float = bounded(4.0, above=0)
    min_inliers: int = bounded(15, least=0)
    patience: int = bounded(20, least=0)

    def build(self, parts: Parts, tracker: Tracker, places: PlaceMemory) -> "Relocalizer":
        """Return a relocalizer that asks the memory of places and refines its finds with the tracker."""
        return Relocalizer(self, parts, tracker, places)


class Relocalizer:
    """Asked with every frame on which tracking failed. Sieves do not reject while it searches (`Stage.RELOCALIZATION`).

    The place that looks most alike is tried first, wherever the camera was last: matching, PnP, a guided search. Then
    come the newest keyframes, each with all its descriptors: after a short gap they know more than words do.
    """

    def __init__(self, config: RelocalizerConfig, parts: Parts, tracker: Tracker, places: PlaceMemory) -> None:
        """Keep what recovering needs."""
        self.config, self.tracker, self.places, self.seed = config, tracker, places, parts.seed
        self._recognizer = config.recognition.build(parts)
        self._n_in_vain = 0

    def recover(self, tracked: Tracked, semantics: Pending[Semantics], world: Map) -> Tracked:
        """Return the lost frame with a pose, or as it was when nothing recognises it.

        After some frames in vain one that shows enough begins a sub-map.
        """
        found = self.by_place(tracked, semantics, world) or self._by_last_keyframes(tracked, semantics, world)
        if found is None:
            found = self._anew(tracked, semantics, world)
        if found is None:
            return tracked
        self._n_in_vain = 0
        return found

    def by_place(self, tracked: Tracked, semantics: Pending[Semantics], world: Map) -> Tracked | None:
        """Return the frame where a place was recognised."""
        frame, index = tracked.frame, self.places.index
        bag = self.places.bag_of_frame(frame)
        for keyframe in self.places.candidates(bag, at_most=self.config.n_places):
            if int(keyframe) not in index:
                continue  # culled by another thread just now
            nodes = index.nodes(int(keyframe))
            found = self._recognizer.recognise(frame, bag, int(keyframe), nodes, world)
            located = None if found is None else self._located(tracked, found, semantics, world, Recovery.PLACE)
            if located is not None:
                return located
        return None

    def _by_last_keyframes(self, tracked: Tracked, semantics: Pending[Semantics], world: Map) -> Tracked | None:
        config = self.config
        for keyframe in world.alive_keyframes()[::-1][: config.n_keyframes]:
            matches = with_keyframe(tracked.frame, int(keyframe), world)
            if len(matches) < config.min_matches:
                continue
            solved = solve_pnp(
                tracked.frame, matches, world, config.reprojection_px, 300, config.min_inliers, self.seed
            )
            if solved is None:
                continue
            T_cam_world, inlier = solved
            point_ids = np.full(len(tracked.frame), -1, dtype=np.int32)
            point_ids[matches.keypoint[inlier]] = matches.point_id[inlier]
            found = Found(T_cam_world, point_ids)
            located = self._located(tracked, found, semantics, world, Recovery.LAST_KEYFRAMES)
            if located is not None:
                return located
        return None

    def _located(
        self, tracked: Tracked, found: Found, semantics: Pending[Semantics], world: Map, recovery: Recovery
    ) -> Tracked | None:
        """Return the frame under a pose that its local map confirms."""
        located = self.tracker.locate(tracked.frame, found.T_cam_world, found.point_ids, semantics, world, recovery)
        return None if located.lost else located

    def _anew(self, tracked: Tracked, semantics: Pending[Semantics], world: Map) -> Tracked | None:
        """Return the frame as the first of a sub-map, when that is due and it shows enough."""
        if self.config.patience == 0:
            return None
        frame = tracked.frame
        n_usable = int((frame.is_static & (frame.keypoints.depth_m > 0)).sum())
        if n_usable < self.tracker.config.min_initial_keypoints:
            return None
        self._n_in_vain += 1
        if self._n_in_vain <= self.config.patience:
            return None
        started = self.tracker.start(frame, semantics, world)
        if started.state is not TrackingState.OK:
            return None
        return replace(started, recovery=Recovery.NEW_SUBMAP)
