"""Homographies: the image motion of a plane, or of any scene under a pure rotation."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, U8, Bool, Floats
from stillroom.geometry.robust import find_homography, usac

MIN_PAIRS = 8
"""Four pairs determine a homography; with fewer than twice as many none of them is checked by another."""

_FIRST_DAMPING = 1e-3
_MAX_DAMPING = 1e8
_TINY_DECREASE = 1e-6
_CHOICES = 2
_LIMIT_IN_MEDIANS = 3.5  # 99.98 % of normal errors in the plane, whose median is 1.18 standard deviations
_LEAST_LIMIT_PX = 0.1


@dataclass(frozen=True)
class HomographyFit:
    """A homography and how well it fits the N pairs that it was found from.

    Attributes:
        H_second_first: Takes points of the first image to the second (3, 3), Frobenius norm 1.
        is_inlier: Which pairs it was fitted to (N,).
        rms_px: Root mean square of their residuals |second − H first| [px].
    """

    H_second_first: F64
    is_inlier: Bool = field(repr=False)
    rms_px: float


def estimate(
    first_px: Floats, second_px: Floats, inlier_px: float, seed: int, magsac: bool = True
) -> HomographyFit | None:
    """Find the homography that most pairs agree with.

    Args:
        first_px, second_px: The pairs (N, 2) [px].
        inlier_px: Largest residual of a pair that agrees [px].
        seed: Of the random samples: the same input and seed give the same answer.
        magsac: Whether to use MAGSAC++, which weights pairs and refines the best homography; else plain RANSAC, whose
            result goes exactly through four of the pairs.

    Returns:
        The fit; None where the pairs do not determine one: too few, in one place or on one line.
    """
    if len(first_px) < MIN_PAIRS:
        return None
    first, second = (np.ascontiguousarray(px, dtype=np.float64) for px in (first_px, second_px))
    found = find_homography(first, second, usac(inlier_px, seed, 0.995, magsac))
    if found is None:
        return None
    H, is_inlier = found
    if is_inlier.sum() < MIN_PAIRS or not _is_regular(H, first):
        return None
    return _fit(H, first, second, is_inlier)


def refine(
    fit: HomographyFit, first_px: Floats, second_px: Floats, symmetric: bool = True, iterations: int = 10
) -> HomographyFit:
    """Minimise the reprojection error over the inliers by Levenberg–Marquardt (PSPNet-SLAM Eq. 11).

    Differs from the paper: Eq. 11 counts the error in the second image alone, as if the first had no noise; by default
    the error in the first image is added (Hartley and Zisserman, Eq. 4.7), so that the answer does not depend on which
    image is called the first. The inliers are chosen again, by a limit that follows from their own noise: a fixed one
    that cuts off good pairs costs more accuracy than the refinement gains.

    Args:
        fit: Where to start, and the inliers.
        first_px, second_px: The pairs (N, 2) [px].
        symmetric: Whether the error in the first image counts too.
        iterations: Most steps.

    Returns:
        The refined fit and the pairs that it was fitted to.
    """
    for _ in range(_CHOICES):
        chosen = _of_their_noise(fit, first_px, second_px)
        fit = _refined(
            HomographyFit(fit.H_second_first, chosen, fit.rms_px), first_px, second_px, symmetric, iterations
        )
    return fit


def _of_their_noise(fit: HomographyFit, first_px: Floats, second_px: Floats) -> Bool:
    """Return which pairs (N,) lie within the noise, estimated by the median residual of the inliers."""
    errors_px = transfer_errors_px(fit.H_second_first, first_px, second_px)
    limit_px = _LIMIT_IN_MEDIANS * float(np.median(errors_px[fit.is_inlier]))
    return np.asarray(errors_px <= max(limit_px, _LEAST_LIMIT_PX))


def _refined(
    fit: HomographyFit, first_px: Floats, second_px: Floats, symmetric: bool, iterations: int
) -> HomographyFit:
    """Return the fit with the least error over its inliers."""
    # Coordinates of about 1 make the columns of the Jacobian comparable (Hartley's normalisation).
    S_first, S_second = _normalization(first_px[fit.is_inlier]), _normalization(second_px[fit.is_inlier])
    a = apply(S_first, first_px[fit.is_inlier])
    b = apply(S_second, second_px[fit.is_inlier])
    # Weights undo the scales: the error is that of pixels in both images.
    weights = np.array([1.0 / S_second[0, 0] ** 2, symmetric / S_first[0, 0] ** 2])
    H = _unit(S_second @ fit.H_second_first @ np.linalg.inv(S_first))
    H = _levenberg_marquardt(H, a, b, weights, iterations)
    H = np.linalg.inv(S_second) @ H @ S_first
    return _fit(H, np.asarray(first_px, np.float64), np.asarray(second_px, np.float64), fit.is_inlier)


def apply(H: Floats, px: Floats) -> F64:
    """Take points (N, 2) to where a homography (3, 3) moves them, (N, 2) (Eq. 10); infinite on its horizon."""
    moved = np.asarray(px, dtype=np.float64) @ H[:, :2].T + H[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        there: F64 = moved[:, :2] / moved[:, 2:]
    return there


def transfer_errors_px(H_second_first: Floats, first_px: Floats, second_px: Floats) -> F64:
    """Return the residuals |second − H first| of pairs (N, 2), (N,) [px]: ε of Eq. 11 is the sum of their squares."""
    return np.asarray(np.linalg.norm(second_px - apply(H_second_first, first_px), axis=1))


def compensate_image(image: U8, H_present_previous: Floats) -> U8:
    """Move all pixels of a previous image (H, W) or (H, W, 3) to where the present one would have them; 0 elsewhere.

    This is the paper's motion compensation frame (III.B).
    """
    size = (image.shape[1], image.shape[0])
    return np.asarray(cv2.warpPerspective(image, H_present_previous, size, flags=cv2.INTER_LINEAR), dtype=np.uint8)


def of_rotation(T_second_first: Floats, K: Floats) -> F64:
    """Return K R K⁻¹ (3, 3), Frobenius norm 1: the image motion of far points, or of all under a pure rotation."""
    return _unit(K @ T_second_first[:3, :3] @ np.linalg.inv(K))


def _is_regular(H: Floats, px: F64) -> bool:
    """Return whether a homography keeps all points (N, 2) on one side of its horizon and keeps their orientation."""
    w = px @ H[2, :2] + H[2, 2]
    return bool(np.all(w > 0) or np.all(w < 0)) and float(np.linalg.det(H / np.linalg.norm(H)) * np.sign(w[0])) > 1e-12


def _fit(H: F64, first: F64, second: F64, is_inlier: Bool) -> HomographyFit:
    errors_px = transfer_errors_px(H, first[is_inlier], second[is_inlier])
    return HomographyFit(_unit(H), is_inlier, float(np.sqrt(np.mean(errors_px**2))))


def _unit(H: Floats) -> F64:
    """Return the same homography with Frobenius norm 1 and a positive last element, where it has one."""
    sign = -1.0 if H[2, 2] < 0 else 1.0
    return np.asarray(sign * H / np.linalg.norm(H), dtype=np.float64)


def _normalization(px: Floats) -> F64:
    """Return the similarity (3, 3) that brings points (N, 2) about the origin, at a mean distance of √2."""
    centre = np.asarray(px, dtype=np.float64).mean(axis=0)
    spread = float(np.mean(np.linalg.norm(px - centre, axis=1)))
    scale = np.sqrt(2.0) / max(spread, 1e-9)
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])


def _levenberg_marquardt(H: F64, a: F64, b: F64, weights: F64, iterations: int) -> F64:
    """Return the homography (3, 3) with the least weighted error; nine parameters, whose scale the damping holds."""
    normal, gradient = np.empty((9, 9)), np.empty(9)
    cost = linearize(H, np.linalg.inv(H), a, b, weights, normal, gradient)
    damping = _FIRST_DAMPING
    for _ in range(iterations):
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -gradient)
        trial = _unit(H + step.reshape(3, 3))
        trial_normal, trial_gradient = np.empty((9, 9)), np.empty(9)
        trial_cost = np.inf
        if abs(np.linalg.det(trial)) > 1e-12:
            inverse = np.linalg.inv(trial)
            trial_cost = linearize(trial, inverse, a, b, weights, trial_normal, trial_gradient)
        if trial_cost < cost:
            gained = cost - trial_cost
            H, cost, normal, gradient = trial, trial_cost, trial_normal, trial_gradient
            damping *= 0.1
            if gained < _TINY_DECREASE * cost:
                break
        elif damping > _MAX_DAMPING:
            break
        else:
            damping *= 10.0
    return H


@njit(nogil=True, cache=True)
def linearize(H: F64, G: F64, a: F64, b: F64, weights: F64, normal: F64, gradient: F64) -> float:
    """Write the normal equations of the nine elements of H, `normal` (9, 9) and `gradient` (9,); return the error.

    The error is Σ w₀ |b − π(H a)|² + w₁ |a − π(G b)|² with G = H⁻¹; ∂G/∂Hᵢⱼ = −G Eᵢⱼ G gives the second part's
    derivatives: column i of G times element j of G b.

    Args:
        H, G: The homography (3, 3) and its inverse.
        a, b: The pairs (N, 2).
        weights: w₀, w₁.
        normal, gradient: Filled in.
    """
    normal[:] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    J = np.empty((2, 9))
    for k in range(len(a)):
        for way in range(2):
            weight = weights[way]
            if weight == 0.0:
                continue
            M = H if way == 0 else G
            x, y = (a[k, 0], a[k, 1]) if way == 0 else (b[k, 0], b[k, 1])
            p = M[0, 0] * x + M[0, 1] * y + M[0, 2]
            q = M[1, 0] * x + M[1, 1] * y + M[1, 2]
            w = M[2, 0] * x + M[2, 1] * y + M[2, 2]
            u, v = p / w, q / w
            r_u = u - (b[k, 0] if way == 0 else a[k, 0])
            r_v = v - (b[k, 1] if way == 0 else a[k, 1])
            for i in range(3):
                for j in range(3):
                    if way == 0:
                        c = (x if j == 0 else y if j == 1 else 1.0) / w
                        J[0, 3 * i + j] = c if i == 0 else -u * c if i == 2 else 0.0
                        J[1, 3 * i + j] = c if i == 1 else -v * c if i == 2 else 0.0
                    else:
                        c = -(p if j == 0 else q if j == 1 else w) / w
                        J[0, 3 * i + j] = c * (G[0, i] - u * G[2, i])
                        J[1, 3 * i + j] = c * (G[1, i] - v * G[2, i])
            cost += weight * (r_u * r_u + r_v * r_v)
            for i in range(9):
                gradient[i] += weight * (J[0, i] * r_u + J[1, i] * r_v)
                for j in range(9):
                    normal[i, j] += weight * (J[0, i] * J[0, j] + J[1, i] * J[1, j])
    return cost
