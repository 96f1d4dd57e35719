"""The rule for objects without a movable class: one whose segment moves against the scene is dynamic."""

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from stillroom.bounds import bounded, check
from stillroom.compiled import njit
from stillroom.data.clusters import Clusters
from stillroom.data.frame import Frame, Keypoints
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics
from stillroom.dynamics.asking import ImageMemory
from stillroom.dynamics.cluster_evidence import MOVES, STAYS, Belief, MovingPixels, Sampler
from stillroom.dynamics.depth_history import STRIDE, SmallView, ask
from stillroom.dynamics.homography.past import EarlierImage, Past, view_of
from stillroom.dynamics.homography.point_motion import DYNAMIC, STATIC, UNKNOWN, ImageView, PointTest, PointTestConfig
from stillroom.geometry import homography, se3
from stillroom.geometry.arrays import F32, F64, I16, I64, Bool
from stillroom.geometry.camera import Lens
from stillroom.geometry.distortion import distorted
from stillroom.geometry.pixels import values_at
from stillroom.protocols import Parts

NEAR = 0.02, 0.01
"""Metres and radians that a pose may move after low-cost tracking before segments are tested again."""


@dataclass(frozen=True)
class MovedSegmentsConfig:
    """When a segment of an image moves against the scene (PSPNet-SLAM III.A, Figure 2).

    The segments are those of the depth cloud (`clusters.kind = "depth"`), which have no class, with what the network
    calls a chair, a monitor or a bottle taken apart from what it touches. Points spread over a segment are searched in
    an earlier image, each where it would have been if it were static. The majority, by `share`, is a vote for or
    against motion; votes are accumulated over images as log-odds.

    Differs from the paper, which gives no rule for how far is moved: the earlier image is not the very last one, to
    which little has moved; and one image does not decide alone.

    Attributes:
        earlier_s: Age of the image that the present one is compared with [s].
        max_points: Points of a segment that are tested, at most; keypoints come on top.
        min_points: With fewer tested points there is no vote.
        share: A segment moves when more than this share of its points does.
        plain: Weight, as evidence for static, of a point without texture whose depth was the same before; a matched
            point has weight 1. Part of what slides within its own outline looks the same.
        tolerance_m, tolerance_share: Depth is the same within the larger of the first and this share of it.
        max_turn_rad_s: Nothing is classified as dynamic while the camera turns faster. Depth and colour are some 30 ms
            apart, which then displaces one against the other by more than many a segment is wide.
        gain: What an image adds to the log-odds when all points agree.
        limit: Largest log-odds, which bounds the weight of earlier images.
        fades_in_s: Time in which unsupported log-odds fall to 1/e.
        reach_m: How far a segment may move in depth between two images.
        margin_px: What lies this close to a moving segment and on no plane or other segment moves too.
        test: When a point moves.
    """

    needs_depth_image: ClassVar[bool] = True

    earlier_s: float = bounded(0.2, least=0)
    max_points: int = bounded(24, least=1)
    min_points: int = bounded(6, least=1)
    share: float = bounded(0.5, above=0, below=1)
    plain: float = 0.25
    tolerance_m: float = 0.05
    tolerance_share: float = 0.02
    max_turn_rad_s: float = 0.5
    gain: float = 1.5
    limit: float = 2.5
    fades_in_s: float = bounded(1.0, above=0)
    reach_m: float = 0.3
    margin_px: int = bounded(8, least=0, pixels=1)
    test: PointTestConfig = field(default_factory=PointTestConfig)

    def build(self, parts: Parts | None = None) -> "MovedSegments":
        """Return the sieve; it makes no random choice."""
        check(self)
        return MovedSegments(self)


@dataclass(frozen=True)
class _Finding:
    """The result for an image at a pose: its segments, the test's view, the segments' log-odds (K,)."""

    clusters: Clusters
    view: ImageView = field(repr=False)
    belief: F64


class MovedSegments:
    """Sieve 2 by segments. Runs once an image, at the first pose that was tracked and not only predicted."""

    def __init__(self, config: MovedSegmentsConfig) -> None:
        """Start without earlier images."""
        self.config = config
        self._past = Past(config.earlier_s)
        self._sampler = Sampler()
        self._belief = Belief(config.fades_in_s, config.reach_m)
        self._pixels = MovingPixels(config.margin_px)
        self._finding: ImageMemory[_Finding] = ImageMemory(*NEAR)
        self._said: tuple[Keypoints, Semantics, _Finding | None, Motion] | None = None

    def judge(self, question: Question) -> Motion:
        """Classify as dynamic what is potentially dynamic, and every segment that is found to move."""
        keypoints, known = question.frame.keypoints, question.known
        finding = None if known.clusters is None else self._find(question, known.clusters)
        said = self._said
        if said is None or said[0] is not keypoints or said[1] is not known or said[2] is not finding:
            self._said = said = keypoints, known, finding, self._verdict(keypoints, known, finding)
        return said[3]

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Store the image and the log-odds of its segments."""
        finding = self._finding.of(frame.image)
        if finding is not None:
            self._belief.remember(frame, finding.clusters, finding.belief, T_cam_world)
            self._past.remember(frame, finding.view, T_cam_world)

    def corrected(self, T_new_old: F64) -> None:
        """Correct the stored poses."""
        self._past.follow(T_new_old)
        self._belief.follow(T_new_old)
        self._finding.forget()

    def _verdict(self, keypoints: Keypoints, known: Semantics, finding: _Finding | None) -> Motion:
        """Combine the masks and what segments move."""
        moving = known.movable
        if finding is not None and np.any(finding.belief > 0):
            said = np.where(finding.belief > 0, MOVES, STAYS).astype(np.uint8)
            moving = moving | self._pixels.marked(finding.clusters, said, moving)
        return Motion(~values_at(moving, keypoints.raw_px), moving)

    def _find(self, question: Question, clusters: Clusters) -> _Finding | None:
        """Return the result for a frame, cached for nearly the same pose; None at a predicted pose."""
        frame, T_cam_world = question.frame, question.T_cam_world
        known = self._finding.near(frame.image, T_cam_world)
        if known is not None or question.stage not in (Stage.LOW_COST, Stage.LOCAL_MAP):
            return known
        before = self._finding.of(frame.image)
        view = view_of(frame.image) if before is None else before.view
        found = _Finding(clusters, view, self._log_odds(frame, clusters, view, T_cam_world))
        return self._finding.keep(frame.image, T_cam_world, found)

    def _log_odds(self, frame: Frame, clusters: Clusters, view: ImageView, T_cam_world: F64) -> F64:
        """Return the log-odds (K,) that each segment moves."""
        config, samples = self.config, self._sampler.take(frame, clusters)
        belief = self._belief.of(samples, len(clusters), T_cam_world, frame.camera, frame.timestamp_s)
        earlier = self._past.before(frame)
        if earlier:
            votes = self._votes(frame, clusters, view, earlier[0], T_cam_world)
            if np.any(votes > 0.0) and self._past.turn_rad_s(frame, T_cam_world) > config.max_turn_rad_s:
                votes = np.minimum(votes, 0.0)
            belief = belief + config.gain * votes
        return np.asarray(np.clip(belief, -config.limit, config.limit))

    def _votes(self, frame: Frame, clusters: Clusters, view: ImageView, earlier: EarlierImage, T_cam_world: F64) -> F64:
        """Return the vote of an earlier image on each segment (K,): −1 static to 1 moving, 0 where unknown."""
        config, camera = self.config, frame.camera
        points = self._points_on(frame, clusters)
        T_then_now = earlier.T_cam_world @ se3.inverse(T_cam_world)
        H_then_now = homography.of_rotation(T_then_now, camera.K)
        test = PointTest(config.test, camera, view, earlier.view, *points[1:], T_then_now, H_then_now)
        verdict = test(np.arange(len(points.segment), dtype=np.int64))
        n = len(clusters)
        moving = np.bincount(points.segment[verdict == DYNAMIC], minlength=n)
        unknown = np.flatnonzero(verdict == UNKNOWN)
        still = (verdict == STATIC).astype(np.float64)
        still[unknown[self._was_there(points, unknown, frame, earlier, T_cam_world)]] = config.plain
        judged = moving + np.bincount(points.segment, still, minlength=n)
        share = moving / np.maximum(judged, 1)
        # From −1 where no point moves, over 0 where as many do as are asked for, to 1 where all do.
        vote = np.where(share > config.share, (share - config.share) / (1.0 - config.share), share / config.share - 1.0)
        return np.where(judged >= config.min_points, vote, 0.0)

    def _was_there(
        self, points: "SegmentPoints", asked: I64, frame: Frame, earlier: EarlierImage, T_cam_world: F64
    ) -> Bool:
        """Return for points `asked` (M,) whether the earlier image has a surface where they are now."""
        camera, config = frame.camera, self.config
        agrees, empty = np.zeros((2, len(asked)), dtype=np.int64)
        points_cam_m = camera.back_project(points.px[asked], points.depth_m[asked])
        stride = camera.in_pixels(STRIDE)
        small_m = np.ascontiguousarray(earlier.view.depth_m[::stride, ::stride])
        view = SmallView(small_m, earlier.T_cam_world, camera.lens, stride)
        points_world_m = se3.transform(se3.inverse(T_cam_world), points_cam_m)
        ask(view, points_world_m, config.tolerance_m, config.tolerance_share, agrees, empty)
        return np.asarray(agrees > 0)

    def _points_on(self, frame: Frame, clusters: Clusters) -> "SegmentPoints":
        """Return keypoints on segments, and points spread over them."""
        kp, samples = frame.keypoints, self._sampler.take(frame, clusters)
        chosen = spread(samples.cluster, self.config.max_points)
        room = len(kp) + len(chosen)
        raw_px, px = np.empty((2, room, 2))
        points = SegmentPoints(np.empty(room, dtype=np.int64), raw_px, px, np.empty(room))
        labels, lens = np.ascontiguousarray(clusters.labels), frame.camera.lens
        n = write_keypoints(kp.raw_px, kp.px, kp.depth_m, labels, points)
        write_samples(samples.points_cam_m, samples.cluster, chosen, lens, n, points)
        n += len(chosen)
        return SegmentPoints(points.segment[:n], points.raw_px[:n], points.px[:n], points.depth_m[:n])


class SegmentPoints(NamedTuple):
    """P points on segments: which (P,), where as taken and undistorted (P, 2) [px], and how deep (P,) [m]."""

    segment: I64
    raw_px: F64
    px: F64
    depth_m: F64


@njit(nogil=True, cache=True)
def write_keypoints(raw_px: F32, px: F32, depth_m: F32, labels: I16, points: SegmentPoints) -> int:
    """Write the keypoints (N, 2), (N, 2) [px], (N,) [m] that have a depth and a label (H, W); return their number."""
    height, width = labels.shape
    n = 0
    for i in range(len(raw_px)):
        column = min(max(int(np.rint(raw_px[i, 0])), 0), width - 1)
        row = min(max(int(np.rint(raw_px[i, 1])), 0), height - 1)
        if labels[row, column] >= 0 and depth_m[i] > 0.0:
            points.segment[n], points.depth_m[n] = labels[row, column], depth_m[i]
            points.raw_px[n] = raw_px[i]
            points.px[n] = px[i]
            n += 1
    return n


@njit(nogil=True, cache=True)
def write_samples(points_cam_m: F64, cluster: I64, chosen: I64, lens: Lens, start: int, points: SegmentPoints) -> None:
    """Write the chosen (M,) of sampled points (S, 3) [m] with their clusters (S,), from place `start` on."""
    for k in range(len(chosen)):
        i, n = chosen[k], start + k
        x, y, z = points_cam_m[i]
        u, v = lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy
        points.segment[n], points.depth_m[n] = cluster[i], z
        points.px[n, 0], points.px[n, 1] = u, v
        points.raw_px[n, 0], points.raw_px[n, 1] = distorted(lens, (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy)


def spread(group: I64, most: int) -> I64:
    """Return up to `most` of each group's members (N,), evenly over their order, in rising order."""
    chosen = np.zeros(len(group), dtype=np.bool_)
    mark_spread(group, np.bincount(group), most, chosen)
    return np.flatnonzero(chosen)


@njit(nogil=True, cache=True)
def mark_spread(group: I64, counts: I64, most: int, chosen: Bool) -> None:
    """Mark every so many members of each group (N,), whose sizes are given (K,), that at most `most` are marked."""
    rank = np.zeros(len(counts), dtype=np.int64)
    for i in range(len(group)):
        g = group[i]
        chosen[i] = rank[g] % max(1, -(-counts[g] // most)) == 0
        rank[g] += 1
