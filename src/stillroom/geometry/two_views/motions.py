"""The camera motions that a fundamental matrix or a homography may stand for; which one holds, the points tell."""

import numpy as np

from stillroom.geometry.arrays import F64, Floats

LEAST_RATIO = 1.00001
"""Neighbouring singular values nearer than this tell no plane: the camera only turned, or the scene is far away."""


def of_fundamental(F_second_first: Floats, K: Floats) -> F64:
    """Return the four motions `T_second_first` (4, 4, 4) of a fundamental matrix (3, 3), translations of length 1.

    Hartley and Zisserman, result 9.19.
    """
    U, _, Vt = np.linalg.svd(K.T @ F_second_first @ K)
    W = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turns = [_proper(U @ W @ Vt), _proper(U @ W.T @ Vt)]
    return np.array([_motion(R, sign * U[:, 2]) for R in turns for sign in (1.0, -1.0)])


def of_homography(H_second_first: Floats, K: Floats) -> F64:
    """Return the eight motions `T_second_first` (8, 4, 4) of a plane's homography (3, 3), translations of length 1.

    Faugeras and Lustman, Motion and structure from motion in a piecewise planar environment, 1988: four for each sign
    of the plane's distance to the second camera's centre.

    Returns:
        The motions; none (0, 4, 4) where two singular values are the same.
    """
    U, d, Vt = np.linalg.svd(np.linalg.inv(K) @ H_second_first @ K)
    if d[0] < LEAST_RATIO * d[1] or d[1] < LEAST_RATIO * d[2]:
        return np.zeros((0, 4, 4))
    s = np.linalg.det(U) * np.linalg.det(Vt)
    d1, d2, d3 = d
    span = d1**2 - d3**2
    x1, x3 = np.sqrt((d1**2 - d2**2) / span), np.sqrt((d2**2 - d3**2) / span)
    root = np.sqrt((d1**2 - d2**2) * (d2**2 - d3**2))
    found = []
    for e1 in (1.0, -1.0):
        for e3 in (1.0, -1.0):
            sine, cosine = e1 * e3 * root / ((d1 + d3) * d2), (d2**2 + d1 * d3) / ((d1 + d3) * d2)
            turn = np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])
            found.append(_motion(s * U @ turn @ Vt, U @ np.array([e1 * x1, 0.0, -e3 * x3])))
    for e1 in (1.0, -1.0):
        for e3 in (1.0, -1.0):
            sine, cosine = e1 * e3 * root / ((d1 - d3) * d2), (d1 * d3 - d2**2) / ((d1 - d3) * d2)
            turn = np.array([[cosine, 0.0, sine], [0.0, -1.0, 0.0], [sine, 0.0, -cosine]])
            found.append(_motion(s * U @ turn @ Vt, U @ np.array([e1 * x1, 0.0, e3 * x3])))
    return np.array(found)


def _proper(R: F64) -> F64:
    """Return the rotation of a matrix that is one but for its sign."""
    return np.asarray(R * np.sign(np.linalg.det(R)))


def _motion(R: F64, t: F64) -> F64:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t / np.linalg.norm(t)
    return T
