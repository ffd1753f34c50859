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

from softrobot_twin.geometry.vector_arrays import copy_vectors, write_product
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import Actuation
from softrobot_twin.simulation.step.augmented_tangent import HeldActuators
from softrobot_twin.simulation.step.force_balance import ForceBalance
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.simulation.step.merit import Merit, Move
from softrobot_twin.simulation.step.tangent import TOO_SHORT, Tangent
from softrobot_twin.simulation.step.time_budget import StageClock

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
# Factor by which a move by a projected tangent is lengthened where it was far too short, and the most tries.
LONGER, MOST_LENGTHENINGS = 4.0, 8
# Moves that a step makes after such a move at least, none longer than it: the first takes the
# stretch back and hardly moves the body, which the stretch stiffens; the second makes what was
# missing.
MOVES_AFTER_OVERSHOOT = 2
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
        balance: The sums of the terms.
        tangent: The tangent, and the condensed system.
        move: The last correction of the positions.
        merit: What its length is judged by, where it `judges`.
        last_move: Longest displacement of a node in it [m].
    """

    def __init__(self, model: Model):
        """Allocate.

        Args:
            model: The built scene.
        """
        self._model, self._rows = model, model.rows
        self._stays_upright = any(term.stays_upright for term in model.forces)
        self.balance, self.move = ForceBalance(model, self._make_whole), Move(model)
        self.merit = Merit(model, self.move, self.balance.gather_forces)
        self._whole_limit = np.inf if self.merit.judges else LONGEST_MOVE * model.nodes.size
        self._step_limit = self._whole_limit
        self.last_move = self._slope = 0.0
        self._moves_to_make = 0
        self._conserves, is_slender = model.actuators.conserves, any(t.is_slender for t in model.forces)
        # Whole moves of slender bodies push back, and converge all the same.
        self._searches = not (self._conserves or is_slender)
        self._judged: Actuation | None = None
        self._judges_projection = False
        # What the last move of the step displaced, where contacts may lead to and fro.
        may_swing = self._rows.varies and not (self.merit.judges or model.is_dynamic)
        self._last_way = np.zeros_like(self.move.displacement) if may_swing else None
        # A single point has no size, and no round-off that could be told from a move.
        finite = np.isfinite(model.nodes.size)
        self._round_off = ROUND_OFF * model.nodes.size if finite else 0.0
        self._was_folded = False
        self._longest, self._work, self._limit = np.zeros((3, 1))
        self.tangent = Tangent(model, self.balance)

    def forget(self) -> None:
        """Forget what earlier states taught: the next linearization starts from nothing."""
        self.balance.forget()
        self.tangent.forget()
        self.merit.forget()

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

    def _look(
        self, positions: np.ndarray, clock: StageClock, held: HeldActuators | None
    ) -> None:
        """Find what is folded and what touches where a linearization begins."""
        if self.balance.is_folded is None:
            self.balance.sum_forces(positions)
        self._was_folded = self.balance.is_folded
        if self._rows.varies:
            self._rows.detect(positions)
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
        if self.tangent.ahead is None:
            self._look(positions, clock, held)
        return self.tangent.linearize(positions, efforts, clock, with_stale_factor, held)

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
            `Tangent.true_efforts`.
        """
        nodes = self._model.nodes
        self.balance.set_multipliers(actuation)
        self._rows.remember(self.balance.multipliers)
        balance, tangent = self.balance, self.tangent
        if balance.makes_whole and not tangent.is_augmented and tangent.linear.rows is None:
            self._limit[0] = self._step_limit
            if balance.make_whole(positions):
                self.last_move = float(self._longest[0])
                is_judged = is_judged and self.last_move > self._round_off
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
        """Note a move for `asks_for_more_moves` or for the merit.

        Without the work of the forces b + Hᵀλ along it [J], it is noted before it is made.

        At given efforts full moves of slender bodies converge faster than moves that lower the
        energy, and only those of bodies that buckle or are nearly flat are judged.
        """
        if actuation.are_efforts_given:
            is_judged = is_judged and (self.tangent.is_projected or self.balance.is_nearly_flat)
        is_searched = self._searches and is_judged and not actuation.are_efforts_given
        self._judges_projection = self.tangent.projects_in_part and self.tangent.is_projected
        needs_slope = self._model.is_dynamic or not self._conserves or self._judges_projection
        is_judged = is_judged and self.merit.judges
        if needs_slope or is_judged:
            if slope is None:
                self.balance.load(actuation)
                slope = self._left_slope()
            self._slope = slope
        self._judged = actuation if is_searched else None
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
        self.balance.gather_forces(positions)

    @property
    def inverts(self) -> bool:
        """Whether the last move folded elements of upright bodies; asked after `residual`.

        To unfold, a body with folded elements may have to fold other ones.
        """
        return self.balance.is_folded and not self._was_folded

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
        if not self.merit.is_judging or self.merit.trusts(self.balance.forces):
            return True
        return self.merit.accepts(positions, share)

    def asks_for_more_moves(self, share: float) -> bool:
        """Whether a step in motion made a move that went too far, and too few after it.

        Asked after `residual`.

        Args:
            share: Share of the last move that was made.
        """
        went_too_far = share < 1.0
        if self.last_move > self._round_off:
            went_too_far = went_too_far or self._left_slope() < -OVERSHOOT * self._slope
        if went_too_far:
            self._moves_to_make = MOVES_AFTER_OVERSHOOT
            self._step_limit = min(self._step_limit, self.last_move)
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
        settled, is_judging = share, self.merit.is_judging
        if self._judged is not None and not self.inverts:
            settled = self._pushing_share(positions, share)
        elif self.inverts:
            settled *= self.balance.upright_share(self.move.start, positions)
        elif not is_judging:
            settled = self._share_without_swing(share)
            if settled == share:
                return share
        elif self.merit.trusts(self.balance.forces):
            may_lengthen = self.tangent.is_projected and not self._was_folded
            if may_lengthen and self._left_slope() > TOO_SHORT * abs(self._slope):
                return self._lengthened_share(positions, share)
            return share
        if is_judging:
            settled = self.merit.search(positions, settled)
        else:
            self.move.make(positions, settled)
            self.balance.gather_forces(positions)
        if self._stays_upright:
            settled = self._unfolded_share(positions, settled)
        self.last_move *= settled / share
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
            if self.balance.upright_share(start, positions) < 1.0:
                break
            tried = self.merit.try_share(positions, LONGER * share, begin)
            if self.balance.is_folded or not tried.change < best.change:
                break
            share, best = LONGER * share, tried
        self.move.make(positions, share)
        self.last_move *= share
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
            self.balance.gather_forces(positions)
        self.move.make(positions, 0.0)
        self.balance.gather_forces(positions)
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
        if goes_back and self.balance.largest[0] > self._model.scene.solver.residual_tolerance:
            shorter = squared / (squared - along)
            share *= shorter
            way *= shorter
        copy_vectors(way, last)
        return share

    def _left_slope(self) -> float:
        """Work of the forces b + Hᵀλ that were taken last along the whole last move [J]."""
        return float(np.vdot(self.balance.forces, self.move.displacement))

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
            self.tangent.judge_projection(self._slope, self._left_slope(), is_whole)
        return residual

    def makes_progress(self) -> bool:
        """Whether the stale factor in use corrects: at held λ the next correction is much smaller.

        Asked after `correct` and `residual`. Notes when the factor is worn out.

        Returns:
            False when the correction must not be kept.
        """
        longest_left = self.longest_left()
        if longest_left <= self._round_off:
            return True
        self.tangent.is_worn = not longest_left <= WORN_CONTRACTION * self.last_move
        return longest_left <= GREATEST_CONTRACTION * self.last_move

    def longest_left(self) -> float:
        """How far the forces out of balance would still move a node, at held λ [m]."""
        return self._model.nodes.longest(self._model.factorization.solve(self.balance.forces))
