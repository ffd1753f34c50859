"""What a step towards targets begins with, and whether the same is asked as before."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit

# A target that moves by more than this share of its distance is another one.
ANOTHER_TARGET = 0.01
# Loads that change by more than this share of all loads are other ones.
OTHER_LOADS = 0.01
NO_LOADS = np.empty(0)


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
