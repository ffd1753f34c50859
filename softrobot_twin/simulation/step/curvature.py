"""How effectors curve on their way: what a linearization does not know of targets out of reach.

Around a place of the actuators d, half the weighted sum of the squared misses r has the Hessian

    Jᵀ w J + S,   S = Σ w r ∇²x

and a linearization knows the first term only. Near the targets S vanishes. Far from them it decides how far
a move may go along the edge of the workspace: without it, moves go to and fro across a curved valley.

S is learnt from what moves did to J, by the symmetric secant update of least change (Powell 1970), of S
alone as in NL2SOL (Dennis, Gay and Welsch 1981). As there, it is used where it told better than the
linearization alone what came of the last move, and shrinks where it told too much. Its positive part adds
rows to the inverse problem, which stays convex.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Eigenvalues of S below this share of the greatest are none.
LEAST_CURVATURE = 1.0e-6
# Moves of the actuators below this share of their scales teach nothing.
LEAST_MOVE = 1.0e-6
# Drives that others fix to this share change nothing by themselves.
SINGULAR = 1.0e-12


class Seen(NamedTuple):
    """What is known of a place of the actuators.

    Attributes:
        drives: Where they are, shape (actuator_count,).
        jacobian: Displacement of effectors by drives in their scales [m], shape (m, actuator_count).
        pull: |w r| there [m].
        bearing: Which actuators and contacts bear.
    """

    drives: np.ndarray
    jacobian: np.ndarray
    pull: float
    bearing: bytes


class Curvature:
    """S of one simulation towards one set of targets.

    Attributes:
        rows: L of its positive part Lᵀ L, by a move of the drives, shape (n, actuator_count).
        last: Where it learnt last; None before.
        is_known: Whether moves have taught any.
        is_used: Whether it told better than the linearization alone what came of the last move.
    """

    def __init__(self, scales: np.ndarray):
        """Begin with none.

        Args:
            scales: Natural scale of each actuator's drive, shape (actuator_count,).
        """
        self._scales, count = scales, len(scales)
        self._S, self.rows = np.zeros((count, count)), np.zeros((0, count))
        self.last: Seen | None = None
        self.is_known = self.is_used = False

    def forget(self) -> None:
        """Forget all: other targets have another S."""
        self._S[:], self.last = 0.0, None
        self.is_known = self.is_used = False

    def rise(self, move: np.ndarray) -> float:
        """By how much S makes T = ½ Σ w r² rise along a move [m²].

        Args:
            move: Change of the drives, shape (actuator_count,).
        """
        along = self.rows @ move
        return 0.5 * float(along @ along)

    def compare(self, decrease: float, promised: float, rise: float) -> None:
        """Use S for the next move if it told better what came of the last one.

        Args:
            decrease: Decrease of T [m²].
            promised: What the linearization promised without S [m²].
            rise: What S made T rise by [m²].
        """
        self.is_used = abs(decrease - promised + rise) < abs(decrease - promised)

    def learn(self, drives: np.ndarray, jacobian: np.ndarray, pull: np.ndarray, bearing: bytes) -> None:
        """Learn from where the actuators came to.

        Args:
            drives: Where they are, shape (actuator_count,).
            jacobian: J, displacement of effectors by drives, shape (m, actuator_count).
            pull: w r of the effectors' rows [m], shape (m,).
            bearing: Which actuators and contacts bear: J leaps where others do.
        """
        last, S = self.last, self._S
        here = self.last = Seen(drives.copy(), jacobian * self._scales, float(np.linalg.norm(pull)), bearing)
        if last is None:
            return
        S *= min(1.0, here.pull / last.pull)
        s = np.where(here.jacobian.any(axis=0), (drives - last.drives) / self._scales, 0.0)
        squared = float(s @ s)
        if last.bearing != bearing or squared <= LEAST_MOVE**2:
            return
        y, told = (here.jacobian - last.jacobian).T @ pull, float(s @ S @ s)
        if told > 0.0:
            S *= min(1.0, abs(float(s @ y)) / told)
        u = y - S @ s
        S += (np.outer(u, s) + np.outer(s, u)) / squared - float(u @ s) / squared**2 * np.outer(s, s)
        self.is_known, (values, vectors) = True, np.linalg.eigh(S)
        kept = values > LEAST_CURVATURE * max(values[-1], 0.0)
        self.rows = np.sqrt(values[kept])[:, None] * vectors[:, kept].T / self._scales


def jacobian_by_drives(
    W: np.ndarray, effectors: slice, by_displacement: np.ndarray, bears: np.ndarray, stiffness: np.ndarray
) -> np.ndarray:
    """Displacement of effectors by the drives of actuators, shape (effector_row_count, actuator_count).

    Args:
        W: Compliance, the rows of the actuators first [m/N], shape (n, n).
        effectors: Rows of the effectors.
        by_displacement: Which actuators bear and are driven by displacements, shape (actuator_count,).
        bears: Which bear at all, same shape.
        stiffness: ρ of an augmented tangent, zero without [N/m], same shape.
    """
    count = len(bears)
    compliance = W[:count, :count]
    drives = np.where(by_displacement[:, None], compliance, np.eye(count) - stiffness[:, None] * compliance)
    return np.linalg.lstsq(drives.T, W[effectors, :count].T, rcond=SINGULAR)[0].T * bears
