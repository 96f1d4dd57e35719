"""The system that bundle adjustment leaves for the cameras once the points are eliminated: dense, or sparse when large.

Both take the kernels' blocks (see `bundle_kernels`) and return the cameras' step.
"""

from typing import NamedTuple, Protocol

import numpy as np

from stillroom.compiled import njit
from stillroom.geometry.arrays import F64, I32, I64
from stillroom.optimize.bundle_kernels import DIAGONAL_FLOOR, Blocks, Order, reduce_to_cameras

SPARSE_FROM = 120
"""Free keyframes from which on most pairs share no point: a dense factorisation would mostly work on zeros."""


class SparseBlocks(NamedTuple):
    """The blocks of a lower block triangle that are not zero, row by row.

    Attributes:
        row_start: Where each row's blocks begin (F + 1,) int64.
        columns: The column of each block (B,) int32, rising within a row.
        values: The blocks (B, 6, 6).
    """

    row_start: I64
    columns: I32
    values: F64


class ReducedSystem(Protocol):
    """Solves for the cameras."""

    def solve(self, blocks: Blocks, factors: F64, damping: float) -> F64 | None:
        """Return the damped step (F, 6); None where there is none."""


def reduced_system(n_free: int, order: Order) -> ReducedSystem:
    """Choose the solver for F free cameras and observations as `bundle_kernels` orders them."""
    return (SparseSystem if n_free >= SPARSE_FROM else DenseSystem)(n_free, order)


class DenseSystem:
    """Cholesky factors of the whole matrix."""

    def __init__(self, n_free: int, order: Order) -> None:
        self._order, self._scratch = order, _scratch(order.starts)
        self._S, self._rhs = np.empty((n_free, 6, n_free, 6)), np.empty((n_free, 6))

    def solve(self, blocks: Blocks, factors: F64, damping: float) -> F64 | None:
        """Return the damped step (F, 6); None where there is none."""
        from scipy.linalg.lapack import dpotrf, dpotrs

        S, rhs = self._S, self._rhs
        reduce_to_cameras(self._order, blocks, factors, damping, self._scratch, S, rhs)
        size = rhs.size
        if not size:
            return np.zeros((0, 6))
        # The transpose is what LAPACK wants to work in place: its upper triangle is our lower one.
        factor, failed = dpotrf(S.reshape(size, size).T, clean=False, overwrite_a=True)
        return None if failed else _finite(dpotrs(factor, rhs.reshape(size))[0])


class SparseSystem:
    """A factorisation with the sparsity of shared points: blocks of the lower triangle, row by row."""

    def __init__(self, n_free: int, order: Order) -> None:
        from scipy.sparse import csr_matrix, tril

        self._order, self._scratch = order, _scratch(order.starts)
        starts, slots = order
        point = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        seen = slots >= 0
        sees = csr_matrix((np.ones(seen.sum(), dtype=np.int32), (slots[seen], point[seen])), (n_free, len(starts) - 1))
        itself = csr_matrix((np.ones(n_free, dtype=np.int32), (np.arange(n_free), np.arange(n_free))))
        pattern = tril(sees @ sees.T + itself, format="csr")
        pattern.sort_indices()
        columns = pattern.indices.astype(np.int32)
        self._S = SparseBlocks(pattern.indptr.astype(np.int64), columns, np.empty((len(columns), 6, 6)))
        self._rhs = np.empty((n_free, 6))

    def solve(self, blocks: Blocks, factors: F64, damping: float) -> F64 | None:
        """Return the damped step (F, 6); None where there is none."""
        from scipy.sparse import bsr_matrix, tril
        from scipy.sparse.linalg import splu

        S = self._S
        reduce_sparsely(self._order, blocks, factors, damping, self._scratch, S, self._rhs)
        size = self._rhs.size
        lower = bsr_matrix((S.values, S.columns, S.row_start), shape=(size, size)).tocsr()
        below = tril(lower, -1, format="csr")
        whole = (lower + below.T).tocsc()
        try:
            system = splu(whole, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError:  # SuperLU raises this for a singular matrix
            return None
        return _finite(system.solve(self._rhs.ravel()))


def _finite(step: F64) -> F64 | None:
    return step.reshape(-1, 6) if np.isfinite(step).all() else None


def _scratch(starts: I64) -> F64:
    """Return room for the observations of any one point."""
    return np.empty((int(np.diff(starts).max(initial=0)), 3, 6))


@njit(nogil=True, cache=True)
def find_block(row_start: I64, columns: I32, row: int, column: int) -> int:
    """Return where the block (row, column) lies; it must exist. Columns of a row are sorted."""
    low, high = row_start[row], row_start[row + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if columns[middle] < column:
            low = middle + 1
        else:
            high = middle
    found: int = low
    return found


@njit(nogil=True, cache=True)
def reduce_sparsely(
    order: Order, blocks: Blocks, L: F64, damping: float, Z: F64, sparse: SparseBlocks, rhs: F64
) -> None:
    """Write the damped reduced system as `reduce_to_cameras` does, but only the blocks that there are.

    Diagonal blocks (the last of each row) are filled in their lower triangle only. Slots rise within a point.
    """
    starts, slots = order
    H_cc, b_c, _, b_p, W = blocks
    row_start, columns, values = sparse
    values[:] = 0.0
    for f in range(b_c.shape[0]):
        S = values[row_start[f + 1] - 1]
        for a in range(6):
            rhs[f, a] = -b_c[f, a]
            for b in range(a + 1):
                S[a, b] = H_cc[f, a, b]
            S[a, a] += damping * H_cc[f, a, a] + DIAGONAL_FLOOR
    for p in range(b_p.shape[0]):
        i0, l10, i1, l20, l21, i2 = L[p, 0], L[p, 1], L[p, 2], L[p, 3], L[p, 4], L[p, 5]
        y0 = i0 * b_p[p, 0]
        y1 = i1 * (b_p[p, 1] - l10 * y0)
        y2 = i2 * (b_p[p, 2] - l20 * y0 - l21 * y1)
        for o in range(starts[p], starts[p + 1]):
            f = slots[o]
            if f < 0:
                continue
            Zo = Z[o - starts[p]]
            for a in range(6):
                z0 = i0 * W[o, 0, a]
                z1 = i1 * (W[o, 1, a] - l10 * z0)
                z2 = i2 * (W[o, 2, a] - l20 * z0 - l21 * z1)
                Zo[0, a], Zo[1, a], Zo[2, a] = z0, z1, z2
                rhs[f, a] += z0 * y0 + z1 * y1 + z2 * y2
            for other in range(starts[p], o + 1):
                g = slots[other]
                if g < 0:
                    continue
                S = values[find_block(row_start, columns, f, g)]
                Zg = Z[other - starts[p]]
                twice = g == f and other != o  # one keyframe, one point, two observations: both orders meet here
                for a in range(6):
                    for b in range(a + 1 if g == f else 6):
                        S[a, b] -= Zo[0, a] * Zg[0, b] + Zo[1, a] * Zg[1, b] + Zo[2, a] * Zg[2, b]
                        if twice:
                            S[a, b] -= Zg[0, a] * Zo[0, b] + Zg[1, a] * Zo[1, b] + Zg[2, a] * Zo[2, b]
