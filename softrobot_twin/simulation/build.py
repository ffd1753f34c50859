"""From a scene to its terms. A term's module is imported only when the scene calls for it."""

from __future__ import annotations

from importlib import import_module

import numpy as np

from softrobot_twin.constraints.terms import RowStack
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.scene.schema import Scene
from softrobot_twin.simulation.body import Body, build_body, carry
from softrobot_twin.simulation.limits import ActuatorLimits
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.plausibility import unit_slips

FACTORIZATIONS = {
    "multifrontal": ("softrobot_twin.solvers.multifrontal", "Multifrontal"),
    "superlu": ("softrobot_twin.solvers.superlu", "SuperLU"),
}
# By law and element.
LAWS = {
    ("corotational", "linear"): ("softrobot_twin.mechanics.corotational", "CorotationalTets"),
    ("corotational", "quadratic"): ("softrobot_twin.mechanics.quadratic_tets", "QuadraticTets"),
    ("linear", "linear"): ("softrobot_twin.mechanics.linear_elastic", "LinearElastic"),
    ("linear", "quadratic"): ("softrobot_twin.mechanics.linear_elastic", "LinearElastic"),
}


def build_model(scene: Scene, factorization_type: type | None = None) -> Model:
    """Turn every effect of a scene into one term, and lay out the system they sum to.

    Args:
        scene: The scene.
        factorization_type: Class of the factorization, in place of the one that the scene names.

    Returns:
        The model.

    Raises:
        SceneError: An entry does not fit the mesh.
        MeshError: The mesh cannot be used.
    """
    notes: list[str] = []
    body = build_body(scene, notes)
    forces = tuple(_force_terms(scene, body))
    cables = _cable_term(scene, body, notes) if scene.cables else None
    effectors = _effector_term(scene, body, notes) if scene.effectors else None
    markers, marker_ids, effector_markers = _markers(scene, body, notes)
    stiff = [*forces] + ([cables] if cables is not None else [])
    pairs = [stencil_pairs(term.stencils()) for term in stiff]
    made_by = factorization_type or _load(FACTORIZATIONS[scene.solver.factorization])
    factorization = made_by(
        np.concatenate([rows for rows, _ in pairs]),
        np.concatenate([columns for _, columns in pairs]),
        len(body.free_nodes),
    )
    for term in stiff:
        term.bind(factorization.elimination_rank, factorization.slots)
    rows = RowStack([term for term in (cables, effectors) if term is not None])
    factorization.prepare_rows(rows.node_index, rows.row_count)
    model = Model(
        scene, body, forces, cables, effectors, rows, _limits(scene), markers, marker_ids,
        effector_markers, factorization, notes,
    )  # fmt: skip
    notes.extend(unit_slips(model))
    return model


def _load(place: tuple[str, str]):
    module, name = place
    return getattr(import_module(module), name)


def _force_terms(scene: Scene, body: Body):
    material = scene.body.material
    law = _load(LAWS[material.law, scene.body.element])
    lame = lame_parameters(material.young_modulus, material.poisson_ratio)
    yield law(body.mesh, body.free_index, lame)
    if any(scene.gravity):
        gravity = _load(("softrobot_twin.mechanics.gravity", "Gravity"))
        yield gravity(body.mesh, body.free_nodes, material.density, np.array(scene.gravity))


def _cable_term(scene: Scene, body: Body, notes: list[str]):
    module = import_module("softrobot_twin.constraints.cable")
    paths = []
    for index, cable in enumerate(scene.cables):
        key = f"cables[{index}]"
        points = carry(body, cable.points, f"{key}.points", scene, notes, cable.hold_radius)
        pull_point = np.array(cable.pull_point)
        if cable.pull_point_on == "body":
            start = carry(
                body, [cable.pull_point], f"{key}.pull_point", scene, notes, cable.hold_radius
            )
            points = start.followed_by(points)
            pull_point = None
        path = module.CablePath(cable.name, points, pull_point)
        for fold in module.folds(path.positions(body.mesh.node_positions)):
            where = "pull_point" if fold == 0 else f"points[{fold - 1}]"
            notes.append(
                f"{key} ({cable.name}) folds back on itself at {where}: "
                "are its points in the right order?"
            )
        paths.append(path)
    return module.Cables(tuple(paths), body.free_index, body.mesh.node_positions)


def _effector_term(scene: Scene, body: Body, notes: list[str]):
    module = import_module("softrobot_twin.constraints.effector")
    effectors = tuple(
        module.EffectorPoints(
            effector.name,
            carry(body, effector.points, f"effectors[{index}].points", scene, notes),
            tuple(module.AXES[direction] for direction in effector.directions),
            effector.weight,
        )
        for index, effector in enumerate(scene.effectors)
    )
    return module.Effectors(effectors, body.free_index)


def _markers(scene: Scene, body: Body, notes: list[str]):
    points = [marker.point for marker in scene.markers]
    if points:
        markers = carry(body, points, "markers", scene, notes)
    else:
        width = body.mesh.tets.shape[1]
        markers = BarycentricMapping(np.empty((0, width), np.int64), np.empty((0, width)))
    ids = [marker.id for marker in scene.markers]
    moving_with = tuple(
        np.array([ids.index(marker) for marker in effector.measured_by], np.int64)
        for effector in scene.effectors
    )
    return markers, np.array(ids, np.uint32), moving_with


def _limits(scene: Scene) -> ActuatorLimits:
    cables = scene.cables
    return ActuatorLimits(
        tuple(cable.name for cable in cables),
        np.array([cable.shortening[0] for cable in cables], float),
        np.array([cable.shortening[1] for cable in cables], float),
        np.array([np.inf if cable.rate is None else cable.rate for cable in cables], float),
        np.array([cable.tension[0] for cable in cables], float),
        np.array([cable.tension[1] for cable in cables], float),
    )
