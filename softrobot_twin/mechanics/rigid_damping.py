"""Mass-proportional damping of free rigid bodies: Rayleigh's α, or the drag of viscous motion.

    force = -α m Δc/h,    torque = -α J φ/h,    J = R I Rᵀ,  φ = log(R R₀ᵀ).
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.rigid_frames import RigidFrames
from softrobot_twin.mechanics.rigid_motion import RigidMotion


class RigidDamping(RigidMotion):
    """Force term of damping by mass and inertia."""

    name = "rigid damping"

    def __init__(self, frames: RigidFrames, masses, inertias, rates):
        """Prepare.

        Args:
            frames: The rigid bodies; a free body's origin is its centre of mass.
            masses: Mass of each free body [kg], shape (free_body_count,).
            inertias: Inertia about the centre of mass in the body's frame [kg m²],
                shape (free_body_count, 3, 3).
            rates: α of each [1/s], shape (free_body_count,), or one for all.
        """
        rates = np.broadcast_to(np.asarray(rates, dtype=float), np.shape(masses))
        super().__init__(frames, rates * masses, rates[:, None, None] * np.asarray(inertias))

    def begin_step(
        self, positions: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Remember where the step of h [s] begins; see `RigidInertia.begin_step`."""
        self._remember_poses(positions)
        self._scale = 1.0 / time_step
