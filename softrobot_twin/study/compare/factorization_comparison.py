"""Factorizations compared on one matrix of a robot, in time and in accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from softrobot_twin.simulation import Simulation
from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.superlu import OPTIONS
from softrobot_twin.study.bench.circle_tour import CircleTour
from softrobot_twin.study.bench.size_measurement import without_garbage_collection
from softrobot_twin.study.bench.superlu_yardstick import SuperLUYardstick
from softrobot_twin.study.compare.factorization_candidates import Candidate, Job, candidates
from softrobot_twin.study.offline.run_summary import Spread, spread

_REFINEMENTS = 3


class FactorizationFigures(NamedTuple):
    """What one factorization took, and how exact it was.

    Attributes:
        name: Its name.
        factor: Time of the numeric factorization [s].
        solves: Time of W and of dx [s].
        residual: ‖A dx - b - Hᵀλ‖ / ‖b + Hᵀλ‖.
        compliance_error: Largest error of W, in shares of its largest entry.
    """

    name: str
    factor: Spread
    solves: Spread
    residual: float
    compliance_error: float


class FactorizationComparison(NamedTuple):
    """All factorizations on one matrix.

    Attributes:
        scene: Name of the scene.
        dof_count: Unknowns.
        row_count: Rows of H.
        figures: One each.
        absent: Packages that are not installed.
    """

    scene: str
    dof_count: int
    row_count: int
    figures: tuple[FactorizationFigures, ...]
    absent: tuple[str, ...]


def compare_factorizations(simulation: Simulation, repeats: int) -> FactorizationComparison:
    """Takes the matrix of a step on a circle, and gives it to all.

    Args:
        simulation: Warmed up.
        repeats: Times that each factorizes and solves.
    """
    tour = CircleTour(simulation)
    simulation.step(tour.next())
    model = simulation.model
    rows = NodeRows(model.rows.row_index.copy(), model.rows.node_index.copy(),
                    model.rows.blocks.copy(), model.rows.row_count)
    generator = np.random.default_rng(1)
    job = Job(SuperLUYardstick(model.factorization).matrix(), rows,
              generator.standard_normal((simulation.dof_count // 3, 3)))
    multipliers = generator.uniform(0.0, 1.0, rows.row_count)
    found, absent = candidates(model.factorization, job)
    exact = _refined_compliance(job)
    with without_garbage_collection():
        times = _time(found, multipliers, repeats)
    return FactorizationComparison(
        simulation.scene.name, simulation.dof_count, rows.row_count,
        tuple(_figures(candidate, job, multipliers, exact, times[candidate.name])
              for candidate in found), tuple(absent))


def _time(
    found: Sequence[Candidate], multipliers: np.ndarray, repeats: int
) -> dict[str, tuple[list[float], list[float]]]:
    """Factor and solve times of each, taken in turns so that all see the same machine."""
    times = {candidate.name: ([], []) for candidate in found}
    for number in range(repeats + 1):
        for candidate in found:
            # Twice, and the second counts: the first finds the caches full of another's matrix.
            for _ in range(2):
                start = perf_counter()
                candidate.factor()
                middle = perf_counter()
                candidate.respond(multipliers)
                end = perf_counter()
            if number:
                times[candidate.name][0].append(middle - start)
                times[candidate.name][1].append(end - middle)
    return times


def _figures(candidate, job: Job, multipliers, exact, times) -> FactorizationFigures:
    W, dx = candidate.respond(multipliers)
    right = job.b.reshape(-1) + job.rows.transposed(len(job.b)) @ multipliers
    residual = np.linalg.norm(job.matrix @ dx - right) / np.linalg.norm(right)
    error = np.abs(W - exact).max() / np.abs(exact).max()
    return FactorizationFigures(
        candidate.name, spread(times[0]), spread(times[1]), float(residual), float(error))


def _refined_compliance(job: Job) -> np.ndarray:
    """W by iterative refinement, its residuals in extended precision where the machine has it."""
    Ht = job.rows.transposed(len(job.b))
    lu, coo = splu(job.matrix, **OPTIONS), job.matrix.tocoo()
    values = coo.data.astype(np.longdouble)
    X = lu.solve(Ht).astype(np.longdouble)
    for _ in range(_REFINEMENTS):
        for k in range(Ht.shape[1]):
            image = np.zeros(len(Ht), dtype=np.longdouble)
            np.add.at(image, coo.row, values * X[coo.col, k])
            X[:, k] += lu.solve((Ht[:, k] - image).astype(float))
    return (Ht.T @ X).astype(float)
