"""How λ is found when effectors have targets (Coevoet 2017, eq. 17-22).

The inverse problem is a quadratic program with complementarity constraints over the efforts of the
actuators, of slides their moves, and the contact forces; without contacts it is an ordinary quadratic
program (`inverse_problem`, `inverse_solver`).

Actuators may be commanded while the others are optimised around them. A winch holds a commanded
cable to a length: its path is as short as that or shorter, and it pulls only where it is taut,
0 ≤ λ ⊥ δ_a - δ_set ≥ 0. That is the law of contact, so a commanded cable is one contact more.

The law holds for a free cable too, whose winch may choose δ_set within its limits. So the greatest
shortening of a winch bounds the path of a taut cable only: either λ ≥ 0 and δ_a ≤ δ_max, or λ = 0,
and the path may be shorter than the shortest length to which the winch can wind the cable. The
search begins in the branch of the held actuation. Branches meet where λ = 0 and δ_a = δ_max; a cable
that an optimum leaves there takes the other one.

How far an optimum is trusted is a question of its own: `Follower`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import NO_EFFORT, Actuation, ContactLoads
from softrobot_twin.simulation.step.apparent_stiffness import StiffnessRows
from softrobot_twin.simulation.step.contact_search import ContactSearch
from softrobot_twin.simulation.step.direct_actuation import DirectActuation, widened
from softrobot_twin.simulation.step.linearized import Linearized, row_motion
from softrobot_twin.simulation.step.situation import NO_LOADS, Situation
from softrobot_twin.solvers.inverse_problem import (
    LEAST_ENERGY_WEIGHT,
    NO_FORCES,
    Bounds,
    InverseSystem,
    build_inverse_problem,
    with_effort_rows,
)
from softrobot_twin.solvers.inverse_solver import proved_efforts
from softrobot_twin.solvers.pivoting import WARM_START
from softrobot_twin.solvers.qpcc import QPCC, QPCCSolution
from softrobot_twin.solvers.quadratic_program import DAQPSolver, whiten

# A target further away than this share of the body's size is approached along a straight line:
# so far from the effector, the linearization says nothing, and chasing it would oscillate.
LONGEST_REACH = 0.05
# The same for an orientation [rad].
LONGEST_TURN = 0.1
# Contacts hold effectors in some directions, in which the same energy moves them far less, and would
# keep them off their targets. There the energy weighs the less the nearer the targets are, as a
# Levenberg-Marquardt weight does (Yamashita and Fukushima 2001), down to this share.
LEAST_ENERGY_SHARE_IN_CONTACT = 1.0 / 512.0
# In contact, what the targets leave open goes at most a tenth of the displacement to the least
# energy in one linearization: a whole one overshoots, and the next takes it back. So it is with wanted
# stiffnesses, which change with the square of efforts that leave the targets alone.
LEAST_PROXIMAL_WEIGHT = 9.0
# With friction along cables the least energy is another where cables slip one way, the other way, or
# stick. Towards it go ever smaller shares, so that no cycle between these lasts.
LEAST_PROXIMAL_WEIGHT_WITH_FRICTION = 99.0
# A contact force, this near to its limit as a share of it, is on it.
LIMIT_MARGIN = 1.0e-4
# The path of a cable this near to its limit, as a share of the cable's scale, is at the limit.
AT_LIMIT = 1.0e-8


@njit(**KERNEL)
def write_steps(
    targets, now, row_effector, row_weights, row_lengths, longest, longest_turn, squares, steps,
    weights,
):  # fmt: skip
    """Displacements to targets, and turns, none longer than may be; see `InverseActuation.steps_to_targets`.

    Both of an effector are shortened by the same factor.

    Args:
        targets: Wanted effector coordinates [m], NaN where free, shape (n,).
        now: Where they are [m], shape (n,).
        row_effector: Effector of each row, shape (n,).
        row_weights: Weight of each row, shape (n,).
        row_lengths: Length per radian of the last rows, those of orientations [m/rad],
            shape (turn_row_count,).
        longest: Longest displacement [m].
        longest_turn: Largest angle [rad].
        squares: Zeros; takes the squared distance [m²] and the squared angle [rad²] of each
            effector, shape (effector_count, 2).
        steps: Takes the displacements [m], shape (n,).
        weights: Takes the weights by these shares, zero where a row is free, shape (n,).
    """
    first = len(now) - len(row_lengths)
    for r in range(len(now)):
        is_wanted = np.isfinite(targets[r])
        steps[r] = targets[r] - now[r] if is_wanted else 0.0
        weights[r] = row_weights[r] if is_wanted else 0.0
        if r < first:
            squares[row_effector[r], 0] += steps[r] * steps[r]
        else:
            squares[row_effector[r], 1] += (steps[r] / row_lengths[r - first]) ** 2
    for r in range(len(now)):
        e = row_effector[r]
        share = longest / max(np.sqrt(squares[e, 0]), longest)
        share = min(share, longest_turn / max(np.sqrt(squares[e, 1]), longest_turn))
        steps[r] *= share
        weights[r] /= share


@njit(**KERNEL)
def write_wanted(targets, row_weights, wanted, wanted_weights):
    """Write targets and their weights, both zero where a row is free, all of shape (n,).

    Args:
        targets: Wanted effector coordinates [m], NaN where free.
        row_weights: Weight of each row.
        wanted: Takes the targets [m].
        wanted_weights: Takes the weights.
    """
    for r in range(len(targets)):
        is_wanted = np.isfinite(targets[r])
        wanted[r] = targets[r] if is_wanted else 0.0
        wanted_weights[r] = row_weights[r] if is_wanted else 0.0


@njit(**KERNEL)
def keep_within(path, lower, upper, round_off, within):
    """Write displacements within their bounds; whether none changed by more than round-off.

    Args:
        path: Displacements [m], shape (n,).
        lower: Least ones [m], shape (n or more,).
        upper: Greatest ones [m], shape (n or more,).
        round_off: Change that counts as zero [m], shape (n,).
        within: Takes the displacements within the bounds [m], shape (n,).
    """
    are_kept = True
    for i in range(len(path)):
        within[i] = min(max(path[i], lower[i]), upper[i])
        are_kept = are_kept and abs(within[i] - path[i]) <= round_off[i]
    return are_kept


@njit(**KERNEL)
def hang_beyond(path, loads, upper, margins, may_hang, slack):
    """Write which cables are slack beyond the greatest shortening of their winches; whether any is.

    Args:
        path: Shortenings of the paths [m], shape (n,).
        loads: Tensions in shares of their scales, shape (n,).
        upper: Greatest shortenings of the winches [m], shape (n or more,).
        margins: Distance from these that counts as zero [m], shape (n,).
        may_hang: Whether each may be slack, shape (n,).
        slack: Written, shape (n,).
    """
    largest, some_hang = 0.0, False
    for i in range(len(slack)):
        largest = max(largest, loads[i])
    for i in range(len(slack)):
        has_none = loads[i] <= NO_EFFORT * largest
        slack[i] = may_hang[i] and has_none and path[i] > upper[i] + margins[i]
        some_hang = some_hang or slack[i]
    return some_hang


@njit(**KERNEL)
def change_slack(displacements, loads, upper, margins, may_hang, slack, was_slack):
    """Change the branch where two branches meet, at no tension and the greatest shortening.

    A taut cable there becomes slack, so that its path may be shorter than its winch's shortest
    cable. A slack one whose path is longer than that may be taut.

    Args:
        displacements: Shortenings that the winches follow [m], shape (n or more,).
        loads: See `hang_beyond`.
        upper: See there.
        margins: See there.
        may_hang: See there.
        slack: Cables that are slack in the branch, shape (n,); changed.
        was_slack: Cables that were taken as slack before and are no more, shape (n,); changed.

    Returns:
        Whether the branch is another one.
    """
    largest, is_changed = 0.0, False
    for i in range(len(slack)):
        largest = max(largest, loads[i])
    for i in range(len(slack)):
        is_short = displacements[i] >= upper[i] - margins[i]
        if slack[i] and not is_short:
            slack[i], was_slack[i], is_changed = False, True, True
        elif may_hang[i] and is_short and not (slack[i] or was_slack[i]):
            slack[i] = loads[i] <= NO_EFFORT * largest
            is_changed = is_changed or slack[i]
    return is_changed


@njit(**KERNEL)
def write_near(drives, share, scales, is_commanded, by_effort, lower, upper, least, most):
    """Narrow bounds to what is near; where they lie further away, to their nearer end.

    Args:
        drives: Displacements now, shape (n,).
        share: How far is near, as a share of the scales.
        scales: Scale of each, shape (n,).
        is_commanded: Whose bounds are left as they are, shape (n,).
        by_effort: The same.
        lower: Least displacements, shape (n,).
        upper: Greatest displacements, shape (n,).
        least: Takes the narrowed ones, shape (n,).
        most: The same.
    """
    for i in range(len(drives)):
        least[i], most[i] = low, high = lower[i], upper[i]
        if not (is_commanded[i] or by_effort[i]):
            reach = share * scales[i]
            least[i] = max(low, min(drives[i] - reach, high))
            most[i] = min(high, max(drives[i] + reach, low))


@njit(**KERNEL)
def guessed_actuation(
    W, first_effector, violation, errors, weights, energy_weight, proximal_weight, centre, held,
    displacement_min, displacement_max, effort_min, effort_max, is_move, stiffness, reference, active,
    may_hang, at_limit, round_off, effort_scales, sizes,
):  # fmt: skip
    """What `_over_branches` finds in one branch of slack cables, from the last active set.

    Args:
        W: Compliance, the rows of the actuators first [m/N], shape (n, n).
        first_effector: First row of the effectors.
        violation: δ_free of all rows [m], shape (n,).
        errors: δ_e,free less the targets [m], shape (e,).
        weights: Weight of each effector row, shape (e,).
        energy_weight: ε.
        proximal_weight: p.
        centre: z̄ [N], shape (a,).
        held: Multipliers when the actuators stay [N], shape (a or more,).
        displacement_min: Least displacements of this step [m], shape (a or more,).
        displacement_max: Greatest ones [m], same shape.
        effort_min: Least efforts [N], same shape.
        effort_max: Greatest ones [N], same shape.
        is_move: Whether the multiplier of each is its move, shape (a,).
        stiffness: ρ of an augmented tangent, zero without [N/m], shape (a,).
        reference: δ_ref of it [m], shape (a,).
        active: Active bounds in the guess, see `proved_efforts`.
        may_hang: Which cables may be slack, shape (a,).
        at_limit: Distance from a greatest shortening that counts as zero [m], shape (a,).
        round_off: Change of a displacement that counts as zero [m], shape (a,).
        effort_scales: Scale of each effort [N], shape (a,).
        sizes: Large displacement of each actuator in its unit, shape (a,).

    Returns:
        Whether they are proved, and no cable changes its branch; multipliers [N], shape (a,);
        displacements within their bounds [m], shape (a,); and the active bounds.
    """
    a = len(centre)
    path = row_motion(W, 0, a, held[:a], violation)
    within, loads, slack = np.empty(a), np.empty(a), np.zeros(a, dtype=np.bool_)
    for i in range(a):
        loads[i] = held[i] - stiffness[i] * (path[i] - reference[i])
        loads[i] /= effort_scales[i]
    hang_beyond(path, loads, displacement_max, at_limit, may_hang, slack)
    least, most, greatest = np.empty(a), np.empty(a), effort_max[:a].copy()
    for i in range(a):
        least[i] = min(displacement_min[i], path[i])
        most[i] = max(displacement_max[i], path[i])
        if slack[i]:
            most[i], greatest[i] = np.inf, 0.0
    effectors = (first_effector, first_effector + len(errors))
    proved, efforts, active = proved_efforts(
        W, effectors, errors, weights, energy_weight, proximal_weight, centre, violation[:a], least,
        most, effort_min[:a], greatest, is_move, stiffness, reference, held[:a], active, sizes,
    )  # fmt: skip
    if not proved:
        return False, efforts, within, active
    is_augmented = False
    for i in range(a):
        is_augmented = is_augmented or stiffness[i] != 0.0
    for i in range(a):
        if not is_augmented:
            efforts[i] = min(max(efforts[i], effort_min[i]), effort_max[i])
    path = row_motion(W, 0, a, efforts, violation)
    if not keep_within(path, displacement_min, displacement_max, round_off, within):
        return False, efforts, within, active
    for i in range(a):
        loads[i] = efforts[i] - stiffness[i] * (path[i] - reference[i])
        loads[i] /= effort_scales[i]
    was_slack = np.zeros(a, dtype=np.bool_)
    is_changed = change_slack(
        within, loads, displacement_max, at_limit, may_hang, slack, was_slack
    )
    return not is_changed, efforts, within, active


class Unknowns(NamedTuple):
    """Order of the unknowns z: efforts of free actuators, those of commanded ones, forces.

    Attributes:
        commanded: Which one-sided actuators are commanded, shape (actuator_count,).
        has_commanded: Whether any is.
    """

    commanded: np.ndarray
    has_commanded: bool

    def stack(self, efforts: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """z of efforts and contact forces [N].

        Args:
            efforts: Efforts of the actuators, in their units, shape (actuator_count,).
            forces: Forces of the contacts [N], shape (contact_row_count,).
        """
        if not (self.has_commanded or len(forces)):
            return efforts
        return np.concatenate([efforts[~self.commanded], efforts[self.commanded], forces])

    def split(self, z: np.ndarray, forces: int) -> tuple[np.ndarray, np.ndarray]:
        """Efforts and contact forces of z.

        Args:
            z: The unknowns.
            forces: Number of contact forces.
        """
        count = len(self.commanded)
        first = len(z) - forces
        if not self.has_commanded:
            return z[:count], z[first:]
        free_count = count - np.count_nonzero(self.commanded)
        efforts = np.empty(count)
        efforts[~self.commanded], efforts[self.commanded] = z[:free_count], z[free_count:first]
        return efforts, z[first:]


class Asked(NamedTuple):
    """What one linearization is asked for; see `Follower.solve`.

    Attributes:
        linear: The condensed system.
        target_rows: Wanted effector coordinates [m], NaN where free, shape (effector_row_count,).
        held: What the actuators do when they stay.
        bounds: Bounds of this linearization.
        commanded: Which actuators are commanded, shape (actuator_count,).
        stiffness: Rows of wanted stiffnesses; None if none is wanted.
    """

    linear: Linearized
    target_rows: np.ndarray
    held: Actuation
    bounds: Bounds
    commanded: np.ndarray
    stiffness: StiffnessRows | None


class Tracking(NamedTuple):
    """The inverse problem of one linearization, but for which cables are slack.

    Attributes:
        linear: The condensed system.
        errors: δ_e,free less where effectors shall be, then those of further rows [m].
        weights: Weight of each of these rows.
        held: What the actuators do when they stay.
        bounds: Bounds of this linearization.
        commanded: Which actuators are commanded, shape (actuator_count,).
        extra: Change of the further rows by the multipliers of the actuators, or None.
    """

    linear: Linearized
    errors: np.ndarray
    weights: np.ndarray
    held: Actuation
    bounds: Bounds
    commanded: np.ndarray
    extra: np.ndarray | None

    def left(self, efforts: np.ndarray, forces: np.ndarray, system: Linearized | None = None) -> np.ndarray:
        """How far effectors are from where they shall be [m], shape (effector_row_count,).

        Args:
            efforts: λ of the actuators, shape (actuator_count,).
            forces: λ of the contacts [N], shape (contact_row_count,).
            system: The system that these are of, if it is another one.
        """
        places = (system or self.linear).effector_places(efforts, forces)
        return self.errors[: len(places)] + places - self.linear.effectors


class InverseActuation:
    """Finds actuation and contact forces that bring effectors to their targets.

    When not all can be met, these are violated in this order: the target; the limit of contact
    force; the tautness of a commanded cable. Limits of the hardware are always kept.

    Attributes:
        least_progress: A step that shortens the way by this share is on its way.
        seeks_once: Whether the first linearization of a step in contact alone seeks the actuators.
        solver: Finds the optimum of each problem.
    """

    least_progress = 1.0
    seeks_once = False

    def __init__(self, model: Model, direct: DirectActuation):
        """Lay out the problem.

        Args:
            model: A scene with actuators and effectors.
            direct: Solves for λ at prescribed displacements.
        """
        self._direct, self._round_off, self._contacts = direct, direct.round_off, model.contacts
        self._target_rows = model.target_rows
        self._energy_weight = max(model.scene.solver.energy_weight, LEAST_ENERGY_WEIGHT)
        self._energy_now, self._longest = self._energy_weight, LONGEST_REACH * model.nodes.size
        self.force_limit = (model.scene.contact and model.scene.contact.force_limit) or np.inf
        actuators = model.actuators
        count, self._is_moved, self._has_slides = actuators.count, actuators.is_moved, actuators.is_moved.any()
        self._one_sided = actuators.one_sided
        self._at_limit = AT_LIMIT * actuators.displacement_scale
        self._may_hang = actuators.one_sided & ~actuators.is_effort_driven
        self._may_hang &= actuators.limits.effort_min <= 0.0
        self._scales = actuators.limits.drive_scale
        # Moves are no efforts, beside which another one would be none.
        self._effort_scales = np.where(self._is_moved, np.inf, actuators.effort_scale)
        alone = model.actuators.conserves and not (model.rows.varies or self._has_slides)
        self._limits, self._by_effort = actuators.limits, actuators.is_effort_driven
        self._proves = model.actuators.conserves and not model.rows.varies
        self._all_free = Unknowns(np.zeros(count, dtype=bool), False)
        self._none, self._nowhere = np.zeros(count), np.full(count, np.nan)
        self._proximal_weight = 0.0 if alone and not model.weighs_stiffness else LEAST_PROXIMAL_WEIGHT
        if not model.actuators.conserves:
            self._proximal_weight = LEAST_PROXIMAL_WEIGHT_WITH_FRICTION
        self._learns = not model.is_dynamic
        self._tolerance = model.reach_tolerance
        self._model = model
        self._search = ContactSearch(self._tolerance, is_exact=not alone)
        self.solver = self._search.solver
        self.reset()

    def reset(self) -> None:
        """Forget the last solution, and the contacts that bore it."""
        self._search.reset()
        if self._model.effectors.orientations:
            self._model.effectors.forget_targets()
        self.begin_step(True, True)

    def begin_step(
        self, is_balanced: bool, is_stable: bool, loads: np.ndarray = NO_LOADS, load: float = 0.0,
        guided: np.ndarray = NO_LOADS,
    ) -> None:  # fmt: skip
        """Let the next solution be the first of a step.

        Args:
            is_balanced: Whether the last step ended near balance.
            is_stable: Whether the body was stable at held displacements there.
            loads: Loads from outside, such as touches [N], shape (n,).
            load: Sum of all loads' sizes [N]; needed with these.
            guided: Where points of the guided bodies are [m], shape (m,).
        """
        self._begins, self._is_balanced, self._is_stable = True, is_balanced, is_stable
        self._loads, self._load, self._guided = loads, load, guided

    def steps_to_targets(self, linear: Linearized, target_rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements to the targets, shortened where they are too long, and their weights.

        Each effector's displacement is shortened by a share of its own. Its weight is divided by
        the share: the slope of the tracking term stays that of the whole distances. So several
        effectors out of reach rest where the weighted sum of their squared distances is least.

        Args:
            linear: The condensed system.
            target_rows: Wanted effector coordinates [m], NaN where free,
                shape (effector_row_count,).

        Returns:
            The displacement of each row [m] and the weight of its error, both zero where it is
            free, same shape.
        """
        steps, weights = np.empty((2, len(target_rows)))
        *rows, count = self._target_rows
        write_steps(
            target_rows, linear.effectors_now, *rows, self._longest, LONGEST_TURN, np.zeros((count, 2)),
            steps, weights,
        )  # fmt: skip
        return steps, weights

    def _places(self, linear: Linearized, found: Actuation, stiffness: StiffnessRows | None) -> np.ndarray:
        """Coordinates of effectors, then of stiffnesses, that an actuation promises [m]."""
        places = linear.effector_places(found.efforts, found.contact.multipliers)
        if stiffness is not None:
            places = np.concatenate([places, stiffness.places(found.efforts)])
        return places

    def _near(self, drives: np.ndarray, asked: Asked, share: float, scales: np.ndarray) -> Bounds:
        """Bounds in which no winch, slide or motor moves by more than a share of its scale."""
        bounds = asked.bounds
        if self._limits.are_all_effort_driven:
            return bounds
        least, most = np.empty((2, len(drives)))
        write_near(drives, share, scales, asked.commanded, self._by_effort, *bounds[:2], least, most)
        return Bounds(least, most, bounds.effort_min, bounds.effort_max)

    def _still(self, linear: Linearized, held: Actuation) -> np.ndarray:
        """Drives when the actuators stay; of a slack cable, the path."""
        path = linear.actuator_displacements(held.efforts, held.contact.multipliers)
        return np.where(self._by_effort, held.drives(self._limits), path)

    def _over_branches(self, tracking: Tracking, chosen: np.ndarray | None = None) -> Actuation | None:
        """The actuation, from the branch of slack cables that the held actuation is in.

        Each next branch contains the optimum of the branch before, hence the objective never rises.
        A cable becomes slack at most once, and taut again at most once. Cables that are `chosen`
        are slack in any case.
        """
        linear, held, upper = tracking.linear, tracking.held, tracking.bounds.displacement_max
        count, contact = linear.groups.actuators.stop, held.contact.multipliers
        path, may_hang = linear.actuator_displacements(held.efforts, contact), self._may_hang
        if tracking.commanded.any():
            may_hang = may_hang & ~tracking.commanded
        if chosen is not None:
            # With wanted stiffnesses, the others bear.
            may_hang = may_hang & ~chosen & (tracking.extra is None)
        branches = np.zeros((2, count), dtype=bool)
        slack, was_slack = branches
        loads = linear.efforts(held.efforts, contact) / self._effort_scales
        some_hang = hang_beyond(path, loads, upper, self._at_limit, may_hang, slack)
        loose = slack if some_hang else None
        if chosen is not None:
            loose = slack | chosen
        found, best = self._solved(tracking, held, path, loose), None
        while found is not None:
            best = found
            loads = linear.efforts(found.efforts, found.contact.multipliers)
            if not change_slack(
                found.displacements, loads / self._effort_scales, upper, self._at_limit, may_hang,
                slack, was_slack,
            ):  # fmt: skip
                break
            loose = slack if chosen is None else slack | chosen
            found = self._solved(tracking, best, path, loose)
        return best

    def guessed(
        self, linear: Linearized, errors: np.ndarray, weights: np.ndarray, held: Actuation,
        bounds: Bounds,
    ) -> Actuation | None:  # fmt: skip
        """The actuation from the last active set; None where `guessed_actuation` proves none.

        Args:
            linear: The condensed system.
            errors: e_e of the effectors' rows [m], shape (n_e,).
            weights: Of these rows, same shape.
            held: What holds the actuators where they are.
            bounds: Bounds of efforts and displacements.
        """
        active, count = self.solver.guess, len(self._none)
        stiffness, reference, *_ = linear.augmentation
        if not self._proves or active is None or len(active) < 2 * count:
            return None
        proved, efforts, within, active = guessed_actuation(
            linear.W, linear.groups.effectors.start, linear.violation, errors, weights,
            self._energy_now, self._proximal_weight,
            np.array(self._all_free.stack(*self._last(linear))), held.efforts, *bounds,
            self._is_moved, stiffness, reference, active, self._may_hang, self._at_limit,
            self._round_off, self._effort_scales, self._limits.displacement_scale,
        )  # fmt: skip
        if not proved:
            return None
        self.solver.active, self._search.touching = active, {}
        self._direct.remember(efforts)
        return Actuation(efforts, within, True, WARM_START, ContactLoads(NO_FORCES, sweeps=1))

    def _solved(
        self, tracking: Tracking, start: Actuation, path: np.ndarray, slack: np.ndarray | None
    ) -> Actuation | None:
        """The actuation in one branch of slack cables.

        Args:
            tracking: The problem.
            start: An actuation of this branch.
            path: Displacements of the paths when the actuators stay [m],
                shape (actuator_row_count,).
            slack: Cables that hang slack in this branch, same shape; None without any.

        Returns:
            The actuation; None where the branch has no solution.
        """
        linear, bounds = tracking.linear, tracking.bounds
        within = widened(path, bounds)
        if slack is not None:
            within = within._replace(
                displacement_max=np.where(slack, np.inf, within.displacement_max),
                effort_max=np.where(slack, 0.0, within.effort_max),
            )
        # What is two-sided is held by equal bounds, not by the law of a slack cable.
        own = (tracking.commanded & self._one_sided)[linear.groups.actuators]
        unknowns = Unknowns(own, bool(own.any()))
        problem = self._problem(tracking, within, unknowns)
        solution = self._solution(tracking, problem, start, unknowns)
        if not solution.solved:
            return None
        efforts, forces = unknowns.split(solution.unknowns, linear.contact_row_count)
        residual = _complementarity_residual(problem, solution.unknowns, forces)
        limits = self._limits_met(forces)
        contact = ContactLoads(forces, solution.programs, residual, limits=limits)
        return self._settled(linear, efforts, contact, bounds, solution.solver)

    def _problem(self, tracking: Tracking, within: Bounds, unknowns: Unknowns) -> QPCC:
        """The inverse problem around one state.

        Args:
            tracking: What it is made of.
            within: Bounds of the actuators in this branch of slack cables.
            unknowns: Order of the unknowns.
        """
        linear, bounds, extra = tracking.linear, tracking.bounds, tracking.extra
        commanded, force_max = unknowns.commanded, NO_FORCES
        if commanded.any():
            within = Bounds(*(bound[~commanded] for bound in within))
        if linear.contact_row_count or commanded.any():
            limits = np.full(linear.contact_row_count, self.force_limit)
            force_max = np.concatenate([bounds.effort_max[commanded], limits])
        system = inverse_system(
            linear, tracking.errors, commanded, bounds.displacement_max, self._is_moved
        )
        if extra is not None:
            system = with_effector_rows(system, extra, commanded)
        problem = build_inverse_problem(
            system, tracking.weights, self._energy_now, within, force_max,
            unknowns.stack(*self._last(linear)), self._proximal_weight,
            self._limits.displacement_scale[~commanded],
        )  # fmt: skip
        return self._with_effort_rows(linear, problem, system, ~commanded)

    def _weight_of_energy(self, linear: Linearized, asked: np.ndarray) -> float:
        """ε of a linearization, by the displacements asked of the effectors [m]."""
        if not linear.contact_row_count:
            return self._energy_weight
        share = max(LEAST_ENERGY_SHARE_IN_CONTACT, float(np.linalg.norm(asked)) / self._longest)
        return max(min(share, 1.0) * self._energy_weight, LEAST_ENERGY_WEIGHT)

    def _last(self, linear: Linearized) -> tuple[np.ndarray, np.ndarray]:
        """Efforts and contact forces of the last solution, where the proximal term is centred.

        What the targets leave open goes slowly from there towards the least energy.
        """
        return self._direct.last_solution(linear)

    @staticmethod
    def _with_effort_rows(
        linear: Linearized, problem: QPCC, system: InverseSystem, own: np.ndarray | slice
    ) -> QPCC:
        """The problem as it is where the tangent is augmented."""
        found = linear.augmentation
        if not found.acts:
            return problem
        return with_effort_rows(
            problem, found.stiffness[own], found.reference[own], system.actuators
        )

    def _solution(
        self, tracking: Tracking, problem: QPCC, start: Actuation, unknowns: Unknowns
    ) -> QPCCSolution:
        """Solve the problem; see `ContactSearch`."""
        linear = tracking.linear

        def missed(z: np.ndarray) -> float:
            efforts, forces = unknowns.split(z, linear.contact_row_count)
            if not (forces > 0.0).any():
                return np.nan
            left = tracking.left(efforts, forces)
            return float(np.linalg.norm(left[tracking.weights[: len(left)] > 0.0]))

        efforts, forces = start.efforts, start.contact.multipliers
        return self._search_of(linear).solve(
            problem, unknowns.stack(efforts, forces), efforts[unknowns.commanded], forces,
            self._contact_keys(linear), missed,
        )  # fmt: skip

    def _search_of(self, linear: Linearized) -> ContactSearch:
        """What solves the problems of a system."""
        return self._search

    def _contact_keys(self, linear: Linearized) -> list[tuple[int, int]]:
        """Pair and key of each contact, by which it is recognised in the next step."""
        return self._contacts.memory.known if linear.contact_row_count else []

    def _settled(
        self, linear: Linearized, efforts: np.ndarray, contact: ContactLoads, bounds: Bounds,
        solver: str,
    ) -> Actuation:  # fmt: skip
        """Set actuators to the paths found, within the hardware's bounds.

        Where the bounds change a displacement, efforts and contact forces are solved anew.
        """
        efforts, path, within, are_kept = self._paths(linear, efforts, contact, bounds)
        if not are_kept:
            # A cable without tension may hang slack: its path is shorter than its length.
            loads = linear.efforts(efforts, contact.multipliers) / self._effort_scales
            is_loose = loads <= NO_EFFORT * loads.max(initial=0.0)
            is_kept = np.abs(within - path) <= self._round_off
            is_kept |= self._by_effort | (self._one_sided & is_loose & (within < path))
            are_kept = is_kept.all()
        if not are_kept:
            drives = np.where(self._by_effort, efforts, within)
            actuation = self._direct.at_drives(linear, drives, bounds)
            limited = actuation.contact._replace(limits=contact.limits)
            return actuation._replace(qp_solver=solver, contact=limited)
        self._direct.remember(efforts)
        return Actuation(efforts, within, True, solver, contact)

    def _paths(
        self, linear: Linearized, efforts: np.ndarray, contact: ContactLoads, bounds: Bounds
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
        """Efforts and displacements found, these within their bounds, and whether all are."""
        if not linear.augmentation.acts:
            efforts = np.minimum(np.maximum(efforts, bounds.effort_min), bounds.effort_max)
        path = linear.actuator_displacements(efforts, contact.multipliers)
        within = np.empty(len(path))
        are_kept = keep_within(
            path, bounds.displacement_min, bounds.displacement_max, self._round_off, within
        )
        return efforts, path, within, are_kept

    def _with_limits(self, found: Actuation) -> Actuation:
        """An actuation with the names of the limits of contact force that it meets."""
        limits = self._limits_met(found.contact.multipliers)
        return found._replace(contact=found.contact._replace(limits=limits))

    def _limits_met(self, forces: np.ndarray) -> tuple[str, ...]:
        """Names of pairs that press as hard as they may, and of those that cannot but exceed it."""
        if not len(forces) or not (forces >= (1.0 - LIMIT_MARGIN) * self.force_limit).any():
            return ()
        found = []
        pair_of = self._contacts.pair[: len(forces)]
        for pair in np.unique(pair_of):
            hardest = forces[pair_of == pair].max() / self.force_limit
            if hardest >= 1.0 - LIMIT_MARGIN:
                exceeded = "_exceeded" if hardest > 1.0 + LIMIT_MARGIN else ""
                names = ".".join(self._contacts.pairs[pair].names)
                found.append(f"{names}.force_limit{exceeded}")
        return tuple(found)

    def is_held_by_energy(
        self, linear: Linearized, target_rows: np.ndarray, held: Actuation, bounds: Bounds,
        tolerance: float,
    ) -> bool:  # fmt: skip
        """Whether the weight of the energy keeps effectors from their targets.

        Errors with the scene's weight and with next to none are compared: those of one
        linearization, within the same bounds, and of targets that are not further away than it
        holds. Contacts that press when the actuators stay go on pressing.

        Args:
            linear: The condensed system.
            target_rows: Wanted effector coordinates [m], NaN where free,
                shape (effector_row_count,).
            held: What the actuators do when they stay.
            bounds: Bounds of this step.
            tolerance: Least difference of the largest errors of an effector that counts [m].

        Returns:
            False also where the weight is the least, or there is no answer.
        """
        # Where slides are is not what the energy decides.
        count = linear.groups.actuators.stop - linear.move_count
        if count == 0 or self._energy_weight <= LEAST_ENERGY_WEIGHT:
            return False
        W, free = with_contacts_closed(linear, held.contact.multipliers)
        now, efforts, e = linear.effectors_now, held.efforts[:count], linear.groups.effectors
        asked, weights = self.steps_to_targets(linear, target_rows)
        energy_weight = self._weight_of_energy(linear, asked)
        system = InverseSystem.without_contacts(
            W[e, :count], W[:count, :count], free[e] - now - asked, free[:count]
        )
        path = system.W_a @ efforts + system.actuators
        within = Bounds(
            np.minimum(bounds.displacement_min[:count], path),
            np.maximum(bounds.displacement_max[:count], path),
            bounds.effort_min[:count], bounds.effort_max[:count],
        )  # fmt: skip
        most = self._largest_error(linear, system, weights, energy_weight, within)
        if not most > tolerance:
            return False
        return most - self._largest_error(linear, system, weights, LEAST_ENERGY_WEIGHT, within) > tolerance

    def _largest_error(
        self, linear: Linearized, system: InverseSystem, weights: np.ndarray,
        energy_weight: float, bounds: Bounds,
    ) -> float:  # fmt: skip
        """Largest error of an effector at the optimum [m]; NaN where there is no answer."""
        problem = build_inverse_problem(
            system, weights, energy_weight, bounds,
            sizes=self._limits.displacement_scale[: len(system.actuators)],
        )
        own = slice(0, len(system.actuators))
        problem = self._with_effort_rows(linear, problem, system, own)
        try:
            solution = DAQPSolver().solve(whiten(problem))
        except np.linalg.LinAlgError:
            return np.nan
        if not solution.solved:
            return np.nan
        errors = system.W_e @ solution.unknowns + system.effectors
        missed = np.where(weights > 0.0, errors, 0.0)
        squares = np.bincount(self._target_rows.owners, weights=missed * missed)
        return float(np.sqrt(squares.max(initial=0.0)))


def rest_rows(model: Model) -> np.ndarray:
    """Effector coordinates in the rest shape [m], shape (effector_row_count,).

    Args:
        model: A scene with effectors.
    """
    terms = filter(None, (model.effectors, model.wanted_sensors))
    return np.concatenate([term.rows_at(model.nodes.rest_positions)[1] for term in terms])


def inverse_system(
    linear: Linearized, errors: np.ndarray, commanded: np.ndarray, prescribed: np.ndarray,
    is_move: np.ndarray,
) -> InverseSystem:  # fmt: skip
    """Blocks of the inverse problem; commanded actuators stand before the contacts.

    Args:
        linear: The condensed system.
        errors: δ_e,free less the targets [m], shape (effector_row_count,).
        commanded: Which actuators are commanded, shape (actuator_count,).
        prescribed: Prescribed displacements of these [m], shape (actuator_count,).
        is_move: Whether the unknown of each actuator is its move, shape (actuator_count,).
    """
    W, free, (_, e, c) = linear.W, linear.violation, linear.groups
    own, taut = np.flatnonzero(~commanded), np.flatnonzero(commanded)
    one_sided = np.concatenate([taut, np.arange(c.start, c.stop)])
    gaps = free[one_sided]
    gaps[: len(taut)] -= prescribed[taut]
    unknowns = np.concatenate([own, one_sided])
    of_unknowns = W[:, unknowns]
    stored = None if linear.stored is None else linear.stored[np.ix_(unknowns, unknowns)]
    return InverseSystem(
        of_unknowns[e], of_unknowns[own], of_unknowns[one_sided], is_move[own], errors, free[own],
        gaps, stored,
    )  # fmt: skip


def with_effector_rows(system: InverseSystem, extra: np.ndarray, commanded: np.ndarray) -> InverseSystem:
    """Add rows below those of the effectors.

    Args:
        system: See `inverse_system`; its effectors contain the errors of these rows already.
        extra: Change of the rows by the multipliers of the actuators, and perhaps by those of the
            contacts, shape (n, actuator_count or more).
        commanded: Which actuators are commanded, shape (actuator_count,).
    """
    more, count = np.zeros((len(extra), system.W_e.shape[1])), len(commanded)
    own, more[:, count : extra.shape[1]] = extra[:, :count], extra[:, count:]
    more[:, :count] = np.concatenate([own[:, ~commanded], own[:, commanded]], axis=1)
    return system._replace(W_e=np.concatenate([system.W_e, more]))


def rows_to_track(
    linear: Linearized, asked: np.ndarray, weights: np.ndarray, stiffness: StiffnessRows | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Errors of effectors, then of stiffnesses [m], their weights, and motion of the latter.

    Args:
        linear: The condensed system.
        asked: Displacements asked of the effectors [m].
        weights: Their weights.
        stiffness: Rows of wanted stiffnesses, or None.
    """
    errors = linear.effectors - linear.effectors_now - asked
    if stiffness is None:
        return errors, weights, None
    return (
        np.concatenate([errors, stiffness.free - stiffness.now - stiffness.asked]),
        np.concatenate([weights, stiffness.weights]), stiffness.motion,
    )  # fmt: skip


def with_stiffness(situation: Situation, stiffness: StiffnessRows | None, efforts: np.ndarray) -> Situation:
    """A situation with the rows of wanted stiffnesses below those of the effectors."""
    if stiffness is None:
        return situation
    places = np.concatenate([situation.places, stiffness.places(efforts)])
    return situation._replace(
        targets=np.concatenate([situation.targets, stiffness.wanted]),
        weights=np.concatenate([situation.weights, stiffness.weights]), places=places,
    )  # fmt: skip


def with_contacts_closed(linear: Linearized, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """W and δ_free of actuators and effectors, where contacts that press stay closed.

    Args:
        linear: The condensed system.
        forces: λ of all contact rows [N], shape (contact_row_count,).

    Returns:
        W [m/N], shape (n, n), and δ_free [m], shape (n,), of the n rows of actuators and effectors.
    """
    kept = linear.groups.effectors.stop
    W, free = linear.W[:kept, :kept], linear.violation[:kept]
    pressing = linear.groups.contacts.start + np.flatnonzero(forces > 0.0)
    if not len(pressing):
        return W, free
    # By least squares: several contacts may be closed by one force.
    across = linear.W[pressing, :kept]
    shares = np.linalg.lstsq(
        linear.W[np.ix_(pressing, pressing)],
        np.column_stack([across, linear.violation[pressing]]), rcond=None,
    )[0]  # fmt: skip
    moved = linear.W[:kept, pressing]
    return W - moved @ shares[:, :-1], free - moved @ shares[:, -1]


def _complementarity_residual(problem: QPCC, z: np.ndarray, forces: np.ndarray) -> float:
    """How exactly gaps and contact forces exclude each other [m]; those of bodies come last."""
    if not len(forces):
        return 0.0
    own = problem.C[:, len(z) - problem.contact_count :].diagonal()
    open_or_pressing = np.minimum(problem.gaps(z), own * problem.forces(z))
    return float(np.abs(open_or_pressing[-len(forces) :]).max())
