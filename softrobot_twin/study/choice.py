"""Which setting is the most accurate of those that keep a rate."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.study.accuracy_row import MESH, AccuracyRow

MARGIN = 0.7
"""Most of a period that the 99th percentile of a step may take: the rest is the node's, and the
machine's."""
ITERATIONS = (1, 2, 3)
# Of settings whose errors differ by less than this share, the faster is better.
_ALIKE = 0.01


class Setting(NamedTuple):
    """What is chosen.

    Attributes:
        mesh: Name of the mesh.
        element: ``linear`` or ``quadratic``.
        law: ``corotational`` or ``linear``.
        iterations: Linearizations a step.
    """

    mesh: str
    element: str
    law: str
    iterations: int


class Measured(NamedTuple):
    """A setting on this machine, along a path at the asked rate.

    Attributes:
        median: Median time of a step [s].
        p99: Its 99th percentile [s].
        linearization_error: What so few linearizations add, of the effector's displacement.
    """

    median: float
    p99: float
    linearization_error: float


class Candidate(NamedTuple):
    """A setting with what is expected of it.

    Attributes:
        setting: The setting.
        mesh_error: Error of mesh, element and law, displacements prescribed.
        measured: Time and what the linearizations add.
        keeps_rate: Whether its steps fit, with the margin.
    """

    setting: Setting
    mesh_error: float
    measured: Measured
    keeps_rate: bool

    @property
    def error(self) -> float:
        """Expected error, of the effector's displacement: the parts may add up."""
        return self.mesh_error + self.measured.linearization_error


class NoSettingError(SoftRobotTwinError):
    """No setting keeps a rate on this machine.

    Attributes:
        rate: Asked rate [Hz].
        nearest: The fastest setting tried, or None.
    """

    def __init__(self, rate: float, nearest: Candidate | None):
        self.rate, self.nearest = rate, nearest
        told = "none could be tried"
        if nearest is not None:
            possible = MARGIN / nearest.measured.p99
            told = (f"the fastest, {words(nearest.setting)}, takes "
                    f"{1e3 * nearest.measured.p99:.2f} ms (p99), which keeps {possible:.0f} Hz")
        super().__init__(f"no setting keeps {rate:g} Hz within {MARGIN:g} of its period of "
                         f"{1e3 / rate:.2f} ms on this machine: {told}")


Measure = Callable[[Setting], Measured]


def words(setting: Setting) -> str:
    """A setting in words."""
    plural = "" if setting.iterations == 1 else "s"
    return (f"{setting.mesh}, {setting.element} tets, {setting.law} law, "
            f"{setting.iterations} linearization{plural}")


def measure_candidates(
    rows: Iterable[AccuracyRow], rate: float, measure: Measure
) -> list[Candidate]:
    """Times every setting; more iterations only where fewer keep the rate.

    Args:
        rows: Errors of meshes, elements and laws.
        rate: Asked rate [Hz].
        measure: Measures one setting on this machine.
    """
    found = []
    for row in rows:
        if row.knob != MESH or not np.isfinite(row.error_lengths + row.error_weightless):
            continue
        for iterations in ITERATIONS:
            setting = Setting(row.mesh, row.element, row.law, iterations)
            measured = measure(setting)
            keeps = measured.p99 <= MARGIN / rate
            found.append(Candidate(setting, row.error, measured, keeps))
            if not keeps:
                break
    return found


def pick(candidates: Iterable[Candidate], rate: float) -> Candidate:
    """The most accurate that keeps the rate; the fastest of those that are as accurate.

    Raises:
        NoSettingError: None keeps it.
    """
    candidates = list(candidates)
    fitting = [one for one in candidates if one.keeps_rate]
    if not fitting:
        fastest = min(candidates, key=lambda one: one.measured.p99, default=None)
        raise NoSettingError(rate, fastest)
    least = min(one.error for one in fitting)
    alike = [one for one in fitting if one.error <= (1.0 + _ALIKE) * least]
    return min(alike, key=lambda one: one.measured.median)
