"""Targets in scenes with friction: one Gauss-Newton step around a solution with friction.

Where contacts stick or slip, forces along them follow from the other multipliers z, the efforts and
the normal forces: λ = T z + t. So the problem is that without friction in other columns,

    sticks      λ_t such that δ_t = 0
    slips       λ_t = µ λ_n d, with d the direction of its force;
                across d it yields by |v| / (µ λ_n), as the direction of the slip v turns
    is open     λ_t = 0

which is the derivative of the solution with friction (implicit differentiation of Coulomb's law).
What the optimum asks of the actuators is then done with friction, in the same linearization. A step
seeks them once: its other linearizations bring the bodies to balance under them.

Where targets leave nothing open, contacts that press first stay closed and the others open: what is left
is a problem in efforts alone, and friction tells whether contacts do so. Where it comes near, or as near
as it promised at the actuators' rates, it is made. Else a search finds which contacts press. Where they
switch between sticking and slipping on the way, effectors do not go where the optimum promised. Then it
is sought again by what the contacts do there, and the nearest of all is made.

Where these come hardly nearer, a kink is in the way, and contacts do something else beyond it. Towards
targets that stay, single actuators are moved to either side, one in each step, and the optimum is sought
by what contacts do there. Where an effector comes to depends on the way, too: steps look whether it is
nearer to go somewhere else first, and back from where contacts slipped to.

Least forces and grip margins of pairs are rows of the problem where an optimum would fall below
them. Where a margin is below its least one already, actuators only move to raise it.

Each step goes a part of the way to targets that stay. Effectors that went too far come back another
way, since friction turns. `Follower` has the radius and the way back. What promises nothing is tried as
well while contacts press, since it tells what they do beyond a kink.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, Self

import numpy as np

from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import NO_EFFORT, Actuation, ContactLoads
from softrobot_twin.simulation.step.apparent_stiffness import StiffnessRows
from softrobot_twin.simulation.step.contact_search import ContactSearch
from softrobot_twin.simulation.step.detours import NEARER, Detours, Turn
from softrobot_twin.simulation.step.direct_actuation import DirectActuation
from softrobot_twin.simulation.step.follower import GREATEST, NO_PROMISE, SHRINK, Follower
from softrobot_twin.simulation.step.inverse_actuation import Asked, Tracking
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.simulation.step.situation import Situation, longest_move
from softrobot_twin.solvers.inverse_problem import Bounds

# Share of its own compliance that a sticking row yields by, where several rows hold the same.
YIELDS = 1.0e-9
# Times that an optimum is sought by what contacts do.
MOST_ROUNDS = 3
# Where an optimum keeps this share of what it promised, it is not sought again.
KEPT_PROMISE = 0.8
# Of the way to the targets each step goes this share where contacts press whose friction is the second
# number or more; with less friction it goes further. With less than the third, friction makes no kinks
# that would be worth a look.
SHARE, MUCH_FRICTION, LITTLE_FRICTION = 0.6, 0.2, 1.0e-3
# In scenes that move in time what is left of the way falls by e in so long [s], however short steps are:
# actuators at their rates could not brake what went faster.
SETTLES = 0.1
# Where squares of misses fall by less than this share, actuators are tried one by one, by moves that
# would go so many times the way; as detours, by longer ones.
PROGRESS, LENGTHS, FAR = 0.1, (0.25, 1.0, 4.0), (4.0, 16.0, 64.0)
# No such move is longer than this multiple of the longest move of a linearization.
LONGEST = 2.0
# Where contacts go on as they do, friction makes what is promised to this share of the way's square.
SO_NEAR = 0.01
# Actuators that came to targets within this share of the tolerance stay, until effectors leave the
# tolerance: where contacts creep by what their solution leaves, a new optimum in each step would
# never rest.
LEFT = 0.05
# Weight of forces beyond their limit, against that of effectors.
FORCES_FIRST = 1.0e2
# What a pair lacks of its least force counts so many times that distance; a share of it that is none.
LEAST_FIRST, LACKS = 10.0, 1.0e-2
# Actuators of a pair below its least margin move where the margin rises by so much; else they stay.
RISES = 1.0e-3
# A share of the tolerance of targets that does not matter.
NO_MATTER = 1.0e-3


@njit(**KERNEL)
def tie(
    first, row_starts, friction, forces, presses, slips, slid, own, least, closes, ties, held, bearing,
    yields,
):  # fmt: skip
    """T of contacts, and the directions in which they hold.

    Args:
        first: First row of the contacts.
        row_starts: First row of each contact and the number of rows, shape (contact_count + 1,).
        friction: µ of each, shape (contact_count,).
        forces: λ of each row of a solution [N], shape (contact_row_count,).
        presses: Whether each contact presses in it, shape (contact_count,).
        slips: Whether it slips, same shape.
        slid: δ of each row [m], shape (contact_row_count,).
        own: Displacement of each row by its own force [m/N], same shape.
        least: Friction that displaces its contact by no more is none [m].
        closes: Whether those that press hold along their normals too, and others stay open.
        ties: Takes T but for what holds, identity before the contacts, zeros before, shape
            (first + contact_row_count, first + contact_count); without columns of contacts where
            these hold.
        held: Takes the directions that hold, zeros before, shape (3 pressing_count, first +
            contact_row_count).
        bearing: Takes the forces by which they hold, zeros before, same shape.
        yields: Takes by what each yields [m/N], shape (3 pressing_count,).

    Returns:
        Number of these directions.
    """
    for i in range(first):
        ties[i, i] = 1.0
    count = 0
    for c in range(len(friction)):
        own_row, normal = row_starts[c], count
        r = first + own_row
        if not closes:
            ties[r, first + c] = 1.0
        elif presses[c]:
            held[count, r] = bearing[count, r] = 1.0
            count += 1
        limit = friction[c] * forces[own_row]
        if row_starts[c + 1] - own_row < 3 or not presses[c]:
            continue
        if limit * max(own[own_row + 1], own[own_row + 2]) <= least:
            continue
        if slips[c]:
            size = np.hypot(forces[own_row + 1], forces[own_row + 2])
            along, across = forces[own_row + 1] / size, forces[own_row + 2] / size
            held[count, r + 1], held[count, r + 2] = -across, along
            bearing[count, r + 1], bearing[count, r + 2] = -across, along
            yields[count] = np.hypot(slid[own_row + 1], slid[own_row + 2]) / limit
            count += 1
            if closes:
                bearing[normal, r + 1] = friction[c] * along
                bearing[normal, r + 2] = friction[c] * across
            else:
                ties[r + 1, first + c] = friction[c] * along
                ties[r + 2, first + c] = friction[c] * across
        else:
            for k in range(2):
                held[count, r + 1 + k] = bearing[count, r + 1 + k] = 1.0
                count += 1
    return count


@njit(**KERNEL)
def grip(is_of, is_margin, shall, friction, at_start, pair, row_starts, forces, rows, least, whole, left):
    """Forces of pairs in a solution, see `Grips.sums`.

    Args:
        is_of: See `Grips`.
        is_margin: See `Grips`.
        shall: Least forces and margins, see `Grips`.
        friction: µ of each pair, shape (pair_count,).
        at_start: Σ λ_n and Σ |λ_t| of each pair where the step began [N], shape (2, pair_count).
        pair: Pair of each contact, shape (contact_count or more,).
        row_starts: First row of each contact and the number of rows, shape (contact_count + 1,).
        forces: λ of each row [N], shape (contact_row_count,).
        rows: Takes derivatives by λ, zeros before, shape (count, contact_row_count).
        least: Takes what these come to at least [N], shape (count,).
        whole: Takes what that is a share of [N], same shape.
        left: Takes the share of its friction that each has left, zero without forces, same shape.
    """
    for g in range(len(shall)):
        before, most_before, along_before, pressed, most, along = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for p in range(len(friction)):
            if is_of[g, p]:
                before += at_start[0, p]
                most_before += friction[p] * at_start[0, p]
                along_before += at_start[1, p]
        for c in range(len(row_starts) - 1):
            r, p = row_starts[c], pair[c]
            if is_of[g, p]:
                pressed += forces[r]
                most += friction[p] * forces[r]
                # A contact without friction has one row.
                if row_starts[c + 1] - r == 3:
                    along += np.hypot(forces[r + 1], forces[r + 2])
        left[g] = 1.0 - along / most if most > 0.0 else 0.0
        whole[g], least[g], by_normal, by = shall[g], shall[g], 1.0, 0.0
        if is_margin[g]:
            left_before = 1.0 - along_before / most_before if most_before > 0.0 else 0.0
            whole[g], least[g] = before, before * (min(shall[g], left_before) - left[g])
            by = before / max(pressed, LACKS * before) if before > 0.0 else 0.0
            by_normal = by * (1.0 - left[g])
        for c in range(len(row_starts) - 1):
            r, p = row_starts[c], pair[c]
            if is_of[g, p]:
                rows[g, r] = by_normal
                if row_starts[c + 1] - r < 3:
                    continue
                size = np.hypot(forces[r + 1], forces[r + 2]) * friction[p]
                if size > 0.0:
                    rows[g, r + 1], rows[g, r + 2] = -by * forces[r + 1] / size, -by * forces[r + 2] / size


def slid_by(linear: Linearized, found: Actuation) -> tuple[np.ndarray, np.ndarray]:
    """λ of all condensed rows in a solution [N], and δ of those of contacts there [m].

    Args:
        linear: The system condensed onto all rows.
        found: The solution.
    """
    (a, _, c), multipliers = linear.groups, np.zeros(len(linear.violation))
    multipliers[a], multipliers[c] = found.efforts[a], found.contact.multipliers
    return multipliers, linear.compliance.motion(c, multipliers) + linear.violation[c]


def tied_by_contacts(
    linear: Linearized, contacts: Contacts, found: Actuation, least: float = 0.0,
    closes: bool = False,
) -> Linearized:  # fmt: skip
    """The system in efforts and normal forces, by what contacts do in a solution.

    Args:
        linear: The condensed system.
        contacts: The contact term.
        found: The solution.
        least: Friction that displaces its contact by no more is none [m].
        closes: Whether the contacts that press stay closed and the others open: then the system is
            one in efforts alone.
    """
    c, n, count = linear.groups.contacts, len(linear.violation), contacts.count
    forces, (multipliers, slid) = found.contact.multipliers, slid_by(linear, found)
    ties = np.zeros((n, c.start + (0 if closes else count)))
    own, (presses, slips) = linear.W.diagonal()[c].copy(), contacts.touch(forces)
    most = 3 * np.count_nonzero(presses)
    held, bearing, yields = *np.zeros((2, most, n)), np.zeros(most)
    holding = tie(
        c.start, contacts.row_starts, contacts.friction, forces, presses, slips, slid, own, least,
        closes, ties, held, bearing, yields,
    )  # fmt: skip
    offset, held, bearing = np.zeros(n), held[:holding], bearing[:holding]
    if holding:
        moved = held @ linear.W
        yielding = moved @ bearing.T
        yielding[np.diag_indices(holding)] += yields[:holding] + YIELDS * yielding.diagonal()
        given = np.column_stack([moved @ ties, held @ linear.violation])
        forces_by = -bearing.T @ np.linalg.solve(yielding, given)
        ties, offset = ties + forces_by[:, :-1], forces_by[:, -1]
    if closes:
        return linear.tied(np.arange(c.start), ties, offset)
    rows = np.concatenate([np.arange(c.start), c.start + contacts.row_starts[:-1]])
    tied = linear.tied(rows, ties, offset)
    # Gaps are solved to a tolerance. Here the solution is exact, else no optimum may start from it.
    gaps = tied.compliance.motion(tied.groups.contacts, multipliers[rows])
    gaps += tied.violation[c.start :]
    tied.violation[c.start :] -= np.where(presses, gaps, np.minimum(gaps, 0.0))
    return tied


class Grips(NamedTuple):
    """Least normal forces and least grip margins of pairs, each of a pair as a whole.

    A margin counts by the normal forces N at which the pair pressed when the step began, so that
    nothing is gained by letting go; one that was less then shall not fall further:

        least force     Σ λ_n >= least
        least margin    N (1 - Σ |λ_t| / Σ µ λ_n) >= N least

    Attributes:
        names: Names of the limits, see `StepReport`.
        is_of: Which of them each pair of the contact term has, shape (count, pair_count).
        least: Least forces [N], then least margins, shape (count,).
        is_margin: Which are margins, same shape.
    """

    names: tuple[str, ...]
    is_of: np.ndarray
    least: np.ndarray
    is_margin: np.ndarray

    @classmethod
    def of(cls, model: Model) -> Self:
        """Those of a scene, which may name none.

        Args:
            model: A scene with friction.
        """
        keys, between = ("least_force", "least_grip_margin"), model.scene.contact.between
        found = [(one.pair, key, getattr(one, key)) for key in keys for one in between
                 if getattr(one, key)]  # fmt: skip
        names = tuple(".".join((*pair, key.replace("least_grip", "grip"))) for pair, key, _ in found)
        is_of = model.contacts.pairs_named([pair for pair, _, _ in found])
        return cls(names, is_of, np.array([least for *_, least in found]),
                   np.array([key == keys[1] for _, key, _ in found]))  # fmt: skip

    def sums(self, contacts: Contacts, forces: np.ndarray) -> tuple[np.ndarray, ...]:
        """The forces of pairs in a solution, linearized around it.

        Args:
            contacts: The contact term.
            forces: λ of the solution [N], shape (contact_row_count,).

        Returns:
            Derivatives by λ, shape (count, contact_row_count); what they shall be at least [N], what
            that is a share of, and what share of its friction each pair has left, shape (count,).
        """
        count = len(self.least)
        rows, (least, whole, left) = np.zeros((count, len(forces))), np.zeros((3, count))
        grip(
            self.is_of, self.is_margin, self.least, contacts.friction_of_pair, contacts.sums_at_start,
            contacts.pair, contacts.row_starts, forces, rows, least, whole, left,
        )  # fmt: skip
        return rows, least, whole, left

    def slips_on(self, contacts: Contacts, held: np.ndarray, found: np.ndarray) -> bool:
        """Whether a pair has less than its least margin, and would not win some of it back.

        Args:
            contacts: The contact term.
            held: λ when the actuators stay [N], shape (contact_row_count,).
            found: λ of what they would do, same shape.
        """
        now = 1.0 - np.nan_to_num(contacts.friction_used(self.is_of, contacts.sums_at_start), nan=1.0)
        stay, go = (self.sums(contacts, forces)[-1] for forces in (held, found))
        is_low = self.is_margin & (now < self.least - LACKS)
        return bool((is_low & (go < np.minimum(stay + RISES, self.least))).any())

    def rows(
        self, linear: Linearized, contacts: Contacts, forces: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `sums`; forces as distances, by which they would press in the mean contact of a pair.

        Args:
            linear: The condensed system.
            contacts: The contact term.
            forces: λ of the solution [N], shape (contact_row_count,).

        Returns:
            Distances by λ [m/N], shape (count, contact_row_count), and the least ones [m], shape
            (count,).
        """
        members = self.is_of[:, contacts.pair[: contacts.count]]
        normals = linear.groups.contacts.start + contacts.row_starts[:-1]
        yields = LEAST_FIRST * (members @ linear.W[normals, normals])
        yields /= np.maximum(members.sum(axis=1), 1)
        rows, least, *_ = self.sums(contacts, forces)
        return yields[:, None] * rows, yields * least

    def tied_rows(
        self, linear: Linearized, tied: Linearized, contacts: Contacts, forces: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `rows`; by the multipliers of a system by what contacts do.

        Args:
            linear: The condensed system.
            tied: That system by what contacts do.
            contacts: The contact term.
            forces: λ of the solution [N], shape (contact_row_count,).

        Returns:
            Distances by its multipliers [m/N], shape (count, n), and the least ones [m], shape (count,).
        """
        (a, _, c), (ties, offset) = tied.groups, tied.ties
        by_force, least = self.rows(linear, contacts, forces)
        rows = np.delete(by_force @ ties[c.start :], np.arange(a.stop, c.start), axis=1)
        return rows, least - by_force @ offset[c.start :]

    def met(self, contacts: Contacts, forces: np.ndarray) -> tuple[str, ...]:
        """Names of pairs that press no harder than they have to, and of those that cannot.

        Args:
            contacts: The contact term.
            forces: λ of all rows [N], shape (contact_row_count,).
        """
        rows, least, whole, _ = self.sums(contacts, forces)
        more = rows @ forces - least
        is_missed = (more < -LACKS * whole) & ~self.is_margin
        return tuple(f"{name}_missed" if few else name
                     for name, few, near in zip(self.names, is_missed, more < LACKS * whole) if near)


class Task(NamedTuple):
    """What a step is to find.

    Attributes:
        tracking: Where effectors shall be, and by what.
        beyond: How far forces beyond their limit press contacts in [m]; None without a limit.
        before: What is missed when the actuators stay [m²].
        negligible: Squares of misses that make no difference [m²].
    """

    tracking: Tracking
    beyond: Callable[[Linearized, Actuation], np.ndarray] | None
    negligible: float
    before: float = np.nan

    @property
    def leaves_open(self) -> bool:
        """Whether there are more actuators than targets determine, which the energy decides."""
        tracking = self.tracking
        return np.count_nonzero(~tracking.commanded) > np.count_nonzero(tracking.weights)

    def missed(self, found: Actuation, system: Linearized | None = None) -> float:
        """Weighted sum of the squares of misses, and of forces beyond their limit [m²].

        Such a force counts by how far it presses its contact in, more than a distance of an effector.

        Args:
            found: The solution.
            system: The system that it is of, if it is another one.
        """
        left = self.tracking.left(found.efforts, found.contact.multipliers, system)
        return float(self.tracking.weights[: len(left)] @ (left * left)) + self.pressed_too_hard(found)

    def pressed_too_hard(self, found: Actuation) -> float:
        """What forces beyond their limit count in `missed` [m²].

        Args:
            found: The solution.
        """
        if not self.beyond:
            return 0.0
        beyond = self.beyond(self.tracking.linear, found)
        return FORCES_FIRST * self.tracking.weights.max(initial=0.0) * float(beyond @ beyond)


class Made(NamedTuple):
    """An optimum by what contacts do in a solution, as friction makes it.

    Attributes:
        actuation: What comes of its drives.
        missed: What that misses [m²].
        promise: What the optimum misses [m²].
    """

    actuation: Actuation
    missed: float
    promise: float

    def nearer_than(self, other: Self | None) -> Self:
        """This, or another one that misses no more.

        Args:
            other: The other one; None without any.
        """
        return self if other is None or self.missed < other.missed else other

    def keeps_promise(self, task: Task) -> bool:
        """Whether what was missed falls by most of what the optimum promised.

        Args:
            task: What the step is to find.
        """
        promised = KEPT_PROMISE * (task.before - self.promise)
        return task.before - self.missed >= promised - task.negligible


class InverseWithFriction(Follower):
    """Finds actuation and contact forces that bring effectors to their targets, with friction."""

    def __init__(self, model: Model, direct: DirectActuation):
        """Lay out the problem.

        Args:
            model: A scene with actuators, effectors and friction.
            direct: See `InverseActuation`.
        """
        self._grips = Grips.of(model)
        super().__init__(model, direct)
        # Squares of misses that make no difference, of weight one.
        self._negligible = NO_MATTER * self._tolerance
        most = float(model.contacts.friction_of_pair.max())
        self._brakes = model.is_dynamic
        self._judges_forces = self.force_limit < np.inf or bool(self._grips.names)
        self._friction = min(1.0, most / MUCH_FRICTION)
        self._left_out = (1.0 - SHARE) * self._friction
        self._rubs = most > LITTLE_FRICTION
        self.seeks_once = self._rubs and not model.is_dynamic
        # Compiled now, not when the first contact presses.
        none, no, matrix = np.zeros(0), np.zeros(0, bool), np.zeros((0, 0))
        tie(
            0, np.zeros(1, np.int64), none, none, no, no, none, none, 0.0, False, matrix, matrix,
            matrix, none,
        )  # fmt: skip
        if self._grips.names:
            self._grips.sums(model.contacts, none)

    def reset(self) -> None:
        """See `InverseActuation`."""
        super().reset()
        # In motion, a linearization sees no further than its step.
        self._detours = Detours(self._learns)
        # Where contacts go on as they do, there is none among the unknowns.
        self._search_as_is = ContactSearch(self._tolerance)
        self._search_as_is.touching = {}
        # Before the first targets, nothing is known of how they move.
        self._targets, self._moved = np.nan, np.zeros(1)
        self._has_come, self._tried_length = False, GREATEST
        # Least forces and margins that lacked in the last optimum.
        self._lacked = np.zeros(len(self._grips.names), bool)

    def solve(
        self, linear: Linearized, target_rows: np.ndarray, held: Actuation, bounds: Bounds,
        stiffness: StiffnessRows | None = None,
    ) -> tuple[Actuation, Actuation]:  # fmt: skip
        """See `InverseActuation`; notes how targets move."""
        if self._begins:
            self._note_motion(target_rows)
        return super().solve(linear, target_rows, held, bounds, stiffness)

    def begin_step(self, is_balanced: bool, is_stable: bool, *around) -> None:
        """See `InverseActuation`; what is in balance while contacts rub is held by them."""
        super().begin_step(is_balanced, is_stable or is_balanced, *around)

    def _search_of(self, linear: Linearized) -> ContactSearch:
        """See `InverseActuation`."""
        is_as_is = linear.ties and not linear.contact_row_count
        return self._search_as_is if is_as_is else self._search

    def told(self, done: Actuation, sought: Actuation) -> Actuation:
        """What actuators and contacts do by drives that were sought, with all that is told of it.

        Args:
            done: What they do.
            sought: What was sought.
        """
        done = self._with_limits(done)
        return done._replace(qp_solver=sought.qp_solver, is_refused=sought.is_refused)

    def _note_motion(self, target_rows: np.ndarray) -> None:
        """Note how targets move from step to step; other ones are sought anew."""
        moved = np.zeros(len(target_rows))
        # Coordinates of orientations change while their targets stay.
        moved[self._positions] = np.nan_to_num(target_rows - self._targets)[self._positions]
        if moved.any():
            self._detours.forget()
            self._has_come = False
        before = np.abs(self._moved)
        self._motion = np.clip(moved, -before, before)
        self._targets, self._moved = target_rows.copy(), moved

    def _over_branches(self, tracking: Tracking, chosen: np.ndarray | None = None) -> Actuation | None:
        """The actuation with friction that comes nearest; where none does, that which holds."""
        linear, held = tracking.linear, tracking.held
        if not linear.contact_row_count:
            return super()._over_branches(tracking, chosen)
        self._last_solution = self._direct.last_solution(linear)
        left_out = self._left_out
        if self._brakes:
            left_out = max(left_out, self._friction * np.exp(-self._contacts.time_step / SETTLES))
            self.least_progress = 0.5 * (1.0 - left_out)
        tracking = self._short_of_targets(tracking, left_out)
        beyond, greatest = self._beyond if self._judges_forces else None, tracking.weights.max(initial=0.0)
        task = Task(tracking, beyond, self._negligible**2 * greatest)
        before, reached = task.missed(held), self._tolerance**2 * greatest
        is_reached = self._learns and self._rubs and self._now <= self._reached
        self._has_come = is_reached and (self._has_come or before <= LEFT**2 * reached)
        if self._has_come:
            return held
        best = self._tried(task._replace(before=before))
        if best is None and held.solved:
            # What contacts do now may admit no solution; the actuators stay, and the bodies move on.
            best = held
        if best is None or not self._rubs:
            return best
        is_stalled = task.missed(best) > (1.0 - PROGRESS) * before
        self._detours.is_stalled = is_stalled and not is_reached
        slips = self._grips.names and self._grips.slips_on(
            self._contacts, held.contact.multipliers, best.contact.multipliers
        )
        if task.missed(best) > before + task.negligible or slips:
            if not self._moved.any():
                self.refuse(False)
            best = held
        self._direct.remember(best.efforts)
        return best

    def _short_of_targets(self, tracking: Tracking, share: float) -> Tracking:
        """Aims short of the targets, where contacts press: what goes too far does not come back.

        In scenes that move in time the way counts from where effectors are, not from where they go
        when the actuators stay: by inertia they would go on, and swing about the targets.

        Args:
            tracking: The problem.
            share: Share of the way that is left out, but for the motion of the targets.
        """
        held, linear = tracking.held, tracking.linear
        if not (held.contact.multipliers > 0.0).any():
            return tracking
        errors = tracking.errors.copy()
        left = tracking.left(held.efforts, held.contact.multipliers)
        if self._brakes:
            left = errors[: len(left)] + linear.effectors_now - linear.effectors
        errors[: len(left)] -= share * (left + self._motion)
        return tracking._replace(errors=errors)

    def _optimum(
        self, task: Task, tied: Linearized, errors: np.ndarray, at: Actuation, bounds: Bounds
    ) -> Actuation | None:
        """The optimum by what contacts do in a solution; least forces and margins that lack are rows of it.

        Args:
            task: What the step is to find.
            tied: The system by what contacts do.
            errors: See `Aim`, in that system.
            at: The solution.
            bounds: Bounds of the optimum.
        """
        tracking = task.tracking._replace(
            linear=tied, errors=errors, held=self._on_normals(at, tied), bounds=bounds
        )
        if not self._grips.names:
            return super()._over_branches(tracking)
        weights, extra, linear = tracking.weights, tracking.extra, task.tracking.linear
        grip, least = self._grips.tied_rows(linear, tied, self._contacts, at.contact.multipliers)
        weight = FORCES_FIRST * weights.max(initial=0.0)
        extra = np.zeros((0, tied.groups.actuators.stop)) if extra is None else extra
        extra = np.pad(extra, ((0, 0), (0, grip.shape[1] - extra.shape[1])))

        def lacking(found: Actuation) -> np.ndarray:
            return grip @ np.append(found.efforts, found.contact.multipliers) < least

        def with_least(wanted: np.ndarray) -> Actuation | None:
            return super(InverseWithFriction, self)._over_branches(tracking._replace(
                errors=np.append(errors, -least[wanted]), extra=np.concatenate([extra, grip[wanted]]),
                weights=np.append(weights, np.full(wanted.sum(), weight)),
            ))  # fmt: skip

        # What lacked before lacks again in most steps. Where it does although it was asked for,
        # it would without; what lacks no more was held down.
        wanted = self._lacked
        found = with_least(wanted)
        if wanted.any() and (found is None or not lacking(found)[wanted].all()):
            wanted = np.zeros(len(least), bool)
            found = with_least(wanted)
        while found is not None:
            low = ~wanted & lacking(found)
            if not low.any():
                break
            wanted = wanted | low
            closer = with_least(wanted)
            if closer is None:
                # What lacks a least force counts so much that the actuators stay instead.
                break
            found = closer
        self._lacked = wanted
        return found

    def _tried(self, task: Task) -> Actuation | None:
        """What this step tries; None where the problem has no solution."""
        linear, held, bounds = task.tracking.linear, task.tracking.held, task.tracking.bounds
        turn = Turn.STRAIGHT if self._moved.any() else self._detours.next()
        if turn is Turn.PROBE:
            probe = self._displaced(task, bounds, self._detours.probe, LENGTHS)
            if probe is not None:
                found = self._nearest(task, probe, linear, bounds, 1)
                return min(probe, found or probe, key=task.missed)
        if turn is Turn.DETOUR:
            self._look_for_detour(task)
            return held
        goes_on = self._rubs and not task.leaves_open
        if goes_on and task.before <= task.negligible:
            return held
        given, as_is = (task, held, linear, bounds), None
        if goes_on:
            as_is, is_good = self._as_contacts_are(*given)
            if is_good:
                return as_is
        found = self._nearest(*given, MOST_ROUNDS)
        if as_is is not None:
            # Actuators do not wind up against contacts that stick for what makes no difference.
            other = task.before if found is None else min(task.before, task.missed(found))
            found = as_is if task.missed(as_is) < other - task.negligible else found
        return found

    def _as_contacts_are(
        self, task: Task, at: Actuation, system: Linearized, bounds: Bounds
    ) -> tuple[Actuation | None, bool]:
        """The nearest that is made where contacts that press in a solution go on pressing.

        It takes a fraction of the time of a search over which contacts press.

        Returns:
            It; and whether that search would hardly find anything nearer.
        """
        best, is_good = None, False
        for _ in range(MOST_ROUNDS):
            made = self._made(task, at, system, bounds, closes=True)
            if made is None:
                break
            at, best = made.actuation, made.nearer_than(best)
            is_good |= self._is_good(task, made, bounds)
            if made.missed - made.promise <= SO_NEAR * task.before + task.negligible:
                break
        return best and best.actuation, is_good

    def _is_good(self, task: Task, made: Made, bounds: Bounds) -> bool:
        """Whether it comes near, or as near as promised by moves as long as they may be."""
        if made.missed <= NEARER * task.before + task.negligible:
            return True
        drives, slack = made.actuation.drives(self._limits), self._at_limit
        least, most = self._limits.drive_bounds(bounds)
        is_bounded = ((drives <= least + slack) | (drives >= most - slack)).any()
        is_nearer = made.missed <= (1.0 - PROGRESS) * task.before
        return is_bounded and is_nearer and made.keeps_promise(task)

    def _look_for_detour(self, task: Task) -> None:
        """Look whether it is nearer to go somewhere else first; the actuators go if it is."""
        wide = self._limits.bounds(task.tracking.held.drives(self._limits), np.inf)
        far, left = self._displaced(task, wide, self._detours.detour, FAR), np.inf
        if far is None:
            return
        if not task.pressed_too_hard(far):
            later = self._from(task.tracking.linear, far)
            backs = [self._nearest(task, far, later, wide, MOST_ROUNDS)]
            if not task.leaves_open:
                backs.append(self._as_contacts_are(task, far, later, wide)[0])
            left = min((task.missed(back) for back in backs if back), default=np.inf)
        goal = self._detours.judge(far.drives(self._limits), left, task.before)
        if goal is not None:
            # What refused moves here says nothing of there.
            self._goal, self._waits, self._passed.since, self.move_limit = goal, 0, 0, GREATEST

    def _nearest(
        self, task: Task, at: Actuation, system: Linearized, bounds: Bounds, rounds: int
    ) -> Actuation | None:
        """The nearest of what is best by what contacts do in a solution, and in what came of it."""
        best = None
        for _ in range(rounds):
            made = self._made(task, at, system, bounds)
            if made is None:
                break
            at, best = made.actuation, made.nearer_than(best)
            if made.keeps_promise(task):
                break
        return best and best.actuation

    def _made(
        self, task: Task, at: Actuation, system: Linearized, bounds: Bounds, closes: bool = False
    ) -> Made | None:
        """What is best by what contacts do in a solution, made with friction; None without any."""
        tied = tied_by_contacts(system, self._contacts, at, self._negligible, closes)
        tracking, (ties, offset), (a, _, c) = task.tracking, tied.ties, tied.groups
        errors = tracking.errors.copy()
        errors[: len(tied.effectors)] += tied.effectors - tracking.linear.effectors
        found = self._optimum(task, tied, errors, at, bounds)
        if found is None:
            return None
        forces = ties[c.start :, a] @ found.efforts[a] + offset[c.start :]
        forces += ties[c.start :, c.start :] @ found.contact.multipliers
        self._direct.expect(found.efforts, forces)
        made = self._with_friction(system, found.drives(self._limits), bounds, found)
        return Made(made, task.missed(made), task.missed(found, tied))

    def _displaced(
        self, task: Task, bounds: Bounds, choice: int, lengths: tuple[float, ...]
    ) -> Actuation | None:
        """What comes of moving one actuator that bears to one side; None where there is none.

        But for contacts, effectors would be displaced by a multiple of what is missed.
        """
        tracking, linear, held = task.tracking, task.tracking.linear, task.tracking.held
        a, e, _ = linear.groups
        loads = np.abs(held.efforts[a]) / self._effort_scales
        bears = loads > NO_EFFORT * loads.max(initial=0.0)
        free = np.flatnonzero(~tracking.commanded[a] & (bears | ~self._one_sided[a]))
        if not len(free):
            return None
        side, choice = choice % 2, choice // 2
        moved, length = free[choice % len(free)], lengths[(choice // len(free)) % len(lengths)]
        self._detours.choices = 2 * len(free) * len(lengths)
        own = 1.0 if self._by_effort[moved] else linear.W[moved, moved]
        farther = np.linalg.norm(linear.W[e, moved]) / own
        reach = length * np.sqrt(task.before / tracking.weights.max())
        move = LONGEST * GREATEST * self._scales[moved]
        if farther > 0.0:
            move = min(move, reach / farther)
        drives = held.drives(self._limits).copy()
        drives[moved] += move if side else -move
        return self._with_friction(linear, self._limits.drives_within(drives, bounds), bounds, held)

    def _from(self, linear: Linearized, found: Actuation) -> Linearized:
        """The system of a later step, whose contacts slip from where they are in a solution."""
        violation, (_, slid) = linear.violation.copy(), slid_by(linear, found)
        slid[self._contacts.row_starts[:-1]] = 0.0
        violation[linear.groups.contacts] -= slid
        return linear.with_violation(violation)

    def tries(self, found: Actuation, held: Actuation) -> Iterator[Actuation]:
        """See `InverseActuation`; any share of a move is made, since another one would try other contacts.

        Args:
            found: See `InverseActuation`.
            held: See there.
        """
        self._task = None
        self._tried_length = longest_move(held.drives(self._limits), found.drives(self._limits), self._scales)
        return super().tries(found, held)

    def refuse(self, is_stuck: bool) -> None:
        """See `InverseActuation`."""
        super().refuse(is_stuck)
        # What moves on asks for about the same again; else another try begins with the radius, not the move.
        moves = self._moved.any()
        self.move_limit = min(0.5 * self._tried_length, self.move_limit) if moves else SHRINK * self.move_limit
        self._pending = None

    def _learn_curvature(self, situation: Situation, linear: Linearized, held: Actuation) -> None:
        """Nothing: contacts that stick or slip bend the way more than the bodies do."""

    def _branches(self, asked: Asked) -> Iterator[np.ndarray]:
        return iter(())

    def _follow(self, asked: Asked) -> Actuation:
        """The optimum; where contacts press, what promises nothing is tried as well."""
        presses = (asked.held.contact.multipliers > 0.0).any()
        if not (self._rubs and presses) or self._goal is not None:
            return super()._follow(asked)
        self._task, self._is_noted, self._settles = None, False, False
        found = self._best(asked) or asked.held._replace(solved=False)
        if found.solved and self._learns and self._is_first and self._is_same:
            self._is_first = False
            promised = self._promised(asked, found)
            if promised > NO_PROMISE * self._now:
                self._note(asked, found, promised)
        return found

    def _with_friction(
        self, linear: Linearized, drives: np.ndarray, bounds: Bounds, promised: Actuation
    ) -> Actuation:
        """What comes of drives with friction, within the same linearization."""
        return self.told(self._direct.at_drives(linear, drives, bounds), promised)

    def _on_normals(self, found: Actuation, tied: Linearized) -> Actuation:
        """An actuation with the forces of a tied system: along normals, or none."""
        normals = found.contact.multipliers[self._contacts.row_starts[:-1]]
        normals = normals[: tied.contact_row_count]
        return found._replace(contact=found.contact._replace(multipliers=normals))

    def _settled(
        self, linear: Linearized, efforts: np.ndarray, contact: ContactLoads, bounds: Bounds,
        solver: str,
    ) -> Actuation:  # fmt: skip
        """Set actuators to the paths found; what comes of them is found with friction."""
        if not linear.ties:
            return super()._settled(linear, efforts, contact, bounds, solver)
        efforts, _, within, _ = self._paths(linear, efforts, contact, bounds)
        return Actuation(efforts, within, True, solver, contact)

    def _last(self, linear: Linearized) -> tuple[np.ndarray, np.ndarray]:
        if not linear.contact_row_count:
            return super()._last(linear)
        efforts, forces = self._last_solution
        return efforts, forces[self._contacts.row_starts[:-1]]

    def _places(self, linear: Linearized, found: Actuation, stiffness: StiffnessRows | None) -> np.ndarray:
        """The same, then how far forces beyond their limit press contacts in [m]."""
        places = super()._places(linear, found, stiffness)
        if not self._judges_forces:
            return places
        return np.append(places, np.linalg.norm(self._beyond(linear, found)))

    def _with_forces(self, situation: Situation, linear: Linearized, held: Actuation) -> Situation:
        """A situation in which forces beyond their limit are judged too."""
        if not self._judges_forces:
            return situation
        weight = FORCES_FIRST * situation.weights.max(initial=0.0)
        return situation._replace(
            targets=np.append(situation.targets, 0.0),
            weights=np.append(situation.weights, weight),
            places=np.append(situation.places, np.linalg.norm(self._beyond(linear, held))),
        )

    def _beyond(self, linear: Linearized, found: Actuation) -> np.ndarray:
        """How far forces beyond their limit press contacts in, then what pairs lack [m], shape (n,)."""
        forces, normals = found.contact.multipliers, self._contacts.row_starts[:-1]
        if not len(forces):
            return np.zeros(0)
        forces = self._of_all_rows(forces)
        rows = linear.groups.contacts.start + normals
        beyond = np.maximum(forces[normals] - self.force_limit, 0.0) * linear.W[rows, rows]
        if not self._grips.names:
            return beyond
        grip, least = self._grips.rows(linear, self._contacts, forces)
        return np.append(beyond, np.maximum(least - grip @ forces, 0.0))

    def _limits_met(self, forces: np.ndarray) -> tuple[str, ...]:
        """The same of the forces of all rows, or of normal forces alone."""
        if not len(forces):
            return ()
        forces, normals = self._of_all_rows(forces), self._contacts.row_starts[:-1]
        limits = super()._limits_met(forces[normals])
        return limits + self._grips.met(self._contacts, forces) if self._grips.names else limits

    def _of_all_rows(self, forces: np.ndarray) -> np.ndarray:
        """Forces of all rows; of a promise, whose margins are kept, those along normals alone."""
        if len(forces) == self._contacts.row_count:
            return forces
        whole = np.zeros(self._contacts.row_count)
        whole[self._contacts.row_starts[:-1]] = forces
        return whole

    def is_held_by_energy(
        self, linear: Linearized, target_rows: np.ndarray, held: Actuation, bounds: Bounds,
        tolerance: float,
    ) -> bool:  # fmt: skip
        """See `InverseActuation`; contacts that stick or slip go on so.

        Args:
            linear: The condensed system.
            target_rows: See `InverseActuation`.
            held: What the actuators do when they stay.
            bounds: Bounds of this step.
            tolerance: See `InverseActuation`.
        """
        if linear.contact_row_count:
            linear = tied_by_contacts(linear, self._contacts, held, self._negligible)
            held = self._on_normals(held, linear)
        return super().is_held_by_energy(linear, target_rows, held, bounds, tolerance)
