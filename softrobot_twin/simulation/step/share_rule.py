"""How much of a move towards an equilibrium is made: one rule for all moves of statics.

With r = b + Hᵀλ at the λ of the linearization, the work of r along a move dq falls from r(0)·dq to zero
where the linearization holds. Most moves are judged by that alone (Matthies and Strang 1979), and
nothing is computed for it that is not needed anyway:

    r(1)·dq >= -½ r(0)·dq    it is made
    r(1)·dq > 0.9 r(0)·dq    it is made longer, where a projected tangent was too stiff

What went further must decrease a merit, by a share of what its slope promises, and a share of it is
sought by the conditions of Wolfe (Nocedal and Wright 2006, section 3.1). The merit falls by the work of
r, by the trapezoid rule, and contains exact penalties µ λ (section 17.2) of what held actuators miss and
of overlaps. So no energy is needed, and the rule holds with friction along cables too.

Overlaps are detected anew at the tried state, because contacts of other edges and facets are what the
linearization does not know. It takes time, hence they count only where the last moves led to some.
Where contacts rub, moves may lead to and fro; then Aitken's share is made.

Slides prescribe where a base is, so it goes there at once, and carries what is attached to it as a rigid
body; only the displacement of the unknowns has shares.
"""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.geometry.vector_arrays import copy_vectors
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import Actuation
from softrobot_twin.simulation.step.force_balance import ForceBalance
from softrobot_twin.simulation.step.tangent import TOO_SHORT

# Where -r(1)·dq is more than this share of r(0)·dq, a move went too far unless the merit falls by the second
# share of what was promised; by the third one where moves are doubted, which lead to and fro else.
OVERSHOOT, DECREASE, DOUBTED = 0.5, 0.05, 0.25
# A move by a projected tangent that was far too short is made longer by this factor.
LONGER = 4.0
# Penalty of held actuators by their λ (Nocedal and Wright 2006, section 17.2).
PENALTY = 2.0
# Largest penalty of overlaps that are found after a move, by r(0)·dq; beyond, moves are doubted: what they
# overlap counts from then on, in so many moves, and in twice as many each time.
OVERLAP, FIRST_DOUBT = 0.25, 3
# A move or an overlap by this share of the body's size counts as round-off.
ROUND_OFF = 1.0e-9
# False position takes at least such a part of what is left; bisection takes turns with it.
LEAST_PART = 0.1
# Shares that are tried of one move, and of one that still folds an element.
MOST_TRIALS, MOST_UNFOLDINGS = 8, 40
# A move takes the one before it back where it goes at least the first share of that one the other way,
# and at least the second share of its square lies along that one.
BACK, ALONG = 0.5, 0.9


class Move:
    """The last correction of one simulation. Its arrays are allocated once.

    Attributes:
        start: Node positions when slides have moved, and before anything else has [m], shape
            (node_count, 3).
        displacement: What it displaces the unknowns by [m], shape (free_node_count, 3).
    """

    def __init__(self, model: Model):
        """Allocate.

        Args:
            model: The built scene.
        """
        self._nodes, self._slides = model.nodes, model.slides
        self.start = np.empty_like(model.nodes.rest_positions)
        # Without slides it starts from where the positions were.
        self._before = np.empty_like(self.start) if model.slides else self.start
        self.displacement = np.zeros((model.nodes.free_node_count, 3))

    def begin(
        self, before: np.ndarray, displacement: np.ndarray, efforts: np.ndarray | None = None
    ) -> None:
        """Note a correction before it is made.

        Args:
            before: Node positions [m], shape (node_count, 3).
            displacement: Of the unknowns [m], shape (free_node_count, 3).
            efforts: Those of `Actuation`, of slides their displacements, shape (actuator_count,);
                needed with slides.
        """
        copy_vectors(before, self.start)
        copy_vectors(displacement, self.displacement)
        if self._slides:
            self._before[:] = before
            self._slides.shift(self.start, -efforts[-self._slides.count :])

    def make(self, positions: np.ndarray, share: float) -> None:
        """Go from where it starts by a share of the displacement.

        Args:
            positions: Takes the node positions [m], shape (node_count, 3).
            share: The share.
        """
        copy_vectors(self.start, positions)
        self._nodes.advance(positions, self.displacement, share)

    def take_back(self, positions: np.ndarray) -> None:
        """Go back to where the positions were before it, also those of slides.

        Args:
            positions: Takes the node positions [m], shape (node_count, 3).
        """
        positions[:] = self._before


class ShareRule:
    """Judges the moves of one simulation.

    Slender parts are stretched on their way: Newton's method needs a quarter of the moves where
    their energy may rise in between, 4 to 19 for the elastica from rest instead of 14 to 42.

    Attributes:
        judges: Whether moves of this scene are judged: in statics, without slender parts and contacts that
            rub. These stick or slip another way after a move, which the work along it does not know.
        is_judging: Whether the last move is judged.
        round_off: Moves [m] and overlaps [m] up to this say nothing of how far a linearization holds.
        folds_whole: Whether elements were folded by the last move as a whole.
    """

    def __init__(self, model: Model, move: Move, balance: ForceBalance):
        """Take the terms.

        Args:
            model: The built scene.
            move: The last correction of the positions.
            balance: Sums its terms.
        """
        self._model, self._move, self._balance = model, move, balance
        is_slender = any(term.is_slender for term in model.forces)
        self.judges = not (model.is_dynamic or is_slender or model.rubs)
        # A single point has no size, and no round-off that could be told from a move.
        self.round_off = ROUND_OFF * model.nodes.size if math.isfinite(model.nodes.size) else 0.0
        actuators = model.actuators
        self._stays_upright = any(term.stays_upright for term in model.forces)
        self._holds = ~(actuators.is_effort_driven | actuators.is_moved)[model.rows.groups.actuators]
        # What the last move of the step displaced, where contacts may lead to and fro.
        self._may_swing = model.rows.varies and not (self.judges or model.is_dynamic)
        self._last_way = np.zeros((len(move.displacement) if self._may_swing else 0, 3))
        self.forget()

    def forget(self) -> None:
        """Trust the next move."""
        self.is_judging = self.folds_whole = False
        self._bears = np.empty(0)
        self._doubt, self._next_doubt = 0, FIRST_DOUBT

    def begin_step(self) -> None:
        """Forget the move before."""
        self._last_way[:] = 0.0

    def begin(self, actuation: Actuation, slope: float, is_judged: bool) -> None:
        """Take a move.

        Args:
            actuation: What actuators and contacts do, λ.
            slope: r(0)·dq [J]; needed where it is judged.
            is_judged: Whether it is judged.
        """
        self.is_judging, self._actuation, self._slope = is_judged, actuation, abs(slope)
        self.folds_whole = False
        contacts = self._model.contacts
        if is_judged and self._model.rows.varies:
            normals = actuation.contact.multipliers[contacts.row_starts[:-1]]
            pairs, values = contacts.pair[: contacts.count], self._model.rows.values
            self._bears = np.bincount(pairs, normals, len(contacts.pairs))
            # Overlaps are parted no faster than by `push_out_speed`, which the rows hold.
            gaps = values[self._model.rows.groups.contacts][contacts.row_starts[:-1]]
            self._parted = self._deepest(pairs, -gaps)

    def see_overlaps(self) -> None:
        """Look at what was detected after the last move; doubt the next ones if it overlaps.

        Contacts of other edges and facets are what the linearization does not know.
        """
        contacts = self._model.contacts
        if not self._model.rows.varies:
            return
        self._overlaps = self._deepest(contacts.pair[: contacts.count], contacts.overlaps)
        if not self.is_judging:
            return
        if PENALTY * float(self._bears @ self._overlaps) > OVERLAP * self._slope:
            if self._doubt == 0:
                self._next_doubt *= 2
            self._doubt = self._next_doubt
        elif self._doubt:
            self._doubt -= 1

    def _deepest(self, pairs: np.ndarray, overlaps: np.ndarray) -> np.ndarray:
        """The deepest overlap of each pair [m], as far as it is no round-off.

        Args:
            pairs: The pair of each overlap, shape (overlap_count,).
            overlaps: How far they overlap [m], shape (overlap_count,).
        """
        deepest = np.zeros(len(self._model.contacts.pairs))
        np.maximum.at(deepest, pairs, overlaps - self.round_off)
        return deepest

    def work(self) -> float:
        """Work of the forces b + Hᵀλ that were taken last along the whole move [J]."""
        return float(np.vdot(self._balance.forces, self._move.displacement))

    def _decrease(self, positions: np.ndarray, share: float) -> float:
        """Decrease of the merit by a share of the move, by what the slopes at its start promise.

        Args:
            positions: Node positions there [m], shape (node_count, 3).
            share: Share of the move that leads there.
        """
        worth = self._worth_of_holding()
        promised, fell = self._slope + worth, 0.5 * (self._slope + self.work()) + worth
        if self._doubt and self._bears.any():
            overlaps = self._model.contacts.deepest_overlaps(positions)
            overlaps = self._deepest(np.arange(len(overlaps)), overlaps)
            fell -= PENALTY * float(self._bears @ (overlaps - self._overlaps)) / share
            promised += PENALTY * float(self._bears @ self._parted)
        return fell / promised if promised else 1.0

    def _worth_of_holding(self) -> float:
        """Work along the move by which it counts that held actuators come to where they shall be [J].

        It is the slope of an exact penalty, `PENALTY` λ max(0, δ_1 - δ), less that of λ itself.
        """
        count, actuation = len(self._holds), self._actuation
        if actuation.are_efforts_given or not self._holds.any():
            return 0.0
        rows = self._model.rows
        entries = rows.row_index < count
        moved = self._move.displacement[rows.node_index[entries]]
        by_entry = np.einsum("ij,ij->i", rows.blocks[entries], moved)
        pulls = actuation.efforts[:count] * np.bincount(rows.row_index[entries], by_entry, count)
        return (PENALTY - 1.0) * float(np.maximum(pulls, 0.0)[self._holds].sum())

    def went_too_far(self, positions: np.ndarray, share: float) -> bool:
        """Whether a judged move went too far for its linearization; asked where r is taken.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3).
            share: Share of the move that was made.
        """
        if not self.is_judging or (self._doubt == 0 and self.work() >= -OVERSHOOT * self._slope):
            return False
        return not self._decrease(positions, share) >= (DOUBTED if self._doubt else DECREASE)

    def settle(
        self, positions: np.ndarray, share: float, was_folded: bool, is_too_stiff: bool, is_sought: bool
    ) -> float:
        """Make the share of the last move that the rule asks for.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3); moved.
            share: Share of the move that was made.
            was_folded: Whether elements were folded where it begins: to unfold, others may have to fold.
            is_too_stiff: Whether the tangent was projected.
            is_sought: Whether targets chose what the actuators do. They may hold a body where it is unstable, and
                their radius tells how far to go: then the move is at most shortened, where it went too far.

        Returns:
            The share that is made; r is taken there.
        """
        may_fold, settled = was_folded or not self._stays_upright, share
        self.folds_whole = self._balance.is_folded and not was_folded
        if self.folds_whole:
            settled *= self._balance.upright_share(self._move.start, positions)
            self._make(positions, settled)
        elif (is_sought or not self._may_swing) and not (self.is_judging and (
                is_too_stiff or self._doubt or not self.work() >= -OVERSHOOT * self._slope)):  # fmt: skip
            return share
        if self.went_too_far(positions, settled) or (self._balance.is_folded and not may_fold):
            return self._shortened(positions, settled, may_fold)
        # Bodies with folded elements unfold by short moves: long ones end elsewhere.
        may_lengthen = is_too_stiff and self.is_judging and not (was_folded or is_sought)
        if may_lengthen and self.work() > TOO_SHORT * self._slope:
            return self._lengthened(positions, settled)
        if settled == share and self._may_swing and not is_sought:
            settled *= self._share_without_swing(share)
            if settled != share:
                self._make(positions, settled)
        return settled

    def _make(self, positions: np.ndarray, share: float) -> None:
        """Make a share of the move, and take the forces there."""
        self._move.make(positions, share)
        self._balance.residual(positions, self._actuation)

    def _shortened(self, positions: np.ndarray, share: float, may_fold: bool) -> float:
        """Make as much of a move that went too far as the forces push along and the merit falls.

        The share is found by false position and bisection; it meets the conditions of Wolfe, or is the last of those
        tried. None is made where each of many more folds elements: those of rubber fold between the points
        that `ForceBalance.upright_share` follows, too.
        """
        low, high, at_low, at_high = 0.0, share, self._slope, self.work()
        for trial in range(MOST_UNFOLDINGS):
            part = 0.5
            if trial % 2 == 0 and self.is_judging and -math.inf < at_high < 0.0:
                part = max(at_low / (at_low - at_high), LEAST_PART)
            share = low + part * (high - low)
            self._make(positions, share)
            left, folds = self.work(), self._balance.is_folded and not may_fold
            if folds or self.went_too_far(positions, share):
                high, at_high = share, left
            elif self.is_judging and left > OVERSHOOT * self._slope:
                low, at_low = share, left
            else:
                return share
            if trial >= MOST_TRIALS and not folds:
                return share
        self._make(positions, 0.0)
        return 0.0

    def _lengthened(self, positions: np.ndarray, share: float) -> float:
        """Make more of a move by a projected tangent, while the forces push on along it.

        Where a body just buckles, its projected tangent is too stiff by orders of magnitude along
        the way it gives.
        """
        start = self._move.start
        for _ in range(MOST_TRIALS):
            longer = LONGER * share
            if self._model.rows.largest_share(start, longer * self._move.displacement) < 1.0:
                break
            self._make(positions, longer)
            if self._balance.upright_share(start, positions) < 1.0 or self._balance.is_folded:
                break
            if self.went_too_far(positions, longer):
                break
            share = longer
            if self.work() <= OVERSHOOT * self._slope:
                return share
        self._make(positions, share)
        return share

    def _share_without_swing(self, share: float) -> float:
        """Share to make of a move that takes the one before it back and does not bring balance.

        Aitken's extrapolation leads to where such moves would end if each were the same share of the
        one before.
        """
        last, shorter, way = self._last_way, 1.0, share * self._move.displacement
        along, squared = float(np.vdot(way, last)), float(np.vdot(last, last))
        goes_back = along < -BACK * squared and along**2 > ALONG * squared * float(np.vdot(way, way))
        if goes_back and self._balance.largest[0] > self._model.scene.solver.residual_tolerance:
            shorter = squared / (squared - along)
        copy_vectors(shorter * way, last)
        return shorter
