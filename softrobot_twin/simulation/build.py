"""From a scene to its terms: only the terms that the scene names are built."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.errors import SceneError
from softrobot_twin.kernels.worker_threads import default_thread_count
from softrobot_twin.mechanics.held_axes import HeldAxes
from softrobot_twin.mechanics.kinematics import on_unknowns
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.scene import Scene
from softrobot_twin.scene.entry_warnings import entry_warnings
from softrobot_twin.simulation.building.actuators import Actuators, build_actuators
from softrobot_twin.simulation.building.deformable_body import of_kind
from softrobot_twin.simulation.building.effector_building import effector_term, marker_mapping
from softrobot_twin.simulation.building.contact_building import contact_term
from softrobot_twin.simulation.building.force_building import force_terms
from softrobot_twin.simulation.building.guided_bodies import Guides
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.reduced_body import ReducedBody
from softrobot_twin.simulation.building.scene_layout import Layout, lay_out
from softrobot_twin.simulation.building.sensor_kinds import sensor_term
from softrobot_twin.simulation.scene_warnings import coarse_ropes, single_layers, unit_slips
from softrobot_twin.solvers import FACTORIZATIONS
from softrobot_twin.solvers.dense_stiffness import DenseStiffness
from softrobot_twin.solvers.factorization import Factorization
from softrobot_twin.solvers.multifrontal import Multifrontal

# Most unknowns of a matrix without zeros: beyond, those between several reduced bodies are worth more.
MOST_DENSE = 400


def build_model(
    scene: Scene, factorization_type: type | None = None, with_warnings: bool = True,
    mounted: np.ndarray | None = None,
) -> Model:  # fmt: skip
    """Turn every effect of a scene into one term, and lay out the system they sum to.

    Args:
        scene: The scene.
        factorization_type: Class of the factorization, in place of the one that the scene names.
        with_warnings: Whether to look for unlikely values; for this the body is solved under its
            weight.
        mounted: See `lay_out`.

    Returns:
        The model.

    Raises:
        SceneError: An entry does not fit the mesh.
        MeshError: The mesh cannot be used.
    """
    try:
        model = _model_of(scene, factorization_type, mounted)
        if with_warnings:
            model.notes.extend([*unit_slips(model), *model.actuators.doubts(model), *single_layers(scene, model),
                                *entry_warnings(scene, model.nodes.size), *coarse_ropes(scene)])
    except SceneError as error:
        raise scene.source.error(error) from None
    model.notes[:] = scene.source.notes(model.notes)
    return model


class Terms(NamedTuple):
    """The terms of a scene, and the bodies that they are of.

    Attributes:
        layout: The bodies and their unknowns.
        forces: Force terms.
        actuators: The actuators of all kinds.
        effectors: Constraint term of the effectors, without rows where there are none.
        markers: See `marker_mapping`.
        contacts: Constraint term of contacts; None without any.
        notes: Repairs and warnings, a sentence each.
        sensors: What all sensors show; None without any.
        wanted_sensors: Constraint term of the sensors that may have targets; None without any.
    """

    layout: Layout
    forces: tuple
    actuators: Actuators
    effectors: Any
    markers: tuple
    contacts: Any
    notes: list[str]
    sensors: Any = None
    wanted_sensors: Any = None

    @property
    def constraints(self) -> list:
        """The constraint terms, in the order of their rows."""
        effectors = [self.effectors] if self.effectors.effectors else []
        return [*self.actuators.terms, *effectors, *filter(None, (self.wanted_sensors, self.contacts))]

    def bind_alone(self, besides: Collection[int] = ()) -> None:
        """Bind terms of which forces and rows are asked, and no stiffness.

        Args:
            besides: Identities of terms that are bound already.
        """
        ranks = np.arange(self.layout.nodes.free_node_count)
        for term in (*self.forces, *self.constraints):
            if id(term) not in besides:
                term.bind(ranks, _no_slots)

    def passive_forces(self, positions: np.ndarray) -> np.ndarray:
        """Forces of the force terms in statics, shape (free_node_count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        forces, still = np.zeros((2, self.layout.nodes.free_node_count, 3))
        for term in self.forces:
            if term.remembers_start:
                term.begin_step(positions, still, np.inf)
            term.add_forces(positions, forces)
        return forces


def _no_slots(rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of blocks in no matrix."""
    return np.zeros((2, *np.shape(rows)), np.int64)


def build_terms(scene: Scene, mounted: np.ndarray | None = None) -> Terms:
    """The terms of a scene alone, which tell forces and rows at a state.

    Args:
        scene: The scene.
        mounted: See `lay_out`.

    Raises:
        SceneError: An entry does not fit the mesh.
        MeshError: The mesh cannot be used.
    """
    notes: list[str] = []
    terms = _terms(lay_out(scene, notes, mounted=mounted), notes)
    if terms.layout.asked:
        # Terms have asked for points of reduced bodies, of which only these are kept.
        notes = []
        terms = _terms(lay_out(scene, notes, terms.layout.asked, mounted), notes)
    return terms


def with_cables(terms: Terms, scene: Scene) -> Terms:
    """The terms of a scene of which only the cables are others, and their actuators alone are new.

    Args:
        terms: Of the scene before, without reduced bodies: these keep only points that are asked for.
        scene: The scene with other cables.

    Raises:
        SceneError: A cable does not fit.
    """
    layout, passive = terms.layout._replace(scene=scene), len(terms.actuators.held_forces)
    actuators = build_actuators(layout, [])
    held = _held_axes(layout)
    forces = terms.forces[: len(terms.forces) - passive - len(held)] + actuators.held_forces + held
    return terms._replace(layout=layout, forces=forces, actuators=actuators)


def _model_of(scene: Scene, factorization_type: type | None, mounted: np.ndarray | None) -> Model:
    terms = build_terms(scene, mounted)
    layout, forces, constraints = terms.layout, terms.forces, terms.constraints
    nodes, is_dense = layout.nodes, _is_dense(layout)
    factorization = bound_factorization(
        factorization_type or FACTORIZATIONS[scene.solver.factorization], [*forces, *constraints],
        nodes.free_node_count, is_dense,
    )  # fmt: skip
    if not is_dense and isinstance(factorization, Multifrontal):
        factorization.use_threads(scene.solver.threads or default_thread_count())
        if factorization.team:
            for term in forces:
                term.use_threads(factorization.team)
    # Binding sorts the terms' entries, so their rows are stacked after it.
    rows = RowStack(constraints, nodes.carried, nodes.free_axes)
    dense = [term for term in (*forces, *constraints) if term.dense_rows is not None]
    if dense:
        factorization = DenseStiffness(factorization, dense)
    factorization.prepare_rows(rows.reached_nodes, rows.row_capacity)
    sliding = {slide.body for slide in scene.slides}
    guided = any(part.is_guided and part.name not in sliding for part in layout.rigid)
    guides = Guides(layout) if guided else None
    remembering = [term for term in forces if term.remembers_start]
    remembering += [term for term in constraints if term.varies]
    return Model(
        scene, layout.bodies, layout.rigid, nodes, forces,
        # Guided bodies move last: all terms store their positions before.
        (*remembering, guides) if guided else (*remembering,),
        terms.actuators, terms.effectors, terms.contacts, rows, *terms.markers, factorization,
        guides, terms.notes, layout.superelements, layout.beams, is_dense, layout.is_held,
        terms.sensors, terms.wanted_sensors,
    )  # fmt: skip


def _terms(layout: Layout, notes: list[str]) -> Terms:
    scene, carried = layout.scene, layout.nodes.carried
    forces = tuple(on_unknowns(term, carried) for term in force_terms(layout, notes))
    actuators = build_actuators(layout, notes)
    contacts = contact_term(layout, notes) if scene.contact else None
    sensors = sensor_term(layout, notes, contacts) if scene.sensors else None
    wanted = sensor_term(layout, [], contacts, True) if scene.sensors else None
    return Terms(
        layout, forces + actuators.held_forces + _held_axes(layout), actuators, effector_term(layout, notes),
        marker_mapping(layout, notes), contacts, notes, sensors, wanted,
    )  # fmt: skip


def _held_axes(layout: Layout) -> tuple[HeldAxes, ...]:
    """What leaves out the forces along held axes, after all other force terms; none without such axes."""
    free_axes = layout.nodes.free_axes
    return () if free_axes is None else (HeldAxes(free_axes),)


def _is_dense(layout: Layout) -> bool:
    """Whether A has no zeros: where all bodies are reduced, and the scene names no factorization."""
    is_reduced = layout.bodies and len(of_kind(layout.bodies, ReducedBody)) == len(layout.bodies)
    if not is_reduced or "factorization" in layout.scene.solver.model_fields_set:
        return False
    return 3 * layout.nodes.free_node_count <= MOST_DENSE


def bound_factorization(made_by: type, stiff: Sequence, free_node_count: int, is_dense: bool = False) -> Factorization:
    """Lay out A for the pattern of the terms that add to it, or for all pairs, and bind the terms.

    Args:
        made_by: Class of the factorization.
        stiff: Terms that add to A.
        free_node_count: Number of free nodes.
        is_dense: Whether all pairs of nodes have entries.
    """
    pairs = [stencil_pairs(term.stencils()) for term in stiff]
    if is_dense:
        pairs = [stencil_pairs(np.arange(free_node_count)[None])]
    rows = np.concatenate([rows for rows, _ in pairs])
    columns = np.concatenate([columns for _, columns in pairs])
    real = (rows < free_node_count) & (columns < free_node_count)
    factorization = made_by(rows[real], columns[real], free_node_count)
    for term in stiff:
        term.bind(factorization.elimination_rank, factorization.slots)
    return factorization
