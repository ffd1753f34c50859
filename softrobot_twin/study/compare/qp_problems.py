"""Inverse problems to compare QP solvers on: those of a robot's own run, and random ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.solvers.inverse_problem import Bounds, InverseSystem, build_inverse_problem
from softrobot_twin.solvers.quadratic_program import DAQPSolver, QPSolution, WhitenedQP, whiten
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
    """Answers by DAQP and keeps every problem."""

    name = DAQPSolver.name

    def __init__(self):
        self._solver = DAQPSolver()
        self.recorded: list[WhitenedQP] = []

    def reset(self) -> None:
        """Nothing to forget."""

    def solve(self, problem: WhitenedQP) -> QPSolution:
        """Keep a problem."""
        self.recorded.append(problem)
        return self._solver.solve(problem)


def recorded_problems(case: BenchCase, count: int) -> ProblemSet:
    """Problems of a scene's own run along the circle.

    Args:
        case: A scene with cables and effectors.
        count: How many.
    """
    recorder = RecordingSolver()
    simulation = Simulation(case.scene, qp_solvers=(recorder,))
    tour = CircleTour(simulation)
    recorder.recorded.clear()
    while len(recorder.recorded) < count:
        simulation.step(tour.next())
    return ProblemSet(f"{case.scene.name}'s own run", (tuple(recorder.recorded[:count]),))


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
    def problem(angle: float) -> WhitenedQP:
        target = 0.6 * way * (np.cos(angle) * first + np.sin(angle) * second)
        system = InverseSystem.without_contacts(
            W_ea, W_aa, -W_ea @ tensions - target, np.zeros(n))
        weights = np.ones(_EFFECTOR_ROWS)
        return whiten(build_inverse_problem(system, weights, _ENERGY_WEIGHT, bounds))

    return tuple(map(problem, angles))
