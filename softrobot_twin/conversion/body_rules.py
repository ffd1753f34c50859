"""Rules of deformable bodies: materials, masses, regions that are fixed or held by springs, motion in time."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import meshio
import numpy as np

from softrobot_twin.conversion.computed_values import (
    REGIONS,
    TOPOLOGIES,
    LoadedMesh,
    array_of,
    boxes_of,
    indices_of,
    is_rigid,
    is_true,
    mapped_from,
    mesh_of,
    number_of,
    points_of,
    spheres_of,
    state_mesh,
    state_of,
    topology_of,
    value_of,
)
from softrobot_twin.conversion.rules import (
    BODIES,
    FIXING,
    SETTINGS,
    BodyRecord,
    Conversion,
    is_below_node,
    rounded,
    rule,
    source_of,
)
from softrobot_twin.conversion.scene_text import SOURCE
from softrobot_twin.conversion.scene_tree import (
    NotConverted,
    SceneComponent,
    first,
    follow,
    is_link,
    nearest,
)
from softrobot_twin.geometry.hexahedral_mesh import INTO_TETS

LINEAR = ("TetrahedronFEMForceField", "FastTetrahedralCorotationalForceField",
          "TetrahedralCorotationalFEMForceField", "HexahedronFEMForceField",
          "TetrahedronCorotationalFEMForceField", "CorotationalFEMForceField",
          "LinearSmallStrainFEMForceField", "ParallelTetrahedronFEMForceField",
          "HexahedronFEMForceFieldAndMass")  # fmt: skip
HYPERELASTIC = ("TetrahedronHyperelasticityFEMForceField", "StandardTetrahedralFEMForceField")
EULER_IMPLICIT = ("EulerImplicitSolver", "EulerImplicitIntegrationScheme", "EulerImplicit")
STATIC = ("StaticSolver", "StaticEquationSolver", "NewtonRaphsonSolver")
OTHER_MOTION = ("EulerExplicitSolver", "EulerSolver", "RungeKutta4Solver", "RungeKutta2Solver",
                "CentralDifferenceSolver", "NewmarkImplicitSolver", "VariationalSymplecticSolver",
                "EulerExplicitIntegrationScheme")  # fmt: skip
MASSES = ("UniformMass", "MeshMatrixMass", "DiagonalMass")
MASSLESS = 1.0
"""Density of a body without a mass [kg/m³]: small, as the step needs one."""
STIFF = 100.0
"""Springs at rest shapes that are this much stiffer than an element are fixed."""
MOST_SPRINGS = 500
"""Soft springs of more points are not written."""
MOST_PARTS = 50
"""A body with more different moduli is not written."""
NEWTON_ITERATIONS = 10
"""Greatest number of linearizations in a step of a converted scene."""


class _Elastic(NamedTuple):
    """A law on some cells.

    Attributes:
        law: Its name here.
        mu: µ of each cell, in the unit of the file; None for laws with constants.
        lame: λ of each cell.
        entry: Keys of the law beside the moduli.
        cells: Which cells of the body, shape (cell_count,).
    """

    law: str
    mu: np.ndarray
    lame: np.ndarray
    entry: dict[str, Any]
    cells: np.ndarray


# --- settings -------------------------------------------------------------------------------------


@rule(SETTINGS, *EULER_IMPLICIT, *STATIC, *OTHER_MOTION)
def motion(conversion: Conversion, component: SceneComponent) -> str | None:
    """The scheme of motion in time, for what is simulated below it.

    Args:
        conversion: The conversion.
        component: The solver.
    """
    if not _is_simulated(conversion, component):
        return None
    first_order = component.kind in EULER_IMPLICIT and is_true(component, "firstOrder", False)
    word = "quasi_static" if component.kind in STATIC else "first_order" if first_order else "dynamic"
    if conversion.scene.setdefault("integration", word) != word:
        raise NotConverted(f"its motion, {word}, is not that of {conversion.scene['integration']} bodies: "
                           "a scene has one")  # fmt: skip
    if component.kind in OTHER_MOTION:
        conversion.notes.append(f"{component.kind} ({component.where}) becomes backward Euler")
    component.read |= {"rayleighStiffness", "rayleighMass"}
    if is_true(component, "trapezoidalScheme", False):
        raise NotConverted("its trapezoidal scheme: time_scheme generalized_alpha is near to it")
    return f"integration {word}"


def _is_simulated(conversion: Conversion, solver: SceneComponent) -> bool:
    forces = (*LINEAR, *HYPERELASTIC, *MASSES, "BeamInterpolation", "AdaptiveBeamForceFieldAndMass", "BeamFEMForceField")
    return any(one.kind in forces and is_below_node(one.node, solver.node) for one in conversion.components)


# --- materials ------------------------------------------------------------------------------------


@rule(BODIES, *LINEAR, *HYPERELASTIC)
def body(conversion: Conversion, component: SceneComponent) -> str | None:
    """A body from all force fields on one state.

    Args:
        conversion: The conversion.
        component: One of them.
    """
    state = conversion.state(component)
    if id(state) in conversion.bodies:
        return f"{conversion.bodies[id(state)].name}.materials"
    fields = [one for one in conversion.components
              if one.kind in (*LINEAR, *HYPERELASTIC) and state_of(one.node) is state]  # fmt: skip
    if is_rigid(state):
        raise NotConverted("it acts on frames, not on points")
    mesh = _body_mesh(state, fields)
    cells = mesh.hexahedra if len(mesh.hexahedra) else mesh.tets
    laws = [_elastic(one, state, cells) for one in fields]
    held = np.any([one.cells for one in laws], axis=0)
    if not held.all():  # nothing holds the others: here they do not exist
        cells, laws = cells[held], [_Elastic(*(part[held] if isinstance(part, np.ndarray) else part for part in one))
                                    for one in laws]
        mesh = mesh._replace(file=None, **{"hexahedra" if len(mesh.hexahedra) else "tets": cells})
    groups, volumes = _grouped(conversion, laws, len(cells)), _volumes(mesh)
    groups.sort(key=lambda one: -float(volumes[one[1]].sum()))
    (base, _), *parts = groups
    named = [(f"part_{index + 1}", *one) for index, one in enumerate(parts)]
    name = conversion.name(state.node.name)
    entry: dict[str, Any] = {SOURCE: [source_of(component)], "name": name}
    record = conversion.bodies[id(state)] = BodyRecord(name, entry, state, mesh)
    entry["mesh"] = _mesh_entry(conversion, record, [(part, chosen) for part, _, chosen in named])
    entry["element"] = "hexahedral" if len(mesh.hexahedra) else "linear"
    entry["material"] = dict(base)
    if parts:
        entry["materials"] = [{"region": part, **made} for part, made, _ in named]
    _add_mass(conversion, record, volumes, bool(parts))
    _add_damping(conversion, record)
    conversion.scene.setdefault("bodies", []).append(entry)
    size = " × ".join(f"{1e3 * conversion.units.metre * one:.4g}" for one in np.ptp(mesh.points, axis=0))
    more = f", {len(parts)} stiffer or softer part{'s'[:len(parts) > 1]}" if parts else ""
    return f"body {name}: {len(mesh.points)} nodes, {size} mm, {_moduli_in_words(base)}{more}"


def _moduli_in_words(material: dict[str, Any]) -> str:
    if "young_modulus" in material:
        return f"E {1e-3 * material['young_modulus']:.4g} kPa, ν {material['poisson_ratio']:.4g}"
    return f"{material['law']}, {material.get('constants', '')}"


def _body_mesh(state: SceneComponent, fields: list[SceneComponent]) -> LoadedMesh:
    """The points of a state, and the cells that its force fields act on."""
    mesh = state_mesh(state)
    own = [one for one in (first(state.node, TOPOLOGIES),) if one is not None]
    tops = own + [one for one in map(topology_of, (one.node for one in fields)) if one is not None and one not in own]
    found = [one for one in map(mesh_of, tops) if len(one.tets) or len(one.hexahedra)][: 1 if own else None]
    if not found:
        raise NotConverted("its node has no topology with cells")
    tets = np.unique(np.concatenate([one.tets for one in found]), axis=0) if len(found) > 1 else found[0].tets
    hexahedra = found[0].hexahedra
    if len(hexahedra) and any(one.kind.startswith("Hexa") for one in fields):
        tets = tets[:0]
    elif len(hexahedra):
        tets, hexahedra = tets if len(tets) else hexahedra[:, INTO_TETS].reshape(-1, 4), hexahedra[:0]
    if not len(tets) and not len(hexahedra):
        raise NotConverted("its topology has neither tetrahedra nor hexahedra")
    if max(int(part.max(initial=-1)) for part in (tets, hexahedra)) >= len(mesh.points):
        raise NotConverted(f"its cells name points beyond the {len(mesh.points)} of its state")
    same = mesh.tets.shape == tets.shape and mesh.hexahedra.shape == hexahedra.shape
    return mesh._replace(tets=tets, hexahedra=hexahedra, file=mesh.file if same else None)


def _elastic(component: SceneComponent, state: SceneComponent, cells: np.ndarray) -> _Elastic:
    """The law of a force field, and the cells of the body that it acts on."""
    covers = np.ones(len(cells), bool)
    topology = topology_of(component.node)
    if topology is not None and topology.node is not state.node:
        mesh = mesh_of(topology)
        own = {tuple(sorted(cell)) for cell in (mesh.hexahedra if cells.shape[1] == 8 else mesh.tets).tolist()}
        covers = np.array([tuple(sorted(cell)) in own for cell in cells.tolist()])
    if component.kind in HYPERELASTIC:
        return _Elastic(*_hyperelastic(component, len(cells)), covers)
    young = array_of(component, 1, "youngModulus")
    ratio = number_of(component, "poissonRatio", otherwise=0.45) or 0.0
    young = np.array([5000.0]) if young is None or not len(young) else young
    factor = array_of(component, 1, "localStiffnessFactor")
    young = young * (1.0 if factor is None or not len(factor) else factor)
    if len(young) not in (1, len(cells), int(covers.sum())):
        raise NotConverted(f"has {len(young)} moduli for {len(cells)} cells")
    every = np.zeros(len(cells))
    every[covers if len(young) == covers.sum() else slice(None)] = young
    if ratio >= 0.5:
        raise NotConverted(f"poissonRatio {ratio:g} must be below 0.5")
    method = str(value_of(component, "method") or "large").lower()
    law = "linear" if method == "small" or component.kind.startswith("LinearSmall") else "corotational"
    return _Elastic(law, every / (2.0 * (1.0 + ratio)),
                    every * ratio / ((1.0 + ratio) * (1.0 - 2.0 * ratio)), {}, covers)  # fmt: skip


def _hyperelastic(component: SceneComponent, count: int) -> tuple[str, np.ndarray, np.ndarray, dict]:
    """Law, moduli and constants of a hyperelastic material, in the convention of SOFA."""
    name = str(value_of(component, "materialName") or "")
    given = array_of(component, 1, "ParameterSet")
    if given is None or not len(given):
        raise NotConverted("it has no ParameterSet")
    if name == "StVenantKirchhoff":
        mu, lame = given[:2]
        return "saint_venant_kirchhoff", np.full(count, mu), np.full(count, lame), {}
    constants: dict[str, Callable[[], tuple[str, dict, float]]] = {
        "NeoHookean": lambda: ("neo_hookean", {}, given[1]),
        "MooneyRivlin": lambda: ("mooney_rivlin", {"c10": given[0], "c01": given[1]}, given[2]),
        # Its energy is µ/α² Σ λ^α; the one here is µ/α Σ λ^α.
        "Ogden": lambda: ("ogden", {"mu": [given[1] / given[2]], "alpha": [given[2]]}, given[0]),
    }
    if name not in constants:
        raise NotConverted(f"its material {name or '(none)'} is not built here")
    try:
        law, own, bulk = constants[name]()
    except IndexError:
        raise NotConverted(f"its ParameterSet has {len(given)} numbers, too few for {name}") from None
    if law == "neo_hookean":
        return law, np.full(count, given[0]), np.full(count, bulk - 2.0 * given[0] / 3.0), {}
    return law, np.zeros(count), np.zeros(count), {"constants": own, "bulk_modulus": bulk}


def _grouped(conversion: Conversion, laws: list[_Elastic], count: int) -> list[tuple[dict, np.ndarray]]:
    """Materials and their cells: Lamé's constants of force fields on the same cell add up."""
    if len({one.law for one in laws}) > 1 or (len(laws) > 1 and any(one.entry for one in laws)):
        raise NotConverted("its force fields have several laws, whose sum is none here")
    mu = sum(np.where(one.cells, one.mu, 0.0) for one in laws) * conversion.units.pressure
    lame = sum(np.where(one.cells, one.lame, 0.0) for one in laws) * conversion.units.pressure
    law, pressure = laws[0], conversion.units.pressure
    if law.entry:
        own = {key: [rounded(part * (pressure if key != "alpha" else 1.0)) for part in value]
               if isinstance(value, list) else rounded(value * pressure)
               for key, value in law.entry["constants"].items()}  # fmt: skip
        made = {"law": law.law, "constants": own, "bulk_modulus": rounded(law.entry["bulk_modulus"] * pressure)}
        return [(made, np.arange(count))]
    pairs = np.stack([mu, lame], axis=1)
    if not (mu > 0.0).all():
        raise NotConverted("its Young's modulus is zero")
    _, place, kinds = np.unique(np.round(pairs / pairs.max(), 10), axis=0, return_index=True, return_inverse=True)
    if len(place) > MOST_PARTS:
        raise NotConverted(f"has {len(place)} different moduli, more than {MOST_PARTS}")
    return [({"law": law.law, "young_modulus": rounded(one * (3 * two + 2 * one) / (two + one)),
              "poisson_ratio": rounded(two / (2.0 * (two + one)))}, np.flatnonzero(np.ravel(kinds) == kind))
            for kind, (one, two) in enumerate(pairs[place])]


def _volumes(mesh: LoadedMesh) -> np.ndarray:
    """Volume of each cell, in the unit of the file."""
    cells = mesh.hexahedra[:, INTO_TETS].reshape(-1, 4) if len(mesh.hexahedra) else mesh.tets
    corners = mesh.points[cells]
    own = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    return own.reshape(len(mesh.hexahedra), -1).sum(axis=1) if len(mesh.hexahedra) else own


# --- meshes ---------------------------------------------------------------------------------------


def _mesh_entry(conversion: Conversion, record: BodyRecord, parts: list[tuple[str, np.ndarray]]) -> dict:
    """The mesh: the scene's own file with its placement, or a file that is written."""
    mesh, metre = record.mesh, conversion.units.metre
    is_read = mesh.file is not None and mesh.file.suffix.lower() in (".vtk", ".vtu", ".msh")
    if is_read and not parts and mesh.placement.is_uniform:
        file = Path(os.path.relpath(mesh.file, conversion.output.resolve().parent)).as_posix()
        made: dict[str, Any] = {"file": file, "scale": rounded(metre * mesh.placement.scale[0])}
        angles = mesh.placement.rotation.as_euler("xyz")
        if np.abs(angles).max() > 1e-12:
            made["rotation"] = rounded(angles)
        if np.abs(mesh.placement.translation).max() > 0.0:
            made["translation"] = conversion.length(mesh.placement.translation)
        return made
    name = f"{conversion.output.stem}_{record.name}.msh"
    kind, cells = ("hexahedron", mesh.hexahedra) if len(mesh.hexahedra) else ("tetra", mesh.tets)
    number = np.ones(len(cells), np.int32)
    for index, (_, chosen) in enumerate(parts):
        number[chosen] = index + 2
    named = {part: np.array([index + 1, 3]) for index, part in enumerate(["body", *(one for one, _ in parts)])}
    content = meshio.Mesh(mesh.points * metre, [(kind, cells)], field_data=named,
                          cell_data={"gmsh:physical": [number], "gmsh:geometrical": [number]})  # fmt: skip
    conversion.files[name] = lambda path: meshio.write(path, content, file_format="gmsh22", binary=False)
    record.mesh = mesh._replace(file=None)
    return {"file": name}


# --- mass and damping -----------------------------------------------------------------------------


def _add_mass(conversion: Conversion, record: BodyRecord, volumes: np.ndarray, has_parts: bool) -> None:
    """The mass of a body, from the mass component of its state."""
    masses = [one for one in conversion.components if one.kind in MASSES and state_of(one.node) is record.state]
    material, kilogram = record.entry["material"], conversion.units.kilogram
    volume = float(volumes.sum()) * conversion.units.metre**3
    if not masses:
        conversion.notes.append(f"body {record.name} has no mass: it takes {MASSLESS:g} kg/m³")
        material["density"] = MASSLESS
        return
    mass = masses[0]
    total, density = number_of(mass, "totalMass", "totalmass"), array_of(mass, 1, "massDensity")
    vertex = number_of(mass, "vertexMass", "mass")
    if mass.kind != "UniformMass" and total is None and vertex is None:
        density = np.ones(1) if density is None or not len(density) else density
        material["density"] = rounded(density[0] * conversion.units.density)
        if np.ptp(density) > 0.0:
            conversion.missing.append((mass, "its densities differ: the first one is taken for the body"))
    else:
        if total is None:
            total = 1.0 if vertex is None else vertex * len(record.mesh.points)
        if has_parts:
            material["density"] = rounded(total * kilogram / volume)
        else:
            material["total_mass"] = rounded(total * kilogram)
    is_lumped = mass.kind == "DiagonalMass" or is_true(mass, "lumping", False)
    record.entry["mass"] = "uniform" if mass.kind == "UniformMass" else "lumped" if is_lumped else "consistent"


@rule(FIXING, *MASSES)
def mass(conversion: Conversion, component: SceneComponent) -> str | None:
    """Tells what a mass became; bodies have read it.

    Args:
        conversion: The conversion.
        component: The mass.
    """
    state = state_of(component.node)
    record = None if state is None else conversion.bodies.get(id(state))
    if record is None:
        if state is not None and id(state) not in conversion.frames and _is_moving(conversion, state):
            raise NotConverted("the points that it belongs to move, and are no body that is converted")
        return None
    if any(one is not component and state_of(one.node) is state for one in conversion.components
           if one.kind in MASSES and one.place < component.place):
        raise NotConverted("a second mass of its body")
    material = record.entry["material"]
    return (f"{record.name}: {1e3 * material['total_mass']:.4g} g" if "total_mass" in material
            else f"{record.name}: {material['density']:.4g} kg/m³")  # fmt: skip


def _add_damping(conversion: Conversion, record: BodyRecord) -> None:
    """Rayleigh damping of the solver above a body; the drag of first-order motion is its mass."""
    solver = nearest(record.state.node, EULER_IMPLICIT)
    if solver is None:
        return
    alpha = number_of(solver, "rayleighMass", otherwise=0.0) or 0.0
    beta = number_of(solver, "rayleighStiffness", otherwise=0.0) or 0.0
    if is_true(solver, "firstOrder", False):
        alpha = 1.0
    given = {key: value for key, value in (("mass", alpha), ("stiffness", beta)) if value}
    if given:
        record.entry["damping"] = {SOURCE: [f"rayleighMass (1/s), rayleighStiffness (s), {solver.where}"], **given}


# --- what is fixed --------------------------------------------------------------------------------


@rule(FIXING, "FixedConstraint", "FixedProjectiveConstraint", "FixedLagrangianConstraint",
      "FixedWeakConstraint", "PartialFixedConstraint", "PartialFixedProjectiveConstraint")  # fmt: skip
def fixed(conversion: Conversion, component: SceneComponent) -> str | None:
    """Points that do not move.

    Args:
        conversion: The conversion.
        component: The constraint.
    """
    if component.kind.startswith("Partial"):
        axes = array_of(component, 1, "fixedDirections")
        if axes is not None and not axes[:3].all():
            raise NotConverted("points that are fixed along some axes only are not built here")
    state = conversion.state(component)
    names = conversion.frames.get(id(state))
    if names is not None:
        return _fix_frames(conversion, component, names)
    record = conversion.bodies.get(id(state))
    if record is None:
        return None if not _is_moving(conversion, state) else _no_body()
    every = is_true(component, "fixAll", False)
    regions = [{"nodes": list(range(len(record.mesh.points)))}] if every else _regions(
        conversion, record, component, "indices")  # fmt: skip
    record.entry.setdefault("fixed", []).extend({SOURCE: [source_of(component)], **one} for one in regions)
    return f"{record.name}.fixed"


def _is_moving(conversion: Conversion, state: SceneComponent) -> bool:
    return nearest(state.node, (*EULER_IMPLICIT, *STATIC, *OTHER_MOTION)) is not None


def _no_body() -> str:
    raise NotConverted("its body is not converted")


def _fix_frames(conversion: Conversion, component: SceneComponent, names: list[str]) -> str:
    """Rigid bodies that do not move, or ends of a beam."""
    chosen = indices_of(component, "indices", "points")
    chosen = np.array([0]) if chosen is None or not len(chosen) else chosen
    beams = {one["name"]: one for one in conversion.scene.get("beams", [])}
    for index in chosen:
        name = names[min(int(index), len(names) - 1)]
        if not name:  # a frame of the world
            continue
        if name in beams:
            end = "start" if index == 0 else "end" if index == len(names) - 1 else None
            if end is None:
                raise NotConverted(f"point {index} is inside the beam {name}: ends can be fixed")
            beams[name].setdefault("fixed", []).append(end)
            continue
        entry = next(one for one in conversion.scene["rigid_bodies"] if one["name"] == name)
        entry["motion"] = "fixed"
        entry.pop("mass", None)
    told = dict.fromkeys(names[min(int(index), len(names) - 1)] for index in chosen)
    return f"{', '.join(filter(None, told)) or 'a frame of the world'}: fixed"


def _regions(conversion: Conversion, record: BodyRecord, component: SceneComponent, *names: str) -> list[dict]:
    """Regions of a body: boxes and spheres where a region of interest of the same points says so."""
    component.read.update(names)
    given = next((component.fields[name] for name in names if component.fields.get(name) is not None), None)
    if is_link(given):
        roi, output = follow(given, component.node)
        if isinstance(roi, SceneComponent) and roi.kind in REGIONS and output == "indices":
            same = state_of(roi.node) is record.state and roi.fields.get("position") is None
            if same and roi.fields.get("orientedBox") is None:
                if roi.kind != "ComplementaryROI":
                    return _region_shapes(conversion, record, roi)
    chosen = indices_of(component, *names)
    if chosen is None:
        chosen = np.array([0])
    if not len(chosen):
        raise NotConverted("it selects no points")
    return [{"nodes": np.unique(chosen).tolist()}]


def _region_shapes(conversion: Conversion, record: BodyRecord, roi: SceneComponent) -> list[dict]:
    made: list[dict] = []
    if roi.kind == "SphereROI":
        for centre, radius in zip(*spheres_of(roi), strict=True):
            if (np.linalg.norm(record.mesh.points - centre, axis=1) <= radius).any():
                made.append({"sphere": {"centre": conversion.length(centre), "radius": conversion.length(radius)}})
    else:
        for low, high in boxes_of(roi):
            if ((record.mesh.points >= low) & (record.mesh.points <= high)).all(axis=1).any():
                made.append({"box": {"minimum": conversion.length(low), "maximum": conversion.length(high)}})
    if not made:
        raise NotConverted(f"{roi.kind} {roi.name} ({roi.where}) selects no points")
    roi.read.update(("box", "centers", "radii"))
    return made


@rule(FIXING, "RestShapeSpringsForceField", "RestShapeSpringForceField", "FixedRestShape")
def rest_shape_springs(conversion: Conversion, component: SceneComponent) -> str | None:
    """Springs to the rest shape: stiff ones fix points.

    Args:
        conversion: The conversion.
        component: The springs.
    """
    state = conversion.state(component)
    external, anchors = value_of(component, "external_rest_shape"), None
    if isinstance(external, SceneComponent) and state_of(external.node) is not state:
        if mapped_from(external) or is_rigid(external) or nearest(external.node, EULER_IMPLICIT) is not None:
            raise NotConverted("springs to the shape of another state that moves are not built here")
        own = indices_of(component, "external_points")
        anchors = points_of(external) if own is None or not len(own) else points_of(external)[own]
    names = conversion.frames.get(id(state))
    stiffness = array_of(component, 1, "stiffness")
    stiffness = np.array([100.0]) if stiffness is None or not len(stiffness) else stiffness
    if names is not None:
        component.read.add("points")
        return _fix_frames(conversion, component, names)
    record = conversion.bodies.get(id(state))
    if record is None:
        return None if not _is_moving(conversion, state) else _no_body()
    hardness = stiffness * conversion.units.stiffness
    if anchors is None and hardness.min() >= STIFF * _node_stiffness(conversion, record):
        regions = _regions(conversion, record, component, "points", "indices")
        record.entry.setdefault("fixed", []).extend({SOURCE: [source_of(component)], **one} for one in regions)
        return f"{record.name}.fixed"
    chosen = indices_of(component, "points", "indices")
    chosen = np.arange(len(record.mesh.points)) if chosen is None or not len(chosen) else chosen
    if len(chosen) > MOST_SPRINGS:
        raise NotConverted(f"{len(chosen)} soft springs are more than {MOST_SPRINGS}")
    anchors = record.mesh.points[chosen] if anchors is None else anchors
    if len(anchors) != len(chosen):
        raise NotConverted(f"{len(chosen)} points are held at {len(anchors)} places")
    for index, value, anchor in zip(chosen, np.resize(hardness, len(chosen)), anchors, strict=True):
        place, held = conversion.length(record.mesh.points[index]), conversion.length(anchor)
        conversion.scene.setdefault("springs", []).append({
            "name": conversion.name(f"{record.name}_rest_{index}"),
            "ends": [{"on": record.name, "point": place}, {"point": held}],
            "stiffness": rounded(value), "rest_length": 0.0})  # fmt: skip
    conversion.scene["springs"][-len(chosen)][SOURCE] = [source_of(component)]
    return f"{len(chosen)} springs of {hardness[0]:.4g} N/m"


def _node_stiffness(conversion: Conversion, record: BodyRecord) -> float:
    """Stiffness of an element, E times its size [N/m]."""
    material = record.entry["material"]
    young = material.get("young_modulus") or material.get("bulk_modulus") or 1e5
    size = float(np.cbrt(_volumes(record.mesh).mean())) * conversion.units.metre
    return float(young) * size
