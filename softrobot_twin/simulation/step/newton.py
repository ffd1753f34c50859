"""One linearization of the motion, and its correction: Coevoet 2017, eq. (9) to (15).

    A dq = b + Hᵀλ,   A = ∂F/∂q (and the geometric stiffness of loaded rows),  b = p - F(q)  (9, 10)
    A dq_free = b,    δ_free = δ(q) + H dq_free                                         (11-13)
    W = H A⁻¹ Hᵀ                                                                        (14)
    λ from an optimisation over W and δ_free                                            (16-18)
    dq = A⁻¹ (b + Hᵀλ)                                                                  (15)

In motion A and b hold inertia and damping of the time step too (5-8). `ForceBalance` sums the terms,
`Tangent` factorizes A and condenses it; here moves are made, and shortened where they went too far.
"""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.geometry.vector_arrays import write_product
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import Actuation
from softrobot_twin.simulation.step.augmented_tangent import HeldActuators
from softrobot_twin.simulation.step.force_balance import ForceBalance
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.simulation.step.share_rule import Move, ShareRule
from softrobot_twin.simulation.step.tangent import Tangent
from softrobot_twin.simulation.step.time_budget import StageClock

# Where no rule tells how far a linearization holds (in motion, with slender parts), no
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
# In motion, a move dq along which forces change from r(0) to r(1) went too far where -r(1)·dq is
# more than this share of r(0)·dq. Parts that turned are stretched then.
OVERSHOOT = 0.1
# Moves that a step makes after such a move at least, none longer than it: the first takes the
# stretch back and hardly moves the body, which the stretch stiffens; the second makes what was
# missing.
MOVES_AFTER_OVERSHOOT = 2


@njit(**KERNEL)
def is_within(number, limit):
    """Whether a `number`, shape (1,), is finite, and no more than `limit`, shape (1,)."""
    return number[0] <= limit[0] and number[0] < np.inf


class Newton:
    """Linearizes a model, and corrects its positions. Its arrays are allocated once.

    Attributes:
        balance: The sums of the terms.
        tangent: The tangent, and the condensed system.
        move: The last correction of the positions.
        share_rule: How much of it is made.
        last_move: Longest displacement of a node in it [m].
    """

    def __init__(self, model: Model):
        """Allocate.

        Args:
            model: The built scene.
        """
        self._model, self._rows = model, model.rows
        self.balance, self.move = ForceBalance(model, self._make_whole), Move(model)
        self.share_rule = ShareRule(model, self.move, self.balance)
        self._whole_limit = np.inf if self.share_rule.judges else LONGEST_MOVE * model.nodes.size
        self._step_limit = self._whole_limit
        self.last_move = self._slope = 0.0
        self._moves_to_make = 0
        self._judges_projection = False
        self._was_folded = False
        self._longest, self._work, self._limit = np.zeros((3, 1))
        self.tangent = Tangent(model, self.balance)

    def forget(self) -> None:
        """Forget what earlier states taught: the next linearization starts from nothing."""
        self.balance.forget()
        self.tangent.forget()
        self.share_rule.forget()

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
        self.share_rule.begin_step()
        if time_step != self.balance.time_step:
            self.tangent.factor_age = None
        self.expect(time_step)

    def take_other_tangent(self) -> None:
        """Make the factor anew: the tangent is another one than in an equally long step before."""
        self.tangent.factor_age = None
        self.balance.forget_stages()

    def expect(self, time_step: float) -> None:
        """Let a step begin.

        Args:
            time_step: Its duration [s].
        """
        self.tangent.ahead = None
        self.balance.expect(time_step)

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
        if self.tangent.is_indefinite or self.tangent.is_projected:
            return False
        self._look(positions, clock, held)
        return self.tangent.prepare(positions, efforts, clock, held)

    def _look(self, positions: np.ndarray, clock: StageClock, held: HeldActuators | None) -> None:
        """Find what is folded and what touches where a linearization begins."""
        if self.balance.is_folded is None:
            self.balance.sum_forces(positions)
        self._was_folded = self.balance.is_folded
        if self._rows.varies:
            self._rows.detect(positions)
            self.share_rule.see_overlaps()
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
        if not self.tangent.ahead:
            self._look(positions, clock, held)
        return self.tangent.linearize(positions, efforts, clock, with_stale_factor, held)

    def correct(
        self, positions: np.ndarray, actuation: Actuation, is_judged: bool = False
    ) -> tuple[float, Actuation]:
        """Move the nodes by A⁻¹ (b + Hᵀλ), eq. (15).

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            actuation: λ of the optimisation.
            is_judged: Whether `settle` judges the move afterwards.

        Returns:
            Share of the move that was made: one, less where it was too long for a
            linearization, zero where it was not finite; and the actuation with its efforts, see
            `Tangent.true_efforts`.
        """
        nodes = self._model.nodes
        self.balance.set_multipliers(actuation)
        self._rows.remember(self.balance.multipliers)
        balance, tangent = self.balance, self.tangent
        if balance.makes_whole and not tangent.is_augmented and tangent.linear.is_whole:
            self._limit[0] = self._step_limit
            if balance.make_whole(positions):
                self.last_move = float(self._longest[0])
                is_judged = is_judged and self.last_move > self.share_rule.round_off
                self._note(actuation, is_judged, float(self._work[0]))
                return 1.0, actuation
        move = tangent.linear.expand(balance.multipliers)
        self.move.begin(positions, move, actuation.efforts)
        longest = nodes.longest(move)
        if math.isfinite(longest):
            share = self._step_limit / longest if longest > self._step_limit else 1.0
            share = min(share, self._rows.largest_share(positions, move))
            self.last_move = share * longest
            actuation = tangent.true_efforts(actuation)
            self._note(actuation, is_judged and longest > self.share_rule.round_off)
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
        self.move.begin(positions, self._model.factorization.expand(self.balance.multipliers))
        nodes.write_largest(move, False, self._longest)
        if not is_within(self._longest, self._limit):
            return False
        if self._rows.largest_share(positions, move) < 1.0:
            return False
        self._rows.add_forces(self.balance.multipliers, self.balance.forces)
        write_product(self.balance.forces.reshape(-1), move.reshape(-1), self._work)
        self.move.make(positions, 1.0)
        return True

    def _note(self, actuation: Actuation, is_judged: bool, slope: float | None = None) -> None:
        """Note a move for `asks_for_more_moves` or for the rule of shares.

        Without the work of the forces b + Hᵀλ along it [J], it is noted before it is made.

        At given efforts full moves of slender bodies converge faster than moves that lower the
        energy, and only those of bodies that buckle or are nearly flat are judged.
        """
        rule, tangent = self.share_rule, self.tangent
        is_judged = is_judged and rule.judges
        if actuation.are_efforts_given:
            is_judged = is_judged and (tangent.is_projected or self.balance.is_nearly_flat)
        self._judges_projection = tangent.projects_in_part and tangent.is_projected
        if slope is None and (is_judged or self._model.is_dynamic or self._judges_projection):
            self.balance.load(actuation)
            slope = rule.work()
        self._slope = slope or 0.0
        rule.begin(actuation, self._slope, is_judged)

    def take_back(self, positions: np.ndarray) -> None:
        """Undo the last move, and take the forces of where it began again, for the next one.

        Args:
            positions: Takes the node positions before it [m], shape (node_count, 3).
        """
        self.move.take_back(positions)
        self.balance.gather_forces(positions)

    @property
    def inverts(self) -> bool:
        """Whether the last move folded elements of upright bodies; asked after `residual`.

        To unfold, a body with folded elements may have to fold other ones.
        """
        return self.balance.is_folded and not self._was_folded

    def asks_for_more_moves(self, share: float) -> bool:
        """Whether a step in motion made a move that went too far, and too few after it.

        Asked after `residual`.

        Args:
            share: Share of the last move that was made.
        """
        went_too_far = share < 1.0
        if self.last_move > self.share_rule.round_off:
            went_too_far = went_too_far or self.share_rule.work() < -OVERSHOOT * self._slope
        if went_too_far:
            self._moves_to_make = MOVES_AFTER_OVERSHOOT
            self._step_limit = min(self._step_limit, self.last_move)
        elif self._moves_to_make:
            self._moves_to_make -= 1
        return self._moves_to_make > 0

    def settle(self, positions: np.ndarray, share: float, is_sought: bool) -> float:
        """Make the share of the last move that the rule asks for; asked after `residual`.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3); moved.
            share: Share of the move that was made.
            is_sought: Whether targets chose what the actuators do.

        Returns:
            The share that is made; forces and residual of the balance are those of it.
        """
        is_too_stiff = self.tangent.is_projected
        settled = self.share_rule.settle(positions, share, self._was_folded, is_too_stiff, is_sought)
        if settled != share:
            self.last_move *= settled / share
        return settled

    def residual(self, positions: np.ndarray, actuation: Actuation) -> float:
        """Largest force out of balance on a node [N]; see `ForceBalance.residual`.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            actuation: λ.
        """
        residual = self.balance.residual(positions, actuation)
        if self._judges_projection:
            self._judges_projection = False
            is_whole = self.last_move < self._step_limit
            self.tangent.judge_projection(self._slope, self.share_rule.work(), is_whole)
        return residual

    def makes_progress(self) -> bool:
        """Whether the stale factor in use corrects: at held λ the next correction is much smaller.

        Asked after `correct` and `residual`. Notes when the factor is worn out.

        Returns:
            False when the correction must not be kept.
        """
        longest_left = self.longest_left()
        if longest_left <= self.share_rule.round_off:
            return True
        self.tangent.is_worn = not longest_left <= WORN_CONTRACTION * self.last_move
        return longest_left <= GREATEST_CONTRACTION * self.last_move

    def longest_left(self) -> float:
        """How far the forces out of balance would still move a node, at held λ [m]."""
        return self._model.nodes.longest(self._model.factorization.solve(self.balance.forces))
