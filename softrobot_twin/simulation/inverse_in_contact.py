"""How λ is found when effectors have targets and bodies touch (Coevoet 2017, eq. 19-22)."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.actuation import Actuation, Linearized, reachable
from softrobot_twin.simulation.commanded_cables import of_cables, split
from softrobot_twin.simulation.contact_actuation import ContactActuation, Touch
from softrobot_twin.simulation.contact_newton import ContactLinearized
from softrobot_twin.simulation.energy_cost import errors_by_energy
from softrobot_twin.simulation.inverse_actuation import EffectorWays
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.steadiness import Steadiness
from softrobot_twin.solvers.complementarity_problem import ComplementarityProblem
from softrobot_twin.solvers.inverse_contact import ContactBounds, build_inverse_contact
from softrobot_twin.solvers.inverse_qp import LEAST_ENERGY_WEIGHT, Bounds
from softrobot_twin.solvers.pivoting import solve_by_pivoting

# Programs that one linearization may solve; each takes some tens of microseconds.
MOST_PROGRAMS = 30
# What the targets leave open goes a tenth of the way to the least energy in one linearization, or
# less: a whole one overshoots and is taken back by the next.
LEAST_STEADINESS = 9.0
# A path beyond its bound by less [m] is on it.
ROUND_OFF = 1.0e-12
# A contact force, this near to its limit as a share of it, is on it.
LIMIT_MARGIN = 1.0e-4
# A force or a gap beyond its bound by less is round-off [N], [m].
EXCESS = 1.0e-6


class InverseInContact:
    """Finds actuation and contact forces that bring effectors to their targets.

    What gives way where not everything can be had, in this order: the target; the limit of contact
    force; the slack of a commanded cable. Limits of the hardware never do.

    Attributes:
        steadiness: How hard the actuators are held to where they are.
    """

    def __init__(self, model: Model, direct: ContactActuation):
        """Lay out the problem.

        Args:
            model: A scene with actuators, effectors and contacts without friction.
            direct: Finds λ of what is held and wound.
        """
        self._model, self._direct = model, direct
        self._contacts = model.contacts
        self._ways = EffectorWays(model)
        self._energy_weight = max(model.scene.solver.energy_weight, LEAST_ENERGY_WEIGHT)
        limit = None if model.scene.contact is None else model.scene.contact.force_limit
        self._force_limit = np.inf if limit is None else limit
        self.steadiness = Steadiness(LEAST_STEADINESS)
        self.reset()

    def reset(self) -> None:
        """Forget which contacts bore the last step, which bounds bound, and all moves."""
        self._touching: dict[tuple[int, int], bool] | None = None
        self._binding: np.ndarray | None = None
        self.steadiness.reset()

    def solve(
        self, linear: ContactLinearized, target_rows: np.ndarray, held: Actuation, bounds: Bounds
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
        now = linear.values[linear.effector_rows]
        asked, weights = self._ways.asked(target_rows, now)
        self.steadiness.learn(held.displacements, asked)
        violation = linear.violation.copy()
        violation[linear.effector_rows] -= now + asked
        commanded = bounds.displacement_min == bounds.displacement_max
        if commanded.any():
            # What holding is, with those where they should be.
            wound = np.where(commanded, bounds.displacement_max, held.displacements)
            held = self._direct.wind(linear, wound, bounds)
            if commanded.all():
                # Nothing is left to choose; how hard it presses is told all the same.
                limits = self._limits_met(held.contact.multipliers)
                return held._replace(contact=held.contact._replace(limits=limits))
        pulled, contacts = commanded[linear.cables], len(held.contact.multipliers)
        taut = held.efforts[linear.cables][pulled]
        touching = np.concatenate([taut, held.contact.multipliers])
        free = held.efforts[linear.cables][~pulled]
        still = np.concatenate([free, held.contact.moves, touching])
        before, forces = self._direct.last_solution()
        last_answer = np.concatenate(
            [before[~pulled], np.zeros(len(held.contact.moves)), before[pulled], forces]
        )
        problem = self._problem(linear, violation, weights, held, bounds, pulled, last_answer)
        last = self._last_touching(contacts)
        solution = solve_by_pivoting(
            problem, still, touching > 0.0,
            None if last is None else np.concatenate([taut > 0.0, last]), MOST_PROGRAMS,
            self._binding,
        )  # fmt: skip
        self._binding = solution.binding
        self._remember(solution.touching[len(taut) :])
        if not solution.solved:
            return held._replace(solved=False)
        return self._settled(linear, problem, solution, bounds, pulled)

    def errors_by_energy(
        self, linear: ContactLinearized, target_rows: np.ndarray, held: Actuation, bounds: Bounds
    ) -> tuple[float, float] | None:
        """See `InverseActuation.errors_by_energy`; what presses when held goes on pressing."""
        a, e = linear.cables, linear.effector_rows
        if a.start == a.stop:
            return None
        kept = np.r_[a, e]
        pressing = linear.contacts.start + np.flatnonzero(held.contact.multipliers > 0.0)
        W, violation = linear.W[np.ix_(kept, kept)], linear.violation[kept]
        if len(pressing):
            # Without the rows whose gap stays closed: several may be closed by one force.
            across = linear.W[np.ix_(pressing, kept)]
            shares = np.linalg.lstsq(
                linear.W[np.ix_(pressing, pressing)],
                np.column_stack([across, linear.violation[pressing]]), rcond=None,
            )[0]  # fmt: skip
            W = W - across.T @ shares[:, :-1]
            violation = violation - across.T @ shares[:, -1]
        n, now = a.stop - a.start, linear.values[e]
        reduced = Linearized(W[:n, :n], W[n:, :n], violation[:n], violation[n:], now)
        asked, weights = self._ways.asked(target_rows, now)
        cables = of_cables(bounds, np.ones(n, dtype=bool))
        within = reachable(reduced, held._replace(efforts=held.efforts[a]), cables)
        return errors_by_energy(
            reduced, reduced.effectors - now - asked, weights, self._ways.row_effector,
            self._energy_weight, within,
        )  # fmt: skip

    def _problem(self, linear, violation, weights, held, bounds: Bounds, commanded, last_answer):
        system = split(
            linear.W, violation, linear.effector_rows, linear.contacts, (linear.G_e, linear.G_c),
            commanded, bounds.displacement_max[linear.cables],
        )  # fmt: skip
        limit = np.full(len(held.contact.multipliers), self._force_limit)
        count = linear.cables.stop
        return build_inverse_contact(
            system, weights, self._energy_weight,
            of_cables(self._cable_bounds(linear, held, bounds), ~commanded),
            ContactBounds(
                -bounds.displacement_max[count:] - linear.slide_positions,
                -bounds.displacement_min[count:] - linear.slide_positions,
                np.concatenate([bounds.effort_max[linear.cables][commanded], limit]),
            ),
            last_answer, self.steadiness.weight, compiled=True,
        )  # fmt: skip

    @staticmethod
    def _cable_bounds(linear: ContactLinearized, held: Actuation, bounds: Bounds) -> Bounds:
        """The cables' bounds, as wide as holding still needs: see `actuation.reachable`."""
        a = linear.cables
        path = linear.path_shortening(held.efforts, held.contact.multipliers)
        return Bounds(
            np.minimum(bounds.displacement_min[a], path),
            np.maximum(bounds.displacement_max[a], path),
            bounds.effort_min[a], bounds.effort_max[a],
        )  # fmt: skip

    def _settled(
        self, linear, problem, solution, bounds: Bounds, commanded: np.ndarray
    ) -> Actuation:
        """Wind to the paths found, within the hardware's bounds; solve anew where that differs."""
        count, z = linear.cables.stop, solution.unknowns
        # Tensions of free cables, moves, tensions of commanded cables, forces.
        pulled = np.count_nonzero(commanded)
        free, first = count - pulled, len(z) - problem.contact_count
        tensions, moves, forces = np.empty(count), z[free:first], z[first + pulled :]
        tensions[~commanded], tensions[commanded] = z[:free], z[first : first + pulled]
        tensions = np.minimum(
            np.maximum(tensions, bounds.effort_min[:count]), bounds.effort_max[:count]
        )
        touch = Touch(
            forces, solution.programs, _residual(problem, z, pulled), 0.0, True,
            moves, self._limits_met(forces),
        )  # fmt: skip
        path = linear.path_shortening(tensions, touch.multipliers)
        within = np.minimum(
            np.maximum(path, bounds.displacement_min[:count]), bounds.displacement_max[:count]
        )
        shortening = np.concatenate([within, -(linear.slide_positions + moves)])
        # What pulls not may hang slack: its path is shorter than what is wound.
        slack = (tensions <= EXCESS) & (within < path)
        if not (slack | (np.abs(within - path) <= ROUND_OFF)).all():
            wound = self._direct.wind(linear, shortening, bounds)
            touch = wound.contact._replace(limits=touch.limits)
            return wound._replace(qp_solver="pivoting", contact=touch)
        self._direct.remember(tensions)
        return Actuation(
            self._direct.with_loads(linear, tensions, touch), shortening, True, "pivoting", touch
        )

    def _limits_met(self, forces: np.ndarray) -> tuple[str, ...]:
        """Names of pairs that press as hard as they may, and of those that cannot but exceed it."""
        if not (forces >= (1.0 - LIMIT_MARGIN) * self._force_limit).any():
            return ()
        found = []
        pair_of = self._contacts.pair[: len(forces)]
        for pair in np.unique(pair_of):
            hardest = forces[pair_of == pair].max() / self._force_limit
            if hardest >= 1.0 - LIMIT_MARGIN:
                exceeded = "_exceeded" if hardest > 1.0 + LIMIT_MARGIN else ""
                names = ".".join(self._contacts.pairs[pair].names)
                found.append(f"{names}.force_limit{exceeded}")
        return tuple(found)

    def _last_touching(self, count: int) -> np.ndarray | None:
        known = self._contacts.memory.known
        if self._touching is None or len(known) != count:
            return None
        return np.array([self._touching.get(key, False) for key in known], dtype=bool)

    def _remember(self, touching: np.ndarray) -> None:
        known = self._contacts.memory.known
        self._touching = dict(zip(known, touching.tolist(), strict=True))


def _residual(problem: ComplementarityProblem, z: np.ndarray, pulled: int) -> float:
    """How exactly gaps and forces exclude each other [m]; the first contacts are cables."""
    if problem.contact_count == pulled:
        return 0.0
    own = problem.C[:, len(z) - problem.contact_count :].diagonal()
    open_or_pressing = np.minimum(problem.gaps(z), own * problem.forces(z))
    return float(np.abs(open_or_pressing[pulled:]).max())
