"""Factorizations that could stand behind a step, each asked to do the same job."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softrobot_twin.solvers.factorization import Factorization, NodeRows
from softrobot_twin.solvers.superlu import OPTIONS


class Candidate(Protocol):
    """A factorization of one matrix.

    Attributes:
        name: What tables call it.
    """

    name: str

    def factor(self) -> None:
        """Factorize the matrix; what depends on its pattern only may be kept from before."""

    def respond(self, multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W = H A⁻¹ Hᵀ, and dx = A⁻¹ (b + Hᵀ λ), shape (dof_count,)."""


class Job(NamedTuple):
    """What every candidate has to do.

    Attributes:
        matrix: A, full, shape (dof_count, dof_count).
        rows: H.
        b: Right-hand side [N], shape (node_count, 3).
    """

    matrix: sp.csc_matrix
    rows: NodeRows
    b: np.ndarray


class InUse:
    """The factorization of a simulation, by its own way: forward solves first, one back."""

    def __init__(self, factorization: Factorization, job: Job):
        self.name = factorization.name
        self._factorization, self._job = factorization, job

    def factor(self) -> None:
        """See `Candidate.factor`."""
        if not self._factorization.factor():
            raise ArithmeticError(f"{self.name}: the matrix is not positive definite")

    def respond(self, multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Candidate.respond`."""
        W = self._factorization.condense(self._job.rows, self._job.b).W
        return W, self._factorization.expand(multipliers).reshape(-1)


class LibraryCandidate:
    """A library that solves for whole right-hand sides: one for each row of H, and b."""

    name = ""

    def __init__(self, job: Job):
        self._matrix = job.matrix
        self._Ht = job.rows.transposed(len(job.b))
        self._right = np.asfortranarray(np.column_stack([self._Ht, job.b.reshape(-1)]))

    def respond(self, multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Candidate.respond`."""
        X = self._solve(self._right)
        return self._Ht.T @ X[:, :-1], X[:, -1] + X[:, :-1] @ multipliers


class SuperLUCandidate(LibraryCandidate):
    """scipy's SuperLU; it orders and analyses anew each time, there is no other way to call it."""

    name = "SuperLU (MMD_AT_PLUS_A, symmetric mode)"

    def factor(self) -> None:
        """See `Candidate.factor`."""
        self._lu = splu(self._matrix, **OPTIONS)

    def _solve(self, right: np.ndarray) -> np.ndarray:
        return self._lu.solve(right)


class QdldlCandidate(LibraryCandidate):
    """qdldl: LDLᵀ entry by entry, ordered by AMD once."""

    name = "qdldl"

    def __init__(self, job: Job):
        import qdldl

        super().__init__(job)
        self._upper = sp.triu(self._matrix, format="csc")
        self._solver = qdldl.Solver(self._upper, upper=True)

    def factor(self) -> None:
        """See `Candidate.factor`."""
        self._solver.update(self._upper, upper=True)

    def _solve(self, right: np.ndarray) -> np.ndarray:
        return np.column_stack([self._solver.solve(column) for column in right.T])


class PardisoCandidate(LibraryCandidate):
    """MKL Pardiso through pypardiso: symmetric positive definite, analysed once."""

    name = "MKL Pardiso"
    _POSITIVE_DEFINITE = 2
    _ANALYSE, _FACTOR, _SOLVE = 11, 22, 33

    def __init__(self, job: Job):
        os.environ.setdefault("MKL_NUM_THREADS", "1")
        from pypardiso import PyPardisoSolver

        super().__init__(job)
        self._upper = sp.triu(self._matrix, format="csr")
        self._solver = PyPardisoSolver(mtype=self._POSITIVE_DEFINITE)
        self._run(self._ANALYSE, np.zeros((self._upper.shape[0], 1)))

    def factor(self) -> None:
        """See `Candidate.factor`."""
        self._run(self._FACTOR, np.zeros((self._upper.shape[0], 1)))

    def _solve(self, right: np.ndarray) -> np.ndarray:
        return self._run(self._SOLVE, right)

    def _run(self, phase: int, right: np.ndarray) -> np.ndarray:
        # Its public calls analyse anew with every matrix.
        self._solver.set_phase(phase)
        return self._solver._call_pardiso(self._upper, right)


_OPTIONAL: dict[str, Callable[[Job], Candidate]] = {
    "qdldl": QdldlCandidate, "pypardiso": PardisoCandidate}


def candidates(factorization: Factorization, job: Job) -> tuple[list[Candidate], list[str]]:
    """All that are installed, the one in use first, and the names of packages that are not."""
    found: list[Candidate] = [InUse(factorization, job), SuperLUCandidate(job)]
    absent = []
    for package, make in _OPTIONAL.items():
        try:
            found.append(make(job))
        except ImportError:
            absent.append(package)
    return found, absent
