"""``python -m softrobot_twin explain``: what a scene contains, its effects, and the terms that are
built for them.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table

from softrobot_twin.analysis.mesh_error import MeshError, MeshErrorEstimator, MeshErrorUnknown
from softrobot_twin.analysis.prestress import prestress
from softrobot_twin.analysis.reduction_error import FullModelError, ReductionStates
from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.control.dynamic_control import DynamicControl
from softrobot_twin.control.force_observer import USUAL_NOISE, ForceObserver
from softrobot_twin.geometry.wall_thickness import ThinnestPart, thinnest_part
from softrobot_twin.harness.length_units import SHOWN
from softrobot_twin.harness.terminal import (
    by_key,
    console,
    listing,
    print_apart,
    table,
    terminal_status,
    warn,
)
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.observed_loads import ObservedLoads
from softrobot_twin.mechanics.sealed_gas import SealedGas
from softrobot_twin.scene import Scene
from softrobot_twin.scene.words import count, in_words, number, vector, words
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.actuator_kinds import ActuatorGroup, Quantity
from softrobot_twin.simulation.building.beam_bodies import BeamBody
from softrobot_twin.simulation.building.cavity_actuator import wall_details
from softrobot_twin.simulation.building.deformable_body import AtRest, MaterialPart, law_at_rest
from softrobot_twin.simulation.command import DEFAULT_TIME_STEP
from softrobot_twin.simulation.mounting import MountingError
from softrobot_twin.simulation.scene_warnings import expected_sag
from softrobot_twin.simulation.step.time_integration import DEFAULT_RADIUS
from softrobot_twin.solvers.dense_stiffness import without_rows
from softrobot_twin.solvers.inverse_problem import LEAST_ENERGY_WEIGHT
from softrobot_twin.study.pneumatic_warnings import burst_warnings, fibre_warnings
from softrobot_twin.study.scene_picture import check_picture, draw_snapshots, take_snapshot


def limits(bounds, unit: str) -> str:
    """A lower and an upper limit as text; each may be infinite.

    Args:
        bounds: The lower and the upper limit.
        unit: Their unit.
    """
    return f"{vector(bounds)} {unit}".rstrip() if np.isfinite(bounds).any() else "without limit"


def _describe_law(law: str, at_rest: AtRest | MaterialPart, constants: dict | None) -> str:
    """A law, its moduli at rest and its own constants, if it has any."""
    moduli = f"E {number(at_rest.young_modulus)} Pa, ν {number(at_rest.poisson_ratio)}"
    if constants is None:
        return f"{law}, {moduli}"
    own = (f"{constant.name} {in_words(constants[constant.name])} {constant.unit}".rstrip()
           for constant in law_named(law).own.constants)
    return words(law, *own, f"at rest {moduli}")


def describe_actuator(group: ActuatorGroup, index: int, entry) -> str:
    """An actuator: its entry as its kind describes it, and its limits with their units.

    Args:
        group: All actuators of a section.
        index: Number of the actuator among them.
        entry: Its entry.
    """
    kind = group.kinds[index]
    parts = [kind.details(entry, group, index)]
    rest = group.effort_zeros[index] if group.has_rest_efforts else 0.0
    for quantity, bounds in ((kind.displacement, group.displacement_bounds[index]),
                             (kind.effort, group.effort_bounds[index] + rest)):
        factor, unit = _shown(quantity)
        parts.append(f"{quantity.word} {limits(factor * np.asarray(bounds), unit)}")
    if np.isfinite(group.rates[index]):
        factor, unit = _shown(kind.setpoint)
        parts.append(f"rate {number(factor * group.rates[index])} {unit}/s")
    return words(*parts)


def _shown(quantity: Quantity) -> tuple[float, str]:
    """Factor and unit by which a quantity is shown."""
    return _READABLE.get(quantity.unit, (1.0, quantity.unit))


_READABLE = {**SHOWN, "rad": (1.0, "rad")}
"""Factor and readable unit of SI units; angles are those of the scene."""


_JOINTS = {"rigid": "moves with its frame", "hinge": "1 unknown: an angle", "ball": "3 unknowns: a rotation"}


def _measured_error(measured: np.ndarray) -> str:
    """The error of a reduced model at fresh states, as its training found it."""
    if np.isnan(measured).any():
        return "not compared with the full model"
    median, worst = 100.0 * measured
    return f"{median:.2g} % off the full model (largest {worst:.2g} %)"


def print_mesh_error(scene: Scene, with_table: bool = False, begin: str = "") -> None:
    """Prints the estimated error of the mesh.

    Args:
        scene: The scene.
        with_table: Whether to print the error of each load too, and to warn of a large error.
        begin: Words before it.
    """
    try:
        with terminal_status("solving with elements of higher order, to estimate the mesh's error"):
            error = MeshErrorEstimator(scene).at_rest()
    except MeshErrorUnknown as unknown:
        console().print(f"{begin}{unknown}")
        return
    if with_table:
        print_apart(_by_load(error))
    if with_table and error.is_large:
        warn(error.in_words())
    else:
        console().print(begin + error.in_words())


def print_reduction_errors(simulation: Simulation, reduction: ReductionStates, largest_range: float) -> None:
    """Prints how far reduced bodies can be believed after a run; nothing without them.

    Args:
        simulation: The simulation, where the run ended.
        reduction: Tells of its reduced bodies; that of the run has the spare modes built already.
        largest_range: Largest share of the trained range in the run.
    """
    if not simulation.has_reduced_bodies:
        return
    with terminal_status("comparing with the full model"):
        by_spare_modes = reduction.read()
        # In motion there is no balance whose error could be told.
        by_full_model = ({} if simulation.model.is_dynamic
                         else FullModelError(simulation).errors(simulation.state))  # fmt: skip
    for name, full in by_full_model.items():
        error, doubt = by_spare_modes[name].error, by_spare_modes[name].doubt
        spare = f", by its spare modes {1e3 * error:.3g} mm" if error == error else ""
        console().print(
            f"{name}: at the last pose the reduced model is {1e3 * full.distance:.3g} mm from the "
            f"full one, {_percent(full.share)} of the displacement{spare}"
        )
        if doubt:
            warn(f"{name}: at the last pose {doubt}")
    if largest_range > 1.0:
        warn(f"the run left the range of the training, up to {largest_range:.1f} times of it: "
             "train where the robot goes, see docs/reduced_models.md")  # fmt: skip


def _by_load(error: MeshError) -> Table:
    forces, lengths = (f"{words} given" for words in error.given)
    compared = {one.element: one for one in (error.own, error.quadratic)}
    columns = [f"{element}, {given}" for element in compared for given in (forces, lengths)]
    return table(
        "Estimated error of the effectors' motion due to the mesh", "load", *columns,
        rows=([loads[0].load, *(_percent(share) for load in loads
                                for share in (load.forces, load.lengths))]
              for loads in zip(*(one.loads for one in compared.values()), strict=True)))


def _percent(share: float) -> str:
    return "" if share != share else f"{100.0 * share:.2g} %"


class Effect(NamedTuple):
    """One entry of a scene.

    Attributes:
        entry: Key of the scene file.
        content: Its content as text with units.
        result: Name of its term, or its other effect.
    """

    entry: str
    content: str
    result: str


def effects(simulation: Simulation) -> list[Effect]:
    """All effects of the scene; entries that are zero or empty are neither built nor listed.

    Args:
        simulation: The simulation of the scene.
    """
    return list(_effects(simulation, [term.name for term in simulation.terms]))


def _effects(simulation: Simulation, names: list[str]) -> Iterator[Effect]:
    scene = simulation.scene
    for body in simulation.model.bodies:
        yield from _body_effects(body, scene.integration, names)
    for beam in simulation.model.beams:
        yield from _beam_effects(beam, scene.integration, names)
    yield from _rigid_effects(simulation, names)
    for section in ("springs", "tubes", "fibres", "mass_springs"):
        for entry in getattr(scene, section):
            word = "spring" if getattr(entry, "springs", True) else "inertia"
            yield Effect(f"{section}: {entry.name}", entry.describe(), _term(names, word))
    if any(scene.gravity):
        yield Effect("gravity", f"{vector(scene.gravity)} m/s²", _term(names, "gravity"))
    yield from _sealed_effects(simulation)
    for group in simulation.actuators.groups:
        section = group.kind.section
        made = "prescribed moves" if group.term is None else f"term {group.term.name}"
        entries = group.entries or scene.actuator_entries[section]
        for index, (name, entry) in enumerate(zip(group.names, entries, strict=True)):
            yield Effect(f"{section}: {name}", describe_actuator(group, index, entry), made)
    results = {
        "motors": "a command for each of its cables", "effectors": _term(names, "effectors"),
        "sensors": "a value after the step", "grips": _term(names, "grips"),
        "reactions": "the residual of held nodes, evaluated after the step",
    }  # fmt: skip
    for section, made in results.items():
        for entry in getattr(scene, section):
            is_led = section == "sensors" and entry.weight is not None
            yield Effect(f"{section}: {entry.name}", entry.describe(),
                         f"{made} and {_term(names, 'sensors')}" if is_led else made)
    if scene.moving_base is not None:
        yield Effect("moving_base", scene.moving_base.describe(), f"a change of {_term(names, 'gravity')}")
    if scene.markers:
        yield Effect("markers", count(scene.markers, "marker"), "a mapping, evaluated after the step")
    yield from _observed_effects(simulation, names)
    if (control := simulation.scene.control) is not None:
        told = DynamicControl(simulation, DEFAULT_TIME_STEP).words()
        yield Effect("control", control.describe(), f"{told}; with ticks of {DEFAULT_TIME_STEP:g} s")
    yield from _contact_effects(simulation, names)
    for key, stage in scene.keyed("mounting"):
        yield Effect(key, stage.describe(), "the shape at rest")
    weight = scene.solver.energy_weight
    if simulation.actuators.count and scene.effectors:
        used = max(weight, LEAST_ENERGY_WEIGHT)
        least = "" if used == weight else ", the least possible in floating point"
        yield Effect("solver.energy_weight", number(weight), f"{number(used)} in the inverse problem{least}")
    most = count(range(scene.solver.newton_iterations), "linearization")
    yield Effect("integration", scene.integration.replace("_", "-"), words(
        _term(names, "inertia") if scene.integration == "dynamic" else "", _scheme(scene),
        f"at most {most} a step"))


def _cells(mesh) -> str:
    """How many cells of each kind a mesh has."""
    return ", ".join(f"{number} {name}" for name, number in mesh.cell_counts.items())


def _scheme(scene) -> str:
    """The time scheme in words where a scene names one of second order."""
    if scene.time_scheme == "backward_euler":
        return ""
    radius = DEFAULT_RADIUS if scene.spectral_radius is None else scene.spectral_radius
    return f"{scene.time_scheme} with spectral radius {number(radius)}"


def grouped(listed: list[Effect]) -> list[Effect]:
    """Effects in which entries that differ only in name are one row.

    Args:
        listed: All effects of a scene.

    Returns:
        The effects in the order in which each content is first listed; the entry of several names
        the first and the last, and how many they are. Many that differ in numbers only are one
        row too, with the least and the greatest of each number.
    """
    def key(effect: Effect) -> tuple[str, str, str]:
        section, colon, _ = effect.entry.partition(": ")
        section = section if colon else _PLACE.sub(r"\1", effect.entry)
        pattern = _POSE if section == _MESHES else _NUMBER
        return section, pattern.sub("#", _PART.sub("part", effect.content)), effect.result

    found: dict[int, Effect] = {}
    for (section, *_), own in by_key(
        (key(effect), (index, effect)) for index, effect in enumerate(listed)
    ).items():  # fmt: skip
        alike = by_key((_PART.sub("part", effect.content), (index, effect))
                       for index, effect in own)  # fmt: skip
        is_one_row = len(alike) > (1 if section == _MESHES else _MOST_ROWS)
        for members in [own] if is_one_row else alike.values():
            found[members[0][0]] = _together(section, [effect for _, effect in members])
    return [found[index] for index in sorted(found)]


# Rows of a section that differ in numbers only become one row if there are more than so many; equal
# meshes at several places are one from two on.
_MOST_ROWS = 4
_MESHES = "bodies.mesh"
_PART = re.compile(r"\bpart (\w+)")
_PLACE = re.compile(r"^(bodies|beams)\[\d+\]")
_POSE = re.compile(r", (?:rotation|translation) \[[^]]*\] (?:rad|m)")
# A number that is no part of a name, such as the 2 of hub_2.
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")


def _together(section: str, effects_alike: list[Effect]) -> Effect:
    """One row for entries of a section that differ in names, parts, numbers or places only."""
    if len(effects_alike) == 1:
        return effects_alike[0]
    names = [effect.entry.partition(": ")[2] for effect in effects_alike]
    contents = [effect.content for effect in effects_alike]
    parts = list(dict.fromkeys(" and ".join(_PART.findall(content)) for content in contents))
    if len(parts) > 1:
        contents = [_PART.sub("part", content) for content in contents]
    if section == _MESHES and len(set(contents)) > 1:
        content = f"{_POSE.sub('', contents[0])}, at {len(names)} places"
    else:
        ranges = map(_range, zip(*map(_NUMBER.findall, contents), strict=True))
        content = _NUMBER.sub(lambda _: next(ranges), contents[0])
    if len(parts) > 1:
        content = content.replace("part", f"parts {_listed(parts)}", 1)
    which = f": {_listed(names)}" if names[0] else ""
    return Effect(f"{section}{which} ({len(names)})", content, effects_alike[0].result)


def _range(numbers: tuple[str, ...]) -> str:
    """A number that all have, or the least and the greatest."""
    if len(set(numbers)) == 1:
        return numbers[0]
    return " to ".join((min(numbers, key=float), max(numbers, key=float)))


def _named(names: list[str]) -> str:
    """Names, or the first and the last of those that differ in their numbers only."""
    alike = by_key((re.sub(r"\d+", "#", name), name) for name in names)
    return ", ".join(_listed(own) for own in alike.values())


def _listed(names: list[str]) -> str:
    """Some names, or the first and the last of many."""
    several = any(", " in name for name in names)
    if len(names) > 4:
        return f"{names[0]}{'; ...; ' if several else ' to '}{names[-1]}"
    return ("; " if several else ", ").join(names)


def _body_effects(body, integration: str, names: list[str]) -> Iterator[Effect]:
    """Effects of a deformable body: mesh, material, fixed regions, damping."""
    entry, key, mesh, vertebrae = body.entry, body.key, body.mesh, body.vertebrae
    material, law = entry.material, entry.material.law
    yield Effect(f"{key}.mesh", f"{entry.mesh.describe()}, {entry.element} elements",
                 f"{mesh.node_count} nodes, {_cells(mesh)}")
    yield Effect(f"{key}.material",
                 words(_describe_law(law, law_at_rest(material, law), material.constants), material.describe()),
                 "in superelements" if vertebrae else _term(names, law))
    for part, other in zip(body.materials[-len(entry.materials):], entry.materials, strict=False):
        cells = "cells" if "hexahedra" in mesh.cell_counts else "tets"
        content = words(f"{other.place}: {_describe_law(part.law, part, other.constants)}",
                        f"{number(part.density)} kg/m³", f"{number(part.volume)} m³", other.describe())
        yield Effect(part.key, content, "in superelements" if vertebrae
                     else f"{_term(names, part.law)} of {len(part.cells)} {cells}")
    if entry.has_patches:
        own = [name for name in names if "patch volumes" in name]
        yield Effect(f"{key}.volume", "changes of volume resisted by patches of elements",
                     _term(own, "patch volumes"))
    if entry.fixed:
        riding = np.concatenate([np.empty(0, np.int64), *body.riding.values()])
        held = int(np.count_nonzero(body.whole.fixed)) - len(np.unique(riding))
        told = f"{held} nodes without unknowns"
        if in_part := int(np.count_nonzero(body.held.any(axis=1) & ~body.fixed)):
            told += f", {in_part} held along some axes"
        yield Effect(f"{key}.fixed", count(entry.fixed, "region"), told)
    if vertebrae:
        yield Effect(
            f"{key}.vertebrae",
            words(*(f"{part.name}{'' if part.is_free else ' (fixed)'}" for part in vertebrae)),
            f"{6 * sum(part.is_free for part in vertebrae)} unknowns, "
            f"{len(body.division.parts)} superelements")
    if entry.reduced:
        kept = body.reduction
        yield Effect(
            f"{key}.reduced", f"{body.mode_count} modes of {entry.reduced.file}, "
            f"{len(kept.sampled.cells)} quadrature points stand for all",
            f"{body.mode_count} unknowns, {_measured_error(kept.measured)}")
    for name, nodes in body.riding.items():
        yield Effect(f"{key}.attached", f"to {name}", f"{len(nodes)} nodes that move with it")
    if integration != "quasi_static":
        yield from _damping_effects(key, entry.damping, _term(names, "mass damping"), _term(names, "strain"))
    for name, use in (("visual", "evaluated after the step"), ("contact_surface", "with which it touches")):
        if getattr(entry, name) is not None:
            yield Effect(f"{key}.{name}", str(getattr(entry, name).file), f"a mapping, {use}")


def _damping_effects(key: str, damping, of_mass: str, of_stiffness: str) -> Iterator[Effect]:
    """Damping of a body or a beam, and the terms of its two parts."""
    if damping.mass > 0.0:
        yield Effect(f"{key}.damping.mass", f"{number(damping.mass)} 1/s", of_mass)
    if damping.stiffness > 0.0:
        yield Effect(f"{key}.damping.stiffness", f"{number(damping.stiffness)} s", of_stiffness)


def _beam_effects(beam: BeamBody, integration: str, names: list[str]) -> Iterator[Effect]:
    """Effects of a beam: its axis and section, material and stiffness, ends, damping."""
    entry, key, material, section = beam.entry, beam.key, beam.entry.material, beam.section
    length = beam.lengths.sum()
    shape = f"{entry.curve} through " if len(entry.points) > 2 else ""
    term = _term(names, "beams")
    stiffness = material.young_modulus * np.array([section.inertia_z, section.inertia_y])
    bending = f"EI {number(stiffness[0])} N m²"
    if not np.isclose(*stiffness, rtol=1.0e-6):
        bending = (f"EI {number(stiffness[0])} and {number(stiffness[1])} N m² against deflection "
                   "along y and z")
    shear = 0.5 * material.young_modulus / (1.0 + material.poisson_ratio)
    yield Effect(f"beams: {beam.name}",
                 f"{shape}{count(entry.points, 'point')}, {number(1e3 * length)} mm long, "
                 f"{entry.section.describe()}",
                 f"{count(beam.lengths, 'element')} of {term}")
    yield Effect(f"{key}.material",
                 material.describe(),
                 f"{bending}, GJ {number(shear * section.torsion)} N m², EA "
                 f"{number(material.young_modulus * section.area)} N, {number(beam.mass)} kg")
    if entry.fixed:
        yield Effect(f"{key}.fixed", ", ".join(entry.fixed), "without unknowns")
    for joint in entry.joined:
        yield Effect(f"{key}.joined", joint.describe(), _JOINTS[joint.by])
    if integration != "quasi_static":
        yield from _damping_effects(key, entry.damping, _term(names, "inertia"), term)


def _rigid_effects(simulation: Simulation, names: list[str]) -> Iterator[Effect]:
    for part in simulation.model.rigid:
        made = {"free": f"6 unknowns, {_term(names, 'rigid')}", "fixed": "no unknowns",
                "guided": "no unknowns, moves as commanded"}  # fmt: skip
        yield Effect(f"rigid_bodies: {part.name}", part.entry.describe(), made[part.entry.motion])
        for joint in part.entry.joined:
            bearing = f"{joint.describe()}, {number(joint.stiffness)} N/m"
            yield Effect(f"rigid_bodies: {part.name}.joined", bearing, _term(names, "joints"))
    for entry in simulation.scene.obstacles:
        yield Effect(f"obstacles: {entry.name}", entry.describe(), "fixed")


def _sealed_effects(simulation: Simulation) -> Iterator[Effect]:
    entries = simulation.scene.sealed_cavities
    for term in simulation.terms if entries else ():
        if term.name != SealedGas.name:
            continue
        walls = term.walls
        for entry, volume, area in zip(entries, walls.rest_volumes, walls.rest_areas, strict=True):
            content = (f"{wall_details(entry, volume, area)}, gas at "
                       f"{number(1e-3 * entry.pressure)} kPa above "
                       f"{number(1e-3 * entry.ambient_pressure)} kPa at rest")
            yield Effect(f"sealed_cavities: {entry.name}", content, f"term {term.name}")


def _contact_effects(simulation: Simulation, names: list[str]) -> Iterator[Effect]:
    """The pairs that may touch, and their common settings."""
    term, entry = simulation.model.contacts, simulation.scene.contact
    # Slides use the contact solver, also in a scene without contact.
    if term is None or entry is None:
        return
    yield Effect("contact", entry.describe(),
                 f"{_term(names, 'contacts')}, {_describe_rows(term)}, stage detect")
    for index, pair in enumerate(term.pairs):
        first, second = pair.names
        is_searched = index < len(entry.between)
        places = "" if is_searched else f", {count(entry.points, 'point')} given in advance"
        yield Effect(f"contact.{'between' if is_searched else 'points'}: {first}, {second}",
                     f"friction {number(pair.friction)}",
                     f"found by {type(pair).__name__}{places}")


def _observed_effects(simulation: Simulation, names: list[str]) -> Iterator[Effect]:
    """The forces that an observer finds, and how surely measurements tell them at rest."""
    if simulation.scene.observer is None:
        return
    observer, first = ForceObserver(simulation), 0
    observer.look()
    noise = simulation.scene.observer.marker_noise or USUAL_NOISE
    told, named = observer.told(noise), f"by a frame with {number(1e3 * noise)} mm of noise"
    named = named if simulation.scene.markers else "by the sensors"
    for force in simulation.model.force_term(ObservedLoads).places:
        deviations = told[first : first + force.dimension]
        first += force.dimension
        what = ("force and torque on a rigid body" if force.is_wrench else
                "force, and its place on the surface" if force.is_found else "force at known points")
        sure = f"each component within {deviations[:3].max():.2g} N (1 sigma)"
        if force.is_wrench:
            sure += f" and {deviations[3:].max():.2g} N m"
        yield Effect(f"observer: {force.name}", f"{what}; {sure} {named}, at rest",
                     _term(names, "observed loads"))


def terms(simulation: Simulation) -> list[tuple[str, str]]:
    """Name, and kind, size and class of the terms that a step sums; alike ones are one row.

    Args:
        simulation: The simulation of the scene.
    """
    lines = Counter()
    for term in simulation.terms:
        is_force = not hasattr(term, "row_count")
        size = _term_size(term) if is_force else _describe_rows(term)
        kind = "force" if is_force else "constraint"
        lines[term.name, f"{kind}, {size}, by {type(term).__name__}"] += 1
    return [(name if many == 1 else f"{name} ({many})", text)
            for (name, text), many in lines.items()]


def sizes(simulation: Simulation) -> list[tuple[str, str]]:
    """What a user asks first: what moves, how large and heavy it is, and the sizes of the system.

    Args:
        simulation: The simulation of the scene.
    """
    model = simulation.model
    named = {
        "actuators": simulation.actuator_names, "effectors": simulation.effector_names,
        **{what: [part.name for part in parts] for what, parts in (
            ("bodies", model.bodies), ("beams", model.beams), ("rigid bodies", model.rigid))},
    }  # fmt: skip
    lines = [(what, _named(list(names)) or "none") for what, names in named.items()
             if names or what not in ("beams", "rigid bodies")]  # fmt: skip
    surface = simulation.surface_positions()
    if len(surface):
        low, high = surface.min(axis=0), surface.max(axis=0)
        rounding = 1e-6 * np.max(high - low)
        low, high = (np.where(np.abs(end) < rounding, 0.0, end) for end in (low, high))
        lines.append(("bounding box", f"{vector(1e3 * low)} to {vector(1e3 * high)} mm"))
    lines += _weights(simulation)
    lines += _by_value("thinnest part of", [
        (body.name, _across(part, body.entry.element))
        for body, part in zip(simulation.model.bodies, thinnest_parts(simulation), strict=True)])
    threads = getattr(without_rows(model.factorization), "thread_count", 1)
    lines.append(("unknowns", f"{simulation.dof_count}"
                  + (f", factorized by {threads} threads" if threads > 1 else "")))
    if simulation.node_count:
        cells = {"tets": simulation.tet_count, "hexahedra": simulation.hexahedron_count}
        lines.append(("mesh", ", ".join([f"{simulation.node_count} nodes", *(
            f"{many} {name}" for name, many in cells.items() if many)])))
    if model.beams:
        lines.append(("beam elements", str(simulation.beam_element_count)))
    return lines


LEAST_ACROSS = 2.0
"""Elements with four nodes across the thinnest part of a body below which a warning is printed."""
FOUR_NODES = ("linear", "smoothed")
"""Elements that need at least as many."""


def _across(part: ThinnestPart, element: str) -> str:
    """A thinnest part in words; its place is left out, as it differs between equal bodies."""
    if part.elements != part.elements:
        return f"{1e3 * part.thickness:.3g} mm"
    return (f"{1e3 * part.thickness:.3g} mm, {part.elements:.2g} {element} "
            f"element{'' if round(part.elements, 1) == 1.0 else 's'} across")


def thinnest_parts(simulation: Simulation) -> list[ThinnestPart]:
    """Thinnest part of each deformable body at rest; bodies with one mesh are measured once.

    Args:
        simulation: The simulation of the scene.
    """
    found: dict[tuple, ThinnestPart] = {}
    parts = []
    for body in simulation.model.bodies:
        key = (str(body.entry.mesh.file), body.entry.mesh.scale, body.mesh.cell_count)
        if key[0] == "None" or key not in found:
            found[key] = thinnest_part(body.mesh)
        parts.append(found[key])
    return parts


def thin_warnings(simulation: Simulation) -> list[str]:
    """A warning for elements with four nodes that are too few across the thinnest part of a body.

    Args:
        simulation: The simulation of the scene.
    """
    thin = by_key(
        (_across(part, body.entry.element), body.name)
        for body, part in zip(simulation.model.bodies, thinnest_parts(simulation), strict=True)
        if body.entry.element in FOUR_NODES and part.elements < LEAST_ACROSS - 0.05
    )  # fmt: skip
    return [f"{_named(names)}: thinnest part {words}; with fewer than {LEAST_ACROSS:.0f} it bends "
            "far too stiffly: use a finer mesh or quadratic elements"
            for words, names in thin.items()]


def rest_paths(simulation: Simulation) -> list[tuple[str, str]]:
    """Length at rest and path of each cable: its pull point, points between, its last point.

    Of many cables, those that are alike in their names and equally long share a row.

    Args:
        simulation: The simulation of the scene.
    """
    kind_of, paths = simulation.actuators.kind_of, simulation.actuator_paths()
    rest = dict(zip(simulation.actuator_names, simulation.rest_setpoints, strict=True))
    cables = {name: path for name, path in paths.items() if kind_of[name].one_sided}
    many = len(cables) > 2 * _MOST_ROWS
    alike = by_key(((re.sub(r"\d+", "#", name), len(path)) if many else name, name)
                   for name, path in cables.items())  # fmt: skip
    rows = []
    for names in alike.values():
        path = cables[names[0]]
        lengths = [f"{1e3 * rest[name]:.4g}" for name in names]
        between = len(path) - 2
        via = f" through {count(range(between), 'point')}" if between else ""
        first = "" if len(names) == 1 else f", {names[0]}"
        which = names[0] if len(names) == 1 else f"{_named(names)} ({len(names)})"
        rows.append((which, f"{_range(tuple(lengths))} mm{first} from {_short(path[0])}{via} to "
                     f"{_short(path[-1])} mm"))
    return rows


def _short(place: np.ndarray) -> str:
    """A place [m] in mm, with four digits."""
    size = 1e-6 * float(np.abs(place).max(initial=0.0))
    shown = [f"{1e3 * (value if abs(value) > size else 0.0):.4g}" for value in place]
    return f"[{', '.join(shown)}]"


def _weights(simulation: Simulation) -> list[tuple[str, str]]:
    """Volume or length, mass and sag of the deformable bodies and beams."""
    lines = _by_value("volume, mass of", [
        (body.name, f"{number(body.mesh.volume)} m³, {number(body.mass)} kg")
        for body in simulation.model.bodies])  # fmt: skip
    lines += _by_value("length, mass of", [
        (beam.name, f"{number(1e3 * beam.lengths.sum())} mm, {number(beam.mass)} kg")
        for beam in simulation.model.beams])  # fmt: skip
    free = {part.name: _own_mass(part.entry, simulation) for part in simulation.model.rigid
            if part.is_free}
    lines += _by_value("mass of", [(name, f"{number(mass)} kg") for name, mass in free.items()])
    if len(simulation.model.bodies) + len(simulation.model.beams) + len(free) > 1:
        whole = sum(part.mass for part in (*simulation.model.bodies, *simulation.model.beams))
        lines.insert(0, ("mass of all", f"{number(whole + sum(free.values()))} kg"))
    reduced = any(body.vertebrae for body in simulation.model.bodies)
    if not lines or not any(simulation.scene.gravity) or reduced:
        return lines
    sag = expected_sag(simulation.model)
    if sag is not None:
        sag_text = f"{1e3 * sag:.3g} mm"
    elif simulation.model.is_held:
        sag_text = "no equilibrium found"
    else:
        sag_text = "not fixed: the body falls"
    if simulation.mounted is not None:
        return [*lines, *_prestress_lines(simulation)]
    return [*lines, ("sag by gravity alone, without actuators", sag_text)]


def _prestress_lines(simulation: Simulation) -> Iterator[tuple[str, str]]:
    """What mounting left in a robot: its energy, and how it pulls at its mounts."""
    found = prestress(simulation)
    yield "elastic energy as mounted", f"{found.energy:.4g} J"
    yield from _by_value("force of the robot on", [
        (name, f"{np.linalg.norm(force):.3g} N, torque {np.linalg.norm(found.torques[name]):.3g} N m")
        for name, force in found.forces.items()
    ])  # fmt: skip
    actuators = simulation.actuators
    for kind in dict.fromkeys(actuators.kinds):
        factor, unit = _shown(kind.effort)
        yield from _by_value(f"{kind.effort.word} at rest of", [
            (name, f"{factor * effort:.3g} {unit}")
            for name, effort, own in zip(
                actuators.names, simulation.mounted.efforts, actuators.kinds, strict=True)
            if own is kind
        ])  # fmt: skip


def _own_mass(entry, simulation: Simulation) -> float:
    """Mass of a free rigid body [kg], without that of nodes and beams that move with it."""
    if entry.mass is not None:
        return entry.mass
    return entry.density * entry.shape.solid(simulation.scene.file_path, []).mass_properties()[0]


def _by_value(what: str, values: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Rows of a quantity, one for all names that have the same value."""
    return [(f"{what} {'each of ' if len(names) > 1 else ''}{_named(names)}", value)
            for value, names in by_key((value, name) for name, value in values).items()]


def _term_size(term) -> str:
    """Elements of a force term, and the nodes that each couples; empty where it has none."""
    stencils = term.stencils()
    if not len(stencils):
        return "no stiffness"
    return f"{count(stencils, 'stencil')} of {count(range(stencils.shape[1]), 'node')}"


def _describe_rows(term) -> str:
    if isinstance(term, Contacts):
        found = sorted(set(term.rows_of_pair.tolist())) or [1]
        return f"{' or '.join(map(str, found))} {'row' if found == [1] else 'rows'} a contact"
    return count(range(term.row_count), "row")


def _term(names: list[str], word: str) -> str:
    """Name of an entry's term, or ``no term``."""
    found = [name for name in names if word in name]
    return f"term {found[0]}" if found else "no term"


def _draw(simulation: Simulation, picture: Path, where: str, view: tuple[float, float] | None) -> None:
    """Draw a robot as it stands, with the names of all things."""
    shot = take_snapshot(simulation, None, simulation.scene.name)
    draw_snapshots([shot], picture, f"{simulation.scene.name} {where}", view, labelled=True)


def explain(scene: Path, mesh_error: bool = True, picture: Path | None = None,
            view: tuple[float, float] | None = None) -> int:
    """Prints what a scene contains, its effects, terms, stages, the error of its mesh and notes.

    Args:
        scene: Scene file.
        mesh_error: Whether the error of its mesh is estimated.
        picture: Picture to write of the scene at rest, with the names of all things; None for none.
        view: Elevation and azimuth of the eye in the picture [degrees]; None for the default.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: The scene or its mesh cannot be used, or the picture cannot be written.
    """
    if picture is not None:
        check_picture(picture)
    output = console()
    try:
        simulation = Simulation.from_scene_file(scene)
    except MountingError as error:
        if picture is not None:
            _draw(error.simulation, picture, "before the step that failed", view)
            output.print(f"picture of where its mounting stands: {picture}")
        raise
    output.print(f"{simulation.scene.name}: {scene}\n")
    asked = [(effect.entry, f"{effect.content} → {effect.result}")
             for effect in grouped(effects(simulation))]
    for title, rows in (
        ("The robot", sizes(simulation)),
        ("Cables at rest", rest_paths(simulation)),
        ("Entries of the scene → what they become", asked),
        ("Terms of a step", terms(simulation)),
        ("Stages of a step", [(", ".join(simulation.stages), "")]),
    ):
        if rows:
            print_apart(listing(title, rows))
    if picture is not None:
        _draw(simulation, picture, "at rest", view)
        output.print(f"picture: {picture}\n")
    if mesh_error:
        print_mesh_error(simulation.scene, with_table=True)
    with terminal_status("driving the cavities to their greatest pressures"):
        bursts = list(burst_warnings(simulation))
    for note in (*simulation.notes, *thin_warnings(simulation), *bursts,
                 *fibre_warnings(simulation, thinnest_parts(simulation))):  # fmt: skip
        warn(note)
    return 0
