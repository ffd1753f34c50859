"""How far a linearization is trusted on the way to targets, learnt from what it promised.

Where a target is out of reach, the remaining error bends the problem as much as its linear part
does (the large-residual case of Gauss-Newton), and a full step of the inverse problem overshoots.
So what a step promises is compared with what came of it, as in every trust region method (Nocedal
and Wright 2006, section 4.1). With the tracking term

    T = ½ Σ q (x - x_d)²,     gain = (T_before - T_now) / (T_before - T_promised)

of the places x that the effectors have in balance at held displacements, as the linearization sees
them. A poor gain multiplies a Levenberg-Marquardt weight on moves of the actuators, a good one
divides it. Targets that are reached, or that move, are not affected: there the promise holds. What
was learnt holds for the targets and loads that it was learnt with, and where guided bodies were then.
A guided body that moves counts as targets that move as far.

Where a robot comes no nearer to its target, two things can be the matter. It may have been caught on
its way, for instance behind an obstacle or folded: then its shape at rest is much nearer. Once it lets go:
the actuators go to rest, and it tries again from there. Caught again, it goes back once along the path
of its actuators, as far as the last target that it reached, and tries again from there. At the same
displacements the body may have another shape than on its way, for instance where it slipped around an
obstacle: then its effectors are led back through the places where they were. Where they come near none
of these, the actuators go where they were at the begin of the path.
Or it goes to and fro without gain, because a kink, such as a contact that opens and closes or a
part that snaps, is sharper than a linearization can tell, or drifts without gain, or its body does
not come to balance. Then it goes on with care, as a trust region method does: it goes back to the
nearest place where it was in balance, and each further place that it tries is judged in balance, and
left again unless it is nearer; the next one is then at most half as far. Where none is nearer, the
actuators rest until something changes.

Where the effectors miss and nothing brings them nearer, a kink may hide a nearer place, such as one
with a cable slack that is taut at its greatest shortening. Then the inverse problem is solved beyond
each kink, one in a step, while the actuators stay. They follow on in the most promising branch, and
go back unless the body rests nearer there. So each such leap brings the effectors nearer.

Where targets are reached, what they leave open goes to where its energy is least. On the way the body may
become unstable, and a linearization may lead far away from there. Each time that a move led away from
reached targets, or from balance, further ones at the targets are much shorter. Where the body becomes
unstable at the targets, or leaves them, the actuators go back to where it was stable there last, and stay.
Where T falls no more to speak of, they rest.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit

# Weights on moves, as multiples of the mean curvature of the tracking term; below the first they
# count as zero.
FIRST, GREATEST = 1.0e-3, 1.0e3
TIGHTER, LOOSER = 8.0, 0.25
# Gains below the first are poor, above the second good.
POOR, GOOD = 0.25, 0.7
# With wanted stiffnesses, weights below this multiple of one that gave a poor gain are not tried again:
# efforts that leave the targets alone change a stiffness only by their square, and each try with a
# smaller weight would move the actuators for nothing.
ABOVE_POOR = 4.0
# A promise below this share of the tracking term is round-off.
NO_PROMISE = 1.0e-9
# Where the tracking term falls by less than this share in so many steps, there is no progress.
PROGRESS, PATIENCE = 1.0e-5, 25
# The same, where the actuators drift in one direction, or the body does not come to balance.
LONG_PATIENCE = 3 * PATIENCE
# Actuators go to and fro where they end nearer to where they began than this share of their path.
TO_AND_FRO = 0.5
# Moves below this share of the actuators' scales are round-off.
MOVED = 1.0e-8
# Steps in which a body that does not move may come to balance, before a place is given up.
MOST_WAITS = 10
# Steps with care towards one target; those that a rate hinders do not count.
MOST_CAREFUL_STEPS = 120
# Places in balance that are kept. Among so many trials, T falls by such a share at least.
MOST_PLACES, TRIALS, TRIAL_PROGRESS = 64, 12, 5.0e-3
# The share by which T must promise to fall beyond a kink.
LEAST_PROMISE = 0.02
# Their first weight: along a valley the tracking term bends far less than on the mean.
FIRST_WITH_CARE = 1.0e-6
# The greatest weight with which these begin, and that they may come to.
MOST_AT_FIRST, GREATEST_WITH_CARE = 1.0, 1.0e6
# Where a target is reached, actuators rest soon. Each so many steps it is looked whether what targets
# leave open goes to and fro. From then on, and after so many looks in any case, it goes by ever
# smaller shares, and by ever shorter moves, while its path between two looks does not get shorter by
# this factor.
SETTLING_STEPS, MOST_LOOKS, SETTLING = 8, 9, 0.5
# Actuators that move further between two looks do not rest.
CREEPS = 1.0e-6 * SETTLING_STEPS
# A trial goes at most this share as far as the one before it that was left again. A small weight may
# be tightened in vain, and would try the same place many times.
SHORTER = 0.5
# No linearization moves an actuator further than this share of its scale.
LONGEST_MOVE = 0.25
# Effectors are at targets where T is at most this share of what counts as reached. Until then they come
# nearer by moves of any length.
EXACT = 1.0e-4
# Where a move at reached targets led away from them or from balance, the next ones there are at most this
# share as long.
MUCH_SHORTER = 0.25
# Where a nearer pose is sought by simulation, actuators are calm after so many steps in balance, none of
# which moved one by more than a share of its scale.
CALM_STEPS, CALM = 10, 1.0e-5
# After so many steps towards the same targets, actuators rest which creep by less than a share of their
# scales in a step, while T falls by less than a share in `PATIENCE` steps.
LATE, CREEPING, NO_GAIN = 6 * PATIENCE, 2.0e-4, 4.0e-4
# A target that moves by more than this share of its distance is another one.
ANOTHER_TARGET = 0.01
# Loads that change by more than this share of all loads are other ones.
OTHER_LOADS = 0.01
# A robot has been caught where its shape at rest is nearer than this share of its distance.
CAUGHT = 0.5
# On its way back a robot is in another shape where an effector is further than this share of the body's
# size from where it was; this many steps lead it towards a place that is further away than that.
ELSEWHERE, STEPS_TO_A_PLACE = 0.1, 3
# Places on the path of the actuators that are kept, and how far they are apart at least, as shares
# of the actuators' scales.
LONGEST_PATH, PATH_SPACING = 512, 1.0e-3


class Approach(Enum):
    """What the actuators do about their targets."""

    FOLLOW = "they follow them"
    REST = "they stay, since nothing brings them nearer"
    RETRACE = "they go back along their path, since they were caught on the way"
    LEAD_BACK = "they lead the effectors back through the places where these were on the way"
    RETURN = "they go to a place, and stay there until the body is in balance"
    DEPART = "they go to a place, and stay there or follow from there"
    LOOK = "they stay, while places beyond kinks are sought"


class ActuatorPath:
    """Where actuators and effectors have been since a target was reached last, in bounded memory."""

    def __init__(self, scales: np.ndarray, coordinate_count: int):
        """Allocate.

        Args:
            scales: Displacement of each actuator that is large, shape (actuator_count,).
            coordinate_count: Number of effector coordinates that are noted.
        """
        self._scales = scales
        self._places = np.empty((LONGEST_PATH, len(scales)))
        self._effectors = np.empty((LONGEST_PATH, coordinate_count))
        self.forget()

    def forget(self) -> None:
        """Begin a new path."""
        self._count, self._spacing = 0, PATH_SPACING

    def add(self, displacements: np.ndarray, effectors: np.ndarray) -> None:
        """Note where the actuators are, unless it is near the place noted last.

        Args:
            displacements: Their displacements, shape (actuator_count,).
            effectors: Effector coordinates there [m], shape (coordinate_count,).
        """
        if self._count:
            last = self._places[self._count - 1]
            if longest_move(last, displacements, self._scales) < self._spacing:
                return
        if self._count == LONGEST_PATH:
            self._count //= 2
            for kept in (self._places, self._effectors):
                kept[: self._count] = kept[: 2 * self._count : 2]
            self._spacing *= 2.0
        self._places[self._count], self._effectors[self._count] = displacements, effectors
        self._count += 1

    @property
    def last(self) -> np.ndarray | None:
        """The place noted last, shape (actuator_count,); None at the begin of the path."""
        return self._places[self._count - 1] if self._count else None

    @property
    def last_effectors(self) -> np.ndarray:
        """Effector coordinates at the place noted last [m], shape (coordinate_count,)."""
        return self._effectors[self._count - 1]

    def go_back(self) -> None:
        """Forget the place noted last."""
        self._count = max(0, self._count - 1)

    def go_to_begin(self) -> None:
        """Forget all places but the first."""
        self._count = min(1, self._count)


@njit(**KERNEL)
def are_equal(first, second):
    """Whether `first` and `second`, shape (n,), have equal entries; NaN equals NaN."""
    for i in range(len(first)):
        is_same_nan = np.isnan(first[i]) and np.isnan(second[i])
        if first[i] != second[i] and not is_same_nan:
            return False
    return True


@njit(**KERNEL)
def longest_move(before, after, scales):
    """Greatest move of an actuator as a share of its scale; zero without actuators.

    Args:
        before: Displacements before the move, in the actuators' units, shape (actuator_count,).
        after: Displacements after the move, same shape.
        scales: Scale of each actuator, in the same units, same shape.
    """
    longest = 0.0
    for i in range(len(scales)):
        longest = max(longest, abs(after[i] - before[i]) / scales[i])
    return longest


@njit(**KERNEL)
def half_squares(weights, here, there):
    """½ Σ w (x - y)² [m²].

    Args:
        weights: w, shape (n,).
        here: x [m], shape (n,).
        there: y [m], shape (n,).
    """
    total = 0.0
    for i in range(len(weights)):
        total += weights[i] * (here[i] - there[i]) ** 2
    return 0.5 * total


@njit(**KERNEL)
def compare_targets(weights, targets, places, commanded, other_weights, other_targets, other_commanded):
    """Compare what is asked with where effectors are, and with what was asked before.

    Args:
        weights: w, shape (n,).
        targets: x* [m], same shape.
        places: x [m], same shape.
        commanded: Commanded displacements, NaN where free, shape (actuator_count,).
        other_weights: w before, shape (n,).
        other_targets: x* before [m], same shape.
        other_commanded: Commanded displacements before, shape (actuator_count,).

    Returns:
        T = ½ Σ w (x - x*)² [m²]; the same for the way of the targets, +∞ where weights or commands
        are others; and the greatest weight.
    """
    greatest, way = 0.0, half_squares(weights, targets, other_targets)
    for i in range(len(weights)):
        greatest = max(greatest, weights[i])
    if not (are_equal(weights, other_weights) and are_equal(commanded, other_commanded)):
        way = np.inf
    return half_squares(weights, places, targets), way, greatest


NO_LOADS = np.empty(0)


class Situation(NamedTuple):
    """What a step towards targets begins with.

    Attributes:
        targets: Wanted effector coordinates [m], any number where free, shape (n,).
        weights: Weight of each coordinate, zero where it is free, shape (n,).
        places: Effector coordinates in balance at held displacements [m], shape (n,).
        displacements: Displacements of the actuators, shape (actuator_count,).
        commanded: Those that are commanded, NaN where free, shape (actuator_count,).
        is_balanced: Whether the last step ended near balance.
        loads: Loads from outside, such as touches [N], shape (m,).
        load: Sum of all loads' sizes [N].
        guided: Where points of the guided bodies are [m], shape (k,).
        is_stable: Whether the body was stable at held displacements, as far as its tangent tells.
    """

    targets: np.ndarray
    weights: np.ndarray
    places: np.ndarray
    displacements: np.ndarray
    commanded: np.ndarray
    is_balanced: bool
    loads: np.ndarray = NO_LOADS
    load: float = 0.0
    guided: np.ndarray = NO_LOADS
    is_stable: bool = True

    def tracking(self, at: np.ndarray) -> float:
        """T [m²] of effector coordinates [m], shape (n,).

        Args:
            at: The coordinates [m], shape (n,).
        """
        return half_squares(self.weights, at, self.targets)

    def compared(self, other: Situation | None) -> tuple[float, float, bool]:
        """Compare it with another situation.

        Args:
            other: The other one, or None.

        Returns:
            T of this one [m²], the greatest weight, and whether the targets, commands and loads are
            those of the other one.
        """
        is_like = other is not None and len(self.targets) == len(other.targets)
        asked = other if is_like else self
        now, way, greatest = compare_targets(
            self.weights, self.targets, self.places, self.commanded, asked.weights, asked.targets,
            asked.commanded,
        )  # fmt: skip
        if is_like and len(self.guided):
            carried = float(np.abs(self.guided - other.guided).max())
            way += 0.5 * greatest * carried**2
        is_same = is_like and way <= ANOTHER_TARGET**2 * now and self.bears_the_same(other)
        return now, greatest, is_same

    def bears_the_same(self, other: Situation) -> bool:
        """Whether the loads from outside are those of another situation.

        Args:
            other: The other situation.
        """
        if not len(self.loads):
            return True
        changed = float(np.abs(self.loads - other.loads).max())
        return changed <= OTHER_LOADS * max(self.load, other.load)


class TargetTrust:
    """The trust in the linearizations of one scene.

    Attributes:
        weight: Weight of the energy of a move, as a multiple of the mean curvature of the tracking
            term.
        open_weight: Weight of the energy of a move as a multiple of that of the energy: what targets
            leave open goes by the share 1 / (1 + open_weight) towards the least energy in one step.
        approach: What the actuators do.
        path: Where the actuators have been.
        is_careful: Whether places are tried with care, each until the body is in balance.
        is_at_targets: Whether effectors are at the targets that it follows.
        longest: Longest move of the next trial with care, as a share of the actuators' scales.
        goal: Displacements to which the actuators return, shape (actuator_count,).
        rest: Effector coordinates in the rest shape [m], shape (n,).
        kink: While it looks beyond kinks, the first that it did not look beyond.
        branch: Cables that are slack in the branch beyond a kink that it chose, shape
            (actuator_row_count,); None where it chose none.
    """

    def __init__(
        self, scales: np.ndarray, rest: np.ndarray, tolerance: float, size: float,
        position_count: int,
    ):  # fmt: skip
        """Start with full trust.

        Args:
            scales: Displacement of each actuator that is large, shape (actuator_count,).
            rest: Effector coordinates in the rest shape [m], shape (n,).
            tolerance: Distance within which a target is reached [m].
            size: The body's size [m].
            position_count: Number of coordinates that are positions; those of orientations follow.
        """
        self._elsewhere = ELSEWHERE * size
        self._scales, self.rest, self._tolerance = scales, rest, tolerance
        self._recent = np.empty((PATIENCE + 1, len(scales)))
        self.path = ActuatorPath(scales, position_count)
        self._positions, self._at_rest = slice(position_count), np.zeros(len(scales))
        # Compiled now, not when the first promise is judged.
        longest_move(self._recent[0], self._recent[0], scales)
        half_squares(rest, rest, rest)
        self.forget()

    def forget(self) -> None:
        """Forget all targets."""
        self.weight = self._floor = 0.0
        self._settle_anew()
        # The situation that was followed first, and that of the last step.
        self._asked: Situation | None = None
        self._last: Situation | None = None
        # Positions of the effectors under loads with the actuators at rest [m], where seen.
        self._settled: np.ndarray | None = None
        self._promised: np.ndarray | None = None
        # The nearest place in balance, or the last one under way to other targets.
        self._nearest: Situation | None = None
        # T where it looked beyond kinks last.
        self._looked, self.branch = np.inf, None
        self._start_again()
        self._free_count = self._unbalanced = 0
        # Where to go first, T up to which to stay there, and T below which to rest later [m²].
        self._departure: tuple[np.ndarray, float, float] | None = None
        self.path.forget()

    @property
    def misses(self) -> np.ndarray:
        """Distances from targets where the last step began, times the roots of their weights [m]."""
        last = self._last
        return np.sqrt(last.weights) * (last.places - last.targets)

    def depart(self, goal: np.ndarray, follows: bool, near: float) -> None:
        """Forget all targets, and let the actuators go to a place first.

        Args:
            goal: Their displacements there, shape (actuator_count,).
            follows: Whether they follow targets from there; else they stay.
            near: T below which they stay where they come to rest [m²].
        """
        self.forget()
        self._departure = goal, -math.inf if follows else math.inf, near

    def _start_again(self) -> None:
        self.approach = Approach.FOLLOW
        self._best, self._since, self._since_balanced = np.inf, 0, 0
        self._step_count, self._creeping_from, self._is_hindered = 0, np.inf, False
        self.is_careful, self._least, self.longest = False, np.inf, np.inf
        # Where it leaps from; None where it does not.
        self._home: Situation | None = None

    def begin(self, situation: Situation) -> None:
        """Compare what the last step promised with what came of it, and choose what to do.

        Args:
            situation: What a step begins with.
        """
        now, greatest, is_same = situation.compared(self._asked)
        if not is_same:
            self._asked, self._free_count = situation, 0
            if longest_move(self._at_rest, situation.displacements, self._scales) <= MOVED:
                self._settled = situation.places[self._positions]
            self.weight = self._floor = 0.0
            self._looked, self.branch = np.inf, None
            self._settle_anew()
            self._start_again()
        if self._departure is not None:
            goal, holds_until, self._rests_below = self._departure
            self.go_to(goal, holds_until)
            self._departure = None
        last = self._last
        if last is not None and not (
            len(last.targets) == len(situation.targets) and situation.bears_the_same(last)
            and (not len(situation.guided) or are_equal(situation.guided, last.guided))
        ):
            # What came of the promise is the work of other loads or of guided bodies too.
            self._promised = None
        reached = 0.5 * greatest * self._tolerance**2
        is_free = self.approach is Approach.FOLLOW and not self.is_careful
        if self._promised is not None and is_free and now > reached:
            before = situation.tracking(self._last.places)
            if self._last_move(situation) > MOVED:
                self._learn(before, situation.tracking(self._promised), now)
            else:
                # Nothing came of the promise because nothing was done about it.
                self._set(self.weight * LOOSER)
        self._has_reached = self._has_reached or now <= reached
        self._unbalanced = 0 if situation.is_balanced else self._unbalanced + 1
        if is_free:
            self._restrain(situation, now, reached)
        if is_free and now < self._rests_below:
            self._note_calm(situation)
        holds = self.approach is Approach.DEPART and self._holds_until > 0.0
        if now <= reached and self.approach is Approach.REST:
            self._watch(situation)
        elif now <= reached and not (self.is_careful and self._unbalanced) and not holds:
            self._set(self.weight * LOOSER)
            self._start_again()
            self.path.forget()
        else:
            # Progress is measured by the target asked first, else noise of targets would hide it.
            self._choose(situation, self._asked.tracking(situation.places))
        if self._has_reached and is_free:
            self._settle(situation)
        follows = self.approach is Approach.FOLLOW
        self._is_within = follows and not self.is_careful and now <= reached > 0.0
        self.is_at_targets = self._is_within and now <= EXACT * reached
        if follows:
            self.path.add(situation.displacements, situation.places[self._positions])
        self._last, self._promised = situation, None

    def go_to(self, goal: np.ndarray, holds_until: float = -math.inf) -> None:
        """Let the actuators go to a place, and stay there where T is small; else follow.

        Args:
            goal: Their displacements there, shape (actuator_count,).
            holds_until: T up to which they stay [m²].
        """
        self.approach, self.goal, self._holds_until = Approach.DEPART, goal, holds_until
        self._wait_count, self._distance, self._is_trial = 0, np.inf, True

    def _restrain(self, situation: Situation, now: float, reached: float) -> None:
        """Shorten moves at targets that led away, and go back to where the body was stable there.

        Args:
            situation: What the step begins with.
            now: T [m²].
            reached: T up to which the targets are reached [m²].
        """
        is_balanced = now <= reached and situation.is_balanced
        if self._is_within and not is_balanced:
            self._shorten(MUCH_SHORTER * self._last_move(situation))
        if is_balanced and situation.is_stable and now <= EXACT * reached:
            # What commands or loads that are new do is not yet seen.
            is_free = self._is_within and bool(np.isnan(situation.commanded).all())
            self._stable = situation if is_free else None
        elif now > reached or (is_balanced and not situation.is_stable):
            if self._stable is not None:
                self.go_to(self._stable.displacements, reached)
                self._stable = None

    def _shorten(self, longest: float) -> None:
        """Make moves at reached targets no longer than a share of the actuators' scales."""
        shorter = min(self._longest_at_targets, longest)
        self._longest_at_targets = shorter if shorter > MOVED else 0.0

    @property
    def move_limit(self) -> float:
        """Longest move of the next linearization, as a share of the actuators' scales."""
        return self._longest_at_targets if self.is_at_targets else LONGEST_MOVE

    def _note_calm(self, situation: Situation) -> None:
        """Rest where the actuators went for its own sake, once they are calm there."""
        is_calm = situation.is_balanced and self._last_move(situation) <= CALM
        self._calm_count = self._calm_count + 1 if is_calm else 0
        if self._calm_count >= CALM_STEPS:
            self._rest_at(situation)

    def _rest_at(self, situation: Situation) -> None:
        self.approach, self.resting = Approach.REST, situation

    def _settle_anew(self) -> None:
        self._is_within = self.is_at_targets = False
        # Where the body was stable at the targets last.
        self._stable: Situation | None = None
        self._longest_at_targets = LONGEST_MOVE
        self._rests_below, self._calm_count = 0.0, 0
        self.open_weight, self._has_reached = 0.0, False
        self._settling: np.ndarray | None = None
        self._settled_path, self._settling_path = np.inf, 0.0
        self._settling_count = self._look_count = 0

    def _settle(self, situation: Situation) -> None:
        """Let what the targets leave open come to rest, once they were reached.

        Its least energy is sought by Newton's method without a search along a line, which may go to
        and fro for ever.
        """
        drives = situation.displacements
        if self._settling is None:
            self._settling = drives
            return
        self._settling_path += self._last_move(situation)
        self._settling_count += 1
        if self._settling_count < SETTLING_STEPS:
            return
        path = self._settling_path
        distance = longest_move(self._settling, drives, self._scales)
        self._look_count += 1
        is_late = self.open_weight > 0.0 or self._look_count > MOST_LOOKS
        goes_on = is_late and path > SETTLING * self._settled_path
        if path > MOVED and (distance < TO_AND_FRO * path or goes_on):
            self.open_weight = 2.0 * self.open_weight + 1.0
            self._shorten(MUCH_SHORTER * path / SETTLING_STEPS)
        if is_late and path > CREEPS and self._unbalanced >= SETTLING_STEPS:
            # Where the body creeps away, the target is held by actuators that never rest.
            self._take_care(situation)
        self._settling, self._settled_path = drives, path
        self._settling_path, self._settling_count = 0.0, 0

    def _last_move(self, situation: Situation) -> float:
        """How far the last step moved the actuators, as a share of their scales."""
        return longest_move(self._last.displacements, situation.displacements, self._scales)

    def _learn(self, before: float, promised: float, now: float) -> None:
        """Set the weight by the gain of the last step."""
        promise = before - promised
        if promise <= NO_PROMISE * before:
            return
        gain = (before - now) / promise
        if gain < POOR:
            if self._has_more and self._home is None:
                self._floor = max(self._floor, ABOVE_POOR * max(self.weight, FIRST))
            self.tighten()
        elif gain > GOOD:
            self._set(self.weight * LOOSER)

    def _choose(self, situation: Situation, now: float) -> None:
        """Choose whether to follow, to rest, or to go back; `now` is T [m²]."""
        if self.approach in (Approach.RETRACE, Approach.LEAD_BACK):
            self._go_back(situation)
            if self.path.last is None or now < CAUGHT**2 * self._best:
                self._start_again()
            return
        if self.approach is Approach.REST:
            self._watch(situation)
            return
        if self.approach is Approach.DEPART:
            if self._has_come(situation):
                holds = situation.is_balanced and now <= self._holds_until
                self._start_again()
                if holds:
                    self._rest_at(situation)
            return
        if self._home is not None and self.approach is not Approach.FOLLOW:
            self._stay_or_return(situation)
            return
        if self.is_careful:
            self._go_carefully(situation, now)
            return
        if self._home is not None and self._ends_leap(situation, now):
            return
        if situation.is_balanced and now < self._least:
            self._nearest, self._least = situation, now
        self._recent[:-1] = self._recent[1:]
        self._recent[-1] = situation.displacements / self._scales
        self._step_count += 1
        if self._creeps_on(now) and situation.is_balanced:
            self._rest_at(situation)
            return
        if now < (1.0 - PROGRESS) * self._best:
            self._best, self._since, self._since_balanced = now, 0, 0
            return
        self._since += 1
        self._since_balanced += situation.is_balanced
        # A body that is not in balance is given time for it with care, but not beyond a kink.
        if self._home or (self._since_balanced < PATIENCE and self._since < PATIENCE):
            return
        is_late = self._since >= LONG_PATIENCE
        if (self._since_balanced >= PATIENCE or is_late) and self._frees_itself(situation, now):
            return
        if self._since_balanced >= PATIENCE and self._may_look(situation, now):
            if not self._path_length:
                self._look(situation, now, Approach.FOLLOW)
                return
        drifts = is_late and self._path_length
        if self._unbalanced >= PATIENCE or self._goes_to_and_fro() or drifts:
            if not self._frees_itself(situation, now):
                self._take_care(situation)

    def _creeps_on(self, now: float) -> bool:
        """Whether the actuators creep for long, with a gain that is not worth it; `now` is T [m²]."""
        if self._step_count % PATIENCE:
            return False
        before, self._creeping_from = self._creeping_from, now
        is_free, self._is_hindered = not self._is_hindered, False
        creeps = 0.0 < self._path_length < CREEPING * PATIENCE
        return self.is_late and is_free and creeps and now > (1.0 - NO_GAIN) * before

    @property
    def is_late(self) -> bool:
        """Whether the same targets have been followed for long."""
        return self._step_count >= LATE

    def _frees_itself(self, situation: Situation, now: float) -> bool:
        """Go to rest where it was caught, later back along the path, once each; whether it does."""
        is_free = bool(np.isnan(situation.commanded).all())
        if self._free_count == 2 or not (is_free and self._is_caught(situation, now)):
            return False
        if self._free_count == 0:
            self.go_to(self._at_rest)
            self._is_trial = False
        else:
            self.approach, self._has_led = Approach.RETRACE, False
        self._free_count += 1
        return True

    def _return(self, situation: Situation) -> None:
        """Go to where the actuators are in a situation, and wait for balance there."""
        self.approach, self.goal = Approach.RETURN, situation.displacements
        self._wait_count, self._distance = 0, np.inf

    def _take_care(self, situation: Situation) -> None:
        """Go to the nearest place in balance, and on from there with care."""
        self.is_careful, self._is_trial = True, False
        self._careful_count = self._trial_count = 0
        self._judged = self._expected = np.inf
        self._is_hindered, self._least_at_floor = False, -np.inf
        self._set(min(self.weight, MOST_AT_FIRST))
        if self._nearest is None:
            self._nearest = situation
        self._before, self._back = deque([self._asked], MOST_PLACES), 1
        self._return(self._nearest)

    def _go_carefully(self, situation: Situation, now: float) -> None:
        """Try places near the nearest one, each until the body is in balance; `now` is T [m²]."""
        self._careful_count += not self._is_hindered
        if self._is_trial and self.approach is Approach.FOLLOW:
            self._return(situation)
        gain, promise = self._least - now, self._least - self._expected
        # Balance that is not yet there makes no difference where a place is much further away, nor
        # where the body is back as it was. In another shape it is not back.
        is_clear = gain < -promise if self._is_trial else gain > -POOR * promise
        is_back = self._is_trial or gain > -TRIAL_PROGRESS * self._least
        distance = longest_move(self.goal, situation.displacements, self._scales)
        is_clear = distance <= MOVED and (is_clear or (situation.is_balanced and is_back))
        if not is_clear and self._waits(situation, distance):
            return
        has_come, self._is_trial = self._is_trial, False
        self.approach = Approach.FOLLOW
        if has_come:
            if not (is_clear and situation.is_balanced and gain > 0.0):
                tried = longest_move(self._nearest.displacements, self.goal, self._scales)
                self.longest = SHORTER * tried
                self.tighten()
                self._return(self._nearest)
                return
            self._learn(self._least, self._expected, now)
            self.longest = np.inf
        elif not is_clear and self._before:
            # Not even where it was in balance before: it goes further back, and less far from there.
            self._floor, self._least_at_floor, self._judged = self.weight, self._least, np.inf
            for _ in range(min(self._back, len(self._before))):
                self._nearest = self._before.pop()
            self._back *= 2
            self._least = self._asked.tracking(self._nearest.places)
            self._return(self._nearest)
            return
        if situation.is_balanced:
            if has_come:
                self._before.append(self._nearest)
                self._floor = self._floor if now >= self._least_at_floor else 0.0
            self._nearest, self._least, self._back = situation, now, 1
        if not is_clear or self._is_in_vain(now):
            self.is_careful, self.weight, self.longest = False, 0.0, np.inf
            if self._frees_itself(situation, now):
                return
            self._rest_at(situation)
            if self._may_look(situation, now):
                self._look(situation, now, Approach.REST)
        elif self._careful_count <= 1 and self._may_look(situation, now):
            self._look(situation, now, Approach.FOLLOW)
        else:
            self._is_trial = True

    def _may_look(self, situation: Situation, now: float) -> bool:
        """Whether it did not yet look beyond kinks from where it is in balance; `now` is T [m²]."""
        return situation.is_balanced and now <= (1.0 - TRIAL_PROGRESS) * self._looked

    def _look(self, situation: Situation, now: float, otherwise: Approach) -> None:
        """Begin to look beyond kinks, where nothing brings the effectors nearer.

        Args:
            situation: What the step begins with.
            now: T [m²].
            otherwise: What is done where that is in vain.
        """
        self._looked, self._home, self._otherwise = now, situation, otherwise
        self._was_careful = self.is_careful
        self._promising = (1.0 - LEAST_PROMISE) * now
        self._chosen = self._before_leap = self.branch
        self.approach, self.kink, self._is_trial = Approach.LOOK, 0, False

    def offer(self, branch: np.ndarray, places: np.ndarray) -> None:
        """Take a branch beyond a kink, where it is more promising than all before.

        Args:
            branch: Cables that are slack in it, shape (actuator_row_count,).
            places: Effector coordinates at its optimum, by the linearization [m], shape (n,).
        """
        promised = self._home.tracking(places)
        if promised < self._promising:
            self._promising, self._chosen = promised, branch

    def end_look(self) -> None:
        """Follow on in the most promising branch, if there is one."""
        home, self._home, self.approach = self._home, None, self._otherwise
        self.resting, self._is_trial = home, self.is_careful
        if self._chosen is not self._before_leap:
            self._start_again()
            self._home, self.branch = home, self._chosen
            self.weight = self._floor = 0.0

    def _ends_leap(self, situation: Situation, now: float) -> bool:
        """Stay beyond a kink only where it is nearer in balance; whether it goes back.

        Args:
            situation: What the step begins with.
            now: T [m²].
        """
        if situation.is_balanced and now < (1.0 - TRIAL_PROGRESS) * self._looked:
            self._start_again()
        elif self._since >= PATIENCE or now > self._looked / CAUGHT**2:
            self.branch = self._before_leap
            self._return(self._home)
            return True
        return False

    def _stay_or_return(self, situation: Situation) -> None:
        """Stay while the inverse looks beyond kinks, or go back to where it leapt from."""
        if self.approach is Approach.LOOK:
            return
        if self._has_come(situation):
            self._nearest, self.resting = self._home, situation
            self._home, self.approach = None, self._otherwise
            if self._was_careful:
                self._take_care(situation)

    def _has_come(self, situation: Situation) -> bool:
        """Whether the actuators are at their goal in balance, or come no nearer to it."""
        distance = longest_move(self.goal, situation.displacements, self._scales)
        is_there = distance <= MOVED and situation.is_balanced
        return is_there or not self._waits(situation, distance)

    def _waits(self, situation: Situation, distance: float) -> bool:
        """Whether the actuators are on their way to the goal, or the body to balance."""
        if distance >= self._distance:
            # A step that changed nothing would change nothing again.
            is_kept = are_equal(situation.places, self._last.places)
            self._wait_count += PATIENCE if is_kept and not situation.is_balanced else 1
        self._distance = distance
        return self._wait_count < (MOST_WAITS if self._is_trial else PATIENCE)

    def _is_in_vain(self, now: float) -> bool:
        """Whether further trials would bring the effectors no nearer; `now` is T [m²]."""
        is_slow = False
        if not self._is_hindered:
            if self._trial_count % TRIALS == 0:
                is_slow, self._judged = now > (1.0 - TRIAL_PROGRESS) * self._judged, now
            self._trial_count += 1
        return is_slow or self._careful_count > MOST_CAREFUL_STEPS or self.weight >= GREATEST_WITH_CARE

    def _go_back(self, situation: Situation) -> None:
        """Choose how to go on along the path: by the actuators while the body is as it was."""
        if self.path.last is None:
            return
        missed = situation.places[self._positions] - self.path.last_effectors
        is_near = float(np.abs(missed).max(initial=0.0)) <= self._elsewhere
        if self.approach is Approach.RETRACE:
            if not (is_near or self._has_led):
                self.approach, self._steps_to_place, self._led_count = Approach.LEAD_BACK, 0, 0
            return
        self._led_count = 0 if is_near else self._led_count + 1
        if self._led_count >= PATIENCE:
            # What keeps another shape may let go of it at the displacements of the begin.
            self.path.go_to_begin()
            self.approach, self._has_led = Approach.RETRACE, True
            return
        self._steps_to_place += 1
        if is_near or self._steps_to_place >= STEPS_TO_A_PLACE:
            self.path.go_back()
            self._steps_to_place = 0

    def _is_caught(self, situation: Situation, now: float) -> bool:
        """Whether the shape at rest, as drawn or under loads, is much nearer to the target."""
        # Of what else is wanted than places, such as a stiffness, the shape at rest has nothing.
        rest = np.zeros(len(situation.targets))
        rest[: len(self.rest)] = self.rest
        nearest = situation.tracking(rest)
        if self._settled is not None:
            rest[self._positions] = self._settled
            nearest = min(nearest, situation.tracking(rest))
        return nearest < CAUGHT**2 * now

    @property
    def _path_length(self) -> float:
        """Path of the actuators in the last steps, as a share of their scales; 0 for round-off."""
        if self._step_count < len(self._recent):
            return 0.0
        length = float(np.linalg.norm(np.diff(self._recent, axis=0), axis=1).sum())
        return length if length > MOVED else 0.0

    def _goes_to_and_fro(self) -> bool:
        """Whether the actuators moved much further than they came in the last steps."""
        distance = float(np.linalg.norm(self._recent[-1] - self._recent[0]))
        return distance < TO_AND_FRO * self._path_length

    def _watch(self, situation: Situation) -> None:
        """Follow again where the resting robot is moved by something else."""
        if not self.resting.is_balanced:
            self.resting = situation
            return
        moved = situation.places - self.resting.places
        if float(np.abs(moved).max(initial=0.0)) > self._tolerance:
            self._start_again()

    def expect(self, places: np.ndarray, is_hindered: bool = False) -> None:
        """Note what a step promises.

        Args:
            places: Effector coordinates in balance after it [m], shape (n,).
            is_hindered: Whether it would go further but for a rate; such a step is no trial.
        """
        self._promised = places
        self._is_hindered = is_hindered or (self._is_hindered and not self.is_careful)
        if self.is_careful:
            self._expected = self._last.tracking(places)

    def is_too_long(self, before: np.ndarray, after: np.ndarray) -> bool:
        """Whether a trial goes further than `longest`, and a greater weight may shorten it.

        Args:
            before: Displacements of the actuators before it, shape (actuator_count,).
            after: Those after it, same shape.
        """
        is_longer = longest_move(before, after, self._scales) > self.longest
        return is_longer and self.weight < GREATEST_WITH_CARE

    def tighten(self) -> None:
        """Trust the next step less; without effect where it does not follow targets."""
        if self.approach is not Approach.FOLLOW:
            return
        self._set(max(self.weight, FIRST_WITH_CARE if self.is_careful else FIRST) * TIGHTER)

    @property
    def _has_more(self) -> bool:
        """Whether more is wanted than places of effectors."""
        return self._last is not None and len(self._last.targets) > len(self.rest)

    def _set(self, weight: float) -> None:
        weight = max(weight, self._floor)
        first, greatest = FIRST, GREATEST
        if self.is_careful:
            first, greatest = FIRST_WITH_CARE, GREATEST_WITH_CARE
        self.weight = min(weight, greatest) if weight >= first else 0.0
