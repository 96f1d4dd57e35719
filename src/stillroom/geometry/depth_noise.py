"""How well sensors measure depth: the deviation σ(z) of structured light and of time of flight."""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F64, Floats

UNKNOWN, STRUCTURED_LIGHT, TIME_OF_FLIGHT = "unknown", "structured-light", "time-of-flight"
"""What measures depth; of the first nothing is known."""


@dataclass(frozen=True)
class DepthNoise:
    """The deviation of measured depth: σ² = (c₀ + c₁ z + c₂ z²)² + (q z²)²/12.

    Attributes:
        polynomial: c₀ [m], c₁ and c₂ [1/m].
        step_per_m: q [1/m]: depth from a disparity that comes in steps comes in steps of q z².
    """

    polynomial: tuple[float, float, float]
    step_per_m: float = 0.0

    def sigma_m(self, depth_m: Floats) -> F64:
        """Return the deviation (N,) [m] of depths (N,) [m]."""
        z = np.asarray(depth_m, dtype=np.float64)
        c0, c1, c2 = self.polynomial
        noise_m, step_m = c0 + z * (c1 + z * c2), self.step_per_m * z * z
        sigma_m: F64 = np.sqrt(noise_m * noise_m + step_m * step_m / 12.0)
        return sigma_m


SENSORS: dict[str, DepthNoise] = {
    # Kinect v1 and Xtion: 0.0012 + 0.0019 (z − 0.4)², steps of 2.8 mm at 1 m (docs/reference.md#noise-of-depth).
    STRUCTURED_LIGHT: DepthNoise((0.001504, -0.00152, 0.0019), 0.0028),
    # Kinect v2 (docs/reference.md#noise-of-depth).
    TIME_OF_FLIGHT: DepthNoise((0.0015, -0.0005, 0.0003)),
}
KNOWN = (UNKNOWN, *SENSORS)
