"""Inertia of free rigid bodies, M v̇ of Coevoet 2017, eq. (1), by backward Euler.

Momentum and angular momentum at the step's end, m Δc/h and J φ/h with J = R I Rᵀ and
φ = log(R R₀ᵀ), differ from those at its beginning by the step's impulse:

    force = -(m Δc/h - m v₀)/h,    torque = -(J φ/h - J₀ ω₀)/h.

So a body without torque keeps its angular momentum in the world exactly, at any time step. Its
energy never grows: with Π the angular momentum in the body's frame and Ω = I⁻¹ Π, the step says
Π₀ - Π = (exp([hΩ]×) - 1) Π, which is at right angles to Ω, so that the energy lost is half of
(Π₀ - Π)·I⁻¹(Π₀ - Π).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.rigid_frames import read_rotation
from softrobot_twin.mechanics.rigid_motion import RigidMotion, write_world_inertia


@njit(cache=True, nogil=True, error_model="numpy")
def write_momenta(x, velocities, origins, first_unknown, inertias, work, out):
    """J ω of every free body."""
    for k in range(len(origins)):
        J, R, w = work[0], work[1], first_unknown + 2 * k + 1
        read_rotation(x, origins[k], R)
        write_world_inertia(R, inertias[k], work[2], J)
        for i in range(3):
            out[k, i] = (
                J[i, 0] * velocities[w, 0] + J[i, 1] * velocities[w, 1] + J[i, 2] * velocities[w, 2]
            )


class RigidInertia(RigidMotion):
    """Force term of the inertia of free rigid bodies. See `RigidMotion` for what it is made of."""

    name = "rigid inertia"

    def begin_step(
        self, positions: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Remember where the step begins, and the momenta there.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
            time_step: h [s].
        """
        self._remember_poses(positions)
        self._scale = 1.0 / time_step**2
        self._write_momenta(positions, velocities, self._twists)
        self._twists /= time_step
        np.multiply(self.masses[:, None], velocities[self._frames.translations], self._pushes)
        self._pushes /= time_step

    def angular_momenta(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """Angular momentum of each body about its centre [N m s], shape (free_body_count, 3)."""
        momenta = np.empty((len(self.masses), 3))
        self._write_momenta(positions, velocities, momenta)
        return momenta

    def _write_momenta(self, positions, velocities, out) -> None:
        write_momenta(
            positions, velocities, self._frames.origins, self._frames.first_unknown,
            self.inertias, self._work, out,
        )  # fmt: skip

    def kinetic_energy(self, positions: np.ndarray, velocities: np.ndarray) -> float:
        """½ m v² + ½ ω·J ω of all free bodies [J]."""
        linear = velocities[self._frames.translations]
        angular = velocities[self._frames.rotations]
        spinning = np.sum(self.angular_momenta(positions, velocities) * angular)
        return 0.5 * float(self.masses @ np.sum(linear**2, axis=1) + spinning)
