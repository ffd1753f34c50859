"""What a step's motion of rigid bodies is worth, times inertia: forces, torques and stiffness.

The motion from the step's beginning is Δc = c - c₀ and φ = log(R R₀ᵀ); with J = R I Rᵀ

    force = p - s m Δc,    torque = l - s J φ,

s, p and l being the term's own. A turn θ on top of R changes J φ by (J Jr⁻¹(φ) - [J φ]×) θ, where
Jr⁻¹ is the right Jacobian's inverse. Only the symmetric part of that goes to the stiffness: the
rest is smaller by the angle turned in the step times how unlike the principal moments are, so that
Newton's iteration contracts by about that: to 1e-12 in 9 iterations at 0.05 rad a step, in 36 at
0.5 rad, not at all from about 1 rad on (moments 1 : 2 : 2.8; in one iteration where they are equal).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.rigid_frames import RigidFrames, read_rotation
from softrobot_twin.mechanics.rotation import write_inverse_jacobian, write_turn


@njit(cache=True, nogil=True, error_model="numpy")
def write_world_inertia(R, inertia, work, out):
    """J = R I Rᵀ."""
    for i in range(3):
        for j in range(3):
            work[i, j] = (
                R[i, 0] * inertia[0, j] + R[i, 1] * inertia[1, j] + R[i, 2] * inertia[2, j]
            )
    for i in range(3):
        for j in range(3):
            out[i, j] = work[i, 0] * R[j, 0] + work[i, 1] * R[j, 1] + work[i, 2] * R[j, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def read_motion(x, n, rotation_before, inertia, work, turn):
    """φ since the step's beginning into `turn`, and J into work[0]."""
    read_rotation(x, n, work[1])
    write_turn(rotation_before, work[1], work[2], turn)
    write_world_inertia(work[1], inertia, work[2], work[0])


@njit(cache=True, nogil=True, error_model="numpy")
def add_motion_forces(
    x, origins, first_unknown, masses, inertias, centres, rotations, scale, pushes, twists,
    work, turn, forces
):  # fmt: skip
    """Add p - s m Δc and l - s J φ of every body."""
    for k in range(len(origins)):
        n, t = origins[k], first_unknown + 2 * k
        read_motion(x, n, rotations[k], inertias[k], work, turn)
        J = work[0]
        for i in range(3):
            forces[t, i] += pushes[k, i] - scale * masses[k] * (x[n, i] - centres[k, i])
            momentum = J[i, 0] * turn[0] + J[i, 1] * turn[1] + J[i, 2] * turn[2]
            forces[t + 1, i] += twists[k, i] - scale * momentum


@njit(cache=True, nogil=True, error_model="numpy")
def add_motion_stiffness(
    x, origins, masses, inertias, rotations, scale, projected, offsets, strides, work, turn, storage
):
    """Add s m, and the symmetric part of s J Jr⁻¹(φ) or, where projected, s J alone."""
    for k in range(len(origins)):
        read_motion(x, origins[k], rotations[k], inertias[k], work, turn)
        J, jacobian, product = work[0], work[1], work[2]
        for i in range(3):
            storage[offsets[2 * k] + i * (strides[2 * k] + 1)] += scale * masses[k]
        product[:] = J
        if not projected:
            # The right Jacobian's inverse is the transpose of the left one's.
            write_inverse_jacobian(turn, jacobian)
            for i in range(3):
                for j in range(3):
                    product[i, j] = (
                        J[i, 0] * jacobian[j, 0] + J[i, 1] * jacobian[j, 1]
                        + J[i, 2] * jacobian[j, 2]
                    )  # fmt: skip
        for j in range(3):
            o = offsets[2 * k + 1] + j * strides[2 * k + 1]
            for i in range(3):
                storage[o + i] += 0.5 * scale * (product[i, j] + product[j, i])


@njit(cache=True, nogil=True, error_model="numpy")
def remember_poses(x, origins, centres, rotations):
    """Origin and rotation of every free body."""
    for k in range(len(origins)):
        for i in range(3):
            centres[k, i] = x[origins[k], i]
        read_rotation(x, origins[k], rotations[k])


class RigidMotion(ForceTerm):
    """Force term whose forces follow the motion since the step's beginning.

    Attributes:
        masses: Mass of each free body [kg], shape (free_body_count,).
        inertias: Inertia about its origin in its own frame [kg m²], shape (free_body_count, 3, 3).
    """

    remembers_start = True

    def __init__(self, frames: RigidFrames, masses, inertias):
        """Prepare.

        Args:
            frames: The rigid bodies; a free body's origin is its centre of mass.
            masses: Mass of each free body [kg], shape (free_body_count,).
            inertias: Inertia about the centre of mass in the body's frame [kg m²],
                shape (free_body_count, 3, 3), symmetric.

        Raises:
            ValueError: The numbers of bodies differ.
        """
        count = frames.free_body_count
        self._frames = frames
        self.masses = np.array(masses, dtype=float).reshape(-1)
        self.inertias = np.array(inertias, dtype=float).reshape(-1, 3, 3)
        if len(self.masses) != count or len(self.inertias) != count:
            raise ValueError(
                f"{count} free bodies, {len(self.masses)} masses, {len(self.inertias)} inertias"
            )
        self._centres = np.zeros((count, 3))
        self._rotations = np.tile(np.eye(3), (count, 1, 1))
        # Before the first step there is no motion yet, and no force.
        self._scale = 0.0
        self._pushes, self._twists = np.zeros((count, 3)), np.zeros((count, 3))
        self._work, self._turn = np.zeros((3, 3, 3)), np.zeros(3)
        self._offsets = self._strides = None

    def stencils(self) -> np.ndarray:
        """Translation and rotation do not couple about the centre of mass, shape (2 k, 1)."""
        unknowns = np.column_stack([self._frames.translations, self._frames.rotations])
        return unknowns.reshape(-1, 1)

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up the diagonal blocks."""
        unknowns = self.stencils().ravel()
        self._offsets, self._strides = slots(unknowns, unknowns)

    def _remember_poses(self, positions: np.ndarray) -> None:
        remember_poses(positions, self._frames.origins, self._centres, self._rotations)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces [N] and torques [N m]; it inverts no element."""
        add_motion_forces(
            positions, self._frames.origins, self._frames.first_unknown, self.masses,
            self.inertias, self._centres, self._rotations, self._scale, self._pushes,
            self._twists, self._work, self._turn, forces,
        )  # fmt: skip
        return 0

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add forces, and stiffness to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Of the unknowns [N] and [N m], shape (free_node_count, 3); added to.
            storage: The factorization's storage; added to.
            projected: True for a stiffness that is positive whatever the turn. Else it may be
                indefinite where a body turns by more than about a radian in a step.
        """
        self.add_forces(positions, forces)
        add_motion_stiffness(
            positions, self._frames.origins, self.masses, self.inertias, self._rotations,
            self._scale, projected, self._offsets, self._strides, self._work, self._turn, storage,
        )  # fmt: skip
