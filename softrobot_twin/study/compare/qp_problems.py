"""Inverse problems to compare QP solvers on: those of a robot's own run, and random ones."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.inverse_actuation import SOLVERS
from softrobot_twin.solvers.inverse_qp import Bounds, WhitenedQP, build_qp
from softrobot_twin.solvers.qp_solution import QPSolution
from softrobot_twin.study.bench.bench_cases import BenchCase
from softrobot_twin.study.bench.circle_tour import CircleTour

SIZES = (4, 8, 12, 24)
_EFFECTOR_ROWS = 3
_ENERGY_WEIGHT = 1.0e-6
_COMPLIANCE = 1.0e-3  # m/N
_SEQUENCES = 6


class ProblemSet(NamedTuple):
    """Problems of one kind.

    Attributes:
        name: What tables call it.
        sequences: Problems that follow each other as in a run; a solver starts anew with each.
    """

    name: str
    sequences: tuple[tuple[WhitenedQP, ...], ...]

    @property
    def count(self) -> int:
        """Unknowns."""
        return len(self.sequences[0][0].q)


class RecordingSolver:
    """Keeps every problem and answers none, so that the next solver is asked."""

    name = "none"
    recorded: list[WhitenedQP] = []

    def __init__(self, count: int):
        self._count = count

    def reset(self) -> None:
        """Nothing to forget."""

    def solve(self, problem: WhitenedQP) -> QPSolution:
        """Keep a problem."""
        type(self).recorded.append(problem)
        return QPSolution(np.full(self._count, np.nan), np.full(2 * self._count, np.nan), False, 0,
                          "recorded", self.name)


def recorded_problems(case: BenchCase, count: int) -> ProblemSet:
    """Problems of a scene's own run along the circle.

    Args:
        case: A scene with cables and effectors.
        count: How many.
    """
    with _recording(case.scene.solver.qp_solver) as recorded:
        simulation = Simulation(case.scene)
        tour = CircleTour(simulation)
        recorded.clear()
        while len(recorded) < count:
            simulation.step(tour.next())
        problems = tuple(recorded[:count])
    return ProblemSet(f"{case.scene.name}'s own run", (problems,))


@contextmanager
def _recording(qp_solver: str) -> Iterator[list[WhitenedQP]]:
    """Asks the recorder before the solvers of a scene."""
    before = SOLVERS[qp_solver]
    RecordingSolver.recorded = []
    SOLVERS[qp_solver] = ((RecordingSolver.__module__, RecordingSolver.__name__), *before)
    try:
        yield RecordingSolver.recorded
    finally:
        SOLVERS[qp_solver] = before


def random_problems(n: int, steps: int, twice: bool = False) -> ProblemSet:
    """Random robots whose effectors are asked to go round, partly further than they can.

    Args:
        n: Actuators, an even number where each stands twice.
        steps: Problems of each of a few sequences.
        twice: Every actuator has a twin: parallel rows, a singular compliance.
    """
    sequences = tuple(_sequence(np.random.default_rng((n, seed)), n, steps, twice)
                      for seed in range(_SEQUENCES))
    return ProblemSet("random, each cable twice" if twice else "random", sequences)


def _sequence(generator, n: int, steps: int, twice: bool) -> tuple[WhitenedQP, ...]:
    different = n // 2 if twice else n
    size = different + _EFFECTOR_ROWS
    # A body's compliance: positive definite, over three decades.
    Q = np.linalg.qr(generator.standard_normal((size, size)))[0]
    W = _COMPLIANCE * (Q * np.logspace(0.0, -3.0, size)) @ Q.T
    of = np.tile(np.arange(different), 2) if twice else np.arange(n)
    W_aa, W_ea = W[np.ix_(of, of)], W[different:, :different][:, of]
    tensions = generator.uniform(0.0, 4.0, n)
    way = np.abs(W_ea @ tensions).max()
    wound = W_aa @ tensions
    room = 0.5 * np.abs(wound).max()
    bounds = Bounds(wound - room, wound + room, np.zeros(n), np.full(n, 10.0))
    first, second = np.linalg.qr(generator.standard_normal((_EFFECTOR_ROWS, 2)))[0].T
    angles = np.linspace(0.0, 2.0 * np.pi, steps, endpoint=False)
    return tuple(
        build_qp(W_ea, W_aa,
                 -W_ea @ tensions - 0.6 * way * (np.cos(a) * first + np.sin(a) * second),
                 np.zeros(n), np.ones(_EFFECTOR_ROWS), _ENERGY_WEIGHT, bounds)
        for a in angles)
