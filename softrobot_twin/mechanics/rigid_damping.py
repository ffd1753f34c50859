"""Mass-proportional damping of free rigid bodies: Rayleigh's α, or the drag of viscous motion.

    force = -α m Δc/h,    torque = -α J φ/h,    J = R I Rᵀ,  φ = log(R R₀ᵀ).
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.rigid_frames import RigidFrames
from softrobot_twin.mechanics.rigid_motion import RigidMotion


class RigidDamping(RigidMotion):
    """Force term of damping by mass and inertia.

    Attributes:
        rate: α [1/s].
    """

    name = "rigid damping"

    def __init__(self, frames: RigidFrames, masses, inertias, rate: float):
        """Prepare.

        Args:
            frames: The rigid bodies; a free body's origin is its centre of mass.
            masses: Mass of each free body [kg], shape (free_body_count,).
            inertias: Inertia about the centre of mass in the body's frame [kg m²],
                shape (free_body_count, 3, 3).
            rate: α [1/s].
        """
        super().__init__(frames, masses, inertias)
        self.rate = float(rate)

    def begin_step(
        self, positions: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Remember where the step of h [s] begins; see `RigidInertia.begin_step`."""
        self._remember_poses(positions)
        self._scale = self.rate / time_step
