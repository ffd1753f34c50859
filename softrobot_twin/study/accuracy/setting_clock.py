"""Candidates timed on this machine: each a first time, and the best of them again in turns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.accuracy.choice import MARGIN, Candidate, Measured, Setting
from softrobot_twin.study.accuracy.moving_path import (
    follow_exactly,
    follow_lengths,
    length_path,
    rounds_of,
)
from softrobot_twin.study.accuracy.robust_timing import RobustTiming
from softrobot_twin.study.accuracy.scene_variant import with_element

STEPS = 120
FIRST_ROUNDS, LAST_ROUNDS = 3, 4
FINALISTS = 3
"""Candidates that keep the rate, the most accurate first, that are timed again; and as many that
just miss it."""
_REFERENCE_STEPS = 25


class SettingClock:
    """Times settings of one scene at one rate, beside its own mesh with linear elements."""

    def __init__(self, own: Scene, rate: float, scene_of: Callable[[Setting], Scene]):
        """Build the reference.

        Args:
            own: The scene on its own mesh.
            rate: Rate to keep [Hz].
            scene_of: Makes the scene of a setting.
        """
        self._rate, self._scene_of = rate, scene_of
        reference = with_element(own, "linear")
        path = length_path(reference, rate, _REFERENCE_STEPS)
        self._timing = RobustTiming(rounds_of(reference, path, 1))

    @property
    def slowdown(self) -> float:
        """How many times slower than its best the machine was in the median round."""
        return self._timing.slowdown

    def measure(self, setting: Setting) -> Measured:
        """Time of a step on this machine, and what the linearizations leave out."""
        self._add_rounds(setting, FIRST_ROUNDS)
        times = self._timing.spread(setting)
        if times.p99 > MARGIN / self._rate:
            return Measured(times.median, times.p99, float("nan"))
        scene = self._scene_of(setting)
        path = length_path(scene, self._rate, STEPS)
        exact, start = follow_exactly(scene, path)
        followed = follow_lengths(scene, path, start, setting.iterations)
        apart = np.linalg.norm(followed.positions - exact, axis=2)
        way = np.linalg.norm(exact - Simulation(scene).effector_positions(), axis=2)
        added = float(np.sqrt(np.mean(apart**2) / np.mean(way**2)))
        return Measured(times.median, times.p99, added)

    def confirm(self, candidates: list[Candidate]) -> list[Candidate]:
        """Times again what is near the choice, in turns, and judges all by all their rounds."""
        ranked = sorted(candidates, key=lambda one: one.error)
        near = [one for one in ranked if one.keeps_rate][:FINALISTS]
        missed = [one for one in ranked if one.measured.p99 <= 1.5 * MARGIN / self._rate
                  and not one.keeps_rate and np.isfinite(one.measured.linearization_error)]
        near += missed[:FINALISTS]
        rounds = {one.setting: self._rounds(one.setting) for one in near}
        for _ in range(LAST_ROUNDS):
            for setting, steps in rounds.items():
                self._timing.add_round(setting, steps)
        return [self._judged(one) for one in candidates]

    def _judged(self, candidate: Candidate) -> Candidate:
        times = self._timing.spread(candidate.setting)
        measured = candidate.measured._replace(median=times.median, p99=times.p99)
        keeps = times.p99 <= MARGIN / self._rate and np.isfinite(measured.linearization_error)
        return candidate._replace(measured=measured, keeps_rate=bool(keeps))

    def _add_rounds(self, setting: Setting, count: int) -> None:
        steps = self._rounds(setting)
        for _ in range(count):
            self._timing.add_round(setting, steps)

    def _rounds(self, setting: Setting):
        scene = self._scene_of(setting)
        return rounds_of(scene, length_path(scene, self._rate, STEPS), setting.iterations)
