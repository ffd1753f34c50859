"""One linearization of the motion, and its correction: Coevoet 2017, eq. (9) to (15).

    A dq = b + Hᵀλ,   A = ∂F/∂q (and the geometric stiffness of loaded rows),  b = p - F(q)  (9, 10)
    A dq_free = b,    δ_free = δ(q) + H dq_free                                         (11-13)
    W = H A⁻¹ Hᵀ                                                                        (14)
    λ from an optimisation over W and δ_free                                            (16-18)
    dq = A⁻¹ (b + Hᵀλ)                                                                  (15)

In motion A and b hold inertia and damping of the time step too (5-8). Force terms and constraint
terms are summed in loops: nothing here knows what kinds a scene has.
"""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.geometry.vector_arrays import copy_vectors, write_product
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.kernels.traced_stage import TracedStages, clear
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import Actuation
from softrobot_twin.simulation.step.augmented_tangent import HeldActuators, augmented_tangent_of
from softrobot_twin.simulation.step.linearized import (
    Linearized,
    LinearizedState,
    PrescribedMoves,
    expected_to_press,
)
from softrobot_twin.simulation.step.merit import Merit, Move
from softrobot_twin.simulation.step.time_budget import StageClock
from softrobot_twin.solvers.dense_stiffness import DenseStiffness, without_rows
from softrobot_twin.solvers.factorization import Factorization

# Where no merit tells how far a linearization holds (in motion, with friction, with slender parts), no
# node moves further than this share of the body's size in one linearization, seen from slides that carry it.
LONGEST_MOVE = 0.1
# Displacements h v that inertia may add to it.
INERTIAL_SHARE = 1.5
# A correction by the factor of an earlier state is kept when what the same factor would correct
# next is at most this share of it. That is the natural monotonicity test of simplified Newton methods
# (Deuflhard 2011, section 2.1). It measures displacements:
# a stale factor leaves small forces on soft directions, which are large displacements.
GREATEST_CONTRACTION = 0.5
# Beyond this share the factor is worn out: the next linearization makes a new one.
WORN_CONTRACTION = 0.1
# Displacements below this share of the body's size are round-off.
ROUND_OFF = 1.0e-9
# In motion, a move dq along which forces change from r(0) to r(1) went too far where -r(1)·dq is
# more than this share of r(0)·dq. Parts that turned are stretched then.
OVERSHOOT = 0.1
# Where forces have no energy, a move went too far where -r(1)·dq is more than this share of r(0)·dq.
# Tries of the share where r·dq is zero, and the share of r(0)·dq that counts as zero.
OVERSHOOT_WITHOUT_ENERGY, MOST_TRIALS, SLOPE_AT_REST = 0.5, 8, 0.1
# A move by a projected tangent was far too short where r(1)·dq is more than this share of r(0)·dq.
# Factor by which it is lengthened, and the most tries.
TOO_SHORT, LONGER, MOST_LENGTHENINGS = 0.9, 4.0, 8
# Where slender bodies have no merit, the next tangent is projected by so much less after such a move,
# and by as much more where -r(1)·dq is more than r(0)·dq; by no less than the second share. The
# share grows by the third until the tangent is definite.
LESS_PROJECTION, LEAST_PROJECTION, MORE_PROJECTION = 8.0, 2.0**-16, 2.0
# Moves that a step makes after such a move at least, none longer than it: the first takes the
# stretch back and hardly moves the body, which the stretch stiffens; the second makes what was
# missing.
MOVES_AFTER_OVERSHOOT = 2
# Places of the traced stages, of terms and of rows apart from them; moves are with the rows.
MOVE, LOAD, GATHER, ASSEMBLE, ASSEMBLE_LATER = range(5)
EVALUATE, ADD_STIFFNESS = GATHER, ASSEMBLE
# A move takes the one before it back where it goes at least the first share of that one the other way,
# and at least the second share of its square lies along that one.
BACK, ALONG = 0.5, 0.9
# Halvings of a move that still folds an element.
MOST_UNFOLDINGS = 40


@njit(**KERNEL)
def is_within(number, limit):
    """Whether a `number`, shape (1,), is finite, and no more than `limit`, shape (1,)."""
    return number[0] <= limit[0] and number[0] < np.inf


class Newton:
    """Linearizes a model, and corrects its positions. Its arrays are allocated once.

    Attributes:
        projected_tangent: True when the last linearization had to project its tangent.
        is_augmented: True when it augmented its tangent by the rows of the actuators.
        inverted_count: Elements that were flat or inside out when the residual was taken last.
        is_folded: True when there were some, or elements beyond the barrier that keeps them so;
            None until forces are taken.
        is_nearly_flat: True when the barrier against flat elements acted in that residual.
        constant_load: Sum of the forces on the nodes at rest, the body's weight [N].
        factor_age: Linearizations since the factor was made; None when there is none of use.
        is_worn: True when a stale factor corrected too little the last time.
        forces: Sum of the forces on free nodes that was taken last [N], shape (free_node_count, 3).
        multipliers: λ of all rows that acted in them, shape (row_count,).
        move: The last correction of the positions.
        merit: What its length is judged by; None in scenes without.
    """

    def __init__(self, model: Model):
        """Allocate.

        Args:
            model: The built scene.
        """
        self._model, self._rows = model, model.rows
        self.forces = np.zeros((model.nodes.free_node_count, 3))
        self.multipliers = np.zeros(self._rows.row_count)
        self._linear: Linearized | None = None
        self._actuation: Actuation | None = None
        self._stays_upright = any(term.stays_upright for term in model.forces)
        self._condensed_forces, self._loaded_forces = self.forces, np.empty_like(self.forces)
        self._effector_columns = None
        if model.slides is not None:
            self._effector_columns = model.slides.effector_columns(model.effectors)
        # In an inverse problem all contacts have a part, and so they have where slides move them.
        self._leaves_out = (
            self._rows.varies and not model.contacts.conserves and model.slides is None
            and model.actuators.conserves
        )
        self.move = Move(model)
        has_merit = self._has_merit()
        self.merit = Merit(model, self.move, self.gather_forces) if has_merit else None
        self._whole_limit = np.inf if has_merit else LONGEST_MOVE * model.nodes.size
        self._step_limit = self._whole_limit
        self._time_step = self._last_move = self._slope = 0.0
        self._moves_to_make = 0
        self._conserves, is_slender = model.actuators.conserves, any(t.is_slender for t in model.forces)
        # Whole moves of slender bodies push back, and converge all the same.
        self._searches = not (self._conserves or is_slender)
        self._judged: Actuation | None = None
        self._judges_projection = False
        # What the last move of the step displaced, where contacts may lead to and fro.
        may_swing = self._rows.varies and not (has_merit or model.is_dynamic)
        self._last_way = np.zeros_like(self.move.displacement) if may_swing else None
        # A single point has no size, and no round-off that could be told from a move.
        finite = np.isfinite(model.nodes.size)
        self._round_off = ROUND_OFF * model.nodes.size if finite else 0.0
        factorization = model.factorization
        self._augmented, self._held = augmented_tangent_of(model), None
        self._projects_in_part = (
            is_slender and not isinstance(factorization, DenseStiffness)
            and not model.is_dynamic and self._conserves
        )  # fmt: skip
        self._was_folded = self._follows = False
        self.projected_tangent = self.is_augmented = False
        sharers = (*model.forces, factorization)
        are_traceable = all(getattr(one, "is_traceable", False) for one in sharers)
        are_rows = self._rows.is_traceable
        reaches_points = are_rows and self._rows.reaches_carried_points
        self._row_points = model.nodes.carried if reaches_points else None
        # Rows that vary have other arrays where there are more or fewer.
        self._has_rows_apart = self._rows.varies or not are_rows
        # What moves the nodes depends on nothing but arrays, where nothing but A holds them.
        self._memory_count = getattr(factorization, "memory_count", None)
        self._makes_whole = (
            are_traceable and are_rows and model.slides is None and self._memory_count is not None
            and all(getattr(kind, "is_traceable", False) for kind in model.nodes.kinds)
        )  # fmt: skip
        self._longest, self._work, self._limit, self._largest = np.zeros((4, 1))
        self._knowing: list = [
            term for term in model.forces if type(term).knows is not ForceTerm.knows
        ]
        if self._rows.may_know:
            self._knowing.append(self._rows)
        # Terms that remember where a step began do something else there than later in it.
        self._starts_apart = any(term.remembers_start for term in model.forces)
        self._is_at_start = True
        moves = self._make_whole, self._load_rows
        self._stages = TracedStages(
            are_traceable, *moves, self._gather, self._assemble, self._assemble
        )
        self._row_stages = TracedStages(
            are_rows, *moves, self._rows.evaluate, self._rows.add_stiffness
        )
        self._move_stages = self._row_stages if self._has_rows_apart else self._stages
        self._traced = [self._stages, self._row_stages]
        assembled = without_rows(factorization)
        if hasattr(assembled, "stages"):
            self._traced.append(assembled.stages)
        self.forget()
        self.gather_forces(model.nodes.rest_positions)
        self.constant_load = float(np.linalg.norm(self.forces, axis=1).sum())
        if self._projects_in_part and self._augmented is not None:
            # Later, slender parts would take the rest shape for where their last move began.
            if not self._measure_stiffness(StageClock()):
                self._augmented = None

    def _has_merit(self) -> bool:
        """Whether equilibria at held actuators are minima of an energy that falls on the way.

        Slender parts are stretched on their way: Newton's method needs a quarter of the moves where
        their energy may rise in between, 4 to 19 for the elastica from rest instead of 14 to 42.

        Where contacts stick or slide, equilibria depend on the way there and are minima of no
        energy. One pair that may rub decides it for all moves of the scene: a contact that begins
        to rub within a step would change what the moves of the step are judged by.
        """
        model = self._model
        conserves = all(term.conserves for term in self._rows.terms)
        is_slender = any(term.is_slender for term in model.forces)
        return conserves and not (model.is_dynamic or is_slender)

    @property
    def asks_for_held(self) -> bool:
        """Whether a linearization depends on what holds the actuators."""
        return self._augmented is not None or self._rows.varies

    @property
    def may_keep_factor(self) -> bool:
        """True when a linearization in a hurry may do with the factor of an earlier state.

        Not where rows vary: with gaps that are off by an old compliance, effectors miss their
        targets by millimetres.
        """
        is_of_use = self.factor_age is not None and not (self.is_worn or self.is_augmented)
        return is_of_use and not self._rows.varies

    @property
    def actuator_compliances(self) -> np.ndarray:
        """Displacement of each actuator by its own effort, at given efforts of the others.

        By the last linearization; infinite where the body is unstable at given efforts. Shape
        (actuator_row_count,), in the actuators' units.
        """
        W = self._linear.W_aa
        if not self.is_augmented:
            return W.diagonal()
        softened = np.linalg.inv(W) - np.diag(self._linear.augmentation.stiffness)
        if np.linalg.eigvalsh(softened)[0] <= 0.0:
            return np.full(len(W), np.inf)
        return np.linalg.inv(softened).diagonal()

    @property
    def static_factorization(self) -> Factorization | None:
        """The factorization, where it holds the exact tangent of statics; else None."""
        is_other = self._model.is_dynamic or self.is_augmented or self.projected_tangent
        if is_other or not self._conserves or self.factor_age is None:
            return None
        return self._model.factorization

    def held_factorization(self, is_held: np.ndarray) -> Factorization | None:
        """What solves with the tangent of statics, while some actuators hold their displacements.

        Where these hold, it makes no difference that their rows augment the tangent.

        Args:
            is_held: Whether each actuator with a row holds, shape (actuator_row_count,).

        Returns:
            It; None where the last step did not have it.
        """
        is_other = self._model.is_dynamic or self.projected_tangent or not self._conserves
        if not self.is_augmented or is_other or self.factor_age is None:
            return self.static_factorization
        rows, augmented = self._rows, self._augmented
        has_own = rows.own_compliance() is not None or augmented.contact_stiffness.any()
        holds = is_held[augmented.stiffness[: len(is_held)] != 0.0].all()
        return augmented if holds and not has_own else None

    def forget(self) -> None:
        """Forget what earlier states taught: the next linearization starts from nothing."""
        for stages in self._traced:
            stages.begin_anew()
        self.factor_age: int | None = None
        self.is_worn = False
        self.inverted_count, self.is_folded = 0, None
        self._ahead: Linearized | None = None
        # Share of its projection in a tangent that is projected.
        self._projection = 1.0
        # Where the exact tangent was indefinite, it is tried again when the augmented one tells
        # that it is definite.
        self._is_indefinite = self._augmented is not None and self._augmented.comes_first
        if self.merit is not None:
            self.merit.forget()
        self._rows.forget()

    def take_augmented_tangent(self) -> bool:
        """Let the next linearization augment its tangent, where held actuators bear.

        Returns:
            Whether that tangent has kernels of its own, for which a body that becomes unstable would
            wait if nothing had compiled them.
        """
        self._is_indefinite = self._augmented is not None
        return self._is_indefinite and self._augmented.has_kernels

    def forget_folds(self) -> None:
        """Take the state where the next linearization begins for one without folds."""
        self.inverted_count, self.is_folded = 0, False

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Allow longer moves to nodes that inertia carries on.

        A factor holds inertia and damping of its own time step, and is of no use for another one.

        Args:
            positions: Not used.
            velocities: Of the unknowns [m/s], shape (free_node_count, 3).
            time_step: The step's duration [s].
        """
        inertial = INERTIAL_SHARE * time_step * self._model.nodes.longest(velocities)
        self._step_limit = self._whole_limit + inertial
        self._moves_to_make = 0
        if self._last_way is not None:
            self._last_way[:] = 0.0
        if time_step != self._time_step:
            self.factor_age = None
        self.expect(time_step)

    def take_other_tangent(self) -> None:
        """Make the factor anew: the tangent is another one than in an equally long step before."""
        self.factor_age = None
        self._forget_stages()

    def expect(self, time_step: float) -> None:
        """Let a step begin; its stages run in Python where it is longer or shorter than before.

        Args:
            time_step: Its duration [s].
        """
        self._is_at_start, self._ahead = True, None
        if time_step != self._time_step:
            self._time_step = time_step
            self._forget_stages()

    def _forget_stages(self) -> None:
        self._stages.forget()
        self._row_stages.forget()

    def go_on(self) -> None:
        """Let a step of statics go on where the one before ended out of balance.

        Else few linearizations a step would do the same in each step, and never come to balance.
        """
        for term in self._model.forces:
            if term.is_slender:
                term.on_points.follow_move(self.move.start)

    def prepare(
        self, positions: np.ndarray, efforts: np.ndarray, clock: StageClock,
        held: HeldActuators | None,
    ) -> bool:  # fmt: skip
        """Linearize ahead of the command of a step, whose first linearization this is then.

        Not where the tangent may be augmented by what the command holds, or was projected.

        Args:
            positions: Node positions where the step begins [m], shape (node_count, 3).
            efforts: Efforts of the actuators there [N], shape (actuator_count,).
            clock: Books the stages.
            held: See `linearize`; of it counts only whether displacements are prescribed.

        Returns:
            Whether it did.
        """
        if self._is_indefinite or self.projected_tangent:
            return False
        self._look(positions, clock, held)
        self.is_augmented = False
        self._rows.limit_stiffness(False)
        self._ahead = self._factored(positions, self._rows.multipliers(efforts), clock)
        self.factor_age = None if self._ahead is None else 0
        return self._ahead is not None

    def _look(
        self, positions: np.ndarray, clock: StageClock, held: HeldActuators | None
    ) -> None:
        """Find what is folded and what touches where a linearization begins."""
        self._follows = held is not None and not held.is_prescribed
        if self.is_folded is None:
            self._sum_forces(positions)
        self._was_folded = self.is_folded
        if self._rows.varies:
            self._rows.detect(positions)
            if self.merit is not None:
                self.merit.see_overlaps()
            self._rows.choose_stiffness(held is not None and held.is_prescribed)
            clock.mark("detect")

    def linearize(
        self,
        positions: np.ndarray,
        efforts: np.ndarray,
        clock: StageClock,
        with_stale_factor: bool = False,
        held: HeldActuators | None = None,
    ) -> Linearized | None:
        """See the bodies from their constraints.

        Where the exact tangent is indefinite, it is augmented by the rows of actuators that are
        held, and where these do not stabilise the bodies either, it is projected.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            efforts: Efforts of the actuators there [N], shape (actuator_count,).
            clock: Books the stages.
            with_stale_factor: Take the new forces and rows, but the tangent of an earlier state:
                W is off by some 1e-3 a step, and the time of assembly and factor is saved.
            held: What holds the actuators; None where efforts are prescribed.

        Returns:
            The condensed system, or None when the tangent cannot be factorized.
        """
        if self._ahead is None:
            self._look(positions, clock, held)
        if with_stale_factor:
            self.factor_age += 1
            self._rows.tell_efforts(efforts)
            self.gather_forces(positions)
            clock.mark("assemble")
            self._linear = self._condense(positions, self._rows.multipliers(efforts))
        else:
            self._linear = self._factor_and_condense(positions, efforts, held, clock)
            self.is_worn = False
            self.factor_age = None if self._linear is None else 0
        clock.mark("condense")
        return self._linear

    def _factor_and_condense(
        self, positions: np.ndarray, efforts: np.ndarray, held: HeldActuators | None,
        clock: StageClock,
    ) -> Linearized | None:  # fmt: skip
        """See the bodies by the exact tangent, the augmented one, or the projected one."""
        multipliers = self._rows.multipliers(efforts)
        may_augment = self._augmented is not None and held is not None
        self.is_augmented = self.projected_tangent = False
        # Masses hold a body in motion, and what is prescribed follows from either tangent.
        is_inverse = may_augment and not (held.is_prescribed or self._model.is_dynamic)
        may_augment = may_augment and (not is_inverse or self._measure_stiffness(clock))
        if not (self._is_indefinite and may_augment):
            self._rows.limit_stiffness(False)
            linear = self._factored(positions, multipliers, clock)
            if linear is not None:
                self._is_indefinite = (
                    is_inverse and may_augment and self._augmented.is_near(linear.W)
                    and self._augmented.choose(efforts, held)
                )
                if not self._is_indefinite:
                    return linear
        self._rows.limit_stiffness(True)
        may_augment = may_augment and self._measure_stiffness(clock)
        may_augment = may_augment and self._augmented.choose(efforts, held)
        if may_augment:
            self.is_augmented, self._held = True, held
            for is_limited in (False, True) if self._rows.may_be_negative else (True,):
                self._rows.limit_stiffness(is_limited)
                linear = self._factored(positions, multipliers, clock)
                if linear is not None:
                    self._is_indefinite = self._augmented.is_needed(
                        linear.W, linear.groups.contacts.start
                    )
                    return linear
        self.is_augmented, self.projected_tangent, self._is_indefinite = False, True, False
        if self._projects_in_part:
            linear = self._least_projected(positions, multipliers, may_augment, clock)
            if linear is not None:
                return linear
        return self._factored(positions, multipliers, clock)

    def _factored(
        self, positions: np.ndarray, multipliers: np.ndarray, clock: StageClock
    ) -> Linearized | None:
        """See the bodies by the tangent of the kind that is set; None where it is not definite."""
        if self._ahead is not None:
            linear, self._ahead = self._ahead, None
            return linear
        if not self._factor(positions, multipliers, clock):
            return None
        try:
            return self._condense(positions, multipliers)
        except np.linalg.LinAlgError:
            # Held actuators do not stabilise the bodies, or rows that are not assembled unsettle them.
            return None

    def _least_projected(
        self, positions: np.ndarray, multipliers: np.ndarray, augments: bool, clock: StageClock
    ) -> Linearized | None:
        """See the bodies by a weighted mean of the exact and the projected tangent.

        Where a slender body just buckles, the projected tangent is too stiff by orders of magnitude
        along the way it gives, and the body would creep.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            multipliers: λ of all rows there, shape (row_count,).
            augments: Whether the mean is augmented by the rows of held actuators.
            clock: Books the stages.

        Returns:
            The condensed system; None where no mean was found definite.
        """
        factorization = self._model.factorization
        self.is_augmented, storage = augments, factorization.storage
        self.assemble(positions, multipliers, True)
        projected = storage.copy()
        self.assemble(positions, multipliers, False)
        exact = storage.copy()
        clock.mark("assemble")
        share = self._projection
        while share <= 1.0:
            storage[:] = (1.0 - share) * exact + share * projected
            try:
                if self._augmented.factor(positions) if augments else factorization.factor():
                    clock.mark("factor")
                    self._projection = share
                    return self._condense(positions, multipliers)
            except np.linalg.LinAlgError:
                pass  # Held actuators do not stabilise the bodies by it.
            share *= MORE_PROJECTION
        self.is_augmented = False
        return None

    def _measure_stiffness(self, clock: StageClock) -> bool:
        """Find how stiff the bodies are along the actuators in their rest shape; False if unstable."""
        if self._augmented.is_measured:
            return True
        rest, rows = self._model.nodes.rest_positions, self._rows
        self._ahead = None
        if not self._factor(rest, np.zeros(rows.row_count), clock):
            return False
        linear = Linearized(self._model.factorization, rows, self.forces)
        self._augmented.measure(linear.W_aa)
        return True

    def _factor(self, positions: np.ndarray, multipliers: np.ndarray, clock: StageClock) -> bool:
        """Assemble and factorize the tangent of the kind that is set."""
        self.assemble(positions, multipliers, self.projected_tangent)
        clock.mark("assemble")
        if self.is_augmented:
            succeeded = self._augmented.factor(positions)
        else:
            succeeded = self._model.factorization.factor()
        clock.mark("factor")
        return succeeded

    def _condense(self, positions: np.ndarray, multipliers: np.ndarray) -> Linearized:
        """W and the violations after free motion, of the rows evaluated last (11-14).

        Args:
            positions: Node positions [m], shape (node_count, 3).
            multipliers: λ of all rows there [N], shape (row_count,).
        """
        model, rows, pressing, row_starts = self._model, self._rows, None, None
        if self._leaves_out and not self._follows:
            row_starts = model.contacts.row_starts
            pressing = expected_to_press(model.contacts, rows.values[rows.groups.contacts])
        moves = self._prescribed_moves(positions)
        if not self.is_augmented:
            forces = self.forces
            if rows.told is not None:
                forces = self._loaded_forces
                copy_vectors(self.forces, forces)
                rows.add_forces(np.zeros(rows.row_count), forces)
            self._condensed_forces = forces
            return Linearized(
                model.factorization, rows, forces, moves, row_starts, pressing,
                multipliers=multipliers,
            )  # fmt: skip
        held = self._held
        reference = model.actuators.limits.drives_within(held.drives, held.bounds)
        augmentation = self._augmented.augmentation(reference)
        forces, shift = self._loaded_forces, np.zeros(rows.row_count)
        copy_vectors(self.forces, forces)
        a = rows.groups.actuators
        shift[a] = augmentation.efforts(np.zeros(a.stop), rows.values[a])
        if augmentation.share is not None:
            shift[a] *= augmentation.share
        c = rows.groups.contacts
        shift[c] = self._augmented.contact_shift(rows.values[c])
        rows.add_forces(shift, forces)
        self._condensed_forces = forces
        return Linearized(
            self._augmented, rows, forces, moves, row_starts, pressing, augmentation
        )

    def true_efforts(self, actuation: Actuation) -> Actuation:
        """The actuation with the efforts λ of its solution λ̂ by the augmented tangent.

        Args:
            actuation: What was found by the last linearization.
        """
        slides, linear = self._model.slides, self._linear
        if not self.is_augmented and slides is None:
            return actuation
        a, _, c = linear.groups
        efforts, forces = actuation.efforts.copy(), actuation.contact.multipliers
        if self.is_augmented:
            reach = self._held.reach
            efforts[a] = np.clip(
                linear.efforts(efforts[a], forces), reach.effort_min[a], reach.effort_max[a]
            )
        if slides is not None:
            own = slice(a.stop - slides.count, a.stop)
            efforts[own] = slides.loads(linear.W[c, own], forces)
        return actuation._replace(efforts=efforts)

    def linearized_state(self, positions: np.ndarray, efforts: np.ndarray) -> LinearizedState:
        """The state of the last linearization, and how it was linearized.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            efforts: Efforts of the actuators there, shape (actuator_count,).
        """
        solver = self._augmented if self.is_augmented else self._model.factorization
        return LinearizedState(
            self._linear, solver, self._condensed_forces, positions.copy(),
            efforts[self._rows.groups.actuators],
        )  # fmt: skip

    def _prescribed_moves(self, positions: np.ndarray) -> PrescribedMoves | None:
        """What slides prescribe; None without any."""
        model = self._model
        if model.slides is None:
            return None
        columns = model.slides.columns(self._rows, self._effector_columns, model.contacts)
        return PrescribedMoves(-model.slides.positions(positions), columns)

    def _set_multipliers(self, actuation: Actuation) -> None:
        """λ of every row; an effector bears no load."""
        groups, is_fit = self._rows.groups, len(self.multipliers) == self._rows.row_count
        if is_fit and actuation is self._actuation:
            return
        if not is_fit:
            self.multipliers = np.zeros(self._rows.row_count)
        self._actuation = actuation
        self.multipliers[groups.actuators] = actuation.efforts[groups.actuators]
        self.multipliers[groups.contacts] = actuation.contact.multipliers

    def correct(
        self, positions: np.ndarray, actuation: Actuation, is_judged: bool = False
    ) -> tuple[float, Actuation]:
        """Move the nodes by A⁻¹ (b + Hᵀλ), eq. (15).

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            actuation: λ of the optimisation.
            is_judged: Whether `accepts` or `settle` judges the move afterwards.

        Returns:
            Share of the move that was made: one, less where it was too long for a
            linearization, zero where it was not finite; and the actuation with its efforts, see
            `true_efforts`.
        """
        nodes = self._model.nodes
        self._set_multipliers(actuation)
        self._rows.remember(self.multipliers)
        if self._makes_whole and not self.is_augmented and self._linear.rows is None:
            if self._memory_count != self._model.factorization.memory_count:
                self._memory_count = self._model.factorization.memory_count
                self._move_stages.forget()
            self._limit[0] = self._step_limit
            if self._move_stages.run(MOVE, positions):
                self._last_move = float(self._longest[0])
                is_judged = is_judged and self._last_move > self._round_off
                self._note(actuation, is_judged, float(self._work[0]))
                return 1.0, actuation
        move = self._linear.expand(self.multipliers)
        self.move.begin(positions, move, actuation.efforts)
        longest = nodes.longest(move)
        if math.isfinite(longest):
            share = self._step_limit / longest if longest > self._step_limit else 1.0
            share = min(share, self._rows.largest_share(positions, move))
            self._last_move = share * longest
            actuation = self.true_efforts(actuation)
            self._note(actuation, is_judged and longest > self._round_off)
            self.move.make(positions, share)
        else:
            share = 0.0
        return share, actuation

    def _make_whole(self, positions: np.ndarray) -> bool:
        """Make the whole of the next move, and find how long it is and what the forces do along it.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.

        Returns:
            Whether it is made: False where it is too long for a linearization or for a row.
        """
        nodes, move = self._model.nodes, self.move.displacement
        self.move.begin(positions, self._model.factorization.expand(self.multipliers))
        nodes.write_largest(move, False, self._longest)
        if not is_within(self._longest, self._limit):
            return False
        if self._rows.largest_share(positions, move) < 1.0:
            return False
        self._rows.add_forces(self.multipliers, self.forces)
        write_product(self.forces.reshape(-1), move.reshape(-1), self._work)
        self.move.make(positions, 1.0)
        return True

    def _note(self, actuation: Actuation, is_judged: bool, slope: float | None = None) -> None:
        """Note a move for `asks_for_more_moves` or for the merit.

        Without the work of the forces b + Hᵀλ along it [J], it is noted before it is made.

        At given efforts full moves of slender bodies converge faster than moves that lower the
        energy, and only those of bodies that buckle or are nearly flat are judged.
        """
        if actuation.are_efforts_given:
            is_judged = is_judged and (self.projected_tangent or self.is_nearly_flat)
        is_searched = self._searches and is_judged and not actuation.are_efforts_given
        self._judges_projection = self._projects_in_part and self.projected_tangent
        needs_slope = self._model.is_dynamic or not self._conserves or self._judges_projection
        if needs_slope or (self.merit is not None and is_judged):
            if slope is None:
                self._load(actuation)
                slope = self._left_slope()
            self._slope = slope
        self._judged = actuation if is_searched else None
        if self.merit is None:
            return
        if is_judged:
            self.merit.begin(actuation, self._slope)
        else:
            self.merit.skip()

    def take_back(self, positions: np.ndarray) -> None:
        """Undo the last move, and take the forces of where it began again, for the next one.

        Args:
            positions: Takes the node positions before it [m], shape (node_count, 3).
        """
        self.move.take_back(positions)
        self.gather_forces(positions)

    @property
    def inverts(self) -> bool:
        """Whether the last move folded elements of upright bodies; asked after `residual`.

        To unfold, a body with folded elements may have to fold other ones.
        """
        return self.is_folded and not self._was_folded

    def accepts(self, positions: np.ndarray, share: float) -> bool:
        """Whether the last move folds no element and lowers the merit; asked after `residual`.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3).
            share: Share of the move that was made.
        """
        if share == 0.0 or self.inverts:
            return False
        if self._judged is not None and self._left_slope() < -OVERSHOOT_WITHOUT_ENERGY * abs(self._slope):
            return False
        if self.merit is None or not self.merit.is_judging or self.merit.trusts(self.forces):
            return True
        return self.merit.accepts(positions, share)

    def asks_for_more_moves(self, share: float) -> bool:
        """Whether a step in motion made a move that went too far, and too few after it.

        Asked after `residual`.

        Args:
            share: Share of the last move that was made.
        """
        went_too_far = share < 1.0
        if self._last_move > self._round_off:
            left = float(np.vdot(self.forces, self.move.displacement))
            went_too_far = went_too_far or left < -OVERSHOOT * self._slope
        if went_too_far:
            self._moves_to_make = MOVES_AFTER_OVERSHOOT
            self._step_limit = min(self._step_limit, self._last_move)
        elif self._moves_to_make:
            self._moves_to_make -= 1
        return self._moves_to_make > 0

    def settle(self, positions: np.ndarray, share: float) -> float:
        """Shorten the last move where it folds elements or does not lower the merit.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3); moved.
            share: Share of the move that was made.

        Returns:
            The share that is made. Where it is another, the residual is to be taken again.
        """
        is_judging = self.merit is not None and self.merit.is_judging
        settled = share
        if self._judged is not None and not self.inverts:
            settled = self._pushing_share(positions, share)
        elif self.inverts:
            settled *= self.upright_share(self.move.start, positions)
        elif not is_judging:
            settled = self._share_without_swing(share)
            if settled == share:
                return share
        elif self.merit.trusts(self.forces):
            may_lengthen = self.projected_tangent and not self._was_folded
            if may_lengthen and self._left_slope() > TOO_SHORT * abs(self._slope):
                return self._lengthened_share(positions, share)
            return share
        if is_judging:
            settled = self.merit.search(positions, settled)
        else:
            self.move.make(positions, settled)
            self.gather_forces(positions)
        if self._stays_upright:
            settled = self._unfolded_share(positions, settled)
        self._last_move *= settled / share
        return settled

    def _lengthened_share(self, positions: np.ndarray, share: float) -> float:
        """Lengthen the last move while the merit falls, and no row forbids it.

        Where a body just buckles, its projected tangent is too stiff by orders of magnitude along
        the way it gives. Bodies with folded elements unfold by short moves: long ones end elsewhere.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3); moved.
            share: Share of the move that was made.

        Returns:
            The share that is made.
        """
        begin = self.merit.at_start()
        best = self.merit.try_share(positions, share, begin)
        for _ in range(MOST_LENGTHENINGS):
            start, longer = self.move.start, LONGER * share * self.move.displacement
            if self._rows.largest_share(start, longer) < 1.0:
                break
            self.move.make(positions, LONGER * share)
            if self.upright_share(start, positions) < 1.0:
                break
            tried = self.merit.try_share(positions, LONGER * share, begin)
            if self.is_folded or not tried.change < best.change:
                break
            share, best = LONGER * share, tried
        self.move.make(positions, share)
        self._last_move *= share
        return share

    def _unfolded_share(self, positions: np.ndarray, share: float) -> float:
        """Shorten the last move further, where elements of rubber fold between the points that
        `largest_share` follows.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3); moved.
            share: Share of the move that was made.

        Returns:
            The share that is made.
        """
        for _ in range(MOST_UNFOLDINGS):
            if not self.inverts:
                return share
            share *= 0.5
            self.move.make(positions, share)
            self.gather_forces(positions)
        self.move.make(positions, 0.0)
        self.gather_forces(positions)
        return 0.0

    def _share_without_swing(self, share: float) -> float:
        """Shorten a move that takes the one before it back and leaves the bodies out of balance.

        Where contacts close by one move and open by the next, moves lead to and fro between two
        states, and no energy tells which of them goes too far. Aitken's extrapolation leads to where
        they would end if each were the same share of the one before.

        Args:
            share: Share of the move that was made.

        Returns:
            The share to make.
        """
        last = self._last_way
        if last is None:
            return share
        way = share * self.move.displacement
        along, squared = float(np.vdot(way, last)), float(np.vdot(last, last))
        goes_back = along < -BACK * squared and along**2 > ALONG * squared * float(np.vdot(way, way))
        if goes_back and self._largest[0] > self._model.scene.solver.residual_tolerance:
            shorter = squared / (squared - along)
            share *= shorter
            way *= shorter
        copy_vectors(way, last)
        return share

    def _left_slope(self) -> float:
        """Work of the forces b + Hᵀλ that were taken last along the whole last move [J]."""
        return float(np.vdot(self.forces, self.move.displacement))

    def _pushing_share(self, positions: np.ndarray, share: float) -> float:
        """How much of a move the forces still push along, where they have no energy.

        What slipped one way may stick or slip the other way after a move, which the linearization
        does not know. The share where the forces do no work along the move is found
        by bisection and false position.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3); moved.
            share: Share of the move that was made.
        """
        begin, left = self._slope, self._left_slope()
        if begin <= 0.0 or left >= -OVERSHOOT_WITHOUT_ENERGY * begin:
            return share
        low, high, at_low, at_high = 0.0, share, begin, left
        for trial in range(MOST_TRIALS):
            share = 0.5 * (low + high)
            if trial % 2 == 0:
                share = low + (high - low) * at_low / (at_low - at_high)
            self.move.make(positions, share)
            self.residual(positions, self._judged)
            left = self._left_slope()
            if abs(left) <= SLOPE_AT_REST * begin:
                break
            if left > 0.0:
                low, at_low = share, left
            else:
                high, at_high = share, left
        return share

    def folds(self, start: np.ndarray, positions: np.ndarray) -> bool:
        """Whether elements fold on the way between two states, or are folded at its end.

        Args:
            start: Node positions where it begins [m], shape (node_count, 3).
            positions: Those where it ends [m], same shape.
        """
        if self.upright_share(start, positions) < 1.0:
            return True
        # Contacts are not detected yet: rows are not evaluated here.
        self._sum_forces(positions)
        return self.is_folded

    @property
    def last_move(self) -> float:
        """Longest displacement of a node in the last move that was made [m]."""
        return self._last_move

    def upright_share(self, start: np.ndarray, positions: np.ndarray) -> float:
        """How much of the way between two states keeps the elements upright.

        Args:
            start: Node positions where it begins [m], shape (node_count, 3).
            positions: Those where it ends [m], same shape.
        """
        return min(term.largest_share(start, positions) for term in self._model.forces)

    def residual(self, positions: np.ndarray, actuation: Actuation) -> float:
        """Largest force out of balance on a node, p - F(q) + Hᵀλ [N]; counts inverted elements.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            actuation: λ.
        """
        self._rows.tell_efforts(actuation.efforts)
        self.gather_forces(positions)
        self._set_multipliers(actuation)
        if self._makes_whole:
            self._move_stages.run(LOAD)
        else:
            self._load_rows()
        if self._judges_projection:
            self._judge_projection(self._last_move < self._step_limit)
        return float(self._largest[0])

    def _load_rows(self) -> None:
        """Add Hᵀλ to the forces gathered last, and find the largest on a node."""
        self._rows.add_forces(self.multipliers, self.forces)
        self._model.nodes.write_largest(self.forces, True, self._largest)

    def _judge_projection(self, is_whole: bool) -> None:
        """Choose by the last move how much the next tangent is projected.

        Args:
            is_whole: Whether the move was not too long for a linearization.
        """
        self._judges_projection = False
        left, slope = self._left_slope(), abs(self._slope)
        if is_whole and left > TOO_SHORT * slope:
            self._projection = max(LEAST_PROJECTION, self._projection / LESS_PROJECTION)
        elif not is_whole or left < -slope:
            self._projection = min(1.0, self._projection * LESS_PROJECTION)

    def _load(self, actuation: Actuation) -> None:
        """Add Hᵀλ to the forces gathered last."""
        self._set_multipliers(actuation)
        self._rows.add_forces(self.multipliers, self.forces)

    def makes_progress(self) -> bool:
        """Whether the stale factor in use corrects: at held λ the next correction is much smaller.

        Asked after `correct` and `residual`. Notes when the factor is worn out.

        Returns:
            False when the correction must not be kept.
        """
        left = self._model.factorization.solve(self.forces)
        longest_left = self._model.nodes.longest(left)
        if longest_left <= self._round_off:
            return True
        self.is_worn = not longest_left <= WORN_CONTRACTION * self._last_move
        return longest_left <= GREATEST_CONTRACTION * self._last_move

    def gather_forces(self, positions: np.ndarray) -> np.ndarray:
        """Sum b = p - F(q) and the rows H, δ of all terms; A stays as it is.

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            The forces.
        """
        self._note_folds(self._stages.run(GATHER, positions))
        if self._has_rows_apart:
            self._row_stages.run(EVALUATE, positions)
        return self.forces

    def _gather(self, positions: np.ndarray) -> tuple[int, int, int]:
        """Sum b of all terms, and evaluate the rows that may be traced."""
        if self._row_points is not None:
            # Else rows apart would be the first to ask for these points here, but not in `assemble`.
            self._row_points.update(positions)
        counts = self._add_forces(positions)
        if not self._has_rows_apart:
            self._rows.evaluate(positions)
        return counts

    def _sum_forces(self, positions: np.ndarray) -> None:
        """Sum b = p - F(q) of all terms, and leave the rows."""
        self._stages.forget()
        self._note_folds(self._add_forces(positions))

    def _add_forces(self, positions: np.ndarray) -> tuple[int, int, int]:
        """Sum b of all terms; counts elements that are inverted, nearly flat, and crossed."""
        clear(self.forces.reshape(-1))
        inverted_count = nearly_flat_count = crossed_count = 0
        for term in self._model.forces:
            inverted_count += term.add_forces(positions, self.forces)
            nearly_flat_count += term.nearly_flat_count
            crossed_count += term.crossed_count
        return inverted_count, nearly_flat_count, crossed_count

    def _note_folds(self, counts: tuple[int, int, int]) -> None:
        """Note what the forces that were taken last tell."""
        inverted_count, nearly_flat_count, crossed_count = counts
        self.inverted_count, self.is_nearly_flat = inverted_count, nearly_flat_count > 0
        self.is_folded = inverted_count > 0 or crossed_count > 0

    def assemble(self, positions: np.ndarray, multipliers: np.ndarray, projected: bool) -> None:
        """Sum b = p - F(q), A and the rows H, δ of all terms.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            multipliers: λ of all rows, shape (row_count,).
            projected: Whether A is made positive definite, element by element.
        """
        model = self._model
        self._rows.tell_efforts(multipliers)
        if not all([term.knows(positions) for term in self._knowing]):
            # Terms that find it out themselves would do something else than in most steps.
            self._stages.run(GATHER, positions)
        if projected:
            self._stages.forget()
            self._assemble(positions, multipliers, True)
        else:
            is_later = self._starts_apart and not self._is_at_start
            self._stages.run(ASSEMBLE_LATER if is_later else ASSEMBLE, positions, multipliers)
        self._is_at_start = False
        if self._has_rows_apart:
            storage = model.factorization.storage
            self._row_stages.run(ADD_STIFFNESS, positions, multipliers, storage, projected)
            self._row_stages.run(EVALUATE, positions)

    def _assemble(
        self, positions: np.ndarray, multipliers: np.ndarray, projected: bool = False
    ) -> None:
        """The same of the force terms, and of the rows that may be traced."""
        factorization = self._model.factorization
        clear(self.forces.reshape(-1))
        factorization.clear()
        for term in self._model.forces:
            term.add(positions, self.forces, factorization.storage, projected)
        if not self._has_rows_apart:
            self._rows.add_stiffness(positions, multipliers, factorization.storage, projected)
            if not self._rows.may_know:
                self._rows.evaluate(positions)
