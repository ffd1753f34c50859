"""Elements of a material that remembers what was done to it: viscosity, softening, or both.

What points remember is part of the state of a simulation: `recall` takes it from there before a
step, and `memory_after` gives it at the step's end. Within a step it is constant, so that
forces and stiffness are exact derivatives of one potential; see `viscosity.py` and `softening.py`.
With both, the overstresses follow the stress of the softened law.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import add_scaled_matrix, scaled_matrix
from softrobot_twin.kernels.compilation import KERNEL, UNCACHED, njit
from softrobot_twin.mechanics.element_assembly import deform, gather, is_of_package
from softrobot_twin.mechanics.element_batches import (
    BATCH,
    at,
    matrix_at,
    node_count_of,
    of_nodes,
    put_matrix,
    scratch,
)
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.point_law import energy_density, law_at, law_of
from softrobot_twin.mechanics.softening import SoftenedLaw, SofteningConstants
from softrobot_twin.mechanics.viscosity import (
    StepFactors,
    ViscousLaw,
    ViscousTerm,
    second_piola,
    step_factors,
)


def write_memory(shape, kept, gained, moves, cells, gradients, overstresses, memory):
    """H = Σ (e_i Q_i - f_i γ_i S₀) at all points.

    Args:
        shape: Parameters of the law without its volume.
        kept: e_i, shape (term_count,).
        gained: f_i γ_i, same shape.
        moves: Moves of the nodes from rest [m], shape (node_count, 3).
        cells, gradients: See `element_assembly.add_forces`.
        overstresses: Q_i [Pa], shape (term_count, batch_count, point_count, 9 × BATCH).
        memory: H [Pa]; written, shape (batch_count, point_count, 9 × BATCH).
    """
    U, F, total = np.empty(gradients.shape[2]), scratch(9), gained.sum()
    for k in range(len(cells)):
        count = node_count_of(cells[k])
        gather(moves, cells[k, :count], U)
        for q in range(gradients.shape[1]):
            deform(U, of_nodes(gradients[k, q], count), F)
            for e in range(BATCH):
                S = second_piola(law_at(shape, k, q, e), matrix_at(F, 0, e))
                H = scaled_matrix(S, -total)
                for i in range(len(kept)):
                    H = add_scaled_matrix(H, matrix_at(overstresses[i, k, q], 0, e), kept[i])
                put_matrix(memory[k, q], 0, e, H)


def advance_overstresses(shape, kept, gained, before, after, cells, gradients, overstresses, advanced):
    """Q_i at the end of a step: e_i Q_i + f_i γ_i (S - S₀).

    Args:
        shape, kept, gained, cells, gradients, overstresses: See `write_memory`.
        before: Moves of the nodes from rest where the step began [m], shape (node_count, 3).
        after: Those where it ends [m], same shape.
        advanced: Q_i at its end [Pa]; written, shape of `overstresses`.
    """
    U, V = np.empty(gradients.shape[2]), np.empty(gradients.shape[2])
    F, G = scratch(9), scratch(9)
    for k in range(len(cells)):
        count = node_count_of(cells[k])
        gather(before, cells[k, :count], U)
        gather(after, cells[k, :count], V)
        for q in range(gradients.shape[1]):
            deform(U, of_nodes(gradients[k, q], count), F)
            deform(V, of_nodes(gradients[k, q], count), G)
            for e in range(BATCH):
                law = law_at(shape, k, q, e)
                begun = second_piola(law, matrix_at(F, 0, e))
                change = add_scaled_matrix(second_piola(law, matrix_at(G, 0, e)), begun, -1.0)
                for i in range(len(kept)):
                    Q = scaled_matrix(matrix_at(overstresses[i, k, q], 0, e), kept[i])
                    put_matrix(advanced[i, k, q], 0, e, add_scaled_matrix(Q, change, gained[i]))


def raise_greatest(shape, moves, cells, gradients, greatest):
    """Raise Ψ_m to the energy of a state where it is greater.

    Args:
        shape, moves, cells, gradients: See `write_memory`; `shape` is not softened.
        greatest: Ψ_m [J/m³]; changed, shape (batch_count, point_count, BATCH).
    """
    U, F = np.empty(gradients.shape[2]), scratch(9)
    for k in range(len(cells)):
        count = node_count_of(cells[k])
        gather(moves, cells[k, :count], U)
        for q in range(gradients.shape[1]):
            deform(U, of_nodes(gradients[k, q], count), F)
            for e in range(BATCH):
                energy = energy_density(shape, matrix_at(F, 0, e))
                greatest[k, q, at(0, e)] = max(greatest[k, q, at(0, e)], energy)


class Recording(NamedTuple):
    """The loops over points that change what is remembered, compiled for a law.

    Attributes:
        write_memory: See the function of this name; so the others.
        advance_overstresses: Overstresses.
        raise_greatest: Greatest energies.
    """

    write_memory: Callable
    advance_overstresses: Callable
    raise_greatest: Callable


@cache
def recording_of(parameters: type) -> Recording:
    """The recording for a law; see `assembly_of`.

    Args:
        parameters: The type of the parameters of the law that is wrapped.
    """
    return _KEPT if is_of_package(parameters) else _recording(UNCACHED)


def _recording(options: dict) -> Recording:
    loops = (write_memory, advance_overstresses, raise_greatest)
    return Recording(*(njit(**options)(loop) for loop in loops))

_KEPT = _recording(KERNEL)


class RememberingElements(Elements):
    """Force term of elements whose material is viscous, softens, or both.

    Attributes:
        viscosity: Terms of the Prony series; empty for a material that is not viscous.
        softening: Constants of the softening; None for a material that does not soften.
    """

    remembers_start = may_rest = True
    memory_name = "material"

    def __init__(
        self, mesh, free_index: np.ndarray, law: tuple, viscosity: tuple[ViscousTerm, ...] = (),
        softening: SofteningConstants | None = None,
    ):  # fmt: skip
        """Prepare the elements; nothing has been done to them yet.

        Args:
            mesh: The body at rest, a `CellMesh`.
            free_index: Unknown of each node, -1 where it is fixed, shape (node_count,).
            law: Parameters of a law, see `has_bulk_modulus`.
            viscosity: Terms of a Prony series.
            softening: Constants of the softening.
        """
        self.viscosity, self.softening = tuple(viscosity), softening
        points = len(mesh.shape_functions.quadrature.points)
        batches = -(-len(mesh.cells) // BATCH)
        self._greatest = np.zeros((batches, points, BATCH if softening else 0))
        self._overstresses = np.zeros((len(self.viscosity), batches, points, 9 * BATCH))
        self._memory = np.zeros((batches, points, 9 * BATCH if self.viscosity else 0))
        self._unwrapped = law
        self._recording = recording_of(type(law))
        self._begin_positions = mesh.node_positions.copy()
        self._factors = StepFactors(np.empty(0), np.empty(0))
        self._hourglass_overstresses = np.zeros((len(self.viscosity), 0))
        super().__init__(mesh, free_index, self._law_of_step(0.0))
        self._law_at_rest = law
        self.name = f"{law_of(law).name} elements"
        if self.viscosity:
            self.name = f"viscous {self.name}"
        if softening is not None:
            self.name = f"softening {self.name}"

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the stiffness, see `Elements`, and lay out what hour-glass modes remember."""
        super().bind(elimination_rank, slots)
        if self.hourglass is not None:
            shape = (len(self.viscosity), *self.hourglass.strains.shape)
            self._hourglass_overstresses = np.zeros(shape)

    def _wrapped(self, bulk_modulus: float) -> tuple:
        """The law with another bulk modulus [Pa], softened where it softens."""
        if self.softening is None:
            return self._unwrapped._replace(bulk_modulus=bulk_modulus)
        shape = self._unwrapped._replace(bulk_modulus=0.0)
        return SoftenedLaw(shape, bulk_modulus, self.softening, self._greatest)

    def _law_of_step(self, time_step: float) -> tuple:
        """The law of a step of a duration [s]."""
        if not self.viscosity:
            return self._wrapped(self._unwrapped.bulk_modulus)
        self._factors = step_factors(self.viscosity, time_step)
        scale = self._factors.scale
        base = self._wrapped(self._unwrapped.bulk_modulus / scale)
        return ViscousLaw(base, scale, self._memory)

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """What points of new material remember: overstresses [Pa] of the terms of the series, and the
        greatest energies [J/m³], and overstresses [N] of hour-glass modes; see `recall`."""
        return {"overstresses": np.zeros_like(self._overstresses),
                "greatest": np.zeros_like(self._greatest),
                "hourglass": np.zeros_like(self._hourglass_overstresses)}  # fmt: skip

    def recall(self, memory: Mapping[str, np.ndarray], positions, efforts) -> None:
        """Take what points remember, before `begin_step`.

        Args:
            memory: As `memory_after` or `memory_at_rest` gave it.
            positions: Not needed.
            efforts: Not needed.
        """
        self._overstresses[:], self._greatest[:] = memory["overstresses"], memory["greatest"]
        self._hourglass_overstresses[:] = memory["hourglass"]
        self._forget()

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Fix the potential of the step.

        Args:
            positions: Node positions where it begins [m], shape (node_count, 3).
            velocities: Not needed.
            time_step: h [s].
        """
        self._begin_positions[:] = positions
        if self.viscosity:
            self.law = self._law_of_step(time_step)
            self._recording.write_memory(
                self._wrapped(0.0), *self._factors, positions - self._reference, self._cells,
                self._gradients, self._overstresses, self._memory,
            )  # fmt: skip
            if self.hourglass is not None:
                kept, gained = self._factors
                begun = self.hourglass.forces_at(positions)
                relaxed = np.tensordot(kept, self._hourglass_overstresses, 1)
                self.hourglass.scale[0] = self._factors.scale
                self.hourglass.pull[:] = gained.sum() * begun - relaxed
        self._forget()

    def memory_after(self, positions: np.ndarray, efforts) -> dict[str, np.ndarray]:
        """What points remember after the step that began last.

        Args:
            positions: Node positions at its end [m], shape (node_count, 3).
            efforts: Not needed.
        """
        after, overstresses = positions - self._reference, np.empty_like(self._overstresses)
        if self.viscosity:
            self._recording.advance_overstresses(
                self._wrapped(0.0), *self._factors, self._begin_positions - self._reference, after,
                self._cells, self._gradients, self._overstresses, overstresses,
            )  # fmt: skip
        greatest = self._greatest.copy()
        if self.softening is not None:
            self._recording.raise_greatest(
                self._unwrapped._replace(bulk_modulus=0.0), after, self._cells, self._gradients,
                greatest,
            )  # fmt: skip
        return {"overstresses": overstresses, "greatest": greatest,
                "hourglass": self._hourglass_overstresses_after(positions)}  # fmt: skip

    def _hourglass_overstresses_after(self, positions: np.ndarray) -> np.ndarray:
        """Those of g at the end of a step [N], see `advance_overstresses`."""
        if self.hourglass is None or not self.viscosity:
            return self._hourglass_overstresses.copy()
        kept, gained = self._factors
        change = self.hourglass.forces_at(positions) - self.hourglass.forces_at(self._begin_positions)
        return kept[:, None, None] * self._hourglass_overstresses + gained[:, None, None] * change
