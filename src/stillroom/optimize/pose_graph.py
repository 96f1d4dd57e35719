"""Pose-graph optimisation: keyframes held together by measured motions between pairs of them.

ORB-SLAM2's essential graph (Mur-Artal and Tardós 2017, section III-C; docs/reference.md#orb-slam2-loops) with the scale
fixed or, over Sim(3), free. The normal equations are sparse; scipy's SuperLU solves them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F64, I64, Bool, Floats, Ints
from stillroom.geometry.groups import RIGID, MotionGroup

_FLOOR = 1e-9
"""Added to the diagonal: a node without edges stays where it is, and no block becomes singular."""


@dataclass(frozen=True)
class PoseGraph:
    """N nodes and E edges, each a measured motion from one node to another.

    Attributes:
        T_world_node: Poses to start from (N, 4, 4).
        is_fixed: Fixed nodes (N,); each connected part needs one.
        first, second: The nodes that an edge joins (E,).
        T_first_second: What was measured between them (E, 4, 4).
        information: Inverse variances of translation [1/m²], rotation [1/rad²] and, where it is free, the logarithm of
            the scale (E, D), in the second node's frame.
        group: What the poses and motions are: rigid, or similarities whose scale is free too.
    """

    T_world_node: Floats
    is_fixed: Bool
    first: Ints
    second: Ints
    T_first_second: Floats
    information: Floats
    group: MotionGroup = RIGID


@dataclass(frozen=True)
class PoseGraphResult:
    """The optimised nodes.

    Attributes:
        T_world_node: Poses (N, 4, 4).
        chi2: Weighted squared error that remains on each edge (E,); the robust kernel is not in it.
        initial_cost, final_cost: Huber's Σρ(χ²).
        n_iterations: Steps tried.
    """

    T_world_node: F64
    chi2: F64
    initial_cost: float
    final_cost: float
    n_iterations: int


@dataclass(frozen=True)
class PoseGraphConfig:
    """Pose-graph optimisation.

    Attributes:
        iterations: Steps, at most.
        huber_chi2: Squared threshold of Huber's kernel: an edge that all others contradict counts less.
        first_damping: Levenberg–Marquardt's λ at the start, relative to the diagonal.
        min_relative_decrease: It ends when a step lowers the cost by no more than this part of it.
    """

    iterations: int = 20
    huber_chi2: float = 16.8
    first_damping: float = 1e-6
    min_relative_decrease: float = 1e-6

    def build(self) -> "PoseGraphOptimizer":
        """Return the optimiser."""
        return PoseGraphOptimizer(self)


class PoseGraphOptimizer:
    """Optimises a pose graph: Levenberg–Marquardt, robust, sparse."""

    def __init__(self, config: PoseGraphConfig | None = None) -> None:
        self.config = config or PoseGraphConfig()

    def __call__(self, graph: PoseGraph, stop: Callable[[], bool] | None = None) -> PoseGraphResult:
        """Minimise the robust error of the edges over the free nodes.

        Args:
            graph: What to optimise.
            stop: Called between steps; true ends it early.
        """
        config, system = self.config, _NormalEquations(graph)
        T = np.array(graph.T_world_node, dtype=np.float64)
        residuals = _residuals(graph, T)
        cost = initial = self._cost(graph, residuals)
        damping, growth, n = config.first_damping, 2.0, 0
        while n < config.iterations and system.n_free and cost > 0.0 and not (stop is not None and stop()):
            n += 1
            system.linearize(graph, T, residuals, self._factors(graph, residuals))
            trial = _moved(T, system.free, system.solve(damping), graph.group)
            trial_residuals = _residuals(graph, trial)
            trial_cost = self._cost(graph, trial_residuals)
            if not trial_cost <= cost:
                damping, growth = max(damping, 1e-9) * growth, 2.0 * growth
                continue
            decrease, cost = cost - trial_cost, trial_cost
            T, residuals = trial, trial_residuals
            damping, growth = damping / 3.0, 2.0
            if decrease <= config.min_relative_decrease * cost:
                break
        return PoseGraphResult(T, _chi2(graph, residuals), initial, cost, n)

    def _factors(self, graph: PoseGraph, residuals: F64) -> F64:
        """Return the derivative of Huber's ρ at each edge (E,)."""
        chi2, limit = _chi2(graph, residuals), self.config.huber_chi2
        return np.asarray(np.sqrt(limit / np.maximum(chi2, limit)))

    def _cost(self, graph: PoseGraph, residuals: F64) -> float:
        chi2, limit = _chi2(graph, residuals), self.config.huber_chi2
        beyond = 2.0 * np.sqrt(limit * np.maximum(chi2, limit)) - limit
        return float(np.where(chi2 <= limit, chi2, beyond).sum())


class _NormalEquations:
    """The sparse system of one graph: its pattern stays, its numbers change with every linearisation."""

    def __init__(self, graph: PoseGraph) -> None:
        self.size = graph.group.size
        self.free = np.flatnonzero(~np.asarray(graph.is_fixed, dtype=np.bool_))
        self.n_free = len(self.free)
        slot = np.full(len(graph.is_fixed), -1, dtype=np.int64)
        slot[self.free] = np.arange(self.n_free)
        self._first, self._second = slot[graph.first], slot[graph.second]
        pairs = (
            (self._first, self._first),
            (self._second, self._second),
            (self._first, self._second),
            (self._second, self._first),
        )
        self._used = [np.flatnonzero((rows >= 0) & (columns >= 0)) for rows, columns in pairs]
        within = np.arange(self.size)
        blocks = [(rows[use], columns[use]) for use, (rows, columns) in zip(self._used, pairs, strict=True)]
        block_rows = np.concatenate([rows for rows, _ in blocks])
        block_columns = np.concatenate([columns for _, columns in blocks])
        shape = len(block_rows), self.size, self.size
        self._rows = np.broadcast_to(self.size * block_rows[:, None, None] + within[:, None], shape).ravel()
        self._columns = np.broadcast_to(self.size * block_columns[:, None, None] + within, shape).ravel()
        self._values = np.zeros(0)
        self._gradient = np.zeros((0, self.size))

    def linearize(self, graph: PoseGraph, T: F64, residuals: F64, factors: F64) -> None:
        """Take up JᵀWJ and JᵀWr at poses (N, 4, 4), the edges weighted by `factors` (E,)."""
        by_second = graph.group.inverse_right_jacobian(residuals)
        T_second_first = graph.group.inverse(T[graph.second]) @ T[graph.first]
        by_first = -by_second @ graph.group.adjoint(T_second_first)
        weighted = factors[:, None] * graph.information
        first_t, second_t = np.swapaxes(by_first, 1, 2), np.swapaxes(by_second, 1, 2)
        W_first, W_second = weighted[:, :, None] * by_first, weighted[:, :, None] * by_second
        across = first_t @ W_second
        blocks = (first_t @ W_first, second_t @ W_second, across, np.swapaxes(across, 1, 2))
        self._values = np.concatenate([b[use] for use, b in zip(self._used, blocks, strict=True)]).ravel()
        self._gradient = np.zeros((self.n_free, self.size))
        for slots, transposed in ((self._first, first_t), (self._second, second_t)):
            held = slots >= 0
            np.add.at(self._gradient, slots[held], (transposed @ (weighted * residuals)[:, :, None])[held, :, 0])

    def solve(self, damping: float) -> F64:
        """Return the step (F, D) of the free nodes."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.linalg import splu

        size = self.size * self.n_free
        H = coo_matrix((self._values, (self._rows, self._columns)), shape=(size, size)).tocsc()
        diagonal = H.diagonal()
        H.setdiag(diagonal * (1.0 + damping) + _FLOOR)
        factors = splu(H, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        step: F64 = factors.solve(-self._gradient.ravel()).reshape(-1, self.size)
        return step


def _residuals(graph: PoseGraph, T: F64) -> F64:
    """Return log(measured⁻¹ · present) of each edge (E, D)."""
    group = graph.group
    present = group.inverse(T[graph.first]) @ T[graph.second]
    return group.log(group.inverse(np.asarray(graph.T_first_second)) @ present)


def _chi2(graph: PoseGraph, residuals: F64) -> F64:
    return np.asarray((graph.information * residuals**2).sum(axis=1))


def _moved(T: F64, free: I64, step: F64, group: MotionGroup) -> F64:
    """Return T exp(ξ) of the free nodes; the others as they are."""
    moved = T.copy()
    if np.isfinite(step).all():
        moved[free] = T[free] @ group.exp(step)
    return moved
