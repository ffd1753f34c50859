"""One SuperLU factorization of a simulation's matrix: the unit in which steps are compared between machines."""

from __future__ import annotations

from dataclasses import dataclass
from time import thread_time

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softrobot_twin.harness.timing import Spread, spread, without_garbage_collection
from softrobot_twin.simulation import Simulation
from softrobot_twin.solvers.dense_stiffness import without_rows
from softrobot_twin.solvers.factorization import Factorization
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.superlu import OPTIONS, SuperLU
from softrobot_twin.study.bench_measurement import WHOLE_STEP, SizeMeasurement

SUPERLU = "one SuperLU factorization"
# Most factorizations, their longest time in all [s], and fewest.
_SAMPLES, _SECONDS, _FEWEST = 20, 20.0, 3


_TRANSPOSED = np.arange(9).reshape(3, 3).T.ravel()
"""Places of the entries of a transposed block."""


class SuperLUReference:
    """Factorizes a simulation's matrix by SuperLU, for comparison, with nodes in the mesh's
    order.
    """

    def __init__(self, factorization: Factorization):
        """Finds where each entry is stored.

        Args:
            factorization: A simulation's factorization.
        """
        self._factorization = factorization
        if isinstance(factorization, Multifrontal):
            keys, count = factorization.layout.block_keys, len(factorization.elimination_rank)
            node = np.argsort(factorization.elimination_rank)
            rows, columns = node[keys % count], node[keys // count]
            self._copy = SuperLU(rows, columns, count)
            starts, _ = self._copy.slots(np.maximum(rows, columns), np.minimum(rows, columns))
            # What is below the diagonal in one order may be above it in the other.
            within = np.where((rows < columns)[:, None], _TRANSPOSED, np.arange(9))
            self._places = (starts[:, None] + within).ravel()

    def matrix(self) -> sp.csc_array:
        """The matrix assembled last, full, shape (dof_count, dof_count)."""
        if not isinstance(self._factorization, Multifrontal):
            return self._factorization.matrix()
        self._copy.storage[self._places] = self._factorization.storage
        return self._copy.matrix()

    def factorize(self) -> float:
        """Processor time of one factorization [s], whose result is not used."""
        matrix = self.matrix()
        start = thread_time()
        splu(matrix, **OPTIONS)
        return thread_time() - start


@dataclass(frozen=True)
class BesideSuperLU(SizeMeasurement):
    """A case of ``bench``, beside factorizations of its matrix.

    Attributes:
        superlu: Processor time of one factorization [s]; NaN for a reduced model, whose matrix is dense and
            small.
        superlu_count: Number of timed factorizations.
    """

    superlu: Spread = spread(())
    superlu_count: int = 0

    @property
    def times(self) -> dict[str, Spread]:
        """Times of stages and of SuperLU, where it was timed [s]."""
        return self.stages | ({SUPERLU: self.superlu} if self.superlu_count else {})

    @property
    def ratio(self) -> float:
        """Median of the whole step by that of one factorization."""
        return self.stages[WHOLE_STEP].median / self.superlu.median

    def columns(self, stage: str) -> dict[str, float]:
        """Cells of bench.csv.

        Args:
            stage: Name of a stage.
        """
        return {"ratio_to_superlu": self.stages[stage].median / self.superlu.median,
                "superlu_ms": 1e3 * self.superlu.median, "superlu_samples": self.superlu_count}


def beside_superlu(size: SizeMeasurement) -> BesideSuperLU:
    """Factorizes the matrix of a case, right after its steps were timed.

    Args:
        size: What was measured of its steps.
    """
    times: list[float] = []
    if not size.is_reduced:
        simulation = Simulation(size.case.scene, with_warnings=False)
        next(size.case.drive(simulation))
        reference = SuperLUReference(without_rows(simulation.model.factorization))
        with without_garbage_collection():
            count = int(np.clip(_SECONDS / reference.factorize(), _FEWEST, _SAMPLES))
            times = [reference.factorize() for _ in range(count)]
    return BesideSuperLU(**vars(size), superlu=spread(times), superlu_count=len(times))
