"""RANSAC as its authors have it: the homography of the four pairs that most others agree with, and nothing after.

OpenCV's estimators, which `homography.estimate` uses, fit the inliers again before they return.
"""

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I64, Floats
from stillroom.geometry.homography import MIN_PAIRS, HomographyFit, transfer_errors_px

CONFIDENCE = 0.995
"""Probability with which one of the samples is free of outliers."""
MOST_SAMPLES = 1000
SAMPLE = 4
_TINY = 1e-9


def of_four_pairs(first_px: Floats, second_px: Floats, inlier_px: float, seed: int) -> HomographyFit | None:
    """Return the homography through four of the pairs (N, 2) that most others agree with (Fischler and Bolles, 1981).

    Args:
        first_px, second_px: The pairs (N, 2) [px].
        inlier_px: Largest residual |second − H first| of a pair that agrees [px].
        seed: Of the samples: the same input and seed give the same answer.

    Returns:
        The fit; None where the pairs do not determine one: too few, in one place or on one line.
    """
    if len(first_px) < MIN_PAIRS:
        return None
    first, second = (np.ascontiguousarray(px, dtype=np.float64) for px in (first_px, second_px))
    S_first, S_second = _units(first), _units(second)
    a, b = first @ S_first[:2, :2].T + S_first[:2, 2], second @ S_second[:2, :2].T + S_second[:2, 2]
    samples = np.random.default_rng(seed).integers(0, len(first), (MOST_SAMPLES, SAMPLE))
    H = np.zeros((3, 3))
    n_inliers = best_of_samples(a, b, samples, inlier_px * S_second[0, 0], CONFIDENCE, H)
    if n_inliers < MIN_PAIRS:
        return None
    H = np.linalg.inv(S_second) @ H @ S_first
    H = np.sign(H[2, 2] or 1.0) * H / np.linalg.norm(H)
    errors_px = transfer_errors_px(H, first, second)
    is_inlier = np.asarray(errors_px <= inlier_px)
    return HomographyFit(H, is_inlier, float(np.sqrt(np.mean(errors_px[is_inlier] ** 2))))


def _units(px: F64) -> F64:
    """Return the similarity (3, 3) that brings points (N, 2) about the origin, at coordinates of about 1."""
    centre = px.mean(axis=0)
    scale = 1.0 / max(float(np.abs(px - centre).mean()), _TINY)
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])


@njit(nogil=True, cache=True, error_model="numpy")
def best_of_samples(a: F64, b: F64, samples: I64, inlier: float, confidence: float, best: F64) -> int:
    """Write the homography (3, 3) of the best sample; return how many pairs (N, 2) agree with it, 0 for none.

    Args:
        a, b: The pairs, in units in which coordinates are about 1.
        samples: Numbers of four pairs each (S, 4); those in which a pair comes twice are passed over.
        inlier: Largest residual, in the units of b.
        confidence: When enough samples were drawn: one is free of outliers with this probability, if the share of
            inliers is that of the best one.
        best: Written.
    """
    n, most, needed = len(a), 0, float(len(samples))
    H = np.empty((3, 3))
    for s in range(len(samples)):
        if s >= needed:
            break
        if not through_four(a, b, samples[s], H):
            continue
        agree = 0
        for k in range(n):
            x, y = a[k]
            w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
            if w <= 0.0:  # On the other side of its horizon: no camera sees both.
                continue
            dx = b[k, 0] - (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w
            dy = b[k, 1] - (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w
            agree += dx * dx + dy * dy <= inlier * inlier
        if agree > most:
            most, best[:] = agree, H
            clean = (agree / n) ** len(samples[s])
            needed = np.log(1.0 - confidence) / np.log(1.0 - clean) if clean < 1.0 else 0.0
    return most


@njit(nogil=True, cache=True, error_model="numpy")
def through_four(a: F64, b: F64, sample: I64, H: F64) -> bool:
    """Write the homography through four pairs, its last element 1 or −1; return whether there is one.

    There is none where a pair comes twice, three are on a line, or the homography turns the image over.
    """
    M = np.zeros((8, 9))
    for r in range(4):
        x, y, u, v = a[sample[r], 0], a[sample[r], 1], b[sample[r], 0], b[sample[r], 1]
        M[2 * r, 0], M[2 * r, 1], M[2 * r, 2] = x, y, 1.0
        M[2 * r, 6], M[2 * r, 7], M[2 * r, 8] = -u * x, -u * y, u
        M[2 * r + 1, 3], M[2 * r + 1, 4], M[2 * r + 1, 5] = x, y, 1.0
        M[2 * r + 1, 6], M[2 * r + 1, 7], M[2 * r + 1, 8] = -v * x, -v * y, v
    for c in range(8):
        pivot = c + np.argmax(np.abs(M[c:, c]))
        if abs(M[pivot, c]) < 1e-9:
            return False
        for j in range(c, 9):
            M[c, j], M[pivot, j] = M[pivot, j], M[c, j]
        for r in range(8):
            if r != c:
                times = M[r, c] / M[c, c]
                for j in range(c, 9):
                    M[r, j] -= times * M[c, j]
    for k in range(8):
        H[k // 3, k % 3] = M[k, 8] / M[k, k]
    H[2, 2] = 1.0
    # All four on one side of the horizon, the side that counts as seen.
    n_before = 0
    for r in range(4):
        n_before += H[2, 0] * a[sample[r], 0] + H[2, 1] * a[sample[r], 1] + 1.0 > 0.0
    if n_before == 0:
        H *= -1.0
    turn = (
        H[0, 0] * (H[1, 1] * H[2, 2] - H[1, 2] * H[2, 1])
        - H[0, 1] * (H[1, 0] * H[2, 2] - H[1, 2] * H[2, 0])
        + H[0, 2] * (H[1, 0] * H[2, 1] - H[1, 1] * H[2, 0])
    )
    return bool(n_before in (0, 4) and turn > 1e-9)
