"""What a scene becomes before it moves: terms, rows, limits. Nothing here changes in a step."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from softrobot_twin.constraints.terms import RowStack
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene.schema import Scene
from softrobot_twin.simulation.body import Body
from softrobot_twin.simulation.limits import ActuatorLimits
from softrobot_twin.solvers.factorization import Factorization


@dataclass
class Model:
    """The built scene.

    Attributes:
        scene: What it was built from.
        body: The body.
        forces: Force terms; a step sums them.
        cables: Constraint term of the cables, or None when the scene names none.
        effectors: Constraint term of the effectors, or None when the scene names none.
        rows: All constraint rows: the actuators', then the effectors'.
        limits: Limits of the actuators.
        markers: Mapping of the markers onto the body.
        marker_ids: Their ids, shape (marker_count,).
        effector_markers: For each effector, places in `marker_ids` of what moves with it.
        factorization: A⁻¹, laid out for the pattern of all terms.
        notes: What was mended or looks wrong, a sentence each.
    """

    scene: Scene
    body: Body
    forces: tuple
    cables: object | None
    effectors: object | None
    rows: RowStack
    limits: ActuatorLimits
    markers: BarycentricMapping
    marker_ids: np.ndarray
    effector_markers: tuple[np.ndarray, ...]
    factorization: Factorization
    notes: list[str] = field(default_factory=list)

    @property
    def terms(self) -> tuple:
        """All terms that a step sums, in the order they are evaluated."""
        constraints = [term for term in (self.cables, self.effectors) if term is not None]
        return (*self.forces, *constraints)

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages of a step, in the order they run."""
        optimise = ("optimise",) if self.cables is not None else ()
        return ("assemble", "factor", "condense", *optimise, "correct", "residual")
