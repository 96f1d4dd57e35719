"""The two models of how an image moves: a homography and a fundamental matrix, fitted to the same samples.

A plane, and any scene under a pure rotation, moves by a homography, and then a fundamental matrix is not determined;
everything else moves by a fundamental matrix. Both are fitted by RANSAC, and their scores tell which one holds
(ORB-SLAM: Mur-Artal et al., T-RO 2015, section IV; docs/reference.md#orb-slam2-monocular).
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, Bool, Floats, Ints

SAMPLE = 8
"""Pairs in a sample; eight determine a fundamental matrix, and the homography gets the same."""
GATE_H, GATE_F = 5.991, 3.841
"""95 % of the χ² of two degrees of freedom and of one [px² at a noise of 1 px]."""


@dataclass(frozen=True)
class Model:
    """A matrix and how well it fits N pairs.

    Attributes:
        matrix: H with `second ~ H first`, or F with `second @ F @ first = 0` (3, 3), of Frobenius norm 1.
        score: Sum over the pairs and both images of the gate less the squared error, where that is within the gate.
        is_inlier: Which pairs agree in both images (N,).
    """

    matrix: F64
    score: float
    is_inlier: Bool = field(repr=False)


def fit_both(
    first_px: Floats, second_px: Floats, sigma_px: float, n_samples: int, seed: int
) -> tuple[Model, Model] | None:
    """Fit a homography and a fundamental matrix to the same samples of pairs.

    Differs from ORB-SLAM2: the best of each is fitted again to all pairs that agree with it, as long as that raises
    its score.

    Args:
        first_px, second_px: The pairs (N, 2) [px], undistorted.
        sigma_px: Standard deviation of a position [px].
        n_samples: Number of samples.
        seed: Of the samples: the same input and seed give the same answer.

    Returns:
        The homography and the fundamental matrix; None for fewer than eight pairs, or where all lie on one line along
        the image.
    """
    first, second = (np.ascontiguousarray(px, dtype=np.float64) for px in (first_px, second_px))
    if len(first) < SAMPLE or min(np.ptp(first, axis=0).min(), np.ptp(second, axis=0).min()) == 0.0:
        return None
    S_first, S_second = _units(first), _units(second)
    a, b = first * S_first[[0, 1], [0, 1]] + S_first[:2, 2], second * S_second[[0, 1], [0, 1]] + S_second[:2, 2]
    samples = np.random.default_rng(seed).random((n_samples, len(first))).argpartition(SAMPLE - 1)[:, :SAMPLE]

    def solved_H(chosen: Ints) -> F64:
        return np.asarray(np.linalg.inv(S_second) @ homographies(a[chosen], b[chosen]) @ S_first)

    def solved_F(chosen: Ints) -> F64:
        return np.asarray(S_second.T @ fundamentals(a[chosen], b[chosen]) @ S_first)

    def scored_H(H: F64) -> Model:
        return _scored(H, score_homography, first, second, sigma_px)

    def scored_F(F: F64) -> Model:
        return _scored(F, score_fundamental, first, second, sigma_px)

    return _best(samples, solved_H, scored_H), _best(samples, solved_F, scored_F)


def _best(samples: Ints, solve: Callable[[Ints], F64], scored: Callable[[F64], Model]) -> Model:
    """Return the best model of the samples (S, 8), fitted again to what agrees with it."""
    best = max((scored(matrix) for matrix in solve(samples)), key=lambda model: model.score)
    while best.is_inlier.sum() >= SAMPLE:
        again = scored(solve(np.flatnonzero(best.is_inlier)[None])[0])
        if again.score <= best.score:
            break
        best = again
    return best


def _scored(
    matrix: F64, score: Callable[[F64, F64, F64, float, Bool], float], first: F64, second: F64, sigma_px: float
) -> Model:
    matrix = np.ascontiguousarray(matrix / np.linalg.norm(matrix))
    is_inlier = np.zeros(len(first), dtype=np.bool_)
    return Model(matrix, float(score(matrix, first, second, sigma_px**-2.0, is_inlier)), is_inlier)


def homographies(a: F64, b: F64) -> F64:
    """Return the homographies (S, 3, 3) that fit each of S sets of pairs (S, M, 2), M of four or more, algebraically.

    Hartley and Zisserman, algorithm 4.1; coordinates should be about 1.
    """
    one, zero = np.ones(a.shape[:2]), np.zeros((*a.shape[:2], 3))
    p = np.concatenate((a, one[..., None]), axis=2)
    u, v = b[..., :1], b[..., 1:]
    rows = np.concatenate(
        (np.concatenate((p, zero, -u * p), axis=2), np.concatenate((zero, p, -v * p), axis=2)), axis=1
    )
    return _null_vectors(rows).reshape(-1, 3, 3)


def fundamentals(a: F64, b: F64) -> F64:
    """Return the fundamental matrices (S, 3, 3) of each of S sets of pairs (S, M, 2), M of eight or more.

    Hartley and Zisserman, algorithm 11.1; coordinates should be about 1.
    """
    p = np.concatenate((a, np.ones((*a.shape[:2], 1))), axis=2)
    q = np.concatenate((b, np.ones((*b.shape[:2], 1))), axis=2)
    F = _null_vectors((q[..., :, None] * p[..., None, :]).reshape(*a.shape[:2], 9)).reshape(-1, 3, 3)
    U, s, Vt = np.linalg.svd(F)
    s[:, 2] = 0.0  # a fundamental matrix has rank two
    return np.asarray(U * s[:, None, :] @ Vt)


def _null_vectors(rows: F64) -> F64:
    """Return the unit vectors (S, 9) that matrices (S, M, 9) take nearest to zero."""
    normal = rows.swapaxes(1, 2) @ rows
    return np.asarray(np.linalg.eigh(normal)[1][..., 0])


def _units(px: F64) -> F64:
    """Return the change of units (3, 3) that brings points (N, 2) about the origin, at coordinates of about 1."""
    centre = px.mean(axis=0)
    scale = 1.0 / np.abs(px - centre).mean(axis=0)
    return np.array([[scale[0], 0.0, -scale[0] * centre[0]], [0.0, scale[1], -scale[1] * centre[1]], [0.0, 0.0, 1.0]])


@njit(nogil=True, cache=True, error_model="numpy")
def score_homography(H: F64, first_px: F64, second_px: F64, inverse_variance: float, is_inlier: Bool) -> float:
    """Return the score of a homography (3, 3) over pairs (N, 2), and write which agree (N,); see `Model`."""
    G = np.empty((3, 3))  # the adjugate: the inverse but for its scale, which does not matter
    for i in range(3):
        for j in range(3):
            r, r2, c, c2 = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            G[i, j] = H[r, c] * H[r2, c2] - H[r, c2] * H[r2, c]
    score = 0.0
    for k in range(len(first_px)):
        is_inlier[k] = True
        for way in range(2):
            M, x, y, u, v = H, first_px[k, 0], first_px[k, 1], second_px[k, 0], second_px[k, 1]
            if way == 1:
                M, x, y, u, v = G, u, v, x, y
            w = M[2, 0] * x + M[2, 1] * y + M[2, 2]
            du = (M[0, 0] * x + M[0, 1] * y + M[0, 2]) / w - u
            dv = (M[1, 0] * x + M[1, 1] * y + M[1, 2]) / w - v
            chi2 = (du * du + dv * dv) * inverse_variance
            if chi2 <= GATE_H:
                score += GATE_H - chi2
            else:  # where w is 0, too
                is_inlier[k] = False
    return score


@njit(nogil=True, cache=True, error_model="numpy")
def score_fundamental(F: F64, first_px: F64, second_px: F64, inverse_variance: float, is_inlier: Bool) -> float:
    """Return the score of a fundamental matrix (3, 3) over pairs (N, 2), and write which agree (N,); see `Model`.

    An error is one number here and two of a homography: it must be less, and then counts as much.
    """
    score = 0.0
    for k in range(len(first_px)):
        is_inlier[k] = True
        x, y, u, v = first_px[k, 0], first_px[k, 1], second_px[k, 0], second_px[k, 1]
        a, b = F[0, 0] * x + F[0, 1] * y + F[0, 2], F[1, 0] * x + F[1, 1] * y + F[1, 2]
        product = a * u + b * v + F[2, 0] * x + F[2, 1] * y + F[2, 2]
        c, d = F[0, 0] * u + F[1, 0] * v + F[2, 0], F[0, 1] * u + F[1, 1] * v + F[2, 1]
        for norm2 in (a * a + b * b, c * c + d * d):
            chi2 = product * product / norm2 * inverse_variance
            if chi2 <= GATE_F:
                score += GATE_H - chi2
            else:
                is_inlier[k] = False
    return score
