"""Consistent mass of beams: their inertia, their weight and their damping by mass.

An element moves as its ends lead it: the axis is Hermite's cubic between them, and what lies off the
axis turns with the ends, in shares that change linearly along the element. With the origin c and the
axes r₁, r₂, r₃ of the frame of each end, every point of it is

    x = Σ w_k z_k,    z = (c, r₁, r₂, r₃ of one end, then of the other),

with constant weights w_k. So the mass matrix by z is constant in every pose,

    M_kl = ∫ρ w_k w_l dV,

rotary inertia and the levers of joints included: an end may be a constant pose in the frame of a
rigid body, or of a hinge. Integrals are exact for a straight element. Euler's beam of such elements
has frequencies that are too high by an error of the fourth power of the elements' length.

Inertia is M v̇ of Coevoet 2017, eq. (1), Newton's law of the points, by backward Euler as in its
eqs. (5-8): the force on z is -M (z - z₀ - h u)/h², with u the velocity of z in the step before:
(z₀ - z₋₁)/h, where z₋₁ follows from the state and its velocities. The momentum of a free beam is constant to round-off. For
a scheme of second order see `begin_second_order`. Damping by mass is -α M (z - z₀)/h, and weight is
the constant force g ∫ρ w_k dV. All of them are forces F on z that act on the unknowns by

    f = F_c,    m = Σ r_i × F_i,

and have a symmetric stiffness: that of M, and the turning terms Σ (F_i·r_i) 1 - (F_i r_iᵀ + r_i F_iᵀ)/2
of each rotation. A frame that does not move by itself counts as unaccelerated.

Arguments of the kernels here; those of one element have no first axis:
    aims, constants: a and F₀ of the ends, shape (element_count, 8, 3).
    constant: Those of one element, shape (8, 3).
    factors: Number c of each element, shape (element_count,).
    forces: On the unknowns [N] and [N m], shape (free_node_count, 3); added to.
    loads, z: F and z of one element, shape (8, 3).
    matrices: M [kg], [kg m] and [kg m²], shape (element_count, 8, 8).
    matrix: M of one element, shape (8, 8).
    order, offsets, strides: See `BoundStencils`, shape (element_count, 4) and (element_count, 10).
    origins, unknowns: Node and unknown of the frame of each end, shape (element_count, 2).
    out: Stiffness of one element by its four unknowns, shape (12, 12); added to.
    x: Node positions [m], shape (node_count, 3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import block_diag, bsr_array, coo_array
from scipy.sparse.linalg import spsolve

from softrobot_twin.geometry.matrix3 import ZERO, add_outer, cross_matrix, plus_identity
from softrobot_twin.geometry.vector3 import add, add_scaled, cross, dot, row, scaled, set_row, subtract
from softrobot_twin.kernels.compilation import INLINED, INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.beam_sections import BeamSection
from softrobot_twin.mechanics.beams import BeamElements
from softrobot_twin.mechanics.force_term import ForceTerm, InertiaTerm
from softrobot_twin.mechanics.rigid_bodies import RigidFrames, RigidInertia
from softrobot_twin.mechanics.stencil import add_lever_turning, add_stencil_matrix, of_frames

# Gauss's rule of four points is exact for products of two cubics.
_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


class BeamMasses(NamedTuple):
    """Mass of the elements of beams.

    Attributes:
        origins: Origin node of the frame of each end, shape (element_count, 2).
        unknowns: Translation of that frame, its rotation comes next; -1 where it does not move by
            itself, shape (element_count, 2).
        matrices: M by z [kg], [kg m] and [kg m²], shape (element_count, 8, 8).
        borne: ∫ρ w dV [kg] and [kg m], shape (element_count, 8).
        damping: α [1/s], shape (element_count,).
    """

    origins: np.ndarray
    unknowns: np.ndarray
    matrices: np.ndarray
    borne: np.ndarray
    damping: np.ndarray


def hermite(s: np.ndarray) -> tuple:
    """For each end of an element: its number, and the weights at shares s of its place, of its
    tangent times the length, and of what turns with it.

    Args:
        s: Shares of the element's length, 0 to 1, shape (count,).
    """
    late = s * s * (3.0 - 2.0 * s)
    return (
        (0, 1.0 - late, s * (1.0 - s) ** 2, 1.0 - s),
        (1, late, -s * s * (1.0 - s), s),
    )


def element_masses(
    elements: BeamElements, lengths, section: BeamSection, density: float, damping: float,
    scales: np.ndarray,
) -> BeamMasses:  # fmt: skip
    """Mass of the elements of one beam.

    Args:
        elements: The elements.
        lengths: Length of each at rest [m], shape (element_count,).
        section: The cross-section.
        density: Mass per volume [kg/m³].
        damping: α [1/s].
        scales: Size of the section at both ends of each, shape (element_count, 2).
    """
    lengths = np.asarray(lengths, float)
    count, shares = len(lengths), 0.5 * (1.0 + _PLACES)
    # Weights of the axis, and of the section's y and z, at each place along each element.
    axis, across = np.zeros((4, count, 8)), np.zeros((2, 4, count, 8))
    for end, place, along, turn in hermite(shares):
        first, points, axes = 4 * end, elements.end_points[:, end], elements.end_axes[:, end]
        axis[:, :, first] = place[:, None]
        axis[:, :, first + 1 : first + 4] = place[:, None, None] * points
        tangents = lengths[:, None] * axes[:, :, 0]
        axis[:, :, first + 1 : first + 4] += along[:, None, None] * tangents
        for k in (0, 1):
            across[k, :, :, first + 1 : first + 4] = turn[:, None, None] * axes[:, :, 1 + k]
    squares = (scales[:, 0] + shares[:, None] * (scales[:, 1] - scales[:, 0])) ** 2
    per_place = density * 0.5 * _WEIGHTS[:, None] * lengths * squares
    matrices = section.area * np.einsum("pe,pek,pel->ekl", per_place, axis, axis)
    for moment, own in zip((section.inertia_z, section.inertia_y), across, strict=True):
        matrices += moment * np.einsum("pe,pek,pel->ekl", per_place * squares, own, own)
    borne = section.area * np.einsum("pe,pek->ek", per_place, axis)
    # An end that does not move by itself accelerates nothing.
    held = np.repeat(elements.unknowns < 0, 4, axis=1)
    matrices[held] = 0.0
    matrices.transpose(0, 2, 1)[held] = 0.0
    return BeamMasses(
        elements.origins, elements.unknowns, matrices, borne, np.full(count, damping)
    )


@njit(**INLINED)
def write_ends(x, origins, z):
    """z of one element: the origins of the frames of its ends, and their axes."""
    for end in range(2):
        n = origins[end]
        set_row(z, 4 * end, row(x, n))
        for i in range(1, 4):
            set_row(z, 4 * end + i, subtract(row(x, n + i), row(x, n)))


@njit(**KERNEL)
def _write_all_ends(x, origins, out):
    """z of every element, shape (element_count, 8, 3)."""
    for e in range(len(origins)):
        write_ends(x, origins[e], out[e])


@njit(**INLINED)
def _write_loads(z, aims, matrix, factor, constant, loads):
    """F = constant - factor M (z - aims) of one element."""
    for k in range(8):
        for i in range(3):
            total = 0.0
            if factor != 0.0:
                for l in range(8):
                    total += matrix[k, l] * (z[l, i] - aims[l, i])
            loads[k, i] = constant[k, i] - factor * total


@njit(**INLINED)
def _fold_loads(z, loads, unknowns, forces):
    """Add the forces and torques of loads on the ends of one element."""
    for end in range(2):
        u = unknowns[end]
        if u < 0:
            continue
        set_row(forces, u, add(row(forces, u), row(loads, 4 * end)))
        torque = row(forces, u + 1)
        for i in range(4 * end + 1, 4 * end + 4):
            torque = add(torque, cross(row(z, i), row(loads, i)))
        set_row(forces, u + 1, torque)


@njit(**KERNEL)
def _add_mass_forces(x, origins, unknowns, matrices, aims, factors, constants, forces):
    """Add the forces of every element; see `MassTerm`."""
    z, loads = np.empty((8, 3)), np.empty((8, 3))
    for e in range(len(origins)):
        write_ends(x, origins[e], z)
        _write_loads(z, aims[e], matrices[e], factors[e], constants[e], loads)
        _fold_loads(z, loads, unknowns[e], forces)


@njit(**ONCE)
def _write_element_stiffness(z, M, factor, out):
    """factor Dᵀ M D by the translations and rotations of both ends, shape (12, 12)."""
    for a in range(2):
        for b in range(2):
            lever_a, lever_b, products = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), ZERO
            for j in range(1, 4):
                r, m, n = row(z, 4 * b + j), M[4 * a, 4 * b + j], M[4 * b, 4 * a + j]
                lever_b = add_scaled(lever_b, r, m)
                lever_a = add_scaled(lever_a, row(z, 4 * a + j), n)
                for i in range(1, 4):
                    mass, first = M[4 * a + i, 4 * b + j], row(z, 4 * a + i)
                    products = plus_identity(products, mass * dot(first, r))
                    products = add_outer(products, scaled(r, -mass), first)
            by_b, by_a = cross_matrix(lever_b), cross_matrix(lever_a)
            for p in range(3):
                for q in range(3):
                    out[6 * a + p, 6 * b + q] = factor * M[4 * a, 4 * b] if p == q else 0.0
                    out[6 * a + p, 6 * b + 3 + q] = -factor * by_b[p][q]
                    out[6 * a + 3 + p, 6 * b + q] = factor * by_a[p][q]
                    out[6 * a + 3 + p, 6 * b + 3 + q] = factor * products[p][q]


@njit(**INNER)
def add_turning(z, loads, out):
    """Add Σ (F·r) 1 - (F rᵀ + r Fᵀ)/2 to the rotation of each end."""
    for end in range(2):
        for k in range(4 * end + 1, 4 * end + 4):
            add_lever_turning(row(loads, k), row(z, k), 6 * end + 3, out)


@njit(**KERNEL)
def _add_mass_stiffness(
    x, origins, unknowns, matrices, aims, factors, constants, projected, order, offsets, strides,
    forces, storage,
):  # fmt: skip
    """Add the forces and the stiffness of every element; where projected, without turning terms."""
    z, loads, whole = np.empty((8, 3)), np.empty((8, 3)), np.zeros((12, 12))
    for e in range(len(origins)):
        write_ends(x, origins[e], z)
        _write_loads(z, aims[e], matrices[e], factors[e], constants[e], loads)
        _fold_loads(z, loads, unknowns[e], forces)
        if factors[e] != 0.0:
            _write_element_stiffness(z, matrices[e], factors[e], whole)
        else:
            whole[:] = 0.0
        if not projected:
            add_turning(z, loads, whole)
        add_stencil_matrix(order[e], offsets[e], strides[e], whole, storage)


class MassTerm(ForceTerm):
    """Force term of F = F₀ - c M (z - a), with numbers c, aims a and constant forces F₀.

    Attributes:
        masses: The mass of the elements.
        aims: a of the ends, shape (element_count, 8, 3).
        constants: F₀ on the ends, same shape.
        factors: c of each element, shape (element_count,).
    """

    def __init__(self, masses: BeamMasses):
        """Lay out the elements: without c, aims and forces they have no forces.

        Args:
            masses: Their mass.
        """
        self.masses = masses
        count = len(masses.origins)
        self._stencils = of_frames(masses.unknowns)
        self.aims, self.constants = np.zeros((2, count, 8, 3))
        self.factors = np.zeros(count)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces [N] and torques [N m]; it inverts no element."""
        m = self.masses
        _add_mass_forces(
            positions, m.origins, m.unknowns, m.matrices, self.aims, self.factors,
            self.constants, forces,
        )  # fmt: skip
        return 0

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add forces, and stiffness to the system matrix; see `ForceTerm.add`."""
        m, bound = self.masses, self._bound
        _add_mass_stiffness(
            positions, m.origins, m.unknowns, m.matrices, self.aims, self.factors,
            self.constants, projected, bound.order, bound.offsets, bound.strides, forces, storage,
        )  # fmt: skip

    def ends(self, positions: np.ndarray) -> np.ndarray:
        """z of every element [m] and [-], shape (element_count, 8, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        ends = np.empty_like(self.aims)
        _write_all_ends(positions, self.masses.origins, ends)
        return ends


class BeamWeight(MassTerm):
    """Force term of the weight of beams."""

    name = "weight of beams"
    is_traceable = True

    def __init__(self, masses: BeamMasses, gravity: np.ndarray):
        """Take the mass and gravity.

        Args:
            masses: The mass of the elements.
            gravity: Acceleration [m/s²], shape (3,).
        """
        super().__init__(masses)
        self.constants[:] = masses.borne[:, :, None] * np.asarray(gravity, float)

    def potential(self, positions: np.ndarray) -> float:
        """Potential energy of the weight, zero at the origin of the world [J].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return -float(np.sum(self.constants * self.ends(positions)))


class BeamDamping(MassTerm):
    """Force term of damping by the mass of beams, -α M (z - z₀)/h."""

    name = "mass damping of beams"
    is_traceable = True
    remembers_start = True

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember where the step of h [s] begins; see `ForceTerm.begin_step`."""
        _write_all_ends(positions, self.masses.origins, self.aims)
        np.divide(self.masses.damping, time_step, out=self.factors)


class BeamInertia(MassTerm, InertiaTerm):
    """Force term of the inertia of beams."""

    name = "inertia of beams"
    is_traceable = True
    remembers_start = True

    def __init__(self, masses: BeamMasses, frames: RigidFrames, rigid: RigidInertia | None = None):
        """Take the mass.

        Args:
            masses: The mass of the elements.
            frames: The frames of the scene.
            rigid: Inertia of the other frames, which a beam may join; None without any.
        """
        super().__init__(masses)
        self._frames, self._rigid = frames, rigid

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember the state at the beginning of a step, and go on from there as in the step before.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
            time_step: h [s].
        """
        if time_step == np.inf:
            self.factors[:] = 0.0
            return
        before = self._left(positions, velocities, time_step)
        self.aims = 2.0 * self.ends(positions) - self.ends(before)
        self.factors[:] = self.weight / time_step**2

    def begin_second_order(
        self, positions: np.ndarray, ahead: np.ndarray, velocities: np.ndarray,
        accelerations: np.ndarray, time_step: float,
    ) -> None:  # fmt: skip
        """Remember the state at the beginning of a step of second order.

        With the displacement φ of the unknowns, their acceleration at the end is w (φ/h - u)/h. That
        of z has another part, by the change of ∂z/∂q: z̈ = w (z - a)/h² with

            a = z(q* ⊖ (φ* - h u)) - (z(q* ⊕ h v*) + z(q* ⊖ h v*) - 2 z(q*))/w,

        where q* = q₀ ⊕ φ* and v* are predictions of the end by the acceleration at the beginning:
        their errors change the acceleration by the square of h. At a rigid body that tumbles and is no
        ball, a smaller error in proportion to h remains.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            ahead: u, of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
            velocities: At the beginning, same shape.
            accelerations: Same shape.
            time_step: h [s].
        """
        h = time_step
        if self._rigid is not None:
            # The scheme has J⁻¹ l̇ of a rigid body in place of the acceleration of its rotation.
            own, gyroscopic = self._rigid.gyroscopic_rates(positions, velocities)
            ahead, accelerations = ahead.copy(), accelerations.copy()
            ahead[own] -= h * (0.5 - 1.0 / self.weight) * gyroscopic
            accelerations[own] -= gyroscopic
        end = self._moved(positions, velocities + 0.5 * h * accelerations, h)
        forced = velocities + 0.5 * h * accelerations - ahead
        then = velocities + h * accelerations
        bend = self.ends(self._moved(end, then, h)) + self.ends(self._left(end, then, h))
        bend -= 2.0 * self.ends(end)
        self.aims = self.ends(self._left(end, forced, h)) - bend / self.weight
        self.factors[:] = self.weight / h**2

    def _moved(self, positions, rates, time_step: float) -> np.ndarray:
        moved = positions.copy()
        self._frames.advance(moved, time_step * rates, 1.0)
        return moved

    def _left(self, positions, rates, time_step: float) -> np.ndarray:
        left = positions.copy()
        self._frames.recede(left, time_step * rates)
        return left

    def add_accelerations(self, positions, forces, accelerations) -> None:
        """Write M⁻¹ f of all frames, see `InertiaTerm`: beams couple those that they join.

        It comes after the inertia of rigid bodies, whose own accelerations it replaces.
        """
        frames = self._frames
        first = frames.first_unknown
        D, m = self._derivatives(positions), self.masses
        M = block_diag([coo_array(np.kron(own, np.eye(3))) for own in m.matrices], format="csr")
        M = (D.T @ M @ D).tocsr()[3 * first :, 3 * first :]
        size = M.shape[0] // 3
        blocks = np.zeros((size, 3, 3))
        if self._rigid is not None:
            own, inertias = self._rigid.world_blocks(positions)
            blocks[own - first] += inertias
        # Nothing accelerates the unused numbers of hinges.
        unused = (M.diagonal().reshape(-1, 3) == 0.0) & (np.einsum("kii->ki", blocks) == 0.0)
        blocks += unused[:, :, None] * np.eye(3)
        M = M + bsr_array((blocks, np.arange(size), np.arange(size + 1)), shape=M.shape)
        found = spsolve(M.tocsc(), np.where(unused, 0.0, forces[first:]).ravel())
        accelerations[first:] = found.reshape(-1, 3)

    def _derivatives(self, positions: np.ndarray):
        """D = ∂z/∂q, sparse, shape (24 element_count, 3 free_node_count)."""
        frames, m = self._frames, self.masses
        identity, first = np.eye(3), frames.free_node_count
        through = frames.twist_derivatives(positions)
        values, lines, columns = [], [], []

        def put(block, line, pair):
            """Add a block by a translation or rotation: of an unknown, or of a hinged frame."""
            reached = [(pair, identity)] if pair < first else through[pair - first]
            for unknown, derivative in reached:
                values.append((block @ derivative).ravel())
                lines.append(np.repeat(3 * line + np.arange(3), 3))
                columns.append(np.tile(3 * unknown + np.arange(3), 3))

        for e, ends in enumerate(self.ends(positions)):
            for end in (0, 1):
                u = int(m.unknowns[e, end])
                if u < 0:
                    continue
                put(identity, 8 * e + 4 * end, u)
                for k in range(4 * end + 1, 4 * end + 4):
                    put(np.cross(ends[k], identity), 8 * e + k, u + 1)
        shape = (24 * len(m.origins), 3 * frames.free_node_count)
        entries = (np.concatenate(lines), np.concatenate(columns))
        return coo_array((np.concatenate(values), entries), shape=shape).tocsr()

    def _rates(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """ż of every element, shape (element_count, 8, 3)."""
        return (self._derivatives(positions) @ velocities.ravel()).reshape(-1, 8, 3)

    def kinetic_energy(self, positions: np.ndarray, velocities: np.ndarray) -> float:
        """½ ∫ρ ‖v‖² dV [J]; see `ForceTerm.kinetic_energy`."""
        rates = self._rates(positions, velocities)
        return 0.5 * float(np.einsum("eki,ekl,eli->", rates, self.masses.matrices, rates))
