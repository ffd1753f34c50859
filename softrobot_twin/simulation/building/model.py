"""The built scene: terms, rows and limits. Nothing here changes in a step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.constraints.sensors import Sensors
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.compression_watch import CompressionWatch
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.kinematics import Nodes
from softrobot_twin.mechanics.strain_watch import StrainWatch
from softrobot_twin.mechanics.superelements import Superelements
from softrobot_twin.scene.schema import Scene
from softrobot_twin.simulation.building.actuators import Actuators
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.solvers.factorization import Factorization

STAGES = ("detect", "assemble", "factor", "condense", "stiffness", "optimise", "correct", "residual")
"""Names of all stages of a step, in the order they run."""

# Where the scene gives no `reach_tolerance`: its largest value [m], and its share of the size.
REACH_TOLERANCE, REACH_SHARE = 1.0e-4, 1.0e-3


class TargetRows(NamedTuple):
    """Rows that may have targets: positions first, then orientations and sensors.

    Attributes:
        owners: Effector or sensor of each, shape (row_count,).
        weights: Weight of the error of each, same shape.
        lengths: Length per radian [m/rad], of a sensor for a large change [m], of each row but those
            of positions, shape (row_count - position_row_count,).
        count: Number of effectors and sensors.
    """

    owners: np.ndarray
    weights: np.ndarray
    lengths: np.ndarray
    count: int


@dataclass
class Model:
    """The built scene.

    Attributes:
        scene: Its description.
        bodies: Its deformable bodies.
        rigid: Its rigid bodies.
        nodes: The nodes of all of them.
        forces: Force terms; a step sums them.
        beginners: Objects that use the state at the beginning of a step: terms of motion, which
            store it, and guided bodies, which are moved. Empty in statics without guided bodies.
        actuators: The actuators of all kinds.
        effectors: Constraint term of the effectors, without rows where the scene names none.
        contacts: Constraint term of contacts, or None when the scene names none.
        rows: All constraint rows: the actuators', the effectors', then the contacts'.
        markers: Mapping of the markers onto the bodies.
        marker_ids: Their ids, shape (marker_count,).
        effector_markers: For each effector, indices into `marker_ids` of its markers.
        factorization: A⁻¹, laid out for the pattern of all terms.
        guides: Mover of the guided bodies, or None when the scene has none.
        notes: Repairs and warnings, a sentence each.
        superelements: Those of each body that is reduced to vertebrae, by its name.
        beams: Its beams.
        is_dense: Whether A has no zeros, as the coordinates of reduced bodies are all coupled.
        is_held: See `Layout`.
        sensors: What all sensors show, or None when the scene names none.
        wanted_sensors: Constraint term of those that may have targets, or None without any.
    """

    scene: Scene
    bodies: tuple[Body, ...]
    rigid: tuple
    nodes: Nodes
    forces: tuple[ForceTerm, ...]
    beginners: tuple
    actuators: Actuators
    effectors: Any
    contacts: object | None
    rows: RowStack
    markers: BarycentricMapping
    marker_ids: np.ndarray
    effector_markers: tuple[np.ndarray, ...]
    factorization: Factorization
    guides: object | None = None
    notes: list[str] = field(default_factory=list)
    superelements: dict[str, Superelements] = field(default_factory=dict)
    beams: tuple = ()
    is_dense: bool = False
    is_held: bool = True
    sensors: Sensors | None = None
    wanted_sensors: Sensors | None = None

    @property
    def terms(self) -> tuple:
        """All terms that a step sums, in the order they are evaluated."""
        return (*self.forces, *self.rows.terms)

    def force_term(self, kind: type) -> Any:
        """The force term of a kind; None without any.

        Args:
            kind: Its class.
        """
        points = (term.on_points for term in self.forces)
        return next((term for term in points if isinstance(term, kind)), None)

    @property
    def target_rows(self) -> TargetRows:
        """What the rows of the effectors group belong to: effectors, then sensors with targets."""
        effectors, sensors = self.effectors, self.wanted_sensors
        lengths = effectors.row_lengths
        rows = TargetRows(effectors.row_effector, effectors.row_weights, lengths, len(effectors.effectors))
        if sensors is None:
            return rows
        own = rows.count + np.arange(sensors.row_count)
        return TargetRows(
            np.concatenate([rows.owners, own]), np.concatenate([rows.weights, sensors.row_weights]),
            np.concatenate([lengths, sensors.row_lengths]), rows.count + sensors.row_count,
        )  # fmt: skip

    @property
    def reach_tolerance(self) -> float:
        """Distance within which a target counts as reached [m]."""
        given = self.scene.solver.reach_tolerance
        return min(REACH_TOLERANCE, REACH_SHARE * self.nodes.size) if given is None else given

    @property
    def rubs(self) -> bool:
        """True when contacts have friction."""
        return self.rows.varies and self.contacts.rubs

    @property
    def slides(self):
        """Object that prescribes displacements without multipliers, or None without any."""
        return self.actuators.moves

    @property
    def strain_watches(self) -> tuple[StrainWatch, ...]:
        """Watches of the materials that have a range of strains; empty without any."""
        return self._watches("strain_watch")

    @property
    def compression_watches(self) -> tuple[CompressionWatch, ...]:
        """Watches of the hexahedra; empty without any."""
        return self._watches("compression_watch")

    def _watches(self, name: str) -> tuple:
        watches = (getattr(term.on_points, name, None) for term in self.forces)
        return tuple(watch for watch in watches if watch is not None)

    @property
    def is_dynamic(self) -> bool:
        """True when a step needs its duration."""
        return self.scene.integration != "quasi_static"

    @property
    def weighs_stiffness(self) -> bool:
        """True when an effector asks for a stiffness, with a weight."""
        entries = (effector.stiffness for effector in self.scene.effectors)
        return any(entry is not None and entry.weight > 0.0 for entry in entries)

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages of a step, in the order they run."""
        is_there = {
            "detect": self.rows.varies, "stiffness": self.weighs_stiffness,
            "optimise": any(term.group != "effectors" for term in self.rows.terms),
        }  # fmt: skip
        return tuple(stage for stage in STAGES if is_there.get(stage, True))
