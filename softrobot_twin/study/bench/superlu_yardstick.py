"""One SuperLU factorization of the matrix a step has just used: the ratio to it travels well."""

from __future__ import annotations

from time import thread_time
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softrobot_twin.solvers.factorization import Factorization
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.superlu import OPTIONS
from softrobot_twin.study.bench.process_memory import page_faults

class YardstickTime(NamedTuple):
    """One factorization timed.

    Attributes:
        time: Processor time [s]. On a quiet machine it is the time on the clock; on a busy one
            it leaves out what other processes took, which would flatter a shorter step.
        page_faults: Pages that the system had to provide meanwhile. SuperLU allocates anew at
            every call; whether that costs faults, and a quarter of its time, is up to the
            allocator's history.
    """

    time: float
    page_faults: int


class SuperLUYardstick:
    """Reads the matrix out of a factorization's storage, nodes in the mesh's order."""

    def __init__(self, factorization: Factorization):
        """Find where each entry is stored.

        Args:
            factorization: Any that a simulation uses.
        """
        self._factorization = factorization
        if isinstance(factorization, Multifrontal):
            self._gather, self._indices, self._indptr = _pattern(factorization)

    def matrix(self) -> sp.csc_matrix:
        """The matrix assembled last, full, shape (dof_count, dof_count)."""
        if not isinstance(self._factorization, Multifrontal):
            return sp.csc_matrix(self._factorization.matrix())
        count = len(self._indptr) - 1
        values = self._factorization.storage[self._gather]
        return sp.csc_matrix((values, self._indices, self._indptr), shape=(count, count))

    def factorize(self) -> YardstickTime:
        """Time of one factorization; what it found is thrown away."""
        matrix = self.matrix()
        faults = page_faults()
        start = thread_time()
        splu(matrix, **OPTIONS)
        return YardstickTime(thread_time() - start, page_faults() - faults)


def _pattern(factorization: Multifrontal) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place in storage of each entry of the full matrix, its row indices and column starts."""
    rank = factorization.elimination_rank
    node_count = len(rank)
    node = np.empty(node_count, dtype=np.int64)
    node[rank] = np.arange(node_count)
    keys = factorization.layout.block_keys
    rows, columns = node[keys % node_count], node[keys // node_count]
    local_column, local_row = np.divmod(np.arange(9), 3)
    i = (3 * rows[:, None] + local_row).ravel()
    j = (3 * columns[:, None] + local_column).ravel()
    place = np.arange(len(i))
    mirrored = np.repeat(rows != columns, 9)
    count = 3 * node_count
    # Places are counted from one: a stored zero would be dropped.
    full = sp.coo_matrix(
        (np.concatenate([place, place[mirrored]]) + 1,
         (np.concatenate([i, j[mirrored]]), np.concatenate([j, i[mirrored]]))),
        shape=(count, count)).tocsc()
    full.sort_indices()
    return full.data - 1, full.indices.astype(np.int32), full.indptr.astype(np.int32)
