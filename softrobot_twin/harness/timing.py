"""How times are measured: spreads, references that are timed beside, and the slowdown by others."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from time import thread_time
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.linalg import splu

from softrobot_twin.solvers.factorization import Factorization
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.superlu import OPTIONS, SuperLU


class Spread(NamedTuple):
    """Median, 99th percentile and maximum of a set of numbers, in their unit."""

    median: float
    p99: float
    maximum: float


def spread(values: ArrayLike) -> Spread:
    """Median, 99th percentile and maximum over the finite values; NaN when there is none.

    Args:
        values: Numbers, some of them perhaps not finite, of any shape.
    """
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return Spread(np.nan, np.nan, np.nan)
    return Spread(float(np.median(finite)), float(np.percentile(finite, 99.0)), float(finite.max()))


@cache
def _set_loaded_modules_aside() -> None:
    """Takes what lives as long as the process out of later collections, once.

    Modules make up most objects: a collection that visits them takes some tenths of a second, and a
    study begins many measurements.
    """
    gc.collect()
    gc.freeze()


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Collects garbage now and disables the collector inside the context."""
    was_on = gc.isenabled()
    _set_loaded_modules_aside()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


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


Round = Callable[[], np.ndarray]
"""A function that runs some steps and returns their times [s], shape (step_count,)."""


class RobustTiming:
    """Times rounds of several settings and removes the slowdown caused by other programs.

    A reference is timed before and after each round. The times of a round are divided by the
    slowdown: the reference's time before and after this round, over its shortest time in all
    rounds.
    """

    def __init__(self, reference: Round):
        """Stores the reference.

        Args:
            reference: Runs the steps of the reference.
        """
        self._reference = reference
        self._rounds: dict[object, list[tuple[float, float, float]]] = {}
        self._references: list[float] = []

    def add_round(self, key: object, steps: Round) -> None:
        """Times one round of a setting.

        Args:
            key: The setting.
            steps: Runs its steps.
        """
        before = float(np.median(self._reference()))
        times = steps()
        after = float(np.median(self._reference()))
        self._references += [before, after]
        made = 0.5 * (before + after), *np.percentile(times, (50.0, 99.0))
        self._rounds.setdefault(key, []).append(made)

    def spread(self, key: object) -> Spread:
        """Median and 99th percentile of a step of a setting when nothing else runs [s].

        Args:
            key: The setting, as it was measured.
        """
        rounds = np.array(self._rounds[key])
        shares = min(self._references) / rounds[:, :1]
        median, p99 = np.median(rounds[:, 1:] * shares, axis=0)
        return Spread(float(median), float(p99), float(p99))

    @property
    def reference(self) -> float:
        """Shortest median time of a step of the reference [s]."""
        return min(self._references)

    @property
    def slowdown(self) -> float:
        """Median over rounds of the reference's time over its shortest time."""
        return float(np.median(self._references) / min(self._references))
