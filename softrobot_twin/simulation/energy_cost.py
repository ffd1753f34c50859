"""How far the weight of the energy keeps effectors off their targets."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.actuation import Linearized
from softrobot_twin.solvers.inverse_problem import (
    LEAST_ENERGY_WEIGHT,
    Bounds,
    InverseSystem,
    build_inverse_problem,
)
from softrobot_twin.solvers.quadratic_program import DAQPSolver, whiten


def errors_by_energy(
    linear: Linearized, violation: np.ndarray, weights: np.ndarray, row_effector: np.ndarray,
    energy_weight: float, bounds: Bounds,
) -> tuple[float, float] | None:  # fmt: skip
    """Errors that the optimum leaves with a weight of the energy, and with the least.

    Args:
        linear: The condensed system of cables and effectors.
        violation: Effectors' δ less the targets [m], shape (effector_row_count,).
        weights: Weight of each effector row, zero where free, same shape.
        row_effector: Effector of each row, same shape.
        energy_weight: ε.
        bounds: Bounds of this step, as wide as holding needs.

    Returns:
        Largest error of an effector with both [m]; None where ε is the least already, or one of the
        problems has no answer.
    """
    if energy_weight <= LEAST_ENERGY_WEIGHT:
        return None
    errors, solver = [], DAQPSolver(len(linear.actuators))
    system = InverseSystem.without_contacts(
        linear.W_ea, linear.W_aa, violation, linear.actuators
    )
    for weight in (energy_weight, LEAST_ENERGY_WEIGHT):
        try:
            problem = whiten(build_inverse_problem(system, weights, weight, bounds))
        except np.linalg.LinAlgError:
            return None
        solution = solver.solve(problem)
        if not solution.solved:
            return None
        missed = np.where(weights > 0.0, linear.W_ea @ solution.unknowns + violation, 0.0)
        squares = np.bincount(row_effector, weights=missed * missed)
        errors.append(float(np.sqrt(squares.max(initial=0.0))))
    return errors[0], errors[1]
