"""How λ is found when effectors have targets and bodies touch (Coevoet 2017, eq. 19-22)."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.actuation import Actuation
from softrobot_twin.simulation.contact_actuation import ContactActuation, Touch, path_shortening
from softrobot_twin.simulation.contact_newton import ContactLinearized
from softrobot_twin.simulation.inverse_actuation import LONGEST_REACH, within_reach
from softrobot_twin.simulation.model import Model
from softrobot_twin.solvers.inverse_contact import (
    ContactBounds,
    InverseContact,
    build_inverse_contact,
)
from softrobot_twin.solvers.inverse_qp import Bounds
from softrobot_twin.solvers.pivoting import solve_by_pivoting

# Programs that one linearization may solve; each takes some tens of microseconds.
MOST_PROGRAMS = 30
# A force or a gap beyond its bound by less is round-off [N], [m].
EXCESS = 1.0e-6


class InverseInContact:
    """Finds actuation and contact forces that bring effectors to their targets.

    What gives way where not everything can be had, in this order: the target; the limit of contact
    force; the slack of a commanded cable. Limits of the hardware never do.
    """

    def __init__(self, model: Model, direct: ContactActuation):
        """Lay out the problem.

        Args:
            model: A scene with actuators, effectors and contacts without friction.
            direct: Finds λ of what is held and wound.
        """
        self._model, self._direct = model, direct
        self._contacts = model.contacts
        self._row_effector = model.effectors.row_effector
        self._row_weights = model.effectors.row_weights
        self._energy_weight = model.scene.solver.energy_weight
        self._longest_reach = LONGEST_REACH * model.nodes.size
        limit = None if model.scene.contact is None else model.scene.contact.force_limit
        self._force_limit = np.inf if limit is None else limit
        self.reset()

    def reset(self) -> None:
        """Forget which contacts bore the last step."""
        self._touching: dict[tuple[int, int], bool] = {}

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
        wanted = np.isfinite(target_rows)
        now = linear.values[linear.effector_rows]
        asked = np.where(wanted, target_rows - now, 0.0)
        asked = within_reach(asked, self._row_effector, self._longest_reach)
        violation = linear.violation[linear.effector_rows] - now - asked
        weights = np.where(wanted, self._row_weights, 0.0)
        count, contacts = linear.cables.stop, len(held.contact.multipliers)
        problem = build_inverse_contact(
            self._system(linear, violation), weights, self._energy_weight,
            self._cable_bounds(linear, held, bounds),
            ContactBounds(
                -bounds.shortening_max[count:] - linear.slide_positions,
                -bounds.shortening_min[count:] - linear.slide_positions,
                np.full(contacts, self._force_limit),
            ),
        )  # fmt: skip
        if not problem.is_finite:
            return held._replace(solved=False)
        still = np.concatenate(
            [held.tensions[:count], held.contact.moves, held.contact.multipliers]
        )
        solution = solve_by_pivoting(
            problem, still, held.contact.multipliers > 0.0, self._last_touching(contacts),
            MOST_PROGRAMS,
        )  # fmt: skip
        self._remember(solution.touching)
        if not solution.solved:
            return held._replace(solved=False)
        return self._settled(linear, solution, bounds)

    def _system(self, linear: ContactLinearized, violation: np.ndarray) -> InverseContact:
        a, e, c = linear.cables, linear.effector_rows, linear.contacts
        W = linear.W
        return InverseContact(
            W[e, a], W[e, c], W[a, a], W[a, c], W[c, c],
            linear.G_e, np.zeros((a.stop, linear.G_e.shape[1])), linear.G_c,
            violation, linear.violation[a], linear.violation[c],
        )  # fmt: skip

    @staticmethod
    def _cable_bounds(linear: ContactLinearized, held: Actuation, bounds: Bounds) -> Bounds:
        """The cables' bounds, as wide as holding still needs: see `actuation.reachable`."""
        a = linear.cables
        path = path_shortening(linear, held)
        return Bounds(
            np.minimum(bounds.shortening_min[a], path),
            np.maximum(bounds.shortening_max[a], path),
            bounds.tension_min[a], bounds.tension_max[a],
        )  # fmt: skip

    def _settled(self, linear: ContactLinearized, solution, bounds: Bounds) -> Actuation:
        """Wind to the paths found, within the hardware's bounds; solve anew where that differs."""
        count = linear.cables.stop
        slides = len(linear.slide_positions)
        tensions = np.clip(
            solution.unknowns[:count], bounds.tension_min[:count], bounds.tension_max[:count]
        )
        moves = solution.unknowns[count : count + slides]
        forces = solution.unknowns[count + slides :]
        touch = Touch(
            forces, solution.programs, self._residual(linear, tensions, moves, forces), 0.0, True,
            moves, self._names_of(solution.force_excess),
        )  # fmt: skip
        found = Actuation(tensions, np.empty(0), contact=touch)
        path = path_shortening(linear, found)
        within = np.clip(path, bounds.shortening_min[:count], bounds.shortening_max[:count])
        shortening = np.concatenate([within, -(linear.slide_positions + moves)])
        if not np.array_equal(within, path):
            wound = self._direct.wind(linear, shortening, bounds)
            touch = wound.contact._replace(limits=touch.limits)
            return wound._replace(qp_solver="pivoting", contact=touch)
        return Actuation(
            self._direct.with_loads(linear, tensions, touch), shortening, True, "pivoting", touch
        )

    def _residual(self, linear: ContactLinearized, tensions, moves, forces) -> float:
        """How exactly gaps and forces exclude each other [m]."""
        a, c = linear.cables, linear.contacts
        if len(forces) == 0:
            return 0.0
        W = linear.W
        gaps = W[c, a] @ tensions + W[c, c] @ forces + linear.G_c @ moves + linear.violation[c]
        return float(np.abs(np.minimum(gaps, forces * W[c, c].diagonal())).max())

    def _names_of(self, excess: np.ndarray) -> tuple[str, ...]:
        pairs = self._contacts.pair[: len(excess)][excess > EXCESS]
        names = [self._contacts.pairs[pair].names for pair in np.unique(pairs)]
        return tuple(f"{first}.{second}.force_limit" for first, second in names)

    def _last_touching(self, count: int) -> np.ndarray | None:
        known = self._contacts.memory.known
        if not self._touching or len(known) != count:
            return None
        return np.array([self._touching.get(key, False) for key in known], dtype=bool)

    def _remember(self, touching: np.ndarray) -> None:
        known = self._contacts.memory.known
        self._touching = dict(zip(known, touching.tolist(), strict=True))
