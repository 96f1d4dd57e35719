"""The 256 comparisons of the ORB descriptor, asked of OpenCV.

Descriptors are worth most when they are everyone's: OpenCV's pattern was learned (Rublee et al., ICCV 2011) and
vocabularies are trained on it. OpenCV does not export the table, but its answers give it away: on white noise the
bit that compares the blurred patch at p and q is the sign of a linear function of the patch, and least squares finds
the two places where that function is not zero. This takes a fifth of a second, once a process.
"""

from functools import lru_cache

import cv2
import numpy as np

from stillroom.geometry.arrays import F64, I32, I64, U8, Bool

REACH_PX = 13
"""No comparison reaches further than this from the keypoint, along x or y."""
_WIDTH = 2 * REACH_PX + 1
_TILE_PX = 64
_TILES = 48
_RIDGE = 20.0
_AGREEMENT = 0.97
"""Not 1: OpenCV's blur inside ORB and its public one differ by a rounding now and then."""


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
    assert agreement >= _AGREEMENT, f"OpenCV's ORB is not the one we know: a bit agrees in {agreement:.1%} only"
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
