"""How λ is found when the effectors have targets (Coevoet 2017, eq. 17-18)."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.actuation import Actuation, Linearized, reachable, settle_slack
from softrobot_twin.solvers.inverse_qp import Bounds, build_qp
from softrobot_twin.solvers.osqp_solver import OSQPSolver


class InverseActuation:
    """Finds the actuation that brings effectors to their targets.

    Limits are given up in this order: first the target, then that a slack cable is taken up at
    once. The limits of the hardware are never given up.
    """

    def __init__(self, actuator_count: int, row_weights: np.ndarray, energy_weight: float):
        """Lay out the problem.

        Args:
            actuator_count: Number of actuators.
            row_weights: Weight of each effector row, shape (effector_row_count,).
            energy_weight: ε, relative to the tracking term.
        """
        self._row_weights = row_weights
        self._energy_weight = energy_weight
        self._solver = OSQPSolver(actuator_count)

    def reset(self) -> None:
        """Forget the last solution."""
        self._solver.reset()

    def solve(
        self, linear: Linearized, target_rows: np.ndarray, held: Actuation, bounds: Bounds
    ) -> Actuation:
        """Solve the inverse problem around one state.

        Args:
            linear: The condensed system.
            target_rows: Wanted effector coordinates [m], NaN where free,
                shape (effector_row_count,).
            held: What the actuators do when they stay.
            bounds: Bounds of this step.

        Returns:
            The actuation, or the held one with `solved` False.
        """
        wanted = np.isfinite(target_rows)
        violation = np.where(wanted, linear.effectors - target_rows, 0.0)
        problem = build_qp(
            linear.W_ea,
            linear.W_aa,
            violation,
            linear.actuators,
            np.where(wanted, self._row_weights, 0.0),
            self._energy_weight,
            reachable(linear, held, bounds),
        )
        solution = self._solver.solve(problem)
        if not solution.solved:
            return held._replace(solved=False)
        tensions = np.clip(solution.multipliers, bounds.tension_min, bounds.tension_max)
        return settle_slack(linear, tensions, bounds)
