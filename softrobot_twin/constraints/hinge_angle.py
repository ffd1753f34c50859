"""Angles of hinges as displacements of actuators; the multiplier is the torque of the motor.

The angle α of a hinge is the first number of its own block of unknowns
(`mechanics/hinged_frames.py`), so its row of H is constant and has one entry, and the torque λ acts
on both sides of the hinge. The angle is measured from the frames, up to whole turns: it is the one
that is nearest to the middle of the motor's limits.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.mechanics.hinged_frames import HingedFrames

TURN = 2.0 * np.pi


class HingeAngles(ConstraintTerm):
    """Constraint term of hinges that motors drive.

    Attributes:
        hinges: The hinges, shape (row_count,).
        scales: A large angle of each [rad], shape (row_count,).
        stiffness: Typical stiffness of what each turns [N m], shape (row_count,).
    """

    name = "hinge motors"
    group = "actuators"

    def __init__(self, frames: HingedFrames, hinges, limits, stiffness):
        """Take the hinges.

        Args:
            frames: The hinged frames.
            hinges: The hinge of each motor, shape (count,).
            limits: Least and greatest angle of each [rad], less than a turn apart, shape
                (count, 2).
            stiffness: Typical stiffness of what each turns [N m], shape (count,).
        """
        limits = np.array(limits, float).reshape(-1, 2)
        self._frames = frames
        self.hinges, self._middles = np.array(hinges, np.int64), limits.mean(axis=1)
        self.row_count, self.stiffness = len(self.hinges), np.array(stiffness, float)
        widest = np.abs(limits).max(axis=1)
        self.scales = np.where(widest > 0.0, widest, 1.0)
        self.entry_rows = np.arange(self.row_count)
        self.entry_nodes = frames.own[self.hinges]
        self._offsets = self._strides = None

    def angles(self, positions: np.ndarray) -> np.ndarray:
        """Angles [rad], each within half a turn of its middle, shape (row_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        apart = self._frames.angles(positions)[self.hinges] - self._middles
        return self._middles + apart - TURN * np.round(apart / TURN)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and the angles δ [rad]; see `ConstraintTerm.evaluate`."""
        blocks[:] = 1.0, 0.0, 0.0
        values[:] = self.angles(positions)

    def axis_lines(self, positions: np.ndarray) -> np.ndarray:
        """Both ends of a line along each axis, through the hinge [m], shape (row_count, 2, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        frames = self._frames
        places = positions[frames.hinged_nodes[self.hinges]]
        half = frames.hinges.radii[self.hinges, None] * frames.world_axes(positions)[self.hinges]
        return np.stack([places - half, places + half], axis=1)

    def stencils(self) -> np.ndarray:
        """The own unknowns of the hinges, for `add_row_stiffness`, shape (row_count, 1)."""
        return self.entry_nodes.reshape(-1, 1)

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the diagonal blocks."""
        self._offsets, self._strides = slots(self.entry_nodes, self.entry_nodes)

    def add_row_stiffness(self, positions: np.ndarray, stiffness: np.ndarray, storage: np.ndarray) -> None:
        """Add Hᵀ ρ H; see `ConstraintTerm.add_row_stiffness`."""
        storage[self._offsets] += stiffness

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """Share of a move in which no hinge turns by more than a quarter turn."""
        largest = np.abs(move[self.entry_nodes, 0]).max(initial=0.0)
        return 1.0 if largest <= 0.25 * TURN else float(0.25 * TURN / largest)


class YieldingHingeAngles(HingeAngles):
    """Hinges of which some have motors that yield; see `ConstraintTerm.yields`.

    The motor turns by δ = α + λ / k, where the hinge turns by α under the torque λ.

    Attributes:
        compliance: Turn of each motor by its torque [rad/(N m)], shape (row_count, row_count), diagonal.
        stretch_ratios: Ones: the hinge turns as the motor does.
    """

    yields = True

    def __init__(self, frames: HingedFrames, hinges, limits, stiffness, yielding):
        """Take the hinges.

        Args:
            frames: See `HingeAngles`.
            hinges: See there.
            limits: See there.
            stiffness: See there.
            yielding: k of each motor, infinite for one that does not yield [N m/rad], shape (count,).
        """
        super().__init__(frames, hinges, limits, stiffness)
        self.compliance = np.diag(1.0 / np.array(yielding, float))
        self.stretch_ratios = np.ones(self.row_count)
