"""How times are measured: spreads, references that are timed beside, and the slowdown by others."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike


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
    def slowdown(self) -> float:
        """Median over rounds of the reference's time over its shortest time."""
        return float(np.median(self._references) / min(self._references))
