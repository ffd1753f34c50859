"""Cables that stretch: the length on the winch is that of the unstretched cable.

A cable of axial stiffness EA [N] under the tension λ is longer by the strain λ / EA. Of a path of the
length L(q) the unstretched cable is L / (1 + λ / EA) long, so the shortening at the winch is

    δ = L_rest - L(q) / (1 + λ / EA) = L_rest - L(q) + C λ,    C = L(q) / (EA + λ).

L_rest - L(q) has the rows of a cable that does not stretch, and the stretch adds C to the diagonal of
W. C changes with λ by the strain only, which Newton's method meets by using the C of the last tension.
The strain is the same along the path (Hooke's law, without the mass of the cable). A slack cable has
no strain and no force, as without elasticity.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.cable import CablePath, Cables
from softrobot_twin.mechanics.kinematics import CarriedPoints


class ElasticCables(Cables):
    """Constraint term of cables of which some stretch; see `ConstraintTerm.yields`.

    Attributes:
        axial_stiffness: EA of each cable, infinite for one that does not stretch [N],
            shape (row_count,).
        compliance: C at the state evaluated last [m/N], shape (row_count, row_count), diagonal.
    """

    yields = True

    def __init__(
        self, paths: tuple[CablePath, ...], free_index: np.ndarray, rest_positions: np.ndarray,
        points: CarriedPoints | None = None, may_spread: bool = False,
        axial_stiffness: np.ndarray = np.empty(0),
    ):  # fmt: skip
        """Divide the paths into segments.

        Args:
            paths: The cables.
            free_index: Unknown or carried point of each node, -1 where fixed,
                shape (node_count,).
            rest_positions: Node positions at rest [m], shape (node_count, 3).
            points: The carried points of the scene; None without any.
            may_spread: See `Cables`.
            axial_stiffness: EA of each cable, infinite for one that does not stretch [N],
                shape (row_count,).
        """
        self.axial_stiffness = np.array(axial_stiffness, float)
        self.compliance = np.zeros((len(paths), len(paths)))
        self._told = np.zeros(len(paths))
        super().__init__(paths, free_index, rest_positions, points, may_spread)
        self._set_compliance(self.rest_lengths)

    @property
    def stretch_ratios(self) -> np.ndarray:
        """1 + λ / EA of each cable at the told tensions, shape (row_count,)."""
        return 1.0 + self._told / self.axial_stiffness

    def tell_efforts(self, efforts: np.ndarray) -> None:
        """Set the tensions [N], shape (row_count,); see `ConstraintTerm.tell_efforts`."""
        self._told = np.array(efforts, float)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and the shortenings of the paths [m], and the compliance."""
        self._write_rows(positions, blocks, values)
        self._set_compliance(values)
        np.subtract(self.rest_lengths, values, out=values)

    def _set_compliance(self, lengths: np.ndarray) -> None:
        np.fill_diagonal(self.compliance, lengths / (self.axial_stiffness + self._told))
