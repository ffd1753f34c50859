"""Rules of deformable bodies: materials, masses, regions that are fixed or held by springs, motion in time."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

import meshio
import numpy as np

from softrobot_twin.conversion.computed_values import (
    LoadedMesh,
    array_of,
    indices_of,
    is_inside,
    is_rigid,
    is_true,
    mapped_from,
    mapping_of,
    mesh_of,
    number_of,
    points_of,
    shapes_of,
    state_mesh,
    state_of,
    used_topology,
    value_of,
)
from softrobot_twin.conversion.mesh_entries import own_file
from softrobot_twin.conversion.rules import (
    BODIES,
    FIXING,
    SETTINGS,
    BodyRecord,
    Conversion,
    rounded,
    rule,
    source_of,
)
from softrobot_twin.conversion.scene_text import SOURCE
from softrobot_twin.conversion.scene_tree import (
    KINDS,
    NotConverted,
    SceneComponent,
    SceneNode,
    components_below,
    first,
    follow,
    is_link,
    nearest,
    root_of,
)
from softrobot_twin.geometry.hexahedral_mesh import INTO_TETS

MASSLESS = 1.0
"""Density of a body without a mass [kg/m³]: small, as the step needs one."""
STIFF = 100.0
"""Springs at rest shapes that are this much stiffer than an element are fixed."""
STIFF_FRAME = 1e4
"""Springs at frames that are as stiff as this are fixed [N/m]."""
MOST_SPRINGS = 500
"""Soft springs of more points are not written."""
MOST_PARTS = 50
"""A body with more different moduli is not written."""
NEWTON_ITERATIONS = 10
"""Greatest number of linearizations in a step of a converted scene."""

_PARAMETERS = {"StVenantKirchhoff": 2, "NeoHookean": 2, "MooneyRivlin": 3, "Ogden": 3}
"""Numbers in the ParameterSet of each material."""


class _Elastic(NamedTuple):
    """A law on some cells.

    Attributes:
        law: Its name here.
        mu: µ of each cell [Pa]; zero for laws with constants.
        lame: λ of each cell [Pa].
        entry: Keys of the law in place of the moduli.
        cells: Which cells of the body, shape (cell_count,).
    """

    law: str
    mu: np.ndarray
    lame: np.ndarray
    entry: dict[str, Any]
    cells: np.ndarray


# --- settings -------------------------------------------------------------------------------------


@rule(SETTINGS, *KINDS["movers"])
def motion(conversion: Conversion, component: SceneComponent) -> str | None:
    """The scheme of motion in time, for what is simulated below it.

    Args:
        conversion: The conversion.
        component: The solver.
    """
    if not components_below(component.node, KINDS["elastic"] + KINDS["masses"] + KINDS["beams"]):
        return None
    first_order = component.kind in KINDS["euler_implicit"] and is_true(component, "firstOrder", False)
    word = "quasi_static" if component.kind in KINDS["static"] else "first_order" if first_order else "dynamic"
    if conversion.scene.setdefault("integration", word) != word:
        raise NotConverted(f"its motion, {word}, is not that of {conversion.scene['integration']} bodies: "
                           "a scene has one")  # fmt: skip
    if component.kind in KINDS["other_motion"]:
        conversion.notes.append(f"{component.kind} ({component.where}) becomes backward Euler")
    component.read |= {"rayleighStiffness", "rayleighMass"}
    if is_true(component, "trapezoidalScheme", False):
        raise NotConverted("its trapezoidal scheme: time_scheme generalized_alpha is near to it")
    return f"integration {word}"


# --- materials ------------------------------------------------------------------------------------


@rule(BODIES, *KINDS["elastic"])
def body(conversion: Conversion, component: SceneComponent) -> str | None:
    """A body from all force fields on one state.

    Args:
        conversion: The conversion.
        component: One of them.
    """
    state = conversion.state(component)
    if id(state) in conversion.bodies:
        return f"{conversion.bodies[id(state)].name}.materials"
    fields = _acting_on(state, KINDS["elastic"])
    if is_rigid(state):
        raise NotConverted("it acts on frames, not on points")
    mesh = _body_mesh(state, fields)
    cells = mesh.hexahedra if len(mesh.hexahedra) else mesh.tets
    laws = [_elastic(conversion, one, state, cells) for one in fields]
    held = np.any([one.cells for one in laws], axis=0)
    if not held.all():  # nothing holds the others: here they do not exist
        cells = cells[held]
        laws = [one._replace(mu=one.mu[held], lame=one.lame[held], cells=one.cells[held]) for one in laws]
        mesh = mesh._replace(file=None, **{"hexahedra" if len(mesh.hexahedra) else "tets": cells})
    groups, volumes = _grouped(laws), _volumes(mesh)
    groups.sort(key=lambda one: -float(volumes[one[1]].sum()))
    (base, _), *parts = groups
    named = [(f"part_{index + 1}", *one) for index, one in enumerate(parts)]
    name = conversion.name(state.node.name)
    entry: dict[str, Any] = {SOURCE: [source_of(component)], "name": name}
    acting = {id(one): law.cells for one, law in zip(fields, laws, strict=True)}
    record = conversion.bodies[id(state)] = BodyRecord(name, entry, state, mesh, acting, groups)
    entry["mesh"] = _mesh_entry(conversion, record, [(part, chosen) for part, _, chosen in named])
    entry["element"] = "hexahedral" if len(mesh.hexahedra) else "linear"
    entry["material"] = dict(base)
    if parts:
        entry["materials"] = [{"region": part, **made} for part, made, _ in named]
    _add_mass(conversion, record, volumes)
    entry |= damping_of(state.node)
    conversion.scene.setdefault("bodies", []).append(entry)
    moduli = (f"E {1e-3 * base['young_modulus']:.4g} kPa, ν {base['poisson_ratio']:.4g}" if "young_modulus" in base
              else f"{base['law']}, {base['constants']}")  # fmt: skip
    size = " × ".join(f"{1e3 * conversion.units.metre * one:.4g}" for one in np.ptp(mesh.points, axis=0))
    more = f", {len(parts)} stiffer or softer part{'s'[:len(parts) > 1]}" if parts else ""
    return f"body {name}: {len(mesh.points)} nodes, {size} mm, {moduli}{more}"


def _acting_on(state: SceneComponent, kinds: tuple[str, ...]) -> list[SceneComponent]:
    return [one for one in components_below(root_of(state.node), kinds) if state_of(one.node) is state]


def _body_mesh(state: SceneComponent, fields: list[SceneComponent]) -> LoadedMesh:
    """The points of a state, and the cells that its force fields act on."""
    mesh = state_mesh(state)
    own = [one for one in state.node.components if one.kind in KINDS["topologies"]]
    tops = dict.fromkeys([*own, *map(used_topology, fields)])
    found = [one for one in map(mesh_of, filter(None, tops)) if len(one.tets) or len(one.hexahedra)]
    found = found[: 1 if own else None]
    if not found:
        raise NotConverted("its node has no topology with cells")
    tets = np.unique(np.concatenate([one.tets for one in found]), axis=0) if len(found) > 1 else found[0].tets
    hexahedra = found[0].hexahedra
    if len(hexahedra) and any("Hexa" in one.kind + str(one.fields.get("template")) for one in fields):
        tets = tets[:0]
    elif len(hexahedra):
        tets, hexahedra = tets if len(tets) else hexahedra[:, INTO_TETS].reshape(-1, 4), hexahedra[:0]
    if max(int(part.max(initial=-1)) for part in (tets, hexahedra)) >= len(mesh.points):
        raise NotConverted(f"its cells name points beyond the {len(mesh.points)} of its state")
    same = mesh.tets.shape == tets.shape and mesh.hexahedra.shape == hexahedra.shape
    return mesh._replace(tets=tets, hexahedra=hexahedra, file=mesh.file if same else None)


def _elastic(conversion: Conversion, component: SceneComponent, state: SceneComponent, cells: np.ndarray) -> _Elastic:
    """The law of a force field, and the cells of the body that it acts on."""
    covers = np.ones(len(cells), bool)
    topology = used_topology(component)
    if topology is not None and topology.node is not state.node:
        mesh = mesh_of(topology)
        own = {tuple(sorted(cell)) for cell in (mesh.hexahedra if cells.shape[1] == 8 else mesh.tets).tolist()}
        # An empty one is filled from the one above, by a mapping such as Hexa2TetraTopologicalMapping.
        covers = np.array([tuple(sorted(cell)) in own for cell in cells.tolist()]) if own else covers
    if component.kind in KINDS["hyperelastic"]:
        return _hyperelastic(conversion, component, covers)
    ratio = number_of(component, "poissonRatio", otherwise=0.45)
    young = (array_of(component, 1, "youngModulus", otherwise=[5000.0])
             * array_of(component, 1, "localStiffnessFactor", otherwise=[1.0]))  # fmt: skip
    if len(young) not in (1, len(cells), int(covers.sum())):
        raise NotConverted(f"has {len(young)} moduli for {len(cells)} cells")
    every = np.zeros(len(cells))
    every[covers if len(young) == covers.sum() else slice(None)] = young * conversion.units.pressure
    if ratio >= 0.5:
        raise NotConverted(f"poissonRatio {ratio:g} must be below 0.5")
    method = str(value_of(component, "method") or "large").lower()
    law = "linear" if method == "small" or component.kind.startswith("LinearSmall") else "corotational"
    mu = every / (2.0 * (1.0 + ratio))
    return _Elastic(law, mu, mu * 2.0 * ratio / (1.0 - 2.0 * ratio), {}, covers)


def _hyperelastic(conversion: Conversion, component: SceneComponent, covers: np.ndarray) -> _Elastic:
    """A hyperelastic law, whose parameters are in the convention of SOFA."""
    name = str(value_of(component, "materialName") or "(none)")
    given = array_of(component, 1, "ParameterSet", otherwise=[])
    if name not in _PARAMETERS:
        raise NotConverted(f"its material {name} is not built here")
    if len(given) < _PARAMETERS[name]:
        raise NotConverted(f"its ParameterSet has {len(given)} numbers, too few for {name}")
    one, two, *more = given * conversion.units.pressure
    none = np.zeros(len(covers))
    if name == "StVenantKirchhoff":
        return _Elastic("saint_venant_kirchhoff", none + one, none + two, {}, covers)
    if name == "NeoHookean":
        return _Elastic("neo_hookean", none + one, none + two - 2.0 * one / 3.0, {}, covers)
    if name == "MooneyRivlin":
        law, constants, bulk = "mooney_rivlin", {"c10": one, "c01": two}, more[0]
    else:
        # SOFA's energy is µ/α² Σ λ^α; the one here is µ/α Σ λ^α.
        law, bulk, constants = "ogden", one, {"shear_moduli": np.array([two / given[2]]), "exponents": given[2:3]}
    constants = {key: rounded(value) for key, value in constants.items()}
    return _Elastic(law, none, none, {"constants": constants, "bulk_modulus": rounded(bulk)}, covers)


def _grouped(laws: list[_Elastic]) -> list[tuple[dict[str, Any], np.ndarray]]:
    """Materials and their cells: Lamé's constants of force fields on the same cell add up."""
    law, *others = laws
    if len({one.law for one in laws}) > 1 or others and any(one.entry for one in laws):
        raise NotConverted("its force fields have several laws, whose sum is none here")
    if law.entry:
        return [({"law": law.law, **law.entry}, np.arange(len(law.cells)))]
    pairs = sum(np.where(one.cells, [one.mu, one.lame], 0.0) for one in laws).T
    if not (pairs[:, 0] > 0.0).all():
        raise NotConverted("its Young's modulus is zero")
    _, place, kinds = np.unique(np.round(pairs / pairs.max(), 10), axis=0, return_index=True, return_inverse=True)
    if len(place) > MOST_PARTS:
        raise NotConverted(f"has {len(place)} different moduli, more than {MOST_PARTS}")
    return [({"law": law.law, "young_modulus": rounded(mu * (3.0 * lame + 2.0 * mu) / (lame + mu)),
              "poisson_ratio": rounded(lame / (2.0 * (lame + mu)))}, np.flatnonzero(np.ravel(kinds) == kind))
            for kind, (mu, lame) in enumerate(pairs[place])]  # fmt: skip


def _volumes(mesh: LoadedMesh) -> np.ndarray:
    """Volume of each cell, in the unit of the file."""
    cells = mesh.hexahedra[:, INTO_TETS].reshape(-1, 4) if len(mesh.hexahedra) else mesh.tets
    corners = mesh.points[cells]
    own = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    return own.reshape(len(mesh.hexahedra), -1).sum(axis=1) if len(mesh.hexahedra) else own


# --- meshes ---------------------------------------------------------------------------------------


def _mesh_entry(conversion: Conversion, record: BodyRecord, parts: list[tuple[str, np.ndarray]]) -> dict[str, Any]:
    """The mesh: the scene's own file with its placement, or a file that is written."""
    mesh = record.mesh
    own = None if parts else own_file(conversion, mesh, (".vtk", ".vtu", ".msh"))
    if own is not None:
        return own
    name = f"{conversion.output.stem}_{record.name}.msh"
    kind, cells = ("hexahedron", mesh.hexahedra) if len(mesh.hexahedra) else ("tetra", mesh.tets)
    number = np.ones(len(cells), np.int32)
    for index, (_, chosen) in enumerate(parts):
        number[chosen] = index + 2
    named = {part: np.array([index + 1, 3]) for index, part in enumerate(["body", *(one for one, _ in parts)])}
    content = meshio.Mesh(mesh.points * conversion.units.metre, [(kind, cells)], field_data=named,
                          cell_data={"gmsh:physical": [number], "gmsh:geometrical": [number]})  # fmt: skip
    conversion.files[name] = lambda path: meshio.write(path, content, file_format="gmsh22", binary=False)
    record.mesh = mesh._replace(file=None)
    return {"file": name}


# --- mass and damping -----------------------------------------------------------------------------


def mass_of(state: SceneComponent, count: int) -> tuple[SceneComponent | None, float | None]:
    """The mass component of a state, and its total mass in the unit of the file; None where it has a density.

    Args:
        state: The state.
        count: Number of its points.
    """
    mass = next(iter(_acting_on(state, KINDS["masses"])), None)
    if mass is None:
        return None, None
    vertex = number_of(mass, "vertexMass", "mass")
    usual = 1.0 if mass.kind == "UniformMass" else None
    return mass, number_of(mass, "totalMass", "totalmass", otherwise=usual if vertex is None else vertex * count)


def _add_mass(conversion: Conversion, record: BodyRecord, volumes: np.ndarray) -> None:
    """The mass of a body, from the mass component of its state."""
    mass, total = mass_of(record.state, len(record.mesh.points))
    material, units = record.entry["material"], conversion.units
    if mass is None:
        conversion.notes.append(f"body {record.name} has no mass: it takes {MASSLESS:g} kg/m³")
        material["density"] = MASSLESS
        return
    if total is None:
        source = first(mass.node, ("NodalMassDensity",)) or mass
        density = array_of(source, 1, "massDensity", "property", otherwise=[1.0])
        material["density"] = rounded(density[0] * units.density)
        if np.ptp(density) > 0.0:
            conversion.missing.append((mass, "its densities differ: the first one is taken for the body"))
    elif "materials" in record.entry:
        material["density"] = rounded(total / volumes.sum() * units.density)
    else:
        material["total_mass"] = rounded(total * units.kilogram)
    is_lumped = mass.kind == "DiagonalMass" or is_true(mass, "lumping", False)
    record.entry["mass"] = "uniform" if mass.kind == "UniformMass" else "lumped" if is_lumped else "consistent"


@rule(FIXING, *KINDS["masses"])
def mass(conversion: Conversion, component: SceneComponent) -> str | None:
    """Tells what a mass became; bodies have read it.

    Args:
        conversion: The conversion.
        component: The mass.
    """
    state = conversion.state(component)
    record = conversion.bodies.get(id(state))
    if record is None:
        if id(state) not in conversion.frames and _is_moving(state):
            raise NotConverted("the points that it belongs to move, and are no body that is converted")
        return None
    if mass_of(state, 0)[0] is not component:
        raise NotConverted("a second mass of its body")
    material = record.entry["material"]
    return (f"{record.name}: {1e3 * material['total_mass']:.4g} g" if "total_mass" in material
            else f"{record.name}: {material['density']:.4g} kg/m³")  # fmt: skip


def damping_of(node: SceneNode) -> dict[str, Any]:
    """Rayleigh damping of the solver above a node; the drag of first-order motion is the mass.

    Args:
        node: The node of a body or a beam.

    Returns:
        The key `damping` of an entry, or nothing.
    """
    solver = nearest(node, KINDS["euler_implicit"])
    if solver is None:
        return {}
    given = {key: number_of(solver, f"rayleigh{key.title()}", otherwise=0.0) for key in ("mass", "stiffness")}
    if is_true(solver, "firstOrder", False):
        given["mass"] = 1.0
    return {"damping": {key: value for key, value in given.items() if value}} if any(given.values()) else {}


# --- what is fixed --------------------------------------------------------------------------------


@rule(FIXING, *KINDS["fixing"])
def fixed(conversion: Conversion, component: SceneComponent) -> str | None:
    """Points that do not move, along all axes or some.

    Args:
        conversion: The conversion.
        component: The constraint.
    """
    state = conversion.state(component)
    for whole in conversion.bodies.values():
        for _, nodes, points in parts_of(whole, [state]):
            chosen = nodes[np.argsort(points)][indices_of(component, "indices", otherwise=[0])]
            return _fix(whole, component, [{"nodes": np.unique(chosen).tolist()}])
    record = _held_record(conversion, component)
    if not isinstance(record, BodyRecord):
        return record
    if is_true(component, "fixAll", False):
        return _fix(record, component, [{"nodes": list(range(len(record.mesh.points)))}])
    return _fix(record, component, _regions(conversion, record, component, "indices"))


def parts_of(
    record: BodyRecord, states: Collection[SceneComponent]
) -> list[tuple[SceneComponent, np.ndarray, np.ndarray]]:
    """The parts that a mapping joins to a body: their state, nodes of the body, and the part's points at these.

    Args:
        record: The body.
        states: States whose parts are looked for.

    Raises:
        NotConverted: The mapping has other points than the body.
    """
    mapping = mapping_of(record.state)
    sources = mapped_from(record.state, mapping)
    if mapping is None or mapping.kind != "SubsetMultiMapping" or not any(one in states for one in sources):
        return []
    pairs = array_of(mapping, 2, "indexPairs", otherwise=np.empty((0, 2))).astype(np.int64)
    if len(pairs) != len(record.mesh.points):
        raise NotConverted(f"indexPairs of {mapping.where} are not those of {len(record.mesh.points)} points")
    every = ((one, pairs[:, 0] == number) for number, one in enumerate(sources) if one in states)
    return [(one, np.flatnonzero(is_own), pairs[is_own, 1]) for one, is_own in every]


def _held_record(conversion: Conversion, component: SceneComponent) -> BodyRecord | str | None:
    """The body that a component holds; what it becomes for frames; None for what does not move."""
    state = conversion.state(component)
    if id(state) in conversion.frames:
        return _fix_frames(conversion, component, conversion.frames[id(state)])
    if id(state) not in conversion.bodies and _is_moving(state):
        raise NotConverted("its body is not converted")
    return conversion.bodies.get(id(state))


def _is_moving(state: SceneComponent) -> bool:
    return nearest(state.node, KINDS["movers"]) is not None


def _fix(record: BodyRecord, component: SceneComponent, regions: list[dict[str, Any]]) -> str:
    axes = [axis for axis, is_held in zip("xyz", _directions(component), strict=False) if is_held]
    if not axes:
        return "nothing, as it holds no axis"
    if len(axes) < 3:
        regions = [{**one, "axes": axes} for one in regions]
    record.entry.setdefault("fixed", []).extend({SOURCE: [source_of(component)], **one} for one in regions)
    return f"{record.name}.fixed"


def _directions(component: SceneComponent) -> np.ndarray:
    """Whether a constraint holds points or frames along each axis, and about it."""
    return array_of(component, 1, "fixedDirections", otherwise=[1.0] * 3).ravel()


def _fix_frames(conversion: Conversion, component: SceneComponent, names: list[str]) -> str:
    """Rigid bodies that do not move, or ends of a beam."""
    motion = "fixed"
    if not _directions(component).all():
        if not conversion.is_static or not _acting_on(conversion.state(component), ("SlidingActuator",)):
            raise NotConverted("frames that are fixed along or about some axes only are not built here")
        motion = "guided"  # by a slide
    chosen = indices_of(component, "indices", "points", otherwise=[0])
    beams, rigids = ({one["name"]: one for one in conversion.scene.get(section, ())}
                     for section in ("beams", "rigid_bodies"))  # fmt: skip
    told = {names[min(index, len(names) - 1)]: index for index in chosen}
    for name, index in told.items():
        if name in beams and motion == "guided":
            raise NotConverted("the slide of a beam is not built: join its end to a rigid body")
        if name in beams and index not in (0, len(names) - 1):
            raise NotConverted(f"point {index} is inside the beam {name}: ends can be fixed")
        if name in beams:
            beams[name].setdefault("fixed", []).append("end" if index else "start")
        elif name:  # others are frames of the world
            rigids[name]["motion"] = motion
            rigids[name].pop("mass", None)
    return f"{', '.join(filter(None, told)) or 'a frame of the world'}: {motion}"


def _regions(
    conversion: Conversion, record: BodyRecord, component: SceneComponent, *names: str
) -> list[dict[str, Any]]:
    """Regions of a body: boxes and spheres where a region of interest of the same points says so."""
    given = next((component.fields[name] for name in names if component.fields.get(name) is not None), None)
    roi, output = follow(given, component.node) if is_link(given) else (None, None)
    if isinstance(roi, SceneComponent) and roi.kind in KINDS["regions"] and output == "indices":
        has_own = roi.fields.get("position") is not None or roi.fields.get("orientedBox") is not None
        if state_of(roi.node) is record.state and not has_own:
            component.read.update(names)
            return _region_shapes(conversion, record, roi)
    chosen = indices_of(component, *names)
    if chosen is not None and not len(chosen):
        raise NotConverted("it selects no points")
    return [{"nodes": [0] if chosen is None else np.unique(chosen).tolist()}]


def _region_shapes(conversion: Conversion, record: BodyRecord, roi: SceneComponent) -> list[dict[str, Any]]:
    made = [{kind: {key: conversion.length(value) for key, value in shape.items()}}
            for kind, shape in shapes_of(roi) if is_inside(record.mesh.points, kind, shape).any()]  # fmt: skip
    if not made:
        raise NotConverted(f"{roi.kind} {roi.name} ({roi.where}) selects no points")
    return made


@rule(FIXING, *KINDS["rest_springs"])
def rest_shape_springs(conversion: Conversion, component: SceneComponent) -> str | None:
    """Springs to the rest shape: stiff ones fix points.

    Args:
        conversion: The conversion.
        component: The springs.
    """
    state, anchors = conversion.state(component), None
    external = value_of(component, "external_rest_shape")
    if isinstance(external, SceneComponent) and state_of(external.node) is not state:
        if mapped_from(external) or is_rigid(external) or nearest(external.node, KINDS["euler_implicit"]):
            raise NotConverted("springs to the shape of another state that moves are not built here")
        own = indices_of(component, "external_points", otherwise=np.arange(len(points_of(external))))
        anchors = points_of(external)[own]
    hardness = array_of(component, 1, "stiffness", otherwise=[100.0]) * conversion.units.stiffness
    if id(state) in conversion.frames and hardness.min() < STIFF_FRAME:
        raise NotConverted(f"a frame on a spring of {hardness.min():g} N/m; from {STIFF_FRAME:g} it is fixed")
    record = _held_record(conversion, component)
    if not isinstance(record, BodyRecord):
        return record
    if anchors is None and hardness.min() >= STIFF * _node_stiffness(conversion, record):
        return _fix(record, component, _regions(conversion, record, component, "points", "indices"))
    points = record.mesh.points
    chosen = indices_of(component, "points", "indices", otherwise=np.arange(len(points)))
    if len(chosen) > MOST_SPRINGS:
        raise NotConverted(f"{len(chosen)} soft springs are more than {MOST_SPRINGS}")
    anchors = points[chosen] if anchors is None else anchors
    if len(anchors) != len(chosen):
        raise NotConverted(f"{len(chosen)} points are held at {len(anchors)} places")
    for index, value, held_at in zip(chosen, np.resize(hardness, len(chosen)), anchors, strict=True):
        conversion.add("springs", component, {
            "name": conversion.name(f"{record.name}_rest_{index}"),
            "ends": [{"on": record.name, "point": conversion.length(points[index])},
                     {"point": conversion.length(held_at)}],
            "stiffness": rounded(value), "rest_length": 0.0})  # fmt: skip
    return f"{len(chosen)} springs of {hardness[0]:.4g} N/m"


def _node_stiffness(conversion: Conversion, record: BodyRecord) -> float:
    """Stiffness of an element, E times its size [N/m]."""
    material = record.entry["material"]
    young = material.get("young_modulus") or material["bulk_modulus"]
    return float(young * np.cbrt(_volumes(record.mesh).mean()) * conversion.units.metre)
