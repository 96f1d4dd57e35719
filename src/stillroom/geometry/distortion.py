"""Brown–Conrady distortion as kernels call it."""

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Lens, brown_conrady

distorted = njit(nogil=True, cache=True)(brown_conrady)
"""`brown_conrady` of one ray, compiled: `distorted(lens, x, y)` returns where it is seen, (u, v) [px]."""


# In line, for a call that passes arrays counts references, which takes longer than the work.
@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def seen_at(T: F64, lens: Lens, X: float, Y: float, Z: float) -> tuple[float, float, float]:
    """Return where a point [m] is in the image as taken, (u, v) [px], and its depth z [m]; of use where z > 0.

    Args:
        T: Motion (4, 4) from the point's frame to the camera's.
        lens: Of the camera.
        X, Y, Z: The point.
    """
    z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
    x = (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]) / z
    y = (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]) / z
    u, v = distorted(lens, x, y)
    return u, v, z
