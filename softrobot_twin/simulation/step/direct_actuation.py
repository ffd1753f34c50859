"""Solution for λ with commanded actuators: by displacement, by effort, or held.

Everything works on the condensed system δ = W λ + δ_free. Without contact it is the small convex
problem of `direct_problem`, solved exactly; with contact actuators and contacts are one
complementarity problem (`contact_problem`). A scene with contact pairs has the second kind in all
states, also without contacts: else results would change by the solver's tolerance when contacts are
made and lost, and a robot beside an obstacle would not come to rest.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import Actuation, ContactLoads
from softrobot_twin.simulation.step.contact_solvers import FORCE_SHARE, ContactSolvers
from softrobot_twin.simulation.step.linearized import Linearized, row_motion
from softrobot_twin.solvers.contact_problem import (
    ContactProblem,
    ContactSolution,
    with_frictionless_contacts,
)
from softrobot_twin.solvers.direct_problem import solve_direct, solve_towards
from softrobot_twin.solvers.inverse_problem import Bounds

# A displacement beyond its limit by less, as a share of the actuator's scale, is on it.
ROUND_OFF = 1.0e-11


@njit(**KERNEL)
def release_at_limits(path, least, most, round_off, by_effort, lower, upper, displacements):
    """Let efforts deviate that hold actuators beyond limits of displacement; whether any does.

    Where none does, displacements of effort-driven actuators become those of the bodies.

    Args:
        path: Displacements of the bodies, shape (n,).
        least: Least displacements, shape (n or more,).
        most: Greatest ones, shape (n or more,).
        round_off: Distance from these that counts as zero, shape (n or more,).
        by_effort: Whether each actuator is effort-driven, shape (n,).
        lower: Least efforts, equal to the greatest where the effort is held, shape (n,); changed.
        upper: Greatest efforts, shape (n,); changed.
        displacements: Displacements that are held, shape (n or more,); changed.
    """
    is_any_beyond = False
    for i in range(len(path)):
        if by_effort[i] and lower[i] == upper[i]:
            if path[i] < least[i] - round_off[i]:
                displacements[i], upper[i], is_any_beyond = least[i], np.inf, True
            elif path[i] > most[i] + round_off[i]:
                displacements[i], lower[i], is_any_beyond = most[i], -np.inf, True
    if not is_any_beyond:
        for i in range(len(path)):
            if by_effort[i]:
                displacements[i] = min(max(path[i], least[i]), most[i])
    return is_any_beyond


@njit(**KERNEL)
def move_by_efforts(W, violation, efforts, least, most, round_off, displacements):
    """Displacements of the bodies at given efforts; whether none is beyond its limits.

    Args:
        W: Compliance, the rows of the actuators first [m/N], shape (m, m).
        violation: δ_free of all rows [m], shape (m,).
        efforts: λ, shape (n,).
        least: See `release_at_limits`.
        most: See there.
        round_off: See there.
        displacements: Takes them, within the limits, shape (n,).
    """
    path, is_any_beyond = row_motion(W, 0, len(efforts), efforts, violation), False
    for i in range(len(path)):
        displacements[i] = min(max(path[i], least[i]), most[i])
        is_any_beyond = is_any_beyond or not (
            least[i] - round_off[i] <= path[i] <= most[i] + round_off[i]
        )
    return not is_any_beyond


class DirectActuation:
    """Solves for efforts and contact forces with commanded actuators.

    Attributes:
        solvers: Solvers of contacts; None in scenes without.
        round_off: Displacement beyond a limit that is on it, shape (actuator_count,).
    """

    def __init__(self, model: Model):
        """Create the solvers that the scene needs.

        Args:
            model: The built scene.
        """
        self._contacts, self._row_count = model.contacts, model.actuators.row_count
        # Those whose unknown is their displacement are the last.
        self._moved = slice(self._row_count, None)
        self._one_sided = model.actuators.one_sided
        self._limits = model.actuators.limits
        self._by_effort = model.actuators.is_effort_driven
        rows = model.actuators.row_count
        self._are_all_by_effort = bool(self._by_effort.all()) and rows == model.actuators.count
        self._actuators, self._may_stall = model.actuators, bool(model.actuators.stalls.any())
        self.round_off = ROUND_OFF * model.actuators.displacement_scale
        # What is no length counts as one beside contacts: by its scale as much as the robot's size.
        is_length = np.array([kind.displacement.unit == "m" for kind in model.actuators.kinds], bool)
        lengths = np.where(is_length, 1.0, model.nodes.finite_size / model.actuators.displacement_scale)
        self._lengths = lengths[:rows]
        # A scene without contact allocates no contact solver.
        self.solvers = ContactSolvers(model.scene.contact) if model.rows.varies else None
        self._efforts = self._before = np.zeros(model.actuators.count)
        self._expected: np.ndarray | None = None
        # Pairs with friction, and others without.
        self._mixes = model.rows.varies and len(set(model.contacts.rows_of_pair)) > 1

    def warm_up(self) -> None:
        """Compile every contact solver that may be needed."""
        if self.solvers and self._contacts.pairs:
            self.solvers.warm_up(3 if self._contacts.rubs else 1)

    def remember(self, efforts: np.ndarray) -> None:
        """Start the next solution from these efforts [N], shape (actuator_count,).

        Where contacts stick and slip, complementarity has several solutions: a state that is
        restored goes on as before only from its own efforts.

        Args:
            efforts: The efforts, in the actuators' units, shape (actuator_count,).
        """
        if len(efforts) > self._row_count:
            efforts = efforts.copy()
            efforts[self._moved] = 0.0
        self._efforts = efforts

    def expect(self, efforts: np.ndarray, forces: np.ndarray) -> None:
        """Start the next solution in contact, and no other, from what it is expected to be.

        Args:
            efforts: See `remember`.
            forces: λ of the contacts [N], shape (contact_row_count,).
        """
        self._expected = np.concatenate([efforts[: self._row_count], forces])

    def last_solution(self, linear: Linearized) -> tuple[np.ndarray, np.ndarray]:
        """Multipliers of the last linearization's solution.

        Args:
            linear: The condensed system.

        Returns:
            Efforts [N], zero of slides, shape (actuator_count,), and the forces in it of the present contacts
            [N], shape (contact_row_count,).
        """
        if not linear.contact_row_count:
            return self._before, np.empty(0)
        return self._before, self._contacts.last_multipliers

    def held(
        self, linear: Linearized, drives: np.ndarray, bounds: Bounds, is_needed: bool
    ) -> Actuation | None:
        """The actuation with all actuators held; see `at_drives`.

        Returns:
            The actuation; None with contact pairs, where it is not needed.
        """
        self._before = self._efforts
        return self.at_drives(linear, drives, bounds) if is_needed or not self.solvers else None

    def at_drives(self, linear: Linearized, drives: np.ndarray, bounds: Bounds) -> Actuation:
        """Efforts and contact forces where each actuator holds its displacement, or its effort.

        Args:
            linear: The condensed system.
            drives: δ_a, of effort-driven actuators λ_a, each in the unit of its kind,
                shape (actuator_count,).
            bounds: Bounds on the efforts, and on the displacements of effort-driven actuators.

        Returns:
            The actuation. Without a solution `solved` is False and the efforts are zero; if
            contacts did not converge, it has the smallest residual found.
        """
        if linear.move_count:
            bounds = self._with_moves(bounds, drives - linear.actuators)
        lower, upper = bounds.effort_min, bounds.effort_max
        if self._limits.has_effort_driven:
            found = self._regulate(linear, drives, lower, upper, bounds)
        else:
            found = self._hold(linear, drives, lower, upper)
        return self._stall(linear, found) if self._may_stall else found

    def _with_moves(self, bounds: Bounds, moves: np.ndarray) -> Bounds:
        """Bounds in which slides make these moves [m], shape (actuator_count,)."""
        least, most = bounds.effort_min.copy(), bounds.effort_max.copy()
        least[self._moved], most[self._moved] = moves[self._moved], moves[self._moved]
        return bounds._replace(effort_min=least, effort_max=most)

    def _stall(self, linear: Linearized, found: Actuation) -> Actuation:
        """Displacements of motors at a limit of their torque: where the bodies are."""
        stalled = self._actuators.stalled(found.efforts)
        if not (found.solved and stalled.any()):
            return found
        path = linear.actuator_displacements(found.efforts, found.contact.multipliers)
        return found._replace(displacements=np.where(stalled, path, found.displacements))

    def _hold(
        self, linear: Linearized, displacements: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> Actuation:
        """Efforts within bounds, and contact forces, at given displacements."""
        if self.solvers:
            return self._in_contact(linear, displacements, lower, upper)
        if self._limits.has_effort_driven and (lower == upper).all():
            # All efforts are held, as where regulators hold all pressures: nothing is to be found.
            return self._free(lower.copy(), displacements)
        efforts = solve_direct(
            linear.W, linear.violation, displacements, lower, upper, self._limits.displacement_scale
        )
        solved = efforts is not None
        return self._free(efforts if solved else np.zeros(len(lower)), displacements, solved)

    def _regulate(
        self, linear: Linearized, drives: np.ndarray, lower: np.ndarray, upper: np.ndarray,
        bounds: Bounds,
    ) -> Actuation:  # fmt: skip
        """The same where efforts of some actuators are held.

        An effort is held by equal bounds. At a limit of its displacement an actuator is held by the
        limit, and its effort deviates from the given one: an empty cavity bears on its walls.
        """
        by_effort = self._by_effort
        if self._are_all_by_effort and not self.solvers:
            efforts, displacements = drives.copy(), drives.copy()
            if move_by_efforts(
                linear.W, linear.violation, efforts, bounds.displacement_min,
                bounds.displacement_max, self.round_off, displacements,
            ):  # fmt: skip
                return self._free(efforts, displacements)
        # An effort is no displacement that is missed, beside which those of the others would be none.
        displacements = np.where(by_effort, linear.actuators, drives)
        lower, upper = np.where(by_effort, drives, (lower, upper))
        while True:
            found = self._hold(linear, displacements, lower, upper)
            path = linear.actuator_displacements(found.efforts, found.contact.multipliers)
            if not release_at_limits(
                path, bounds.displacement_min, bounds.displacement_max, self.round_off, by_effort,
                lower, upper, displacements,
            ):  # fmt: skip
                return found._replace(displacements=displacements)

    def at_efforts(
        self, linear: Linearized, efforts: np.ndarray, held: Actuation, bounds: Bounds
    ) -> Actuation:
        """Displacements at given efforts of actuators, within the bounds.

        Args:
            linear: The condensed system.
            efforts: Commanded efforts [N], shape (actuator_count,); NaN for actuators that are held.
            held: Actuation with all actuators held; always admissible.
            bounds: Bounds of this step.

        Returns:
            The actuation: with the given efforts, if their displacements are within the bounds;
            else, without contact and where none is held, with the nearest efforts in the energy
            norm of W.
        """
        wanted = np.clip(efforts, bounds.effort_min, bounds.effort_max)
        if linear.move_count:
            wanted[self._moved] = held.efforts[self._moved]
            bounds = self._with_moves(bounds, held.efforts)
        if self.solvers or np.isnan(wanted).any():
            return self._at_efforts_beside_others(linear, wanted, held, bounds)
        path = linear.actuator_displacements(held.efforts, held.contact.multipliers)
        within = widened(path, bounds)
        # The path of a cable without tension may be shorter than its winch can wind it.
        hangs = self._one_sided & ~self._by_effort & (wanted <= 0.0)
        within.displacement_max[hangs] = np.inf
        found = solve_towards(
            linear.W_aa, linear.actuators, wanted, within, self._limits.displacement_scale
        )
        if found is None:
            return held._replace(solved=False)
        return self.settle(linear, found, bounds)

    def settle(self, linear: Linearized, efforts: np.ndarray, bounds: Bounds) -> Actuation:
        """Set actuators to the displacements of given efforts, within the hardware's bounds.

        Args:
            linear: The condensed system, without contacts.
            efforts: λ_a [N], shape (actuator_count,).
            bounds: Bounds of this step. Effort-driven actuators are where their efforts bring them.

        Returns:
            The actuation, solved again if the bounds change a displacement.
        """
        path = linear.W_aa @ efforts + linear.actuators
        within = self._within(path, bounds)
        if np.array_equal(within, path):
            return self._free(efforts, within)
        settled = np.where(self._by_effort, efforts, within)
        return self.at_drives(linear, settled, bounds)

    def _within(self, path: np.ndarray, bounds: Bounds) -> np.ndarray:
        """Displacements δ_a within bounds where these are set, shape (actuator_count,)."""
        within = np.clip(path, bounds.displacement_min, bounds.displacement_max)
        return np.where(self._by_effort, path, within) if self._limits.has_effort_driven else within

    def _free(self, efforts: np.ndarray, displacements: np.ndarray, solved: bool = True) -> Actuation:
        """An actuation without contact."""
        self.remember(efforts)
        return Actuation(efforts, displacements, solved)

    def _at_efforts_beside_others(
        self, linear: Linearized, wanted: np.ndarray, held: Actuation, bounds: Bounds
    ) -> Actuation:
        """The same beside contacts, and beside actuators that are held, whose effort is NaN."""
        is_held = np.isnan(wanted)
        lower = np.where(is_held, bounds.effort_min, wanted)
        upper = np.where(is_held, bounds.effort_max, wanted)
        solution = self._hold(linear, held.displacements, lower, upper)
        path = linear.actuator_displacements(solution.efforts, solution.contact.multipliers)
        within = np.where(is_held, held.displacements, self._within(path, bounds))
        # A cable without tension may be slack: its path is shorter than its length.
        slack = self._one_sided & (wanted <= 0.0) & (within < path)
        if ((within == path) | slack | is_held).all():
            return solution._replace(displacements=within)
        return self.at_drives(linear, np.where(self._by_effort, wanted, within), bounds)

    def _in_contact(
        self, linear: Linearized, displacements: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> Actuation:
        """Efforts within bounds, and contact forces, at given displacements."""
        count = linear.groups.actuators.stop - linear.move_count
        # A slide goes where it is told, whatever touches its bodies.
        moves = lower[count:]
        found = self._solve(linear, displacements[:count], moves, lower[:count], upper[:count])
        efforts = np.concatenate([found.multipliers[:count], moves])
        self.remember(efforts)
        contact = ContactLoads(
            found.multipliers[count:], found.sweeps, found.gap_residual, found.force_residual,
            found.converged,
        )  # fmt: skip
        return Actuation(efforts, np.asarray(displacements), contact=contact)

    def _solve(
        self, linear: Linearized, displacements: np.ndarray, moves: np.ndarray,
        lower: np.ndarray, upper: np.ndarray,
    ) -> ContactSolution:  # fmt: skip
        """Multipliers of the actuators, then of all contacts.

        If only some contacts are condensed, those that would penetrate in the solution are added,
        and it is solved again; the second time all are added.
        """
        contacts, sweeps, rounds = self._contacts, 0, 0
        guess, expected = self._guesses()
        units = np.append(self._lengths, np.ones(len(guess) - self._row_count))
        while True:
            problem = self._problem(linear, displacements, moves, lower, upper)
            chosen = self._places(linear)
            found = self.solvers.solve(
                problem, (guess / units)[chosen], (expected / units)[chosen], contacts.margin
            )
            multipliers = np.zeros(len(guess))
            multipliers[chosen] = found.multipliers * units[chosen]
            if linear.is_whole:
                return found._replace(multipliers=multipliers)
            sweeps, rounds = sweeps + found.sweeps, rounds + 1
            gaps = linear.open_gaps(multipliers[chosen])
            crossing = gaps < -self._allowed_crossing(problem, found)
            if not crossing.any():
                crossed = max(0.0, -gaps.min(initial=np.inf))
                return found._replace(
                    multipliers=multipliers, sweeps=sweeps,
                    gap_residual=max(found.gap_residual, crossed),
                )  # fmt: skip
            guess = expected = multipliers
            linear.take(crossing if rounds == 1 else gaps < np.inf)

    def _problem(self, linear: Linearized, displacements, moves, lower, upper) -> ContactProblem:
        """The problem of the actuators and of the contacts that are condensed."""
        contacts = self._contacts
        compliance, violation = linear.of_actuators_and_contacts(moves)
        violation[: len(displacements)] -= displacements
        problem = ContactProblem(
            None if compliance.Yt is not None else compliance.W, violation, lower, upper,
            contacts.friction[linear.chosen], 3 if contacts.rubs else 1, compliance.Yt,
        )  # fmt: skip
        problem = problem if (self._lengths == 1.0).all() else problem.in_units(self._lengths)
        return with_frictionless_contacts(problem) if self._mixes else problem

    @staticmethod
    def _places(linear: Linearized) -> np.ndarray | slice:
        """Indices of the condensed rows among the multipliers of actuators and contacts."""
        if linear.is_whole:
            return slice(None)
        count = linear.groups.actuators.stop
        return np.concatenate([np.arange(count), count + linear.contact_rows])

    def _guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """All multipliers of the last solution, and the extrapolated ones of this step [N]."""
        if self._expected is not None:
            expected, self._expected = self._expected, None
            return expected, expected
        memory, efforts = self._contacts.memory, self._efforts[: self._row_count]
        return (np.concatenate([efforts, memory.guess]),
                np.concatenate([efforts, memory.expected]))

    def _allowed_crossing(self, problem: ContactProblem, found: ContactSolution) -> float:
        """Penetration of an omitted contact up to which the solution counts as solved [m].

        It is within the tolerance, and so small that the force of the contact would be negligible.
        """
        own = problem.W.diagonal()[self._row_count :]
        frictionless = len(problem.lower) - self._row_count
        normals = np.concatenate(
            [own[:frictionless], own[frictionless :: problem.rows_per_contact]]
        )
        stiffest = normals[normals > 0.0].min(initial=np.inf)
        force = FORCE_SHARE * np.abs(found.multipliers).max(initial=0.0)
        return min(self.solvers.tolerance, stiffest * force)


def widened(path: np.ndarray, bounds: Bounds) -> Bounds:
    """Bounds of the actuators, widened to contain the held state.

    The path of a slack cable is shorter than its length, that of a cable at its greatest tension is
    longer; neither violates a limit of the hardware. With the held state inside, the problem always
    has an admissible point.

    Args:
        path: Displacements of the paths with all actuators held [m], shape (n,).
        bounds: Bounds of this step.
    """
    return bounds._replace(
        displacement_min=np.minimum(bounds.displacement_min, path),
        displacement_max=np.maximum(bounds.displacement_max, path),
    )
