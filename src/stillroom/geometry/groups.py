"""The kinds of motion that a pose graph may hold together, as arrays of them: with six degrees of freedom, or seven."""

from collections.abc import Callable
from dataclasses import dataclass

from stillroom.geometry import se3, sim3, twists
from stillroom.geometry.arrays import F64


@dataclass(frozen=True)
class MotionGroup:
    """Functions on motions (N, 4, 4), which multiply as matrices, and on their tangents (N, D).

    Attributes:
        size: Degrees of freedom D of a tangent.
        exp, log: Motions of tangents, and tangents of motions.
        inverse: Inverse motions.
        adjoint: Matrices (N, D, D) with `exp(Ad ξ) X = X exp(ξ)`.
        inverse_right_jacobian: Derivatives (N, D, D) of `log(exp(r) exp(ξ))` by ξ at 0.
    """

    size: int
    exp: Callable[[F64], F64]
    log: Callable[[F64], F64]
    inverse: Callable[[F64], F64]
    adjoint: Callable[[F64], F64]
    inverse_right_jacobian: Callable[[F64], F64]


RIGID = MotionGroup(6, twists.exp, twists.log, se3.inverse, twists.adjoint, twists.inverse_right_jacobian)
"""SE(3); tangents are (ρ [m], φ [rad])."""
SIMILAR = MotionGroup(7, sim3.exp, sim3.log, sim3.inverse, sim3.adjoint, sim3.inverse_right_jacobian)
"""Sim(3); tangents are (ρ [m], φ [rad], σ), the last the logarithm of the scale."""
