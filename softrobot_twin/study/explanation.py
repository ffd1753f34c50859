"""A scene said in words: the effects it calls for, and what they were built into.

The terms and stages are read off the built simulation, never listed by hand, so what is shown is
what a step runs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation import Simulation


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
        size: Rows of H for a constraint, empty for a force.
    """

    name: str
    kind: str
    built_from: str
    size: str


def effects(simulation: Simulation) -> list[Effect]:
    """Everything that the scene names."""
    scene = simulation.scene
    names = [term.name for term in simulation.terms]
    material, mesh = scene.body.material, scene.body.mesh
    # What is zero or empty costs nothing: it is neither built nor listed.
    listed = [
        Effect("body.mesh", f"{_mesh_words(mesh)}, {scene.body.element} elements",
               f"{simulation.node_count} nodes, {simulation.tet_count} tets"),
        Effect("body.material",
               f"{material.law}, E {_number(material.young_modulus)} Pa, "
               f"ν {_number(material.poisson_ratio)}, {_number(material.density)} kg/m³",
               _term(names, material.law)),
        Effect("body.fixed", _count(scene.body.fixed, "region"),
               f"{simulation.node_count - simulation.dof_count // 3} nodes without unknowns"),
    ]
    if any(scene.gravity):
        listed.append(Effect("gravity", f"{_vector(scene.gravity)} m/s²",
                             _term(names, "gravity")))
    listed += [Effect(f"cables: {cable.name}", _cable_words(cable), _term(names, "cables"))
               for cable in scene.cables]
    listed += [Effect(f"effectors: {effector.name}",
                      f"{_count(effector.points, 'point')}, directions "
                      f"{' '.join(effector.directions)}, weight {_number(effector.weight)}",
                      _term(names, "effectors"))
               for effector in scene.effectors]
    if scene.markers:
        listed.append(Effect("markers", _count(scene.markers, "marker"),
                             "a mapping, read after the step"))
    listed.append(Effect("integration", scene.integration.replace("_", "-"),
                         f"at most {_count(range(scene.solver.newton_iterations), 'linearization')}"
                         " a step"))
    return listed


def terms(simulation: Simulation) -> list[TermLine]:
    """The terms that a step sums, in its order."""
    lines = []
    for term in simulation.terms:
        rows = getattr(term, "row_count", None)
        kind = "force" if rows is None else "constraint"
        size = "" if rows is None else _count(range(rows), "row")
        built_from = f"{type(term).__module__}.{type(term).__qualname__}"
        lines.append(TermLine(term.name, kind, built_from, size))
    return lines


def sizes(simulation: Simulation) -> list[tuple[str, str]]:
    """How large the system is."""
    surface = simulation.surface_positions()
    low, high = surface.min(axis=0), surface.max(axis=0)
    return [
        ("nodes", str(simulation.node_count)),
        ("tets", str(simulation.tet_count)),
        ("degrees of freedom", str(simulation.dof_count)),
        ("surface triangles", str(len(simulation.surface_triangles))),
        ("bounding box", f"{_vector(1e3 * low)} to {_vector(1e3 * high)} mm"),
        ("actuators", ", ".join(simulation.actuator_names) or "none"),
        ("effectors", ", ".join(simulation.effector_names) or "none"),
    ]


def _term(names: list[str], word: str) -> str:
    """The term that an entry became; an entry without one is said to have none."""
    found = [name for name in names if word in name]
    return f"term {found[0]}" if found else "no term"


def _mesh_words(mesh) -> str:
    words = [str(mesh.file)]
    if mesh.scale != 1.0:
        words.append(f"scale {_number(mesh.scale)}")
    if any(mesh.rotation):
        words.append(f"rotation {_vector(mesh.rotation)} rad")
    if any(mesh.translation):
        words.append(f"translation {_vector(mesh.translation)} m")
    return ", ".join(words)


def _cable_words(cable) -> str:
    words = [_count(cable.points, "point"), f"pulled from the {cable.pull_point_on}",
             f"shortening {_vector(1e3 * np.array(cable.shortening))} mm",
             f"tension {_vector(cable.tension)} N"]
    if cable.rate is not None:
        words.append(f"rate {_number(1e3 * cable.rate)} mm/s")
    return ", ".join(words)


def _count(things, name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


def _number(value: float) -> str:
    return f"{value:.6g}"


def _vector(values) -> str:
    return "[" + ", ".join(_number(float(value)) for value in values) + "]"
