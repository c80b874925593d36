"""A sparse matrix as solvers take it: what there is of SciPy's, which takes 20 MB of memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.lie import Array


@dataclass(kw_only=True, eq=False)
class SparseMatrix:
    """A matrix of ``shape``, column by column (CSC).

    Column j has the entries from ``indptr[j]`` to ``indptr[j + 1]`` of ``data`` (nnz,), whose
    rows, rising, are ``indices`` (nnz,). The names are SciPy's, by which OSQP asks.
    """

    shape: tuple[int, int]
    data: Array
    indices: NDArray[np.int32]
    indptr: NDArray[np.int32]

    @property
    def nnz(self) -> int:
        """The number of entries."""
        return len(self.data)

    @staticmethod
    def of_pattern(
        rows: NDArray[np.intp], columns: NDArray[np.intp], *, shape: tuple[int, int]
    ) -> tuple[SparseMatrix, NDArray[np.intp]]:
        """Return zeros at given places (nnz,), each given once, and where in ``data`` each is."""
        order = np.lexsort((rows, columns))
        places = np.empty_like(order)
        places[order] = np.arange(len(order))
        ends = np.cumsum(np.bincount(columns, minlength=shape[1]))
        matrix = SparseMatrix(
            shape=shape,
            data=np.zeros(len(order)),
            indices=rows[order].astype(np.int32),
            indptr=np.concatenate(([0], ends)).astype(np.int32),
        )
        return matrix, places
