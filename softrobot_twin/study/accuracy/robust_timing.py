"""Times of steps on a machine that is not idle: in rounds, each beside a reference.

A round times the reference and then a setting. Where the reference takes longer than it ever did,
the machine is slow just then (others use its memory and its clock), and the setting's times are
taken as much shorter. Of the rounds the median counts, so that one disturbed round does not decide.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrobot_twin.study.offline.run_summary import Spread

Round = Callable[[], np.ndarray]
"""Gives the times of some steps [s], shape (step_count,)."""


class _Timed(NamedTuple):
    reference: float
    median: float
    p99: float


class RobustTiming:
    """Rounds of several settings, and the fastest the reference ever was."""

    def __init__(self, reference: Round):
        """Take what is timed beside everything else.

        Args:
            reference: The reference.
        """
        self._reference = reference
        self._rounds: dict[object, list[_Timed]] = {}
        self._references: list[float] = []

    def add_round(self, key: object, steps: Round) -> None:
        """Times one round of a setting.

        Args:
            key: The setting.
            steps: Makes its steps.
        """
        before = float(np.median(self._reference()))
        times = steps()
        after = float(np.median(self._reference()))
        self._references += [before, after]
        made = _Timed(0.5 * (before + after), *np.percentile(times, (50.0, 99.0)))
        self._rounds.setdefault(key, []).append(made)

    def spread(self, key: object) -> Spread:
        """Median and 99th percentile of a step of a setting when nothing else runs [s]."""
        best = min(self._references)
        rounds = np.array([(timed.median, timed.p99) for timed in self._rounds[key]])
        shares = np.array([best / timed.reference for timed in self._rounds[key]])
        median, p99 = np.median(rounds * shares[:, None], axis=0)
        return Spread(float(median), float(p99), float(p99))

    @property
    def slowdown(self) -> float:
        """How many times longer than ever before the reference took, in the median round."""
        return float(np.median(self._references) / min(self._references))
