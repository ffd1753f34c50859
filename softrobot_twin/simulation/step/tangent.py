"""The tangent of a model at a state, and the system that it is condensed to.

The exact tangent A where it is positive definite; else A augmented by rows of held actuators, see
`augmented_tangent.py`; else A projected, element by element, onto what is positive definite.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.vector_arrays import copy_vectors
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import Actuation
from softrobot_twin.simulation.step.augmented_tangent import (
    Augmentation,
    HeldActuators,
    augmented_tangent_of,
)
from softrobot_twin.simulation.step.force_balance import ForceBalance
from softrobot_twin.simulation.step.linearized import (
    NO_MOVES,
    Linearized,
    LinearizedState,
    PrescribedMoves,
    expected_to_press,
)
from softrobot_twin.simulation.step.time_budget import StageClock
from softrobot_twin.solvers.dense_stiffness import DenseStiffness
from softrobot_twin.solvers.factorization import Factorization

# A move by a projected tangent was far too short where r(1)·dq is more than this share of r(0)·dq.
TOO_SHORT = 0.9
# Where moves of slender bodies are not judged, the next tangent is projected by so much less after such a move,
# and by as much more where -r(1)·dq is more than r(0)·dq; by no less than the second share. The
# share grows by the third until the tangent is definite.
LESS_PROJECTION, LEAST_PROJECTION, MORE_PROJECTION = 8.0, 2.0**-16, 2.0


class Tangent:
    """Linearizes a model and condenses it onto its constraints.

    Attributes:
        is_projected: True when the last linearization had to project its tangent.
        is_augmented: True when it augmented its tangent by the rows of the actuators.
        factor_age: Linearizations since the factor was made; None when there is none of use.
        is_indefinite: Whether the next tangent is augmented by what holds, if that bears.
        is_worn: True when a stale factor corrected too little the last time.
        ahead: A condensed system that the next linearization takes; None without.
        linear: The last condensed system.
        asks_for_held: Whether a linearization depends on what holds the actuators.
        projects_in_part: Whether a tangent is projected by as little as makes it definite.
    """

    linear: Linearized

    def __init__(self, model: Model, balance: ForceBalance):
        """Allocate.

        Args:
            model: The built scene.
            balance: Sums its terms.
        """
        self._model, self._rows, self._balance = model, model.rows, balance
        self._condensed_forces, self._loaded_forces = balance.forces, np.empty_like(balance.forces)
        if model.slides:
            self._effector_columns = model.slides.effector_columns(model.effectors)
        self._conserves, self._follows = model.actuators.conserves, False
        # In an inverse problem all contacts have a part, and so they have where slides move them.
        self._leaves_out = model.rubs and not model.slides and self._conserves
        self.is_projected = self.is_augmented = False
        self._augmented, self._held = augmented_tangent_of(model), None
        count = model.actuators.count
        self._plain = Augmentation(*np.zeros((2, count)), np.ones(count), acts=False)
        self.projects_in_part = (
            any(term.is_slender for term in model.forces) and self._conserves
            and not (isinstance(model.factorization, DenseStiffness) or model.is_dynamic)
        )
        self.forget()
        # Later, slender parts would take the rest shape for where their last move began.
        if self.projects_in_part and self._augmented and not self._measure_stiffness(StageClock()):
            self._augmented = None
        self.asks_for_held = bool(self._augmented) or model.rows.varies

    def forget(self) -> None:
        """Forget what earlier states taught: the next linearization starts from nothing."""
        self.factor_age: int | None = None
        self.is_worn = False
        self.ahead: Linearized | None = None
        # Share of its projection in a tangent that is projected.
        self._projection = 1.0
        # Where the exact tangent was indefinite, it is tried again when the augmented one tells
        # that it is definite.
        self.is_indefinite = bool(self._augmented) and self._augmented.comes_first

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
        W = self.linear.W_aa
        if not self.is_augmented:
            return W.diagonal()
        softened = np.linalg.inv(W) - np.diag(self.linear.augmentation.stiffness)
        if np.linalg.eigvalsh(softened)[0] <= 0.0:
            return np.full(len(W), np.inf)
        return np.linalg.inv(softened).diagonal()

    @property
    def static_factorization(self) -> Factorization | None:
        """The factorization, where it holds the exact tangent of statics; else None."""
        is_other = self._model.is_dynamic or self.is_augmented or self.is_projected
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
        is_other = self._model.is_dynamic or self.is_projected or not self._conserves
        if not self.is_augmented or is_other or self.factor_age is None:
            return self.static_factorization
        rows, augmented = self._rows, self._augmented
        has_own = rows.own_compliance() is not None or augmented.contact_stiffness.any()
        holds = is_held[augmented.stiffness[: len(is_held)] != 0.0].all()
        return augmented if holds and not has_own else None

    def take_augmented_tangent(self) -> None:
        """Let the next linearization augment its tangent where held actuators bear, if kernels are
        compiled for that alone: a body that becomes unstable would wait for them.
        """
        self.is_indefinite = bool(self._augmented) and self._augmented.has_kernels

    def prepare(
        self, positions: np.ndarray, efforts: np.ndarray, clock: StageClock,
        held: HeldActuators | None,
    ) -> bool:  # fmt: skip
        """Linearize ahead of the command of a step; see `Newton.prepare`, also for the arguments."""
        self._follows = held is not None and not held.is_prescribed
        self.is_augmented = False
        self._rows.limit_stiffness(False)
        self.ahead = self._factored(positions, self._rows.multipliers(efforts), clock)
        self.factor_age = 0 if self.ahead else None
        return bool(self.ahead)

    def linearize(
        self, positions: np.ndarray, efforts: np.ndarray, clock: StageClock,
        with_stale_factor: bool, held: HeldActuators | None,
    ) -> Linearized | None:  # fmt: skip
        """See the bodies from their constraints; see `Newton.linearize`, also for the arguments."""
        self._follows = held is not None and not held.is_prescribed
        if with_stale_factor:
            self.factor_age += 1
            self._rows.tell_efforts(efforts)
            self._balance.gather_forces(positions, True)
            clock.mark("assemble")
            linear = self._condense(positions, self._rows.multipliers(efforts))
        else:
            linear = self._factor_and_condense(positions, efforts, held, clock)
            self.is_worn = False
            self.factor_age = 0 if linear else None
        clock.mark("condense")
        if linear:
            self.linear = linear
        return linear

    def _factor_and_condense(
        self, positions: np.ndarray, efforts: np.ndarray, held: HeldActuators | None,
        clock: StageClock,
    ) -> Linearized | None:  # fmt: skip
        """See the bodies by the exact tangent, the augmented one, or the projected one."""
        multipliers = self._rows.multipliers(efforts)
        may_augment = self._augmented is not None and held is not None
        self.is_augmented = self.is_projected = False
        # Masses hold a body in motion, and what is prescribed follows from either tangent.
        is_inverse = may_augment and not (held.is_prescribed or self._model.is_dynamic)
        may_augment = may_augment and (not is_inverse or self._measure_stiffness(clock))
        if not (self.is_indefinite and may_augment):
            self._rows.limit_stiffness(False)
            linear = self._factored(positions, multipliers, clock)
            if linear:
                self.is_indefinite = (
                    is_inverse and may_augment and self._augmented.is_near(linear.W)
                    and self._augmented.choose(efforts, held)
                )
                if not self.is_indefinite:
                    return linear
        self._rows.limit_stiffness(True)
        may_augment = may_augment and self._measure_stiffness(clock)
        may_augment = may_augment and self._augmented.choose(efforts, held)
        if may_augment:
            self.is_augmented, self._held = True, held
            for is_limited in (False, True) if self._rows.may_be_negative else (True,):
                self._rows.limit_stiffness(is_limited)
                linear = self._factored(positions, multipliers, clock)
                if linear:
                    self.is_indefinite = self._augmented.is_needed(
                        linear.W, linear.groups.contacts.start
                    )
                    return linear
        self.is_augmented, self.is_projected, self.is_indefinite = False, True, False
        if self.projects_in_part:
            linear = self._least_projected(positions, multipliers, may_augment, clock)
            if linear:
                return linear
        return self._factored(positions, multipliers, clock)

    def _factored(
        self, positions: np.ndarray, multipliers: np.ndarray, clock: StageClock
    ) -> Linearized | None:
        """See the bodies by the tangent of the kind that is set; None where it is not definite."""
        if self.ahead:
            linear, self.ahead = self.ahead, None
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
        self._balance.assemble(positions, multipliers, True)
        projected = storage.copy()
        self._balance.assemble(positions, multipliers, False)
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
        self.ahead = None
        if not self._factor(rest, np.zeros(rows.row_count), clock):
            return False
        linear = Linearized(self._model.factorization, rows, self._balance.forces)
        self._augmented.measure(linear.W_aa)
        return True

    def _factor(self, positions: np.ndarray, multipliers: np.ndarray, clock: StageClock) -> bool:
        """Assemble and factorize the tangent of the kind that is set."""
        self._balance.assemble(positions, multipliers, self.is_projected)
        clock.mark("assemble")
        factorization = self._model.factorization
        succeeded = self._augmented.factor(positions) if self.is_augmented else factorization.factor()
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
        moves = NO_MOVES
        if model.slides:
            columns = model.slides.columns(rows, self._effector_columns, model.contacts)
            moves = PrescribedMoves(-model.slides.positions(positions), columns)
        solver, augmentation, shift = model.factorization, self._plain, np.zeros(rows.row_count)
        if self.is_augmented:
            held, solver, (a, _, c) = self._held, self._augmented, rows.groups
            reference = model.actuators.limits.drives_within(held.drives, held.bounds)
            augmentation = solver.augmentation(reference)
            shift[a] = augmentation.efforts(np.zeros(a.stop), rows.values[a])
            shift[a] *= augmentation.share
            shift[c] = solver.contact_shift(rows.values[c])
        self._condensed_forces = self._balance.forces
        if self.is_augmented or rows.told is not None:
            self._condensed_forces = self._loaded_forces
            copy_vectors(self._balance.forces, self._loaded_forces)
            rows.add_forces(shift, self._loaded_forces)
        return Linearized(
            solver, rows, self._condensed_forces, moves, row_starts, pressing, augmentation, multipliers
        )

    def true_efforts(self, actuation: Actuation) -> Actuation:
        """The actuation with the efforts λ of its solution λ̂ by the augmented tangent.

        Args:
            actuation: What was found by the last linearization.
        """
        slides, linear = self._model.slides, self.linear
        if not (self.is_augmented or slides):
            return actuation
        a, _, c = linear.groups
        efforts, forces = actuation.efforts.copy(), actuation.contact.multipliers
        if self.is_augmented:
            reach = self._held.reach
            efforts[a] = np.clip(
                linear.efforts(efforts[a], forces), reach.effort_min[a], reach.effort_max[a]
            )
        if slides:
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
            self.linear, solver, self._condensed_forces, positions.copy(),
            efforts[self._rows.groups.actuators],
        )  # fmt: skip

    def judge_projection(self, slope: float, left: float, is_whole: bool) -> None:
        """Choose by the last move how much the next tangent is projected.

        Args:
            slope: Work of the forces b + Hᵀλ there along it, r(0)·dq [J].
            left: Work of the forces after it along it, r(1)·dq [J].
            is_whole: Whether the move was not too long for a linearization.
        """
        slope = abs(slope)
        if is_whole and left > TOO_SHORT * slope:
            self._projection = max(LEAST_PROJECTION, self._projection / LESS_PROJECTION)
        elif not is_whole or left < -slope:
            self._projection = min(1.0, self._projection * LESS_PROJECTION)
