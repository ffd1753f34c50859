"""Which setting is the most accurate of those that keep a rate."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.study.accuracy.accuracy_error import AccuracyError
from softrobot_twin.study.accuracy.accuracy_row import MESH, AccuracyRow

MARGIN = 0.7
"""Most of a period that the 99th percentile of a step may take: the rest is the node's, and the
machine's."""
ITERATIONS = (1, 2, 3)
CAUTION = 0.2
"""A choice with a larger error is not made without a word."""
# Linearizations that take off less than this share of the error are not worth their time.
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
        linearization_error: What so few linearizations add, of the effector's displacement; NaN
            where steps are late and it was not asked for.
    """

    median: float
    p99: float
    linearization_error: float


class Candidate(NamedTuple):
    """A setting with what is expected of it.

    Attributes:
        setting: The setting.
        mesh_error: Error of mesh, element and law, displacements prescribed.
        force_error: The same with forces prescribed.
        measured: Time and what the linearizations add.
        keeps_rate: Whether its steps fit, with the margin.
    """

    setting: Setting
    mesh_error: float
    force_error: float
    measured: Measured
    keeps_rate: bool

    @property
    def error(self) -> float:
        """Expected error, of the effector's displacement: the parts may add up."""
        added = self.measured.linearization_error
        return self.mesh_error + (added if np.isfinite(added) else 0.0)


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
    """Times settings, the most accurate mesh first, as long as one could still be picked.

    More linearizations are tried only where fewer keep the rate.

    Args:
        rows: Errors of meshes, elements and laws.
        rate: Asked rate [Hz].
        measure: Measures one setting on this machine.
    """
    known = [row for row in rows if row.knob == MESH
             and np.isfinite(row.error_lengths + row.error_weightless)]
    found: list[Candidate] = []
    for row in sorted(known, key=lambda row: row.error):
        best = min((one.error for one in found if one.keeps_rate), default=np.inf)
        if row.error > best + undecided(known):
            break
        for iterations in ITERATIONS:
            setting = Setting(row.mesh, row.element, row.law, iterations)
            measured = measure(setting)
            keeps = measured.p99 <= MARGIN / rate
            found.append(Candidate(setting, row.error, row.error_tensions, measured, keeps))
            if not keeps:
                break
    return found


def undecided(rows: Iterable[AccuracyRow]) -> float:
    """Errors that differ by less than this do not differ: the reference's uncertainty."""
    return max((row.uncertainty for row in rows if np.isfinite(row.uncertainty)), default=0.0)


def refuse_unsure(rows: Iterable[AccuracyRow], scene: str) -> None:
    """Refuses errors that the reference cannot tell apart.

    Args:
        rows: Errors of meshes, elements and laws.
        scene: Name of the scene, to name in the error.

    Raises:
        AccuracyError: The reference is less sure than the meshes differ.
    """
    rows = list(rows)
    errors = [row.error for row in rows if row.law == "corotational" and np.isfinite(row.error)]
    unsure = undecided(rows)
    differ = max(errors, default=0.0) - min(errors, default=0.0)
    if unsure > differ:
        raise AccuracyError(scene, f"the reference is sure to {100.0 * unsure:.2g} % only, the "
                            f"meshes differ by {100.0 * differ:.2g} %: none can be called the "
                            "best; add a finer mesh to the family")


def cautions(best: Candidate) -> list[str]:
    """What must be said of a choice that is far off; empty where it is not."""
    told = []
    for error, given in ((best.error, "lengths"), (best.force_error, "tensions")):
        if not error <= CAUTION:
            share = f"{100.0 * error:.0f} %" if np.isfinite(error) else "an unknown share"
            told.append(f"CAUTION: for given cable {given} the effector is off by {share} of its "
                        "displacement, and no setting that keeps the rate is known to be better")
    return told


def pick(candidates: Iterable[Candidate], rate: float, undecided: float = 0.0) -> Candidate:
    """The most accurate that keeps the rate.

    Of meshes whose errors the reference cannot tell apart it is the one that errs least with
    forces prescribed, where no luck helps; of numbers of linearizations that differ little, the
    fastest.

    Args:
        candidates: What was measured.
        rate: Asked rate [Hz].
        undecided: Errors that differ by less do not differ.

    Raises:
        NoSettingError: None keeps the rate.
    """
    candidates = list(candidates)
    fitting = [one for one in candidates if one.keeps_rate]
    if not fitting:
        fastest = min(candidates, key=lambda one: one.measured.p99, default=None)
        raise NoSettingError(rate, fastest)
    least = min(one.error for one in fitting)
    alike = [one for one in fitting if one.error <= least + max(undecided, _ALIKE * least)]
    soundest = min(alike, key=lambda one: (one.force_error, one.error)).setting
    same = [one for one in alike if one.setting[:3] == soundest[:3]]
    least = min(one.error for one in same)
    return min((one for one in same if one.error <= (1.0 + _ALIKE) * least),
               key=lambda one: one.measured.median)
