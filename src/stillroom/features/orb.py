"""ORB features on a scale pyramid, spread evenly, with depth (ORB-SLAM2; Rublee et al., ICCV 2011)."""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.frame import Frame, Keypoints, ScaleLevels
from stillroom.data.image import Image
from stillroom.data.map import Map
from stillroom.data.sensor import Sensor
from stillroom.features.corners import detect, spread
from stillroom.features.keypoint_depth import KeypointDepth, RegisteredDepth
from stillroom.features.patches import REACH_PX, blur, describe, orientations, turned_places
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, Bool
from stillroom.geometry.camera import Camera
from stillroom.protocols import Parts

BORDER_PX = 19
"""The turned pattern reaches 13·√2 px and rounds up; nothing closer to the edge can be described."""
_WIDTH = 2 * REACH_PX + 1
_TILE_PX = 64
_TILES = 48
_RIDGE = 20.0
_AGREEMENT = 0.97
"""Not 1: OpenCV's blur inside ORB and its public one differ by a rounding now and then."""


def _at_usual_size(gray: U8, size: tuple[int, int]) -> U8:
    """Return an image of another width and height [px]; the image itself where it has them."""
    if size == (gray.shape[1], gray.shape[0]):
        return gray
    how = cv2.INTER_AREA if size[0] < gray.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(gray, size, interpolation=how), dtype=np.uint8)


# The 256 comparisons of the ORB descriptor, recovered from OpenCV.
#
# Descriptors should be compatible with those of others: OpenCV's pattern was learned (Rublee et al., ICCV 2011) and
# vocabularies are trained on it. OpenCV does not export the table, but it can be recovered from its descriptors: on
# white noise the bit that compares the blurred patch at p and q is the sign of a linear function of the patch, and
# least squares finds the two places where that function is not zero. This takes a fifth of a second, once a process.


@lru_cache(maxsize=1)
def orb_pattern() -> I32:
    """Return the comparisons (256, 4) int32 as x0 y0 x1 y1 [px]: the bit is set when blurred(p0) < blurred(p1).

    Raises:
        AssertionError: OpenCV's descriptor is no longer a set of pairwise comparisons.
    """
    patches, bits = _answers_on_noise()
    centred = patches - patches.mean(axis=0)
    # The ridge is a tenth of the blurred noise's variance: less of it amplifies what the blur took away.
    gram = centred.T @ centred / len(centred) + _RIDGE * np.eye(centred.shape[1])
    weights = np.linalg.solve(gram, centred.T @ (2.0 * bits - 1.0) / len(centred))
    pairs = np.stack((weights.argmin(axis=0), weights.argmax(axis=0)), axis=1)
    for bit, pair in enumerate(pairs):
        pairs[bit] = _sharpened(pair, patches, bits[:, bit].astype(np.bool_))
    pattern = np.concatenate(
        [np.stack((place % _WIDTH, place // _WIDTH), axis=1) - REACH_PX for place in pairs.T], axis=1
    )
    return np.ascontiguousarray(pattern, dtype=np.int32)


def _sharpened(pair: I64, patches: F64, answers: Bool) -> I64:
    """Return the two places (2,), moved by a pixel where that explains the answers (M,) better."""
    best, agreement = pair, _agreement(pair, patches, answers)
    if agreement < _AGREEMENT:
        steps = [dx + _WIDTH * dy for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        candidates = np.clip([pair + np.array((a, b)) for a in steps for b in steps], 0, _WIDTH**2 - 1)
        best = max(candidates, key=lambda candidate: _agreement(candidate, patches, answers))
        agreement = _agreement(best, patches, answers)
    assert agreement >= _AGREEMENT, f"OpenCV's ORB differs from the expected one: a bit agrees in {agreement:.1%} only"
    return best


def _agreement(pair: I64, patches: F64, answers: Bool) -> float:
    return float(np.mean((patches[:, pair[0]] < patches[:, pair[1]]) == answers))


def _answers_on_noise() -> tuple[F64, U8]:
    """Return blurred noise patches (M, 27²) and OpenCV's descriptor bits on them (M, 256)."""
    noise = np.random.default_rng(0).integers(0, 256, (_TILES * _TILE_PX,) * 2, dtype=np.uint8)
    middles = np.arange(_TILES) * _TILE_PX + _TILE_PX // 2
    keypoints = [cv2.KeyPoint(float(x), float(y), 31.0, 0.0, 1.0, 0) for y in middles for x in middles]
    # One level and a level-0 octave: OpenCV describes the image itself, unscaled and unrotated.
    orb = cv2.ORB.create(nfeatures=len(keypoints), nlevels=1)
    kept, descriptors = orb.compute(noise, keypoints)
    assert len(kept) == len(keypoints)
    blurred = cv2.GaussianBlur(noise, (7, 7), 2, sigmaY=2, borderType=cv2.BORDER_REFLECT_101)
    reach = np.arange(-REACH_PX, REACH_PX + 1)
    row = (middles[:, None, None, None] + reach[None, None, :, None]).astype(np.intp)
    column = (middles[None, :, None, None] + reach[None, None, None, :]).astype(np.intp)
    patches = blurred[row, column].reshape(len(keypoints), -1).astype(np.float64)
    return patches, np.unpackbits(np.asarray(descriptors), axis=1, bitorder="little")


@dataclass(frozen=True)
class OrbConfig:
    """How keypoints are found.

    Attributes:
        n_features: Keypoints to aim for in a frame.
        scale_factor, n_levels: The pyramid.
        strong_score, usual_score, weak_score: FAST scores. Corners that are not strong are taken only where there is
            no strong one; weak ones only in an image that is poor in corners (dark, blurred, bare walls).
        min_depth_m, max_depth_m: Depth outside this range counts as unknown.
    """

    n_features: int = bounded(1000, least=1)
    scale_factor: float = bounded(1.2, above=1)
    n_levels: int = bounded(8, least=1)
    strong_score: int = bounded(20, least=0)
    usual_score: int = bounded(12, least=0)
    weak_score: int = bounded(7, least=0)
    min_depth_m: float = bounded(0.1, least=0)
    max_depth_m: float = bounded(20.0, above=0)

    def contradiction(self) -> tuple[str, str] | None:
        """Return that the nearest depth is not below the farthest."""
        fits = self.min_depth_m < self.max_depth_m
        return None if fits else ("max_depth_m", "min_depth_m")

    def scales(self, camera: Camera, sensor: Sensor = Sensor.RGBD) -> ScaleLevels:
        """Return the pyramid over images of a camera."""
        return ScaleLevels.of(camera, sensor, self.scale_factor, self.n_levels)

    def registered_depth(self, camera: Camera) -> RegisteredDepth:
        """Return what reads the depth of keypoints in a camera's depth images."""
        return RegisteredDepth(camera, self.min_depth_m, self.max_depth_m)

    def many(self, factor: int) -> "OrbConfig":
        """Return the same for so many times more keypoints."""
        return replace(self, n_features=factor * self.n_features)

    def build(self, parts: Parts, depth: KeypointDepth | None = None) -> "OrbExtractor":
        """Return the extractor for a camera; where `depth` is not given, depth images are read."""
        depth = self.registered_depth(parts.camera) if depth is None else depth
        return OrbExtractor(self, parts.camera, self.scales(parts.camera, parts.sensor), parts.seed, depth)


class UntilMap:
    """Finds keypoints by one extractor until there is a map, then by another: a single camera begins with more."""

    def __init__(self, before: "OrbExtractor", after: "OrbExtractor", world: Map) -> None:
        """Store both, and the map."""
        self._before, self._after, self._world = before, after, world

    def extract(self, image: Image) -> Frame:
        """Return the frame of the image."""
        return (self._before if self._world.is_empty else self._after).extract(image)


class OrbExtractor:
    """Finds ORB keypoints in images of one camera."""

    def __init__(self, config: OrbConfig, camera: Camera, scales: ScaleLevels, seed: int, depth: KeypointDepth) -> None:
        """Prepare quotas and tables."""
        self.config, self.camera, self.scales, self.seed = config, camera, scales, seed
        self._depth = depth
        shares = self.scales.factors**-1.0
        self._quotas = [int(q) for q in np.rint(config.n_features * shares / shares.sum())]
        self._sizes = [(max(1, round(camera.width / f)), max(1, round(camera.height / f))) for f in self.scales.factors]
        self._ratios = np.array([camera.width, camera.height]) / np.array(self._sizes)
        self._places = turned_places(orb_pattern())
        # The level, and it blurred once and twice. New ones for every image would cost as much as a level's corners.
        self._scratch = [np.empty((3, height_px, width_px), np.uint8) for width_px, height_px in self._sizes]

    def extract(self, image: Image) -> Frame:
        """Return the frame of the image; a black image gives zero keypoints."""
        levels, found = self.find(image.gray)
        keypoints = self._depth.measured(image, levels, found)
        return Frame(image, self.camera, self.scales, keypoints, np.ones(len(keypoints), dtype=np.bool_))

    def find(self, gray: U8) -> tuple[list[U8], Keypoints]:
        """Return the pyramid of a brightness (H, W), valid until the next call, and its keypoints, of unknown depth."""
        config, levels = self.config, self._pyramid(gray)
        corners = detect(levels, config.usual_score, BORDER_PX)
        if config.weak_score != config.usual_score and len(corners.score) < 2 * config.n_features:
            corners = detect(levels, config.weak_score, BORDER_PX)
        chosen = spread(corners, self._sizes, self._quotas, config.strong_score, self.seed)
        own_px, octave = corners.px[chosen], corners.level[chosen]
        angle_rad, descriptors = self._describe(levels, own_px, octave)
        raw_px = in_the_image(own_px, octave, self._ratios)
        n = len(raw_px)
        return levels, Keypoints(
            px=self.camera.undistort(raw_px),
            raw_px=raw_px,
            octave=octave,
            angle_rad=angle_rad,
            descriptors=descriptors,
            depth_m=np.zeros(n, dtype=np.float32),
            right_px=np.full(n, -1.0, dtype=np.float32),
        )

    def _pyramid(self, gray: U8) -> list[U8]:
        levels = [np.ascontiguousarray(_at_usual_size(gray, self._sizes[0]))]
        for size, (level, _, _) in zip(self._sizes[1:], self._scratch[1:], strict=True):
            resized = cv2.resize(levels[-1], size, dst=level, interpolation=cv2.INTER_LINEAR)
            levels.append(np.asarray(resized, dtype=np.uint8))
        return levels

    def _describe(self, levels: list[U8], px: F32, octave: I32) -> tuple[F32, U8]:
        angle_rad, descriptors = np.empty(len(px), dtype=np.float32), np.empty((len(px), 32), dtype=np.uint8)
        edges = np.searchsorted(octave, np.arange(len(levels) + 1)).tolist()
        for number, image in enumerate(levels):
            own = slice(edges[number], edges[number + 1])
            if own.start == own.stop:
                continue
            _, once, blurred = self._scratch[number]
            blur(image, once, blurred)
            orientations(image, px[own], angle_rad[own])
            describe(blurred, px[own], angle_rad[own], self._places, descriptors[own])
        return angle_rad, descriptors


@njit(nogil=True, cache=True)
def in_the_image(px: F32, octave: I32, ratios: F64) -> F32:
    """Return where pixels (N, 2) of levels (N,) lie in the image as taken (N, 2) [px].

    Pixel centres, not corners, are what a resize keeps. `ratios` (L, 2) are the sizes of the image by those of levels.
    """
    raw_px, half = np.empty((len(px), 2), np.float32), np.float32(0.5)
    for i in range(len(px)):
        for axis in range(2):
            raw_px[i, axis] = (px[i, axis] + half) * ratios[octave[i], axis] - 0.5
    return raw_px
