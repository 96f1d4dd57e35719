"""Brown–Conrady distortion as kernels call it."""

from stillroom.compiled import njit
from stillroom.geometry.camera import brown_conrady

distorted = njit(nogil=True, cache=True)(brown_conrady)
"""`brown_conrady` of one ray, compiled: `distorted(lens, x, y)` returns where it is seen, (u, v) [px]."""
