"""How far a linearization is trusted on the way to targets, learnt from what it promised.

Where a target is out of reach, the remaining error bends the problem as much as its linear part
does (the large-residual case of Gauss-Newton), and a full step of the inverse problem overshoots.
So what a step promises is compared with what came of it, as in every trust region method (Nocedal
and Wright, Numerical Optimization, 2006, section 4.1). With the tracking term

    T = ½ Σ q (x - x_d)²,     gain = (T_before - T_now) / (T_before - T_promised)

of the places x that the effectors have in balance at held displacements, as the linearization sees
them. A poor gain multiplies a Levenberg-Marquardt weight on moves of the actuators, a good one
divides it. Targets that are reached, or that move, are not affected: there the promise holds.

A target that brings no gain any more is out of reach. Then the actuators rest until the target
changes. Before that, a robot that is further away from its target than its shape at rest would be
has been caught on the way, for instance behind an obstacle: it goes back once along the path of its
actuators, as far as the last target that it reached, and tries again from there.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

# Weights on moves, as multiples of the weight of the energy; below the first they count as zero.
FIRST, GREATEST = 1.0, 1.0e9
TIGHTER, LOOSER = 8.0, 0.25
# Gains below the first are poor, above the second good.
POOR, GOOD = 0.25, 0.7
# A promise below this share of the tracking term is round-off.
NO_PROMISE = 1.0e-9
# Where the tracking term falls by less than this share in so many steps, there is no progress.
PROGRESS, PATIENCE = 1.0e-5, 25
# The same, where the body does not come to balance meanwhile.
PATIENCE_UNBALANCED = 8 * PATIENCE
# A target that moves by more than this share of its distance is another one.
ANOTHER_TARGET = 0.01
# A robot has been caught where its shape at rest is nearer than this share of its distance.
CAUGHT = 0.5
# Places on the path of the actuators that are kept, and how far they are apart at least, as shares
# of the actuators' scales.
LONGEST_PATH, PATH_SPACING = 512, 1.0e-3


class Approach(Enum):
    """What the actuators do about their targets."""

    FOLLOW = "they follow them"
    REST = "they stay, since nothing brings them nearer"
    RETRACE = "they go back along their path, since they were caught on the way"


class ActuatorPath:
    """Where the actuators have been since a target was reached last, in bounded memory."""

    def __init__(self, scales: np.ndarray):
        """Allocate.

        Args:
            scales: Displacement of each actuator that is large, shape (actuator_count,).
        """
        self._scales = scales
        self._places = np.empty((LONGEST_PATH, len(scales)))
        self.forget()

    def forget(self) -> None:
        """Begin a new path."""
        self._count, self._spacing = 0, PATH_SPACING

    def add(self, displacements: np.ndarray) -> None:
        """Note where the actuators are, unless it is near the place noted last.

        Args:
            displacements: Their displacements, shape (actuator_count,).
        """
        if self._count:
            moved = np.abs(displacements - self._places[self._count - 1]) / self._scales
            if moved.max(initial=0.0) < self._spacing:
                return
        if self._count == LONGEST_PATH:
            self._count //= 2
            self._places[: self._count] = self._places[: 2 * self._count : 2]
            self._spacing *= 2.0
        self._places[self._count] = displacements
        self._count += 1

    @property
    def last(self) -> np.ndarray | None:
        """The place noted last, shape (actuator_count,); None at the begin of the path."""
        return self._places[self._count - 1] if self._count else None

    def go_back(self) -> None:
        """Forget the place noted last."""
        self._count = max(0, self._count - 1)


class TargetTrust:
    """The trust in the linearizations of one scene.

    Attributes:
        weight: Weight of the energy of a move, as a multiple of the weight of the energy itself.
        approach: What the actuators do.
        path: Where the actuators have been.
    """

    def __init__(self, scales: np.ndarray, least: float = 0.0):
        """Start with the least weight.

        Args:
            scales: Displacement of each actuator that is large, shape (actuator_count,).
            least: Least weight.
        """
        self._least = least
        self.path = ActuatorPath(scales)
        self.forget()

    def forget(self) -> None:
        """Forget all targets."""
        self.weight = self._least
        self._targets: np.ndarray | None = None
        self._before: np.ndarray | None = None
        self._promised: np.ndarray | None = None
        self._start_again()
        self._has_retraced = False
        self.path.forget()

    def _start_again(self) -> None:
        self.approach = Approach.FOLLOW
        self._best, self._since, self._since_balanced = np.inf, 0, 0

    def begin(
        self, targets: np.ndarray, weights: np.ndarray, places: np.ndarray, rest: np.ndarray,
        tolerance: float, is_balanced: bool,
    ) -> None:  # fmt: skip
        """Compare what the last step promised with what came of it.

        Args:
            targets: Wanted effector coordinates [m], where free any number, shape (n,).
            weights: Weight of each coordinate, zero where it is free, shape (n,).
            places: Effector coordinates in balance at held displacements [m], shape (n,).
            rest: Effector coordinates in the rest shape [m], shape (n,).
            tolerance: Distance within which a target is reached [m].
            is_balanced: Whether the last step ended near balance.
        """

        def tracking(at: np.ndarray) -> float:
            missed = at - targets
            return 0.5 * float(weights @ (missed * missed))

        now = tracking(places)
        if self._is_another(targets, weights, now):
            self._targets, self._has_retraced = targets.copy(), False
            self.weight = self._least
            self._start_again()
        reached = 0.5 * float(weights.max(initial=0.0)) * tolerance**2
        if self._promised is not None and self.approach is Approach.FOLLOW and now > reached:
            self._learn(tracking(self._before), tracking(self._promised), now)
        self._before, self._promised = places.copy(), None
        if now <= reached:
            self._start_again()
            self.path.forget()
        else:
            self._decide(now, tracking(rest), is_balanced)

    def _is_another(self, targets: np.ndarray, weights: np.ndarray, now: float) -> bool:
        """Whether the target is not the one that was followed."""
        if self._targets is None:
            return True
        moved = targets - self._targets
        return 0.5 * float(weights @ (moved * moved)) > ANOTHER_TARGET**2 * now

    def _learn(self, before: float, promised: float, now: float) -> None:
        """Set the weight by the gain of the last step."""
        promise = before - promised
        if promise <= NO_PROMISE * before:
            return
        gain = (before - now) / promise
        if gain < POOR:
            self.tighten()
        elif gain > GOOD:
            self._set(self.weight * LOOSER)

    def _decide(self, now: float, at_rest: float, is_balanced: bool) -> None:
        """Choose whether to follow, to rest, or to go back."""
        if self.approach is Approach.RETRACE:
            if self.path.last is None or now < CAUGHT**2 * self._best:
                self._start_again()
            return
        if now < (1.0 - PROGRESS) * self._best:
            self._best, self._since, self._since_balanced = now, 0, 0
            return
        self._since += 1
        self._since_balanced += is_balanced
        if self._since_balanced < PATIENCE and self._since < PATIENCE_UNBALANCED:
            return
        if at_rest < CAUGHT**2 * now and not self._has_retraced:
            self.approach, self._has_retraced = Approach.RETRACE, True
        else:
            self.approach = Approach.REST

    def expect(self, places: np.ndarray) -> None:
        """Note what a step promises.

        Args:
            places: Effector coordinates in balance after it [m], shape (n,).
        """
        self._promised = places

    def tighten(self) -> None:
        """Trust the next step less."""
        self._set(max(self.weight, FIRST) * TIGHTER)

    def _set(self, weight: float) -> None:
        self.weight = max(self._least, min(weight, GREATEST) if weight >= FIRST else 0.0)
