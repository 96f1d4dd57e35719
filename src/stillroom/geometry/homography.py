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
_Units = tuple[float, float, float]
"""The similarity that takes points from pixels to other units: by its scale, after x and y of its centre [px]."""


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
        magsac: Whether to use MAGSAC++, which weights pairs and refines the best homography; else OpenCV's plain
            RANSAC, which fits its best one again to the pairs that agree.

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
    H, is_inlier = fit.H_second_first.copy(), fit.is_inlier.copy()
    first, second = (np.ascontiguousarray(px, dtype=np.float64) for px in (first_px, second_px))
    rms_px = compensate(H, first, second, is_inlier, symmetric, iterations)
    return HomographyFit(H, is_inlier, rms_px)


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


# The kernels of the refinement.


@njit(nogil=True, cache=True, error_model="numpy")
def compensate(H: F64, first_px: F64, second_px: F64, is_inlier: Bool, symmetric: bool, iterations: int) -> float:
    """Refine a homography (3, 3) over the pairs (N, 2) whose noise it explains; see `refine`.

    Args:
        H: Where to start; the refined one is written.
        first_px, second_px: The pairs.
        is_inlier: The pairs (N,) that it was fitted to; those that it is fitted to now are written.
        symmetric, iterations: As `refine`.

    Returns:
        Root mean square of the inliers' residuals [px].
    """
    a, b, errors_px, M = np.empty_like(first_px), np.empty_like(first_px), np.empty(len(first_px)), np.empty((3, 3))
    for _ in range(_CHOICES):
        _write_errors(H, first_px, second_px, errors_px)
        limit_px = max(_LIMIT_IN_MEDIANS * np.median(errors_px[is_inlier]), _LEAST_LIMIT_PX)
        is_inlier[:] = errors_px <= limit_px
        # Coordinates of about 1 make the columns of the Jacobian comparable (Hartley's normalisation).
        S_first, n = _normalized(first_px, is_inlier, a)
        S_second, n = _normalized(second_px, is_inlier, b)
        _change_units(H, S_first, S_second, M)
        # Weights undo the scales: the error is that of pixels in both images.
        weights = 1.0 / S_second[0] ** 2, (1.0 / S_first[0] ** 2 if symmetric else 0.0)
        _minimize(M, a[:n], b[:n], weights, iterations)
        _change_units(M, _back(S_first), _back(S_second), H)
        _to_unit(H)
    _write_errors(H, first_px, second_px, errors_px)
    return float(np.sqrt(np.mean(errors_px[is_inlier] ** 2)))


@njit(nogil=True, cache=True, error_model="numpy")
def _write_errors(H: F64, first_px: F64, second_px: F64, errors_px: F64) -> None:
    """Write `transfer_errors_px`."""
    for k in range(len(first_px)):
        x, y = first_px[k]
        w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
        dx = second_px[k, 0] - (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w
        dy = second_px[k, 1] - (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w
        errors_px[k] = np.sqrt(dx * dx + dy * dy)


@njit(nogil=True, cache=True, error_model="numpy")
def _normalized(px: F64, chosen: Bool, normal: F64) -> tuple[_Units, int]:
    """Write the chosen of the points (N, 2), brought about the origin, at a mean distance of √2; return their number.

    Returns:
        The units that they are in, and how many there are.
    """
    n, x, y, spread = 0, 0.0, 0.0, 0.0
    for k in range(len(px)):
        if chosen[k]:
            normal[n] = px[k]
            x += px[k, 0]
            y += px[k, 1]
            n += 1
    x, y = x / n, y / n
    for k in range(n):
        spread += np.sqrt((normal[k, 0] - x) ** 2 + (normal[k, 1] - y) ** 2)
    scale = np.sqrt(2.0) / max(spread / n, 1e-9)
    for k in range(n):
        normal[k, 0], normal[k, 1] = scale * (normal[k, 0] - x), scale * (normal[k, 1] - y)
    return (scale, x, y), n


@njit(nogil=True, cache=True)
def _back(units: _Units) -> _Units:
    """Return the units that undo a change of units."""
    scale, x, y = units
    return 1.0 / scale, -scale * x, -scale * y


@njit(nogil=True, cache=True)
def _change_units(H: F64, first: _Units, second: _Units, changed: F64) -> None:
    """Write the homography H (3, 3) for points of both images in other units."""
    (s, x, y), (s2, x2, y2) = first, second
    for i in range(3):
        changed[i, 0], changed[i, 1] = H[i, 0] / s, H[i, 1] / s
        changed[i, 2] = H[i, 0] * x + H[i, 1] * y + H[i, 2]
    for j in range(3):
        changed[0, j] = s2 * (changed[0, j] - x2 * changed[2, j])
        changed[1, j] = s2 * (changed[1, j] - y2 * changed[2, j])


@njit(nogil=True, cache=True)
def _to_unit(H: F64) -> None:
    """Do what `_unit` does, in place."""
    scale = (-1.0 if H[2, 2] < 0.0 else 1.0) / np.sqrt((H * H).sum())
    for i in range(3):
        for j in range(3):
            H[i, j] *= scale


@njit(nogil=True, cache=True, error_model="numpy")
def _invert(H: F64, inverse: F64) -> float:
    """Write the inverse of a matrix (3, 3) and return its determinant; with one of 0 nothing usable is written."""
    for i in range(3):
        for j in range(3):
            r, r2, c, c2 = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            inverse[i, j] = H[r, c] * H[r2, c2] - H[r, c2] * H[r2, c]
    determinant: float = H[0, 0] * inverse[0, 0] + H[0, 1] * inverse[1, 0] + H[0, 2] * inverse[2, 0]
    inverse /= determinant
    return determinant


@njit(nogil=True, cache=True, error_model="numpy")
def _minimize(H: F64, a: F64, b: F64, weights: tuple[float, float], iterations: int) -> None:
    """Write the homography (3, 3) with the least weighted error: Levenberg–Marquardt from H on.

    It has nine parameters, whose scale the damping holds.
    """
    trial, inverse, step = np.empty((3, 3)), np.empty((3, 3)), np.empty(9)
    normal, gradient, trial_normal, trial_gradient = np.empty((9, 9)), np.empty(9), np.empty((9, 9)), np.empty(9)
    _to_unit(H)
    _invert(H, inverse)
    cost, damping = linearize(H, inverse, a, b, weights, normal, gradient), _FIRST_DAMPING
    for _ in range(iterations):
        trial_cost = np.inf
        if _solve(normal, gradient, damping, step):
            for i in range(9):
                trial[i // 3, i % 3] = H[i // 3, i % 3] - step[i]
            _to_unit(trial)
            if abs(_invert(trial, inverse)) > 1e-12:
                trial_cost = linearize(trial, inverse, a, b, weights, trial_normal, trial_gradient)
        if trial_cost < cost:
            gained, cost = cost - trial_cost, trial_cost
            H[:] = trial
            normal, trial_normal, gradient, trial_gradient = trial_normal, normal, trial_gradient, gradient
            damping *= 0.1
            if gained < _TINY_DECREASE * cost:
                break
        elif damping > _MAX_DAMPING:
            break
        else:
            damping *= 10.0


@njit(nogil=True, cache=True)
def _solve(normal: F64, gradient: F64, damping: float, step: F64) -> bool:
    """Write the solution (9,) of the damped normal equations, by Cholesky; return whether there is one."""
    L = np.empty((9, 9))
    for i in range(9):
        for j in range(i + 1):
            s = normal[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = s / L[j, j]
                continue
            s += damping * (normal[i, i] + 1e-12)
            if not s > 0.0:
                return False
            L[i, i] = np.sqrt(s)
    for i in range(9):
        s = gradient[i]
        for k in range(i):
            s -= L[i, k] * step[k]
        step[i] = s / L[i, i]
    for i in range(8, -1, -1):
        s = step[i]
        for k in range(i + 1, 9):
            s -= L[k, i] * step[k]
        step[i] = s / L[i, i]
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def linearize(H: F64, G: F64, a: F64, b: F64, weights: tuple[float, float], normal: F64, gradient: F64) -> float:
    """Write the normal equations of the nine elements of H, `normal` (9, 9) and `gradient` (9,); return the error.

    The error is Σ w₀ |b − π(H a)|² + w₁ |a − π(G b)|² with G = H⁻¹. Of π(M p) = (u, v) and M p = w (u, v, 1), the
    derivatives by element i, j of H are (B₀ᵢ − u B₂ᵢ) cⱼ and (B₁ᵢ − v B₂ᵢ) cⱼ. For M = H, B is the identity and c is
    p/w; for M = G, B is −G and c is (u, v, 1), because ∂G/∂Hᵢⱼ = −G Eᵢⱼ G. So what is summed over the pairs is products
    of two of c's elements, times 1, u, v, and u² + v².

    Args:
        H, G: The homography (3, 3) and its inverse.
        a, b: The pairs (N, 2).
        weights: w₀, w₁.
        normal, gradient: Filled in.
    """
    normal[:] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    sums, pulls, c, by = np.empty((4, 3, 3)), np.empty((3, 3)), np.empty(3), np.empty(4)
    for way in range(2):
        weight = weights[way]
        if weight == 0.0:
            continue
        M, points, there = (H, a, b) if way == 0 else (G, b, a)
        sums[:] = 0.0
        pulls[:] = 0.0
        error = 0.0
        for k in range(len(points)):
            x, y = points[k, 0], points[k, 1]
            w = 1.0 / (M[2, 0] * x + M[2, 1] * y + M[2, 2])
            u = (M[0, 0] * x + M[0, 1] * y + M[0, 2]) * w
            v = (M[1, 0] * x + M[1, 1] * y + M[1, 2]) * w
            r_u, r_v = u - there[k, 0], v - there[k, 1]
            error += r_u * r_u + r_v * r_v
            c[0], c[1], c[2] = (x * w, y * w, w) if way == 0 else (u, v, 1.0)
            by[0], by[1], by[2], by[3] = 1.0, u, v, u * u + v * v
            for j in range(3):
                pulls[0, j] += c[j] * r_u
                pulls[1, j] += c[j] * r_v
                pulls[2, j] += c[j] * (u * r_u + v * r_v)
            for m in range(4):
                for i in range(3):
                    for j in range(3):
                        sums[m, i, j] += by[m] * (c[i] * c[j])
        cost += weight * error
        _add_equations(G, way == 0, weight, sums, pulls, normal, gradient)
    return cost


@njit(nogil=True, cache=True)
def _add_equations(G: F64, forth: bool, weight: float, sums: F64, pulls: F64, normal: F64, gradient: F64) -> None:
    """Add one way's part of the normal equations, of its sums (4, 3, 3) and pulls (3, 3); see `linearize`."""
    B = np.eye(3) if forth else -G
    for i in range(3):
        for j in range(3):
            gradient[3 * i + j] += weight * (B[0, i] * pulls[0, j] + B[1, i] * pulls[1, j] - B[2, i] * pulls[2, j])
            for k in range(3):
                by_one, by_square = B[0, i] * B[0, k] + B[1, i] * B[1, k], B[2, i] * B[2, k]
                by_u, by_v = B[0, i] * B[2, k] + B[2, i] * B[0, k], B[1, i] * B[2, k] + B[2, i] * B[1, k]
                for n in range(3):
                    normal[3 * i + j, 3 * k + n] += weight * (
                        by_one * sums[0, j, n] - by_u * sums[1, j, n] - by_v * sums[2, j, n] + by_square * sums[3, j, n]
                    )
