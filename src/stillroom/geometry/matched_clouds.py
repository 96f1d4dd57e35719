"""The motion between two clouds of matched points, some of them matched wrongly: rigid, or with a scale.

Horn's closed form on triples, RANSAC over them (ORB-SLAM2's loop closing, with the scale held at 1 or free).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillroom.geometry import sim3
from stillroom.geometry.align import align
from stillroom.geometry.arrays import F64, I64, Bool, Floats

_REFITS = 3


@dataclass(frozen=True)
class RobustFit:
    """A motion (4, 4), rigid or a similarity, and the pairs (N,) that agree with it."""

    T_target_source: F64
    is_inlier: Bool

    @property
    def n_inliers(self) -> int:
        """Number of pairs that agree."""
        return int(self.is_inlier.sum())


def fit_robustly(
    source_m: Floats,
    target_m: Floats,
    agrees: Callable[[F64], Bool],
    rng: np.random.Generator,
    n_samples: int = 300,
    with_scale: bool = False,
) -> RobustFit | None:
    """Find the motion with which most pairs agree.

    Args:
        source_m: Points (N, 3) [m].
        target_m: Their counterparts (N, 3) [m].
        agrees: Returns for motions (S, 4, 4) which pairs are inliers, (S, N).
        rng: Samples the triples.
        n_samples: Triples to try; all of them, at once.
        with_scale: Whether the motion is a similarity (`sim3`) whose scale is free, or rigid.

    Returns:
        The motion, fitted to its inliers; None where fewer than three pairs agree with any.
    """
    source: F64 = np.asarray(source_m, dtype=np.float64)
    target: F64 = np.asarray(target_m, dtype=np.float64)
    n = len(source)
    if n < 3:
        return None
    triples = _triples(n, n_samples, rng)
    of_samples = similar_of_samples if with_scale else rigid_of_samples
    motions = of_samples(source[triples], target[triples])
    votes = agrees(motions)
    best = int(np.argmax(votes.sum(axis=1)))
    fit = RobustFit(motions[best], votes[best])
    for _ in range(_REFITS):
        if fit.n_inliers < 3:
            return None
        aligned = align(source[fit.is_inlier], target[fit.is_inlier], with_scale)
        T_target_source = sim3.of(aligned.T_target_source, aligned.scale)
        refit = RobustFit(T_target_source, agrees(T_target_source[None])[0])
        if refit.n_inliers < fit.n_inliers:
            break
        fit = refit
    return fit


def rigid_of_samples(source_m: F64, target_m: F64) -> F64:
    """Return the motions (S, 4, 4) that best align samples (S, K, 3) of points with their counterparts (S, K, 3)."""
    mean_source, mean_target = source_m.mean(axis=1, keepdims=True), target_m.mean(axis=1, keepdims=True)
    covariances = np.swapaxes(target_m - mean_target, 1, 2) @ (source_m - mean_source)
    U, _, Vt = np.linalg.svd(covariances)
    U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]  # no mirror images
    motions = np.zeros((len(source_m), 4, 4))
    motions[:, :3, :3] = U @ Vt
    motions[:, :3, 3] = mean_target[:, 0] - np.einsum("sij,sj->si", motions[:, :3, :3], mean_source[:, 0])
    motions[:, 3, 3] = 1.0
    return motions


def similar_of_samples(source_m: F64, target_m: F64) -> F64:
    """Return the similarities (S, 4, 4) that best align samples (S, K, 3) of points with their counterparts (S, K, 3).

    The scale is the ratio of the clouds' extents, which favours neither side (Horn 1987, section 2.E); samples of one
    place have the scale 1.
    """
    motions = rigid_of_samples(source_m, target_m)
    mean_source, mean_target = source_m.mean(axis=1, keepdims=True), target_m.mean(axis=1, keepdims=True)
    extents2 = [
        np.sum((points - mean) ** 2, axis=(1, 2)) for points, mean in ((source_m, mean_source), (target_m, mean_target))
    ]
    known = (extents2[0] > 0.0) & (extents2[1] > 0.0)
    scale = np.sqrt(np.where(known, extents2[1], 1.0) / np.where(known, extents2[0], 1.0))
    motions[:, :3, :3] *= scale[:, None, None]
    motions[:, :3, 3] = mean_target[:, 0] - np.einsum("sij,sj->si", motions[:, :3, :3], mean_source[:, 0])
    return motions


def _triples(n: int, n_samples: int, rng: np.random.Generator) -> I64:
    """Draw triples (S, 3) of different numbers below n ≥ 3."""
    first = rng.integers(0, n, n_samples)
    second = (first + rng.integers(1, n, n_samples)) % n
    low, high = np.minimum(first, second), np.maximum(first, second)
    third = rng.integers(0, n - 2, n_samples)  # then past the two that are taken
    third += third >= low
    third += third >= high
    return np.stack((first, second, third), axis=1)
