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
from stillroom.features.corners import Corners, detect, spread
from stillroom.features.keypoint_depth import KeypointDepth, RegisteredDepth
from stillroom.geometry.arrays import F32, F64, I32, I64, U8, U16, Bool
from stillroom.geometry.camera import Camera
from stillroom.protocols import Parts

PATCH_RADIUS_PX = 15
BORDER_PX = 19
"""The turned pattern reaches 13·√2 px and rounds up; nothing closer to the edge can be described."""
N_TURNS = 256
"""The pattern is turned in steps of 1.4°, a tenth of what the descriptor notices; a table is faster than sines."""
REACH_PX = 13
"""No comparison reaches further than this from the keypoint, along x or y."""
TURNED_REACH_PX = 18
"""The same once it is turned: 13·√2 px."""
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


# Orientation and ORB descriptor of corners, on one level of the pyramid.


def patch_half_widths() -> I32:
    """Return the half width of each row of the disc over which the orientation is taken, (16,) int32.

    The disc is OpenCV's: symmetric about the diagonal, so that its steep part mirrors the flat one. Rounding each row
    by itself, as one would, turns the angle by 2° in the median, and the descriptor differs from OpenCV's.
    """
    rows = np.arange(PATCH_RADIUS_PX + 1)
    widths = np.rint(np.sqrt(PATCH_RADIUS_PX**2 - rows**2)).astype(np.int32)
    mirrored = np.array([np.flatnonzero(widths >= row).max() for row in rows], dtype=np.int32)
    return np.where(rows * np.sqrt(2.0) > PATCH_RADIUS_PX, mirrored, widths).astype(np.int32)


def disc_weights() -> tuple[F32, F32]:
    """Return what the pixels of the patch count in its moments along x and along y, (31, 32) each; 0 outside the disc.

    A column more than the patch has makes whole vectors.
    """
    away = np.arange(-PATCH_RADIUS_PX, PATCH_RADIUS_PX + 2, dtype=np.float32)
    rows = away[:-1, None]
    inside = np.abs(away) <= patch_half_widths()[np.abs(rows).astype(np.int64)]
    return np.where(inside, away, np.float32(0.0)), np.where(inside, rows, np.float32(0.0))


# The order of the sum is free because float32 holds every partial sum of whole numbers here without rounding.
@njit(nogil=True, cache=True, fastmath={"reassoc", "contract"})
def orientations(image: U8, px: F32, weights: tuple[F32, F32], angle_rad: F32) -> None:
    """Fill the angle (N,) from keypoint to the centroid of brightness in its disc (Rublee et al. 2011, 3.2)."""
    along_x, along_y = weights
    # Unsigned indices are not asked whether they count from the end, which makes vectors of the inner loop.
    n_rows, n_columns = np.uint64(along_x.shape[0]), np.uint64(along_x.shape[1])
    for i in range(len(px)):
        left, top = np.uint64(px[i, 0] - PATCH_RADIUS_PX), np.uint64(px[i, 1] - PATCH_RADIUS_PX)
        m10, m01 = np.float32(0.0), np.float32(0.0)
        for row in range(n_rows):
            for column in range(n_columns):
                value = np.float32(image[top + row, left + column])
                m10 += along_x[row, column] * value
                m01 += along_y[row, column] * value
        angle_rad[i] = np.arctan2(m01, m10)


def turned_places(pattern: I32) -> U16:
    """Return the pattern (256, 4) turned by each of `N_TURNS` angles, (N_TURNS, 512) uint16.

    Of comparison k the first place is at 2k, the second at 2k + 1: the row times 256 and the column, both counted from
    the first that can be reached.
    """
    angle_rad = 2.0 * np.pi * np.arange(N_TURNS) / N_TURNS
    c, s = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    x, y = pattern.reshape(-1, 2).T.astype(np.float64)
    row, column = TURNED_REACH_PX + np.rint(x * s + y * c), TURNED_REACH_PX + np.rint(x * c - y * s)
    return np.asarray(256 * row + column, dtype=np.uint16)


@njit(nogil=True, cache=True)
def describe(blurred: U8, px: F32, angle_rad: F32, places: U16, descriptors: U8) -> None:
    """Fill the descriptors (N, 32): 256 comparisons of the blurred level, turned by the keypoint's angle."""
    # One small table for all levels stays in the processor's cache; ready offsets would need one for each.
    flat, width = blurred.reshape(-1), np.uint64(blurred.shape[1])
    per_rad = N_TURNS / (2.0 * np.pi)
    u1, u8, low = np.uint64(1), np.uint64(8), np.uint64(255)
    for i in range(len(px)):
        first = np.uint64(px[i, 1] - TURNED_REACH_PX) * width + np.uint64(px[i, 0] - TURNED_REACH_PX)
        turned = places[int(np.floor(angle_rad[i] * per_rad + 0.5)) % N_TURNS]
        for byte in range(np.uint64(32)):
            value = np.uint64(0)
            for bit in range(u8):
                k = np.uint64(16) * byte + np.uint64(2) * bit
                one, other = np.uint64(turned[k]), np.uint64(turned[k + u1])
                one = first + (one >> u8) * width + (one & low)
                other = first + (other >> u8) * width + (other & low)
                value |= np.uint64(flat[one] < flat[other]) << bit
            descriptors[i, byte] = value


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
        self._disc = disc_weights()
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
        angle_rad, descriptors = self._describe(levels, corners, chosen)
        raw_px = self._to_finest_level(corners, chosen)
        n = len(raw_px)
        return levels, Keypoints(
            px=self.camera.undistort(raw_px),
            raw_px=raw_px,
            octave=corners.level[chosen],
            angle_rad=angle_rad,
            descriptors=descriptors,
            depth_m=np.zeros(n, dtype=np.float32),
            right_px=np.full(n, -1.0, dtype=np.float32),
        )

    def _pyramid(self, gray: U8) -> list[U8]:
        levels = [_at_usual_size(gray, self._sizes[0])]
        for size, (level, _, _) in zip(self._sizes[1:], self._scratch[1:], strict=True):
            resized = cv2.resize(levels[-1], size, dst=level, interpolation=cv2.INTER_LINEAR)
            levels.append(np.asarray(resized, dtype=np.uint8))
        return levels

    def _describe(self, levels: list[U8], corners: Corners, chosen: I64) -> tuple[F32, U8]:
        angle_rad = np.zeros(len(chosen), dtype=np.float32)
        descriptors = np.zeros((len(chosen), 32), dtype=np.uint8)
        edges = np.searchsorted(corners.level[chosen], np.arange(len(levels) + 1))
        for number, image in enumerate(levels):
            own = slice(edges[number], edges[number + 1])
            if own.start == own.stop:
                continue
            px = corners.px[chosen[own]]
            # Two 5×5 boxes have the variance of OpenCV's Gaussian (σ = 2 px) at two thirds of its cost.
            _, once, twice = self._scratch[number]
            blurred = np.asarray(cv2.blur(cv2.blur(image, (5, 5), dst=once), (5, 5), dst=twice), dtype=np.uint8)
            orientations(image, px, self._disc, angle_rad[own])
            describe(blurred, px, angle_rad[own], self._places, descriptors[own])
        return angle_rad, descriptors

    def _to_finest_level(self, corners: Corners, chosen: I64) -> F32:
        """Return positions (K, 2) in the image as taken; pixel centres, not corners, are what a resize keeps."""
        ratio = self._ratios[corners.level[chosen]]
        return np.asarray((corners.px[chosen] + 0.5) * ratio - 0.5, dtype=np.float32)
