"""Detect-SLAM's sieve: keypoints and map points with a moving probability (docs/reference.md#detect-slam)."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.compiled import njit
from stillroom.data.frame import Frame, Keypoints
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.result import Tracked
from stillroom.data.semantics import Semantics
from stillroom.features.matching import NEAR_BITS, Queries, Targets, search_windows
from stillroom.geometry.arrays import F32, F64, I32, Bool, Ints
from stillroom.protocols import Parts

UNKNOWN = np.float32(0.5)
"""Of what nothing is known of."""


@dataclass(frozen=True)
class MovingProbabilityConfig:
    """Detect-SLAM's moving probability P (Zhong et al., WACV 2018, section 3.1).

    At a keyframe the detector says of each keypoint whether it lies in a box, S = 1 or 0, and its P and that of its map
    point become (1 − gain) · P + gain · S. Between keyframes P is propagated, before the pose is found: to a keypoint
    from the map point that it is matched with, else from the last frame's keypoint that it is matched with; to those
    without a match from points of high confidence around them, P = 0.5 + Σ C · exp(−d/r) · (P' − 0.5). What is more
    likely moving than not is left out of the pose.

    At a keyframe (`take_up`) the boxes therefore do not decide alone: a point of the background that was often seen
    static stays so in a box that comes to cover it, and one on a person whom the detector misses once stays moving.

    Differs from the paper, which is known here from notes alone: the thresholds of high confidence, r and C are not
    given. What is expanded serves one image and is not handed on: a few points of the background that were matched on a
    person would take all of it with them in some images. A keypoint that is more likely moving makes no map point in a
    keyframe; its P goes on from frame to frame by keypoints alone. A box in an image that is no keyframe counts as a
    sighting of that image, so that a detector for every image can be used too.

    Attributes:
        gain: Weight of a sighting (α of the paper).
        dynamic_above: A keypoint with a larger P is dynamic.
        surely_static, surely_dynamic: Matched points with a P at most and at least this are expanded from.
        reach_px: How far they are (r).
        strength: Of expansion at distance 0 (C).
        search_px: Half the side of the window in which a keypoint of the last frame is searched.
        ratio: The best descriptor there must be nearer than this share of the second best.
    """

    gain: float = bounded(0.3, above=0, most=1)
    dynamic_above: float = bounded(0.5, above=0, below=1)
    surely_static: float = bounded(0.25, least=0, most=0.5)
    surely_dynamic: float = bounded(0.75, least=0.5, most=1)
    reach_px: float = bounded(20.0, above=0, pixels=1)
    strength: float = bounded(0.5, above=0)
    search_px: float = bounded(30.0, above=0)
    ratio: float = bounded(0.9, above=0, most=1)

    def build(self, parts: Parts) -> "MovingProbability":
        """Return the sieve; it makes no random choice."""
        check(self)
        return MovingProbability(self, parts.world)


class PointProbabilities:
    """The P of map points by id; ids are never used again, so those of removed points need no care.

    It is not stored with a map: in one that is continued nothing is known of the points.
    """

    def __init__(self) -> None:
        """Start with no point known."""
        self._p = np.zeros(0, dtype=np.float32)
        self._is_known = np.zeros(0, dtype=np.bool_)

    def of(self, point_ids: I32) -> tuple[F32, Bool]:
        """Return the P of points (N,), and which of them are known; the others have 0.5."""
        within = (point_ids >= 0) & (point_ids < len(self._p))
        row = np.where(within, point_ids, 0)
        if len(self._p) == 0:
            return np.full(len(point_ids), UNKNOWN), within
        is_known: Bool = within & self._is_known[row]
        return np.where(is_known, self._p[row], UNKNOWN), is_known

    def put(self, point_ids: Ints, p_moving: F32) -> None:
        """Store the P of points (N,), all of them valid ids."""
        if len(point_ids) == 0:
            return
        missing = int(np.max(point_ids)) + 1 - len(self._p)
        if missing > 0:
            # Doubled, so that a map that grows is not copied at every keyframe.
            missing = max(missing, len(self._p))
            self._p = np.concatenate((self._p, np.full(missing, UNKNOWN)))
            self._is_known = np.concatenate((self._is_known, np.zeros(missing, dtype=np.bool_)))
        self._p[point_ids] = p_moving
        self._is_known[point_ids] = True

    def follow(self, old_ids: I32, new_ids: I32) -> None:
        """Give points that replaced others (N,), −1 for none, the P of those, unless they have one of their own."""
        p_moving, is_known = self.of(old_ids)
        changed = is_known & (new_ids >= 0) & (new_ids != old_ids)
        changed[changed] = ~self.of(new_ids[changed])[1]
        self.put(new_ids[changed], p_moving[changed])


@dataclass(frozen=True)
class _Known:
    """What is known of a frame.

    Attributes:
        frame: The frame.
        matched: P that its keypoints (N,) have by matching, 0.5 without a match.
        p_moving: The same with what the network finds, where it saw the image.
        is_seen: Whether it did.
    """

    frame: Frame
    matched: F32 = field(repr=False)
    p_moving: F32 = field(repr=False)
    is_seen: bool


class MovingProbability:
    """Sieve 2 of `detect-slam`."""

    def __init__(self, config: MovingProbabilityConfig, world: Map) -> None:
        """Start without a last frame, all points unknown."""
        self.config, self._world = config, world
        self.points = PointProbabilities()
        self._last: _Known | None = None
        self._now: _Known | None = None
        self._paired: tuple[Keypoints, I32, I32] | None = None
        self._written = np.zeros(0, dtype=np.int32)

    def judge(self, question: Question) -> Motion:
        """Classify every keypoint by what is propagated to it, and by the boxes of this image where it has any."""
        frame, found = question.frame, question.found
        matched, is_matched = self._by_matching(frame, question.matches)
        self._now = known = self._known(frame, matched, found if found.has_any else None)
        p_moving = known.p_moving
        if not known.is_seen:
            config, p_moving = self.config, p_moving.copy()
            is_sure = is_matched & ((p_moving <= config.surely_static) | (p_moving >= config.surely_dynamic))
            sure, others = np.flatnonzero(is_sure), np.flatnonzero(~is_matched)
            expand(frame.keypoints.px, p_moving, sure, others, config.reach_px, config.strength)
        return self._motion(p_moving, found)

    def take_up(self, tracked: Tracked, found: Semantics) -> Motion:
        """Update the P of a keyframe's keypoints by its boxes, and classify them again."""
        now, frame = self._now, tracked.frame
        same = now is not None and now.frame.keypoints.raw_px is frame.keypoints.raw_px
        matched = now.matched if now is not None and same else np.full(len(frame), UNKNOWN)
        self._now = self._known(frame, matched, found)
        return self._motion(self._now.p_moving, found)

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Keep the frame, and the P of the points of a keyframe."""
        now = self._now
        if now is None or now.frame.keypoints.raw_px is not frame.keypoints.raw_px:
            return
        if keyframe >= 0:
            if not now.is_seen:  # a network for every image found nothing in this one
                now = self._known(frame, now.matched, Semantics(frame.image.height, frame.image.width))
            self._write(keyframe, now.p_moving)
        self._last, self._paired = now, None

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: probabilities stay with their points."""

    def _write(self, keyframe: int, p_moving: F32) -> None:
        """Store the P (N,) of the points that a keyframe sees, and follow what became of those of the last one."""
        self.points.follow(self._written, self._world.current_ids(self._written))
        point_ids = self._world.points_of(keyframe)
        seen = np.flatnonzero(point_ids >= 0)
        self._written = point_ids[seen].copy()
        self.points.put(self._written, p_moving[seen])

    def _known(self, frame: Frame, matched: F32, found: Semantics | None) -> _Known:
        if found is None:
            return _Known(frame, matched, matched, is_seen=False)
        sighting = found.movable_at(frame.keypoints.raw_px).astype(np.float32)
        gain = np.float32(self.config.gain)
        return _Known(frame, matched, (1 - gain) * matched + gain * sighting, is_seen=True)

    def _motion(self, p_moving: F32, found: Semantics) -> Motion:
        return Motion(p_moving <= self.config.dynamic_above, found.movable)

    def _by_matching(self, frame: Frame, matches: Matches) -> tuple[F32, Bool]:
        """Return the P that a frame's keypoints (N,) have by matching, and which have a match of which P is known."""
        p_moving, is_known = np.full(len(frame), UNKNOWN), np.zeros(len(frame), dtype=np.bool_)
        if self._last is not None:
            then, now = self._pairs(self._last.frame.keypoints, frame)
            p_moving[now] = self._last.p_moving[then]
            is_known[now] = True
        by_point, has_one = self.points.of(matches.point_id)
        p_moving[matches.keypoint[has_one]] = by_point[has_one]
        is_known[matches.keypoint[has_one]] = True
        return p_moving, is_known

    def _pairs(self, then: Keypoints, frame: Frame) -> tuple[I32, I32]:
        """Return matches of the last frame's keypoints with this one's (M,) each; the same ones for every stage."""
        now = frame.keypoints
        if self._paired is None or self._paired[0] is not now:
            radius_px = self.config.search_px * frame.scales.factors[then.octave]
            queries = Queries(
                then.px,
                radius_px.astype(np.float32),
                then.octave - 1,
                then.octave + 1,
                np.full(len(then), -1, dtype=np.float32),
                then.descriptors,
            )
            targets = Targets(now.px, now.octave, now.right_px, now.descriptors, np.ones(len(now), dtype=np.bool_))
            self._paired = now, *search_windows(queries, targets, NEAR_BITS, self.config.ratio)
        return self._paired[1:]


@njit(nogil=True, cache=True)
def expand(px: F32, p_moving: F32, sure: Ints, unmatched: Ints, reach_px: float, strength: float) -> None:
    """Write P of unmatched points (U,), given those that are sure (S,): both are rows of `px` (N, 2) and P (N,)."""
    for i in unmatched:
        total = 0.0
        for j in sure:
            x, y = px[i, 0] - px[j, 0], px[i, 1] - px[j, 1]
            square = x * x + y * y
            if square <= reach_px * reach_px:
                total += strength * np.exp(-np.sqrt(square) / reach_px) * (p_moving[j] - 0.5)
        p_moving[i] = min(max(0.5 + total, 0.0), 1.0)
