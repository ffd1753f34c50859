"""From a scene to its terms: only the terms that the scene names are built."""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.actuators import build_actuators
from softrobot_twin.simulation.apparent_stiffness import why_no_stiffness
from softrobot_twin.simulation.constraint_building import effector_term, marker_mapping
from softrobot_twin.simulation.contact_building import contact_term
from softrobot_twin.simulation.force_building import force_terms
from softrobot_twin.simulation.guided_bodies import Guides
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.scene_layout import lay_out
from softrobot_twin.simulation.scene_warnings import scene_warnings
from softrobot_twin.simulation.unit_checks import unit_slips
from softrobot_twin.solvers import FACTORIZATIONS
from softrobot_twin.solvers.dense_stiffness import DenseStiffness


def build_model(
    scene: Scene, factorization_type: type | None = None, with_warnings: bool = True
) -> Model:
    """Turn every effect of a scene into one term, and lay out the system they sum to.

    Args:
        scene: The scene.
        factorization_type: Class of the factorization, in place of the one that the scene names.
        with_warnings: Whether to look for unlikely values; for this the body is solved under its
            weight.

    Returns:
        The model.

    Raises:
        SceneError: An entry does not fit the mesh.
        MeshError: The mesh cannot be used.
    """
    try:
        model = _model_of(scene, factorization_type)
        _check_stiffness(model)
        if with_warnings:
            model.notes.extend(unit_slips(model))
            model.notes.extend(model.actuators.doubts(model))
            model.notes.extend(scene_warnings(scene, model.nodes.size))
    except SceneError as error:
        raise scene.source.error(error) from None
    model.notes[:] = scene.source.notes(model.notes)
    return model


def _model_of(scene: Scene, factorization_type: type | None) -> Model:
    notes: list[str] = []
    layout = lay_out(scene, notes)
    nodes = layout.nodes
    forces = tuple(force_terms(layout, notes))
    actuators = build_actuators(layout, notes)
    forces += actuators.held_forces
    effectors = effector_term(layout, notes) if scene.effectors else None
    markers, marker_ids, effector_markers = marker_mapping(layout, notes)
    contacts = contact_term(layout, notes) if scene.contact is not None else None
    others = [term for term in (effectors, contacts) if term is not None]
    constraints = [*actuators.terms, *others]
    factorization = _factorization(
        factorization_type or FACTORIZATIONS[scene.solver.factorization],
        [*forces, *constraints], nodes.free_node_count,
    )  # fmt: skip
    # Binding sorts the terms' entries, so their rows are stacked after it.
    rows = RowStack(constraints, nodes.carried)
    dense = [term.dense_rows for term in forces if term.dense_rows is not None]
    if dense:
        factorization = DenseStiffness(factorization)
    reached = np.unique(np.concatenate([rows.reached_nodes, *(part.node_index for part in dense)]))
    factorization.prepare_rows(
        reached, rows.row_capacity + sum(len(part.stiffness) for part in dense)
    )
    guided = any(not part.is_free for part in layout.rigid)
    guides = Guides(layout) if guided else None
    remembering = [term for term in forces if term.remembers_start]
    remembering += [term for term in constraints if term.varies]
    return Model(
        scene, layout.bodies, layout.rigid, nodes, forces,
        # Guided bodies move last: all terms store their positions before.
        (*remembering, guides) if guided else (*remembering,),
        actuators, effectors, contacts, rows, markers, marker_ids, effector_markers,
        factorization, guides, notes, layout.superelements, layout.beams,
    )  # fmt: skip


def _check_stiffness(model: Model) -> None:
    """Refuse wanted stiffnesses in scenes for which their derivative is not built."""
    scene, reason = model.scene, ""
    for index, effector in enumerate(scene.effectors):
        if effector.stiffness is None or effector.stiffness.weight == 0.0:
            continue
        reason = reason or why_no_stiffness(model)
        if reason:
            raise SceneError(
                scene.path, f"effectors[{index}].stiffness", effector.name, "",
                f"in a scene with {reason} a wanted stiffness is not built into this version",
            )  # fmt: skip


def _factorization(made_by: type, stiff: list, free_node_count: int):
    """Lay out A for the pattern of the terms that add to it."""
    pairs = [stencil_pairs(term.stencils()) for term in stiff]
    rows = np.concatenate([rows for rows, _ in pairs])
    columns = np.concatenate([columns for _, columns in pairs])
    real = (rows < free_node_count) & (columns < free_node_count)
    factorization = made_by(rows[real], columns[real], free_node_count)
    for term in stiff:
        term.bind(factorization.elimination_rank, factorization.slots)
    return factorization
