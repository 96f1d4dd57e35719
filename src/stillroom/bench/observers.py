"""Observes a run and runs the geometries on its images: DynaSLAM's, PSPNet-SLAM's, and the latter as printed."""

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from stillroom.bounds import in_pixels_of
from stillroom.data.image import Image
from stillroom.data.map.jumps import JumpFollower
from stillroom.data.matches import Matches
from stillroom.data.motion import Stage
from stillroom.data.question import Question
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics, nothing
from stillroom.dynamics.ants.colony import PATHS
from stillroom.dynamics.ants.comparison import PointSet, SearchComparison, compare
from stillroom.dynamics.ants.search import ALL, ReverseSearch, ReverseSearchConfig, SearchResult
from stillroom.dynamics.asking import Asking
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig, Findings
from stillroom.dynamics.multiview.multiview_geometry import DYNAMIC, Geometry, GeometryConfig, PointsInView
from stillroom.dynamics.projected.paper_ants import PaperAntsConfig, Projected
from stillroom.geometry import se3
from stillroom.geometry.arrays import I64, Bool
from stillroom.geometry.pixels import Shape, grown, values_at
from stillroom.protocols import Parts, RenderedDataset
from stillroom.schedule import Done
from stillroom.system import System

EXHAUSTIVE = "exhaustive"
KEPT_IMAGES = 40
MOST_MOVING = 0.5
CLEAR_PX = 6
"""Keypoints this near to something that moves count neither as moving nor as static."""
HOMOGRAPHY, MULTI_VIEW, PRINTED = "compensated homography", "multi-view depth", "projected points"
"""The tests of a point: what we made of PSPNet-SLAM's, DynaSLAM's, and PSPNet-SLAM's as printed."""
TESTS = HOMOGRAPHY, MULTI_VIEW, PRINTED
SERPENTINE, ANTS = PATHS


@dataclass(frozen=True)
class GeometryTrialConfig:
    """What is measured on each image.

    Attributes:
        network: Whether what the run's network masks is left out; if not, the geometry must find the people itself.
        homography: PSPNet-SLAM's test and search.
        multi_view: DynaSLAM's test, on keypoints of keyframes alone, as its paper has it.
        printed: PSPNet-SLAM's test and search as printed, on the previous frame's projected features.
        repeats: How often each search is timed; the fastest counts.
        picture_of: Number of the image to draw; None for one in which much moves.
    """

    network: bool = False
    homography: CompensatedHomographyConfig = field(default_factory=CompensatedHomographyConfig)
    multi_view: GeometryConfig = field(default_factory=GeometryConfig)
    printed: PaperAntsConfig = field(default_factory=PaperAntsConfig)
    repeats: int = 3
    picture_of: int | None = None

    def build(self, system: System, seed: int) -> "GeometryObserver":
        """Return the observer of a system's run."""
        return GeometryObserver(self, system, seed)


@dataclass(frozen=True)
class Shown:
    """The data for a picture of one image's geometry.

    Attributes:
        image, earlier: The image, and the one that it was compared with.
        findings: Result of the test for every point.
        found: What the ants found.
        ants: Their search.
        mask: What the network masked (H, W); None without a network.
    """

    image: Image
    earlier: Image
    findings: Findings
    found: SearchResult
    ants: ReverseSearchConfig
    mask: Bool | None


class GeometryObserver:
    """Times all tests on each tracked image; at the tracked pose, so that none depends on the run's own sieve.

    Attributes:
        comparisons: The sums over the images, by test and search.
        shown: The image to draw: the one that was asked for, else one in which much moves.
    """

    def __init__(self, config: GeometryTrialConfig, system: System, seed: int) -> None:
        """Start without earlier images."""
        config = in_pixels_of(config, system.mapper.camera.pixel_scale)
        self.config, self._system, self._seed = config, system, seed
        parts = Parts(system.mapper.camera, system.map, seed)
        self._sieve = replace(config.homography, search=EXHAUSTIVE).build(parts)
        self._printed = replace(config.printed, search=ALL).build(parts)
        self._asking = [Asking(self._sieve, system.map), Asking(self._printed, system.map)]
        keyframes = replace(config.multi_view.keyframes, grid_px=0)
        self._multi_view = replace(config.multi_view, keyframes=keyframes).build()
        self._jumps = JumpFollower()
        self._searches = {test: self._new_searches() for test in (HOMOGRAPHY, MULTI_VIEW)}
        self._searches[PRINTED] = {ANTS: config.printed.ants.build(seed)}
        self._images: deque[Image] = deque(maxlen=KEPT_IMAGES)
        self._most = 0
        self.comparisons: dict[tuple[str, str], list[SearchComparison]] = {}
        self.shown: Shown | None = None

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Compare the searches on an image; one without a pose is left out."""
        if tracked.T_world_cam is None:
            return
        frame, T_cam_world, world = tracked.frame, se3.inverse(tracked.T_world_cam), self._system.map
        known = semantics if self.config.network else nothing(frame.image.height, frame.image.width)
        unmatched = Matches.of(np.full(len(frame), -1, dtype=np.int32))
        self._images.append(frame.image)
        T_new_old = self._jumps.missed(world)
        if T_new_old is not None:
            self._multi_view.views.follow(T_new_old)
        for asking in self._asking:
            asking.judge(Question(Stage.LOCAL_MAP, frame, unmatched, Done(known), T_cam_world, world))
        findings, seen = self._sieve.findings, self._multi_view.points_in_view(frame, T_cam_world, world)
        if findings is not None and seen is not None:
            self._compare(findings, seen, known.movable if known.has_any else None)
        keyframe = tracked.reference_keyframe if result.is_keyframe else -1
        self._multi_view.views.note(frame, T_cam_world, tracked.motion.moving, keyframe)
        for asking in self._asking:
            asking.remember(frame, T_cam_world, keyframe)

    def close(self) -> None:
        """Nothing is left open."""

    def _compare(self, findings: Findings, seen: PointsInView, mask: Bool | None) -> None:
        self._show(findings, mask)
        sets = {
            HOMOGRAPHY: _by_homography(findings, self._multi_view, seen, mask),
            MULTI_VIEW: _by_depth(self._multi_view, seen, mask),
        }
        if self._printed.projected is not None:
            sets[PRINTED] = _as_printed(self._printed.projected, self._multi_view, seen)
        for test, points in sets.items():
            for search, compared in compare(points, self._searches[test], self.config.repeats).items():
                self.comparisons.setdefault((test, search), []).append(compared)

    def _show(self, findings: Findings, mask: Bool | None) -> None:
        """Keep the image for the picture, if it is the chosen one, or better than the one before."""
        n = int(np.count_nonzero(findings.found.is_dynamic))
        wanted = self.config.picture_of
        # Where nearly all moves, the test has failed rather than found something.
        more = self._most < n < MOST_MOVING * len(findings.candidates)
        better = more if wanted is None else findings.index == wanted
        earlier = [image for image in self._images if image.depth_m is findings.test.then.depth_m]
        if not better or not earlier:
            return
        self._most = n
        ants = self._searches[HOMOGRAPHY][ANTS]
        found = ants.search(findings.test.raw_px, findings.test.is_dynamic, mask)
        self.shown = Shown(self._images[-1], earlier[0], findings, found, ants.config, mask)

    def _new_searches(self) -> dict[str, ReverseSearch]:
        config = self.config.homography.ants
        return {kind: replace(config, path=replace(config.path, kind=kind)).build(self._seed) for kind in PATHS}


def _by_homography(findings: Findings, geometry: Geometry, seen: PointsInView, mask: Bool | None) -> PointSet:
    """Return the present keypoints with PSPNet-SLAM's test; regions grow from them as they stand."""
    px = findings.test.raw_px

    def grow(moves: Bool) -> Bool:
        return geometry.grow(seen, np.rint(px[moves]).astype(np.int32))

    return PointSet(px, findings.test.is_dynamic, grow, mask)


def _by_depth(geometry: Geometry, seen: PointsInView, mask: Bool | None) -> PointSet:
    """Return the keyframes' keypoints that are in view, with DynaSLAM's test; regions grow from what stands there."""
    points = seen.in_view
    if mask is not None:
        column, row = seen.points.px[points].T
        points = points[~mask[row, column]]

    def test(which: I64) -> Bool:
        return np.asarray(geometry.test(seen, points[which]) == DYNAMIC)

    def grow(moves: Bool) -> Bool:
        return geometry.grow(seen, seen.before_px[points[moves]])

    return PointSet(seen.points.px[points].astype(np.float64), test, grow, mask)


def _as_printed(projected: Projected, geometry: Geometry, seen: PointsInView) -> PointSet:
    """Return the previous frame's projected features with the test as printed; regions grow from what occludes them."""
    test = projected.test

    def grow(moves: Bool) -> Bool:
        return geometry.grow(seen, test.before_px[moves])

    return PointSet(test.raw_px, test, grow)


# Observes a run on a rendered sequence, and counts how much of the moving objects was found.


@dataclass
class Count:
    """How many there were, and how many of them were classified as dynamic."""

    n: int = 0
    said: int = 0

    def add(self, said: Bool) -> None:
        """Count some (N,)."""
        self.n += len(said)
        self.said += int(np.count_nonzero(said))

    @property
    def share(self) -> float | None:
        """Share of them that was classified as dynamic; None where there were none."""
        return self.said / self.n if self.n else None


class MovingThings:
    """The moving objects of a rendered sequence, rendered once for all runs on it."""

    def __init__(self, room: RenderedDataset) -> None:
        """Take the sequence, whole."""
        self._room = room
        self._packed: dict[int, tuple[bytes, bytes]] = {}
        self._shape = room.camera.height, room.camera.width

    def at(self, index: int) -> tuple[Bool, Bool]:
        """Return the pixels (H, W) of all that moves in an image, and of handled objects that do."""
        if index not in self._packed:
            truth = self._room.truth(index)
            handled = truth.moving & self._room.handled(truth.instance)
            self._packed[index] = np.packbits(truth.moving).tobytes(), np.packbits(handled).tobytes()
        moving, handled = (self._unpacked(packed) for packed in self._packed[index])
        return moving, handled

    def _unpacked(self, packed: bytes) -> Bool:
        height, width = self._shape
        bits = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=height * width)
        return bits.reshape(height, width).view(np.bool_)


class TruthObserver:
    """Compares the classification of a run with what truly moves.

    Attributes:
        moving, handled, static: Keypoints on all that moves, on handled objects while they move, and clear of both.
        handled_pixels, static_pixels: Pixels with a depth, likewise.
    """

    def __init__(self, things: MovingThings) -> None:
        """Start counting."""
        self._things = things
        self.moving, self.handled, self.static = Count(), Count(), Count()
        self.handled_pixels, self.static_pixels = Count(), Count()

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Count a tracked image."""
        if tracked.T_world_cam is None:
            return
        frame = tracked.frame
        moving, handled = self._things.at(frame.image.index)
        clear = ~grown(moving, CLEAR_PX, Shape.SQUARE)
        said = ~tracked.is_static
        for count, where in ((self.moving, moving), (self.handled, handled), (self.static, clear)):
            count.add(said[values_at(where, frame.keypoints.raw_px)])
        known = frame.image.depth_m > 0
        self.handled_pixels.add(tracked.motion.moving[handled & known])
        self.static_pixels.add(tracked.motion.moving[clear & known])

    def close(self) -> None:
        """Nothing is left open."""
