"""Actuators that scale the forces of a force term: moduli of regions, rest shapes of beams.

A number λ of a scene, such as Young's modulus of a region or the rest angle of a beam, enters the
energy in a product λ c V(q). Its displacement is δ = -c V, so that H = -c ∂V/∂q are the forces of a
force term with the energy V, and the geometric stiffness is λ c times the stiffness of this term.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.mechanics.beams import BeamElements, Beams
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.stencil import stacked


class ScaledForces(ConstraintTerm):
    """Constraint term of force terms whose forces are scaled; see the module.

    Attributes:
        parts: Force terms of each row.
    """

    group = "actuators"

    def __init__(
        self, name: str, parts: tuple[tuple[ForceTerm, ...], ...], factors: np.ndarray,
        scales: np.ndarray, free_node_count: int, is_definite: bool,
    ):  # fmt: skip
        """Lay out the rows.

        Args:
            name: What it is called in reports.
            parts: Force terms of each row, on unknowns and not bound yet.
            factors: c of each row, shape (row_count,).
            scales: A large δ of each row, in its unit, shape (row_count,).
            free_node_count: Number of unknowns.
            is_definite: Whether a projected stiffness of the parts counts, also where it is
                subtracted from that of a body.
        """
        self.name, self.parts, self.scales = name, parts, scales
        self.row_count, self._factors, self._is_definite = len(parts), factors, is_definite
        own = [np.concatenate([np.unique(term.stencils()) for term in row]) for row in parts]
        own = [np.unique(nodes[nodes >= 0]) for nodes in own]
        self.entry_nodes = np.concatenate(own)
        self.entry_rows = np.repeat(np.arange(len(parts)), [len(nodes) for nodes in own])
        self._forces, self._scratch = np.empty((free_node_count, 3)), np.empty(0)

    def stencils(self) -> np.ndarray:
        """See `ConstraintTerm.stencils`; those of all parts."""
        return stacked([term.stencils() for row in self.parts for term in row])

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Bind all parts; see `ForceTerm.bind`."""
        for row in self.parts:
            for term in row:
                term.bind(elimination_rank, slots)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and δ = -c V; see `ConstraintTerm.evaluate`."""
        for index, row in enumerate(self.parts):
            self._forces[:], own = 0.0, self.entry_rows == index
            for term in row:
                term.add_forces(positions, self._forces)
            blocks[own] = self._factors[index] * self._forces[self.entry_nodes[own]]
            values[index] = -self._factors[index] * sum(term.energy(positions) for term in row)

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add λ c times the stiffness of the parts; see `ConstraintTerm.add_stiffness`."""
        if projected and not self._is_definite:
            return
        if len(self._scratch) != len(storage):
            self._scratch = np.empty_like(storage)
        for row, multiplier in zip(self.parts, self._factors * multipliers, strict=True):
            if multiplier == 0.0:
                continue
            self._scratch[:] = 0.0
            for term in row:
                term.add(positions, self._forces, self._scratch, projected)
            storage += multiplier * self._scratch


class RestShape(Beams):
    """Force term of what a change of the rest shape of beams adds, for a change of one: V = -p · ε.

    ε are the strains s and ψ less those at rest, and p the stiffnesses times the change. The
    stiffness is that of the state: that of the beams themselves predicts the strains.
    """

    def __init__(self, elements: BeamElements, change: np.ndarray):
        """Lay out the elements.

        Args:
            elements: The elements.
            change: Of s₀ and ψ₀ for an effort of one, shape (element_count, 6).
        """
        super().__init__(elements._replace(damping=np.zeros(len(elements.damping))))
        self._k, self._pulls = np.zeros_like(self._k), elements.stiffness * change

    def follow_move(self, start: np.ndarray) -> None:
        """Predict nothing; see `ForceTerm.follow_move` and the class."""

    def energy(self, positions: np.ndarray) -> float:
        """-p · ε, in units of energy by those of the effort; see `ForceTerm.energy`."""
        return -float(np.sum(self._pulls * (self.strains(positions) - self._rest)))

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add forces and stiffness of the state; see `ForceTerm.add`."""
        self._linearized_at.fill(np.nan)
        super().add(positions, forces, storage, projected)
