"""Kernels: the logarithm on SE(3) of one motion; `twists` has that of many at once."""

import math

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64

_SMALL_RAD2 = 0.0025
"""Below this square of the angle a coefficient comes from its series, which is then exact to rounding."""


@njit(nogil=True, cache=True)
def log_of(T_a_b: F64, twist: F64) -> None:
    """Write the twist (6,) of a motion, whose first three rows (3, 4) are read; turns are at most π."""
    rotation_vector(T_a_b, twist[3:])
    a, b, c = twist[3], twist[4], twist[5]
    x, y, z = T_a_b[0, 3], T_a_b[1, 3], T_a_b[2, 3]
    angle2 = a * a + b * b + c * c
    if angle2 < _SMALL_RAD2:
        d = 1.0 / 12.0 + angle2 / 720.0 + angle2 * angle2 / 30240.0
    else:
        half = 0.5 * math.sqrt(angle2)
        d = (1.0 - half * math.cos(half) / math.sin(half)) / angle2
    # The inverse of the left Jacobian (Barfoot, State Estimation for Robotics, 2017, section 7.1), times t.
    dx, dy, dz = b * z - c * y, c * x - a * z, a * y - b * x
    twist[0] = x - 0.5 * dx + d * (b * dz - c * dy)
    twist[1] = y - 0.5 * dy + d * (c * dx - a * dz)
    twist[2] = z - 0.5 * dz + d * (a * dy - b * dx)


@njit(nogil=True, cache=True)
def log_between(T_world_a: F64, T_world_b: F64, T_a_b: F64, twist: F64) -> None:
    """Write the motion from one pose to another (4, 4), `T_a_b`, and its twist (6,); turns are at most π."""
    for i in range(3):
        for j in range(4):
            T_a_b[i, j] = 0.0
            for k in range(3):
                off = T_world_a[k, 3] if j == 3 else 0.0
                T_a_b[i, j] += T_world_a[k, i] * (T_world_b[k, j] - off)
    log_of(T_a_b, twist)


@njit(nogil=True, cache=True)
def rotation_vector(R: F64, phi: F64) -> None:
    """Write the rotation vector (3,) [rad] of a rotation (3, 3), by the largest part of its quaternion (Shepperd)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    largest = 3
    for i in range(3):
        if R[i, i] > (trace if largest == 3 else R[largest, largest]):
            largest = i
    if largest == 3:
        w = 1.0 + trace
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif largest == 0:
        w, x = R[2, 1] - R[1, 2], 1.0 + 2.0 * R[0, 0] - trace
        y, z = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]
    elif largest == 1:
        w, y = R[0, 2] - R[2, 0], 1.0 + 2.0 * R[1, 1] - trace
        x, z = R[0, 1] + R[1, 0], R[1, 2] + R[2, 1]
    else:
        w, z = R[1, 0] - R[0, 1], 1.0 + 2.0 * R[2, 2] - trace
        x, y = R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 1e-12 * w else 2.0 / w
    phi[0], phi[1], phi[2] = scale * x, scale * y, scale * z
