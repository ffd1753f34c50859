"""How λ is found when the effectors have targets (Coevoet 2017, eq. 17-18)."""

from __future__ import annotations

from importlib import import_module

import numpy as np

from softrobot_twin.simulation.actuation import (
    Actuation,
    Linearized,
    reachable,
    settle_slack,
    wind,
)
from softrobot_twin.simulation.energy_cost import errors_by_energy
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.steadiness import Steadiness
from softrobot_twin.solvers.inverse_qp import LEAST_ENERGY_WEIGHT, Bounds, build_qp

# A target further away than this share of the body's size is approached along a straight line:
# so far from the effector, the linearization says nothing, and chasing it would oscillate.
LONGEST_REACH = 0.05
# Solvers in the order they are asked. OSQP's few iterations cost the same whatever is active; where
# it runs into its iteration limit, the exact active-set method finishes, and the report says so.
SOLVERS = {
    "osqp": (
        ("softrobot_twin.solvers.osqp_solver", "OSQPSolver"),
        ("softrobot_twin.solvers.daqp_solver", "DAQPSolver"),
    ),
    "daqp": (("softrobot_twin.solvers.daqp_solver", "DAQPSolver"),),
}


class EffectorWays:
    """What a step asks of the effectors, none of them further than a linearization leads.

    Attributes:
        row_effector: Effector of each row, shape (effector_row_count,).
    """

    def __init__(self, model: Model):
        """Take the effectors.

        Args:
            model: A scene with effectors.
        """
        self.row_effector = model.effectors.row_effector
        self._row_weights = model.effectors.row_weights
        self._longest = LONGEST_REACH * model.nodes.size

    def asked(self, target_rows: np.ndarray, now: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ways to the targets, shortened where they are too long, and their weights.

        Args:
            target_rows: Wanted effector coordinates [m], NaN where free,
                shape (effector_row_count,).
            now: Where they are [m], same shape.

        Returns:
            The way of each row [m] and its weight, both zero where it is free, same shape.
        """
        wanted = np.isfinite(target_rows)
        ways = np.where(wanted, target_rows - now, 0.0)
        distances = np.sqrt(np.bincount(self.row_effector, weights=ways * ways))
        share = self._longest / np.maximum(distances, self._longest)
        return ways * share[self.row_effector], np.where(wanted, self._row_weights, 0.0)


class InverseActuation:
    """Finds the actuation that brings effectors to their targets.

    Limits are given up in this order: first the target, then that a slack cable is taken up at
    once. The limits of the hardware are never given up.

    Attributes:
        steadiness: How hard the actuators are held to where they are.
    """

    def __init__(self, model: Model, solvers: tuple | None = None):
        """Lay out the problem.

        Args:
            model: A scene with cables and effectors.
            solvers: In the order they are asked, in place of those that the scene names.
        """
        self._ways = EffectorWays(model)
        self._energy_weight = max(model.scene.solver.energy_weight, LEAST_ENERGY_WEIGHT)
        self.steadiness = Steadiness()
        self._solvers = solvers or [
            getattr(import_module(module), name)(model.actuators.row_count)
            for module, name in SOLVERS[model.scene.solver.qp_solver]
        ]

    def reset(self) -> None:
        """Forget the last solution."""
        self.steadiness.reset()
        for solver in self._solvers:
            solver.reset()

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
        asked, weights = self._ways.asked(target_rows, linear.effectors_now)
        self.steadiness.learn(held.displacements, asked)
        violation = linear.effectors - linear.effectors_now - asked
        commanded = bounds.displacement_min == bounds.displacement_max
        if commanded.any():
            return self._around(linear, violation, weights, held, bounds, commanded)
        try:
            problem = build_qp(
                linear.W_ea,
                linear.W_aa,
                violation,
                linear.actuators,
                weights,
                self._energy_weight,
                reachable(linear, held, bounds),
                held.efforts,
                self.steadiness.weight,
            )
        except np.linalg.LinAlgError:
            return held._replace(solved=False)
        for solver in self._solvers:
            solution = solver.solve(problem)
            if solution.solved:
                tensions = np.clip(solution.multipliers, bounds.effort_min, bounds.effort_max)
                settled = settle_slack(linear, tensions, bounds)
                return settled._replace(qp_solver=solution.solver)
        return held._replace(solved=False)

    def errors_by_energy(
        self, linear: Linearized, target_rows: np.ndarray, held: Actuation, bounds: Bounds
    ) -> tuple[float, float] | None:
        """What the weight of the energy costs: errors with it and with next to none.

        Both are those of one linearization, within the same bounds, and of targets that are not
        further away than it leads.

        Args:
            linear: The condensed system.
            target_rows: Wanted effector coordinates [m], NaN where free,
                shape (effector_row_count,).
            held: What the actuators do when they stay.
            bounds: Bounds of this step.

        Returns:
            Largest error of an effector with the scene's weight and with the least [m]; None where
            the weight is the least, or there is no answer.
        """
        asked, weights = self._ways.asked(target_rows, linear.effectors_now)
        violation = linear.effectors - linear.effectors_now - asked
        return errors_by_energy(
            linear, violation, weights, self._ways.row_effector, self._energy_weight,
            reachable(linear, held, bounds),
        )  # fmt: skip

    def _around(self, linear, violation, weights, held, bounds: Bounds, commanded) -> Actuation:
        """Solve it where some cables are commanded: taut or slack, as is better."""
        module = import_module("softrobot_twin.simulation.commanded_cables")
        wound = np.where(commanded, bounds.displacement_max, held.displacements)
        start = wind(linear, wound, bounds)
        if commanded.all():
            # Nothing is left to choose.
            return start
        widened = reachable(linear, start, bounds)
        within = bounds._replace(
            displacement_min=np.where(commanded, wound, widened.displacement_min),
            displacement_max=np.where(commanded, wound, widened.displacement_max),
        )
        tensions = module.tensions_around(
            linear, violation, weights, self._energy_weight, start.efforts, within, commanded,
            self.steadiness.weight,
        )  # fmt: skip
        if tensions is None:
            return held._replace(solved=False)
        tensions = np.clip(tensions, bounds.effort_min, bounds.effort_max)
        return settle_slack(linear, tensions, bounds)._replace(qp_solver="pivoting")
