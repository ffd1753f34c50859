"""Damping by the rate at which the elastic force changes: Rayleigh's β.

    f(q) + β (f(q) - f(q₀))/h  =  (1 + β/h) f(q) - (β/h) f(q₀)

In small motion this is -K u - β K v. It damps fast vibrations most, and no translation. The first
part is the elastic force of a body that is stiffer by 1 + β/h; the second is constant in the step.

It is not objective: f turns with the body, so that a strained body that spins is braked a little
(or driven, where it is compressed), by a torque of β Σ f × v, which the elastic force itself
has not.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def subtract_held(held, share, unknowns, forces):
    """f -= share · held, at the given unknowns."""
    for k in range(len(unknowns)):
        n = unknowns[k]
        for i in range(3):
            forces[n, i] -= share * held[n, i]


class StiffnessDamping:
    """An elastic force term with its damping: it takes the place of the elastic term.

    What it does not know itself (the energy, say) it leaves to the elastic term. Until the first
    step begins, and if it takes infinitely long, it is the elastic term: that is statics.

    Attributes:
        elastic: The elastic term; its material is the true one.
        beta: β [s].
        name: The elastic term's.
    """

    def __init__(self, elastic, beta: float):
        """Damp an elastic term.

        Args:
            elastic: `CorotationalTets`, `QuadraticTets` or `LinearElastic`.
            beta: Damping force over rate of the elastic force, β [s], not negative.

        Raises:
            ValueError: β is negative or not finite.
        """
        if not 0.0 <= beta < np.inf:
            raise ValueError(f"beta must be finite and not negative, not {beta} s")
        self.elastic = elastic
        self.beta = float(beta)
        self.name = elastic.name
        stencils = elastic.stencils()
        self._unknowns = np.unique(stencils[stencils >= 0])
        self._share = 0.0
        self._stiffened = elastic
        self._held = np.empty((0, 3))

    def __getattr__(self, name: str):
        """What is public and not found here is the elastic term's."""
        if name.startswith("_") or name == "elastic":
            raise AttributeError(name)
        return getattr(self.elastic, name)

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Bind the elastic term and make room for the force that the step begins with."""
        self.elastic.bind(elimination_rank, slots)
        self._stiffened = self.elastic.stiffened(1.0 + self._share)
        self._held = np.zeros((len(elimination_rank), 3))

    def begin_step(
        self, positions: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Remember the elastic force that the step begins with.

        Args:
            positions: Node positions q₀ [m], shape (node_count, 3).
            velocities: Not needed.
            time_step: h [s].
        """
        share = self.beta / time_step
        if share != self._share:
            self._share = share
            self._stiffened = self.elastic.stiffened(1.0 + share)
        self._held[self._unknowns] = 0.0
        self.elastic.add_forces(positions, self._held)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add elastic and damping force [N] to the forces on the free nodes.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.

        Returns:
            Number of elements that are flat or inside out.
        """
        inverted_count = self._stiffened.add_forces(positions, forces)
        subtract_held(self._held, self._share, self._unknowns, forces)
        return inverted_count

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add the forces, and (1 + β/h) ∂F/∂q to the system matrix.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: True for the positive semi-definite tangent.
        """
        self._stiffened.add(positions, forces, storage, projected)
        subtract_held(self._held, self._share, self._unknowns, forces)
