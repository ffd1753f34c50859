"""A scene said in words: the effects it calls for, and what they were built into.

The terms and stages are read off the built simulation, never listed by hand, so what is shown is
what a step runs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.plausibility import expected_sag
from softrobot_twin.solvers.inverse_qp import LEAST_ENERGY_WEIGHT
from softrobot_twin.study.offline import effect_words as words


class Effect(NamedTuple):
    """One entry of a scene.

    Attributes:
        entry: Key of the scene file.
        asked: What stands there, in words with units.
        makes: Name of the term it became, or in what other way it acts.
    """

    entry: str
    asked: str
    makes: str


class TermLine(NamedTuple):
    """One term of a step.

    Attributes:
        name: The term's name.
        kind: ``force`` or ``constraint``.
        built_from: Module and class.
        size: Rows of H for a constraint, stencils for a force.
    """

    name: str
    kind: str
    built_from: str
    size: str


def effects(simulation: Simulation) -> list[Effect]:
    """Everything that the scene names; what is zero or empty is neither built nor listed."""
    scene = simulation.scene
    names = [term.name for term in simulation.terms]
    listed = []
    for body in simulation.model.bodies:
        listed += _body_effects(body, scene.integration, names)
    listed += _rigid_effects(simulation, names)
    listed += [Effect(f"springs: {spring.name}", words.spring_words(spring),
                      _term(names, "spring")) for spring in scene.springs]
    listed += [Effect(f"tubes: {tube.name}", f"{words.count(tube.points, 'point')}, EA "
                      f"{words.number(tube.axial_stiffness)} N", _term(names, "spring"))
               for tube in scene.tubes]
    listed += [Effect(f"mass_springs: {entry.name}", words.mass_spring_words(entry),
                      _term(names, "spring") if entry.springs else _term(names, "inertia"))
               for entry in scene.mass_springs]
    if any(scene.gravity):
        listed.append(Effect("gravity", f"{words.vector(scene.gravity)} m/s²",
                             _term(names, "gravity")))
    listed += [Effect(f"cables: {cable.name}", words.cable_words(cable), _term(names, "cables"))
               for cable in scene.cables]
    listed += [Effect(f"motors: {motor.name}", f"winds {', '.join(motor.cables)}",
                      "a command for each of its cables") for motor in scene.motors]
    listed += [Effect(f"effectors: {effector.name}", words.effector_words(effector),
                      _term(names, "effectors")) for effector in scene.effectors]
    if scene.markers:
        listed.append(Effect("markers", words.count(scene.markers, "marker"),
                             "a mapping, read after the step"))
    listed += _contact_effects(simulation, names)
    inertia = _term(names, "inertia") + ", " if scene.integration == "dynamic" else ""
    weight = scene.solver.energy_weight
    if scene.cables and scene.effectors:
        used = max(weight, LEAST_ENERGY_WEIGHT)
        least = "" if used == weight else ", the least that the arithmetic bears"
        listed.append(Effect("solver.energy_weight", words.number(weight),
                             f"{words.number(used)} in the inverse{least}"))
    most = words.count(range(scene.solver.newton_iterations), "linearization")
    listed.append(Effect("integration", scene.integration.replace("_", "-"),
                         f"{inertia}at most {most} a step"))
    return listed


def _body_effects(body, integration: str, names: list[str]) -> list[Effect]:
    """A deformable body: mesh, material, what holds it, what damps it."""
    entry, key, mesh = body.entry, body.key, body.mesh
    listed = [
        Effect(f"{key}.mesh", f"{words.mesh_words(entry.mesh)}, {entry.element} elements",
               f"{mesh.node_count} nodes, {mesh.cell_count} tets"),
        Effect(f"{key}.material", words.material_words(entry.material),
               _term(names, entry.material.law))]
    if entry.fixed:
        riding = np.concatenate([np.empty(0, np.int64), *body.riding.values()])
        held = int(np.count_nonzero(body.fixed)) - len(np.unique(riding))
        listed.append(Effect(f"{key}.fixed", words.count(entry.fixed, "region"),
                             f"{held} nodes without unknowns"))
    listed += [Effect(f"{key}.attached", f"to {name}", f"{len(nodes)} nodes that ride on it")
               for name, nodes in body.riding.items()]
    damping = entry.damping
    if integration != "quasi_static":
        if damping.mass > 0.0:
            listed.append(Effect(f"{key}.damping.mass", f"{words.number(damping.mass)} 1/s",
                                 _term(names, "mass damping")))
        if damping.stiffness > 0.0:
            listed.append(Effect(f"{key}.damping.stiffness",
                                 f"{words.number(damping.stiffness)} s",
                                 _term(names, "strain")))
    if entry.visual is not None:
        listed.append(Effect(f"{key}.visual", str(entry.visual.file),
                             "a mapping, read after the step"))
    if entry.contact_surface is not None:
        listed.append(Effect(f"{key}.contact_surface", str(entry.contact_surface.file),
                             "a mapping, with which it touches"))
    return listed


def _rigid_effects(simulation: Simulation, names: list[str]) -> list[Effect]:
    listed = []
    for part in simulation.model.rigid:
        made = "no unknowns, moved as commanded"
        if part.is_free:
            made = f"6 unknowns, {_term(names, 'rigid')}"
        listed.append(Effect(f"rigid_bodies: {part.name}", words.rigid_words(part.entry), made))
    listed += [Effect(f"obstacles: {entry.name}", words.shape_words(entry), "stands still")
               for entry in simulation.scene.obstacles]
    return listed


def _contact_effects(simulation: Simulation, names: list[str]) -> list[Effect]:
    """Every pair that may touch, and what all have in common."""
    term, entry = simulation.model.contacts, simulation.scene.contact
    # Slides are solved with the contacts, also where a scene names none.
    if term is None or entry is None:
        return []
    rows = words.count(range(term.rows_per_contact), "row")
    listed = [Effect("contact", words.contact_words(entry),
                     f"{_term(names, 'contacts')}, {rows} a contact, stage detect")]
    for pair in term.pairs:
        first, second = pair.names
        places = f", {words.count(entry.points, 'point')} known ahead"
        known = "between" if len(listed) <= len(entry.between) else "points"
        way = type(pair).__name__ + (places if known == "points" else "")
        listed.append(Effect(f"contact.{known}: {first}, {second}",
                             f"friction {words.number(pair.friction)}", f"asked by {way}"))
    return listed


def terms(simulation: Simulation) -> list[TermLine]:
    """The terms that a step sums, in its order."""
    lines = []
    for term in simulation.terms:
        rows = getattr(term, "row_count", None)
        kind = "force" if rows is None else "constraint"
        size = _term_size(term) if rows is None else _rows_words(term)
        built_from = f"{type(term).__module__}.{type(term).__qualname__}"
        lines.append(TermLine(term.name, kind, built_from, size))
    return lines


def sizes(simulation: Simulation) -> list[tuple[str, str]]:
    """How large the system is."""
    lines = [
        ("bodies", ", ".join(body.name for body in simulation.model.bodies) or "none"),
        *_weights(simulation),
        ("nodes", str(simulation.node_count)),
        ("tets", str(simulation.tet_count)),
        ("degrees of freedom", str(simulation.dof_count)),
        ("surface triangles", str(len(simulation.surface_triangles))),
    ]
    surface = simulation.surface_positions()
    if len(surface):
        low, high = surface.min(axis=0), surface.max(axis=0)
        lines.append(("bounding box",
                      f"{words.vector(1e3 * low)} to {words.vector(1e3 * high)} mm"))
    if simulation.model.rigid:
        lines.append(("rigid bodies", ", ".join(part.name for part in simulation.model.rigid)))
    return [*lines, ("actuators", ", ".join(simulation.actuator_names) or "none"),
            ("effectors", ", ".join(simulation.effector_names) or "none")]


def _weights(simulation: Simulation) -> list[tuple[str, str]]:
    """Volume and mass of every deformable body, and how far they sag."""
    lines = [
        (f"volume, mass of {body.name}",
         f"{words.number(body.mesh.volume)} m³, {words.number(body.mass)} kg")
        for body in simulation.model.bodies]
    if not lines or not any(simulation.scene.gravity):
        return lines
    sag = expected_sag(simulation.model)
    if sag is not None:
        said = f"{1e3 * sag:.3g} mm"
    elif all(body.is_held for body in simulation.model.bodies):
        said = "elements turn inside out"
    else:
        said = "not held: it falls"
    return [*lines, ("sag by gravity alone, cables slack", said)]


def _term_size(term) -> str:
    """Elements of a force term, and the nodes that each couples; empty where it has none."""
    stencils = term.stencils()
    if not len(stencils):
        return "no stiffness"
    return f"{words.count(stencils, 'stencil')} of {words.count(range(stencils.shape[1]), 'node')}"


def _rows_words(term) -> str:
    per_contact = getattr(term, "rows_per_contact", None)
    if per_contact is not None:
        return f"{words.count(range(per_contact), 'row')} a contact"
    return words.count(range(term.row_count), "row")


def _term(names: list[str], word: str) -> str:
    """The term that an entry became; an entry without one is said to have none."""
    found = [name for name in names if word in name]
    return f"term {found[0]}" if found else "no term"
