"""Force terms of a scene, each imported only where the scene calls for it."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.simulation.layout import Layout

GRAVITY = ("softrobot_twin.mechanics.gravity", "Gravity")
STRAIN_RATE_DAMPING = ("softrobot_twin.mechanics.strain_rate_damping", "StrainRateDamping")
MASS_DAMPING = ("softrobot_twin.mechanics.mass_damping", "MassDamping")
LUMPED_INERTIA = ("softrobot_twin.mechanics.lumped_inertia", "LumpedInertia")
# What nodes weigh, by how a body's mass is spread.
WEIGHING_MASSES = {
    "lumped": ("softrobot_twin.mechanics.nodal_masses", "lumped_masses"),
    "uniform": ("softrobot_twin.mechanics.nodal_masses", "uniform_masses"),
    "consistent": ("softrobot_twin.mechanics.gravity", "borne_masses"),
}
# Masses that move or are braked one by one: none may be negative.
MOVING_MASSES = {**WEIGHING_MASSES, "consistent": WEIGHING_MASSES["lumped"]}
CONSISTENT_INERTIA = ("softrobot_twin.mechanics.consistent_inertia", "ConsistentInertia")
RIGID_DAMPING = ("softrobot_twin.mechanics.rigid_damping", "RigidDamping")
RIGID_INERTIA = ("softrobot_twin.mechanics.rigid_inertia", "RigidInertia")
CHECK_MASSES_HELD = ("softrobot_twin.simulation.held_masses", "check_masses_held")
SPRING_TERM = ("softrobot_twin.simulation.spring_building", "spring_term")


def load(place: tuple[str, str]):
    """Something of a module that is imported only now."""
    module, name = place
    return getattr(import_module(module), name)


def force_terms(layout: Layout, notes: list[str]) -> Iterator:
    """All force terms of a scene.

    Args:
        layout: The bodies.
        notes: Takes what looks wrong.

    Yields:
        The terms, elastic ones first.

    Raises:
        SceneError: An entry does not fit.
    """
    scene = layout.scene
    for body in layout.bodies:
        yield _elastic_term(layout, body)
    if any(scene.gravity):
        yield load(GRAVITY)(_borne_masses(layout), np.array(scene.gravity))
    if scene.mass_springs and scene.integration == "quasi_static":
        load(CHECK_MASSES_HELD)(layout)
    if scene.springs or scene.tubes or any(body.springs for body in scene.mass_springs):
        yield load(SPRING_TERM)(layout, notes)
    if scene.integration != "quasi_static":
        _check_resisted(layout)
        yield from _motion_terms(layout)


def _elastic_term(layout: Layout, body):
    material = body.entry.material
    law = law_named(material.law).of_moduli(material.young_modulus, material.poisson_ratio)
    return Elements(layout.mesh_among_nodes(body), layout.nodes.free_index, law)


def _strain_rate_damping(layout: Layout, body):
    material, beta = body.entry.material, body.entry.damping.stiffness
    lame = lame_parameters(material.young_modulus, material.poisson_ratio)
    mesh = layout.mesh_among_nodes(body)
    return load(STRAIN_RATE_DAMPING)(mesh, layout.nodes.free_index, lame, beta)


def _borne_masses(layout: Layout) -> np.ndarray:
    """Mass whose weight each unknown bears [kg], shape (free_node_count,)."""
    bodies = []
    for body in layout.bodies:
        # A body falls evenly only where its weight is spread like its inertia.
        masses = load(WEIGHING_MASSES[body.entry.mass_model])
        bodies.append(masses(body.mesh, body.density))
    points = [
        np.broadcast_to(entry.masses, len(entry.points)) for entry in layout.scene.mass_springs
    ]
    masses = np.concatenate([np.empty(0), *bodies, *points])[layout.nodes.free_nodes]
    rigid = [(part.mass, 0.0) for part in layout.rigid if part.is_free]
    return np.concatenate([masses, np.array(rigid, float).reshape(-1)])


def _check_resisted(layout: Layout) -> None:
    """First-order motion needs something that resists it, or it would be infinitely fast."""
    scene = layout.scene
    if scene.integration != "first_order":
        return
    for body in layout.bodies:
        damping = body.entry.damping
        if damping.mass == 0.0 and (damping.stiffness == 0.0 or not body.is_held):
            raise SceneError(
                scene.path, f"{body.key}.damping.mass", damping.mass, "1/s",
                "first_order motion needs a drag: without inertia nothing else holds it back",
            )  # fmt: skip
    if layout.rigid and any(part.is_free for part in layout.rigid) or scene.mass_springs:
        raise SceneError(
            scene.path, "integration", "first_order", "",
            "free rigid bodies and point masses have no drag; use dynamic",
        )  # fmt: skip


def _motion_terms(layout: Layout) -> Iterator:
    """Inertia, where motion has it, and what resists motion."""
    dynamic = layout.scene.integration == "dynamic"
    free_index = layout.nodes.free_index
    for body in layout.bodies:
        density, alpha = body.density, body.entry.damping.mass
        is_diagonal = body.entry.mass_model != "consistent"
        own = np.flatnonzero(~body.fixed)
        nodes = own + body.first_node
        if dynamic and not is_diagonal:
            mesh = layout.mesh_among_nodes(body)
            yield load(CONSISTENT_INERTIA)(mesh, free_index, density, layout.nodes.free_nodes)
        masses = load(MOVING_MASSES[body.entry.mass_model])(body.mesh, density)[own]
        if dynamic and is_diagonal:
            yield load(LUMPED_INERTIA)(nodes, free_index[nodes], masses)
        if alpha > 0.0:
            yield load(MASS_DAMPING)(nodes, free_index[nodes], masses, alpha)
        if body.entry.damping.stiffness > 0.0:
            yield _strain_rate_damping(layout, body)
    for entry in layout.scene.mass_springs:
        nodes = layout.mass_nodes[entry.name]
        moving = free_index[nodes] >= 0
        masses = np.broadcast_to(entry.masses, len(nodes))[moving]
        yield load(LUMPED_INERTIA)(nodes[moving], free_index[nodes[moving]], masses)
    free = [part for part in layout.rigid if part.is_free]
    if free:
        yield load(RIGID_INERTIA)(
            layout.nodes.frames,
            np.array([part.mass for part in free]),
            np.array([part.inertia for part in free]),
        )
        rates = np.array([part.entry.damping for part in free])
        if rates.any():
            yield load(RIGID_DAMPING)(
                layout.nodes.frames,
                np.array([part.mass for part in free]),
                np.array([part.inertia for part in free]),
                rates,
            )
