"""How a map is begun with a single camera, whose depth comes from motion alone (ORB-SLAM's initialisation).

The camera must move: a first image is held, and later ones are matched with it, until the two tell a motion and points
(`geometry/two_views`). Both become keyframes, and the median depth of the points in the first one becomes the unit of
length (ORB-SLAM: Mur-Artal et al., T-RO 2015, section IV; docs/reference.md#orb-slam2-monocular).
"""

import logging
import math
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.data.map import Map, submaps
from stillroom.data.matches import Matches
from stillroom.data.motion import Stage
from stillroom.data.question import Question
from stillroom.data.result import FirstView, Tracked, TrackingState
from stillroom.data.semantics import Semantics
from stillroom.features.matching import NEAR_BITS, Queries, Targets, consistent_rotation, search_windows
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, I32, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.two_views.reconstruction import Refusal, TwoViewLimits, TwoViews, reconstruct
from stillroom.optimize import observations
from stillroom.optimize.bundle import BundleAdjuster, BundleConfig, BundleProblem
from stillroom.protocols import MatchSieve, Parts, Pending
from stillroom.tracking.start import Beginnings, Lost

log = logging.getLogger(__name__)
_FINEST = 0


@dataclass(frozen=True)
class MonocularConfig:
    """What is done otherwise with a single camera (ORB-SLAM2's numbers; docs/reference.md#orb-slam2-monocular).

    Attributes:
        features_before_map: Factor on `features.n_features` until there is a map.
        min_matches: Fewest matches with the first image; with fewer, the present image takes its place.
        window_px: Around where a keypoint was last matched, how far it is searched.
        ratio: Ratio test of those matches.
        n_samples: Samples of the RANSAC, for both models.
        min_parallax_deg: Parallax of the 51st best point, at least …
        shutter_s: … and beyond it the angle by which the camera turned in so long, on average between the two images:
            a camera that reads its rows one after the other fakes as much when it turns unevenly.
        min_points: Fewest points of a first map.
        start_again: A map that is lost with no more keyframes than this is dropped, and another begun.
        young_s: A map that is lost within so long of its beginning …
        young_patience: … is dropped too, once so many images that have enough keypoints are not recognised; 0: never.
        share: A keyframe is due when fewer than this share of the reference keyframe's points is tracked.
        min_gap: Frames between keyframes, at least.
        n_neighbours: Covisible keyframes to triangulate with, and to fuse with: depth comes from nowhere else.
        largest_cosine: Of the parallax of a point that is triangulated, at most: .57°. Where all is far for the way
            that the camera went, right pairs have less than ORB-SLAM2's 1.15°, and what is left are wrong ones.
        most_turned_deg: By how much the orientations of its keypoints may differ, less the camera's roll.
        trial_keyframes: A point is tested for so many keyframes …
        min_observations: … and must then be seen by more than so many.
        patience: Frames without recognition after which a sub-map is begun; 0: never, as in ORB-SLAM2.
        last_look: Whether every frame is fitted once more when a run ends, in any method: a frame's pose by a keyframe
            that was culled since is worse than the map.
    """

    features_before_map: int = bounded(2, least=1)
    min_matches: int = bounded(100, least=8)
    window_px: float = bounded(100.0, above=0, pixels=1)
    ratio: float = bounded(0.9, above=0, most=1)
    n_samples: int = bounded(200, least=1)
    min_parallax_deg: float = bounded(1.0, least=0)
    shutter_s: float = bounded(0.02, least=0)
    min_points: int = bounded(80, least=8)
    start_again: int = bounded(5, least=0)
    young_s: float = bounded(2.0, least=0)
    young_patience: int = bounded(10, least=0)
    share: float = bounded(0.9, least=0, most=1)
    min_gap: int = bounded(1, least=0)
    n_neighbours: int = bounded(20, least=0)
    largest_cosine: float = bounded(0.99995, above=0, most=1)
    most_turned_deg: float = bounded(20.0, above=0, most=180)
    trial_keyframes: int = bounded(3, least=1)
    min_observations: int = bounded(2, least=0)
    patience: int = bounded(0, least=0)
    last_look: bool = True

    def build(self, parts: Parts, sieve: MatchSieve) -> "TwoViewStart":
        """Return the stage that begins maps; it asks the sieve what moves."""
        return TwoViewStart(self, parts.camera, sieve, parts.seed, len(parts.world.keyframes))


@dataclass(frozen=True)
class _Held:
    """The image that is held, which of its keypoints take part (N,), and where they were last seen (N, 2) [px]."""

    tracked: Tracked
    takes_part: Bool
    last_px: F32


class TwoViewStart:
    """Begins a map with two images."""

    def __init__(
        self, config: MonocularConfig, camera: Camera, sieve: MatchSieve, seed: int, first_keyframe: int = 0
    ) -> None:
        """Start without an image; keyframes before the first one are those of earlier runs."""
        self.config, self.camera, self.sieve, self.seed = config, camera, sieve, seed
        self._first_keyframe = first_keyframe
        self._refusals: Counter[Refusal] = Counter()
        self._n_dropped = 0
        self._held: _Held | None = None
        self._limits = TwoViewLimits(
            sigma_px=camera.pixel_scale,
            n_samples=config.n_samples,
            min_parallax_rad=math.radians(config.min_parallax_deg),
        )
        self._adjust: BundleAdjuster = BundleConfig(iterations_first=10, iterations_second=10).build()

    @property
    def beginnings(self) -> Beginnings:
        """How often two images were refused, and maps dropped."""
        return Beginnings({reason.value: n for reason, n in sorted(self._refusals.items())}, self._n_dropped)

    def start(self, frame: Frame, semantics: Pending[Semantics], world: Map) -> Tracked:
        """Return the frame as the second of a map where it makes one with the image that is held; else without a pose.

        Args:
            frame: The frame, after sieve 1.
            semantics: What is potentially dynamic in it.
            world: The map, or the map in which no place was recognised.
        """
        nothing = np.full(len(frame), -1, dtype=np.int32)
        T_world_first = submaps.origin(world.n_submaps)
        motion = self.sieve.judge(
            Question(Stage.LOCAL_MAP, frame, Matches.of(nothing), semantics, T_world_first, world)
        )
        waiting = Tracked(frame, TrackingState.NOT_INITIALIZED, None, nothing, motion)
        first, second = self._matched(waiting)
        if self._held is None or len(first) < self.config.min_matches:
            self._hold(waiting)
            return waiting
        held = self._held.tracked
        found = self._reconstructed(held.frame, first, frame, second)
        if isinstance(found, TwoViews) and found.parallax_rad < self._needed_rad(found, held.frame, frame):
            found = Refusal.LITTLE_PARALLAX
        if isinstance(found, Refusal):
            self._refusals[found] += 1
            return waiting
        self._held = None
        place = np.flatnonzero(found.has_point)
        view = FirstView(
            Tracked(held.frame, TrackingState.OK, T_world_first, np.full(len(held.frame), -1, np.int32), held.motion),
            first[place],
            second[place],
            se3.transform(T_world_first, found.points_first[place]),
        )
        T_world_second = T_world_first @ se3.inverse(found.T_second_first)
        log.info("a map begins with images %d and %d", held.frame.image.index, frame.image.index)
        return replace(waiting, state=TrackingState.OK, T_world_cam=T_world_second, first_view=view)

    def may_begin(self, frame: Frame) -> bool:
        """Return whether a frame has enough keypoints to begin a sub-map with."""
        return int(np.count_nonzero(frame.is_static & (frame.keypoints.octave == _FINEST))) >= self.config.min_matches

    def starts_again(self, lost: Lost, world: Map) -> bool:
        """Drop the sub-map in which tracking was lost, if it is too young to be trusted; return whether it was."""
        keyframes = world.keyframes
        own = np.flatnonzero(keyframes.submap == lost.submap)
        alive = own[keyframes.is_alive[own]]
        if len(alive) == 0 or alive[0] < self._first_keyframe:
            return False  # what an earlier run has mapped is not this one's to drop, however small it is
        lasted_s = lost.since_s - float(keyframes.timestamp_s[own[0]])
        if len(alive) > self.config.start_again and not self._is_given_up(lasted_s, lost.n_in_vain):
            return False
        submaps.discard(lost.submap, world)
        self._held = None
        self._n_dropped += 1
        log.warning(
            "tracking was lost %.2g s after a map was begun, with %d keyframes: it is dropped, and another is begun",
            lasted_s,
            len(alive),
        )
        return True

    def _is_given_up(self, lasted_s: float, n_in_vain: int) -> bool:
        """Return whether a map is young, and nothing of it was recognised for long enough.

        Differs from ORB-SLAM2, which counts keyframes: here nearly every image is one until a map has its points, and
        before that it is lost as easily.
        """
        return lasted_s <= self.config.young_s and 0 < self.config.young_patience <= n_in_vain

    def _hold(self, tracked: Tracked) -> None:
        keypoints = tracked.frame.keypoints
        takes_part = tracked.is_static & (keypoints.octave == _FINEST)
        enough = np.count_nonzero(takes_part) >= self.config.min_matches
        self._held = _Held(tracked, takes_part, keypoints.px.copy()) if enough else None

    def _matched(self, present: Tracked) -> tuple[I32, I32]:
        """Return the keypoints (M,) of the image that is held, and of the present one, that match."""
        if self._held is None:
            return np.zeros(0, np.int32), np.zeros(0, np.int32)
        there, here = self._held.tracked.frame.keypoints, present.frame.keypoints
        asked = np.flatnonzero(self._held.takes_part).astype(np.int32)
        finest, unknown_px = np.full(len(asked), _FINEST, np.int32), np.full(len(asked), -1, np.float32)
        radius_px = np.full(len(asked), self.config.window_px, np.float32)
        queries = Queries(self._held.last_px[asked], radius_px, finest, finest, unknown_px, there.descriptors, asked)
        usable = present.is_static & (here.octave == _FINEST)
        targets = Targets(here.px, here.octave, here.right_px, here.descriptors, usable)
        query, target = search_windows(queries, targets, NEAR_BITS, self.config.ratio)
        first = asked[query]
        steady = consistent_rotation(there.angle_rad[first], here.angle_rad[target])
        first, second = first[steady], target[steady]
        self._held.last_px[first] = here.px[second]
        return first, second

    def _reconstructed(self, first: Frame, mine: I32, second: Frame, theirs: I32) -> TwoViews | Refusal:
        """Return motion and points of two frames with matched keypoints (M,), the median depth of the points 1."""
        first_px, second_px = first.keypoints.px[mine], second.keypoints.px[theirs]
        found = reconstruct(first_px, second_px, self.camera.K, self._limits, self.seed)
        if isinstance(found, Refusal):
            return found
        found = self._adjusted(found, first_px, second_px)
        if int(found.has_point.sum()) < self.config.min_points:
            return Refusal.FEW_PAIRS
        unit = float(np.median(found.points_first[found.has_point, 2]))
        T_second_first = found.T_second_first.copy()
        T_second_first[:3, 3] /= unit
        return replace(found, T_second_first=T_second_first, points_first=found.points_first / unit)

    def _needed_rad(self, found: TwoViews, first: Frame, second: Frame) -> float:
        """Return the parallax that the points of two frames must have [rad]."""
        turn_rad_s = float(se3.angle_rad(found.T_second_first)) / (second.timestamp_s - first.timestamp_s)
        return self._limits.min_parallax_rad + self.config.shutter_s * turn_rad_s

    def _adjusted(self, found: TwoViews, first_px: F32, second_px: F32) -> TwoViews:
        """Return two views after bundle adjustment; points that do not fit are left out."""
        place = np.flatnonzero(found.has_point)
        n = len(place)
        px = np.concatenate((first_px[place], second_px[place]))
        unknown_px = np.full(2 * n, -1.0, dtype=np.float32)
        level_weights = np.array([self.camera.pixel_scale**-2.0])
        result = self._adjust(
            BundleProblem(
                T_cam_world=np.stack((np.eye(4), found.T_second_first)),
                is_fixed=np.array([True, False]),
                points_world_m=found.points_first[place],
                obs_keyframe=np.repeat((0, 1), n),
                obs_point=np.tile(np.arange(n), 2),
                observed_px=observations.observed_px(px, unknown_px),
                weights=observations.weights(np.zeros(2 * n, np.int32), unknown_px, level_weights),
            ),
            self.camera,
        )
        fits = result.is_inlier[:n] & result.is_inlier[n:]
        has_point, points = np.zeros_like(found.has_point), np.zeros_like(found.points_first)
        has_point[place[fits]], points[place] = True, result.points_world_m
        return replace(found, T_second_first=result.T_cam_world[1], has_point=has_point, points_first=points)
