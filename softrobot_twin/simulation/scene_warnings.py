"""What is warned of in a built scene before the first step: coarse meshes, and wrong units.

Millimetres read as metres and kPa as Pa are far from their natural scale, and the body may sag too far.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from softrobot_twin.geometry.hexahedral_mesh import HEXAHEDRON_FACES, OPPOSITE_FACES, HexahedralMesh
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.beam_bodies import build_section
from softrobot_twin.simulation.building.deformable_body import of_kind
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.reduced_body import ReducedBody
from softrobot_twin.simulation.step.share_rule import OVERSHOOT

SIZE_RANGE = (0.002, 5.0)
"""Usual range of the size of soft robots [m]."""
DENSITY_RANGE = (20.0, 10_000.0)
"""Range from foam to steel [kg/m³]."""
YOUNG_RANGE = (1.0e3, 3.0e11)
"""Range from jelly to steel [Pa]."""
THICK_SHARE = 1.0
"""A beam that is more across than this share of its length is none."""
CONFINED = 1.25
"""Cells whose sides cannot bulge are reported where they are stiffer than this many times E."""
LOCKING_RATIO = 0.47
"""Above this Poisson ratio linear tetrahedra lock."""
SAG_SHARE = 0.5
"""A sag by more than this share of the size is reported as unlikely."""
LINEAR_SHARE = 0.02
"""A sag below this share of the size is linear in the weight."""
MOST_SOLVES = 100
"""Largest number of linearizations to an equilibrium under gravity; thin rubber took up to 88."""
MOST_NODES_SOLVED = 600_000
"""Largest product of linearizations and free nodes: a large mesh with a wrong unit has no equilibrium,
and its start must not wait for a long search."""
FEWEST_SOLVES = 20
"""Linearizations that are tried on the largest meshes too."""
MOST_HALVINGS = 12
"""Largest number of halvings of a move that went too far."""
LONGEST_MOVE = 0.1
"""Largest displacement of a node in one of them, as a share of the size."""
TOLERANCE = 1.0e-4
"""An equilibrium is found when no node moves by more than this share of the size."""


def single_layers(scene: Scene, model: Model) -> Iterator[str]:
    """Hexahedra between a held face and one that is held too, or may stick: their sides cannot bulge.

    Such a cell strains along one axis alone, by the modulus (1 - ν) E/((1 + ν)(1 - 2 ν)). No measure of
    a step shows it: strain does not vary in the cell.

    Args:
        scene: The scene.
        model: The built scene.

    Yields:
        A sentence for each body.
    """
    sticky = {name for one in scene.touching if scene.contact.friction_of(one) for name in one.pair}
    for body in (one for one in model.bodies if isinstance(one.mesh.corner_mesh, HexahedralMesh)):
        layer = _between_held_faces(body, body.name in sticky)
        nu = max(part.poisson_ratio for part in body.materials)
        if len(layer) and 1.0 - nu > CONFINED * (1.0 + nu) * (1.0 - 2.0 * nu):
            yield (f"{body.key}: {len(layer)} hexahedra lie in one layer between faces that are held, or "
                   "stick: their sides cannot bulge, so they are far too stiff in compression; take four layers")


def _between_held_faces(body, sticks: bool) -> np.ndarray:
    """Which hexahedra have a free side between two faces that different things hold.

    Args:
        body: A body with hexahedra.
        sticks: Whether its surface may stick to another body.
    """
    mesh = body.mesh.corner_mesh
    faces, cells = mesh.hexahedra[:, HEXAHEDRON_FACES], mesh.cells_of_surface - len(mesh.tets)
    holders = body.fixed.astype(int)
    for index, nodes in enumerate(body.riding.values()):
        holders[nodes] = 2 + index
    holder = holders[faces]
    holder = np.where((holder == holder[..., :1]).all(axis=2), holder[..., 0], 0)
    is_outer = np.zeros(holder.shape, bool)
    cells, corners = cells[cells >= 0], mesh.surface_triangles[cells >= 0]
    triangle, face = np.nonzero((faces[cells][..., None] == corners[:, None, None]).any(axis=2).all(axis=2))
    is_outer[cells[triangle], face] = True
    held = np.where((holder == 0) & is_outer & sticks, -1, holder)
    is_layer = np.zeros(len(faces), bool)
    for one, other in OPPOSITE_FACES:
        sides = np.delete(is_outer & (holder == 0), (one, other), axis=1).any(axis=1)
        pair = held[:, [one, other]]
        is_layer |= sides & (pair != 0).all(axis=1) & (pair[:, 0] != pair[:, 1])
    return np.flatnonzero(is_layer)


def coarse_ropes(scene: Scene) -> Iterator[str]:
    """Beams whose elements are longer than the radius of a round thing that they may be drawn around.

    Args:
        scene: The scene.

    Yields:
        A sentence for each.
    """
    beams = {beam.name: beam for beam in scene.beams}
    radii = {}
    for one in (*scene.obstacles, *scene.rigid_bodies):
        shape = getattr(one, "cylinder", None) or getattr(one, "capsule", None)
        if shape:
            radii[one.name] = shape.radius
    for index, touching in enumerate(scene.touching):
        for name, other in (touching.pair, touching.pair[::-1]):
            if name not in beams or other not in radii:
                continue
            beam, radius = beams[name], radii[other]
            length = sum(math.dist(a, b) for a, b in pairwise(beam.points))
            is_bendable = 2.0 * build_section(beam.section, beam.material.poisson_ratio).radius < radius
            if is_bendable and length > beam.elements * radius and length > math.pi * radius:
                yield (f"contact.between[{index}]: the elements of {name} are {length / beam.elements:.3g} m "
                       f"long, {other} has a radius of {radius:.3g} m: drawn around it, {name} follows it "
                       "coarsely, and friction holds too little; for that take at least "
                       f"{math.ceil(3.0 * length / radius - 1.0e-6)} elements, three to a radius")  # fmt: skip


def unit_slips(model: Model) -> list[str]:
    """Warn of values that suggest a wrong unit.

    Args:
        model: The built scene; see `expected_sag` for what is left undefined.

    Returns:
        A sentence for each warning; empty without warnings.
    """
    notes = [note for odd in (*map(_odd_values, model.bodies), *map(_odd_beam, model.beams)) for note in odd]
    linear, size = linear_sag(model), model.nodes.size
    if linear is None or linear <= SAG_SHARE * size:
        return notes
    sag = equilibrium_sag(model)
    check = "check the units of young_modulus, the mass and gravity, and what is fixed"
    if sag is None:
        notes.append(
            f"under gravity alone, without actuators, no equilibrium of {_what(model)} was found; "
            f"a linear solution sags by {linear:.3g} m, the size is {size:.3g} m: {check}"
        )
    elif sag > SAG_SHARE * size:
        notes.append(
            f"under gravity alone, without actuators, {_what(model)} sags by {sag:.3g} m, its size "
            f"is {size:.3g} m: {check}"
        )
    return notes


def _what(model: Model) -> str:
    """What sags, in words."""
    if not model.beams:
        return "the body"
    return "a body or beam" if model.bodies else "a beam"


def _odd_values(body) -> list[str]:
    has_density = body.entry.material.density is not None
    weight = "density" if has_density else "total_mass over its volume"
    notes = []
    for part in body.materials:
        element = body.entry.element
        locks = element in ("linear", "smoothed") and not body.entry.has_patches
        if locks and part.poisson_ratio > LOCKING_RATIO:
            notes.append(
                f"{part.key}.poisson_ratio = {part.poisson_ratio:g} with {body.key}.element = "
                f"{element}: above {LOCKING_RATIO:g} {element} tetrahedra lock, the body is far too "
                "stiff; use volume: patches with a hyperelastic law, or element: quadratic"
            )
    hint = "is the mesh in millimetres? then give scale: 0.001"
    if body.size < SIZE_RANGE[0]:
        hint = "is the mesh in metres? then leave out scale: 0.001"
    checked = [(f"{body.key}.mesh size", body.size, SIZE_RANGE, "m", hint)]
    for part in body.materials:
        checked += [
            (f"{part.key}.{weight}", part.density, DENSITY_RANGE, "kg/m³",
             "silicone has about 1070 kg/m³"),
            (f"{part.key}.young_modulus", part.young_modulus, YOUNG_RANGE, "Pa",
             "silicone has some 1e4 to 1e6 Pa"),
        ]  # fmt: skip
    return notes + _outside(checked)


def _odd_beam(beam) -> list[str]:
    material, key = beam.entry.material, beam.key
    length, across = float(beam.lengths.sum()), 2.0 * beam.radius
    notes = _outside([
        (f"{key} length", length, SIZE_RANGE, "m", "are its points in millimetres?"),
        (f"{key}.material.density", material.density, DENSITY_RANGE, "kg/m³",
         "silicone has about 1070 kg/m³, steel 7850"),
        (f"{key}.material.young_modulus", material.young_modulus, YOUNG_RANGE, "Pa",
         "silicone has some 1e4 to 1e6 Pa, steel 2.1e11"),
    ])  # fmt: skip
    if across > THICK_SHARE * length:
        notes.append(
            f"{key}.section is {across:.4g} m across, the beam is {length:.4g} m long: a beam is "
            "slender; is the section in millimetres?"
        )
    return notes


def _outside(checked: list[tuple]) -> list[str]:
    """A sentence for each value that is outside its usual range."""
    return [
        f"{name} = {value:.4g} {unit} is outside {low:g} to {high:g} {unit}: {hint}"
        for name, value, (low, high), unit, hint in checked if not low <= value <= high
    ]  # fmt: skip


def expected_sag(model: Model) -> float | None:
    """How far the deformable bodies and beams sag under gravity alone [m].

    Actuators do nothing, nothing is touched, what is guided stays. A sag below `LINEAR_SHARE` of the
    size is that of one linear solve, within a tenth of the equilibrium of this mesh; a larger one
    is that of the equilibrium itself.

    Args:
        model: The built scene. Its factorization, and where its terms of motion begin, are used
            and left undefined, as before the first step.

    Returns:
        The largest displacement of a node; None where a body floats, or is so soft that no
        equilibrium without inverted elements was found.
    """
    sag = linear_sag(model)
    if sag is None or sag <= LINEAR_SHARE * model.nodes.size:
        return sag
    return equilibrium_sag(model)


def linear_sag(model: Model) -> float | None:
    """Largest displacement of bodies and beams under gravity, by one linear solve [m].

    Args:
        model: The model of a simulation.

    Returns:
        None where a body floats.
    """
    return _sag(model, most_solves=1, tolerance=np.inf)


def equilibrium_sag(model: Model) -> float | None:
    """Largest displacement of bodies and beams in equilibrium under gravity, by Newton [m].

    Args:
        model: The model of a simulation.

    Returns:
        None where a body floats or no equilibrium was found.
    """
    affordable = max(FEWEST_SOLVES, MOST_NODES_SOLVED // max(model.nodes.free_node_count, 1))
    return _sag(model, min(MOST_SOLVES, affordable), TOLERANCE * model.nodes.size)


def _sag(model: Model, most_solves: int, tolerance: float) -> float | None:
    """Newton's method from the shape at rest, until no node moves by more than a tolerance [m]."""
    soft, soft_nodes = _soft_unknowns(model)
    if len(soft) == 0:
        return 0.0
    if not model.is_held:
        return None
    nodes, factorization = model.nodes, model.factorization
    _forget_motion(model)
    positions = nodes.rest_positions.copy()
    forces = np.zeros((nodes.free_node_count, 3))
    # A single solve is the linear solution and is not limited; several are kept from overshooting.
    longest_move = np.inf if most_solves == 1 else LONGEST_MOVE * nodes.size
    # Beams are stretched on their way: their moves may raise the energy.
    is_judged = most_solves > 1 and not any(term.is_slender for term in model.forces)
    for _ in range(most_solves):
        for projected in (False, True):
            forces[:] = 0.0
            factorization.clear()
            for term in model.forces:
                term.add(positions, forces, factorization.storage, projected)
            if factorization.factor():
                break
        else:
            return None
        moves = factorization.solve(forces).copy()
        longest = float(np.linalg.norm(moves[soft], axis=1).max())
        if not longest < np.inf:
            return None
        share = min(1.0, longest_move / max(longest, 1e-300))
        if is_judged:
            _advance_judged(model, positions, moves, forces, share)
        else:
            nodes.advance(positions, moves, share)
        if longest <= tolerance:
            upright = sum(term.add_forces(positions, forces) for term in model.forces) == 0
            sunk = [(positions - nodes.rest_positions)[soft_nodes], *_sunk_reduced(model, positions)]
            return float(np.linalg.norm(np.concatenate(sunk), axis=1).max()) if upright or most_solves == 1 else None
    return None


def _advance_judged(
    model: Model, positions: np.ndarray, moves: np.ndarray, forces: np.ndarray, share: float
) -> None:
    """Makes a share of a move dq, halved until it turns no element and does not go too far.

    It goes too far where -r(1)·dq is above `OVERSHOOT` of r(0)·dq, with the forces r.

    Args:
        model: The built scene.
        positions: Node positions [m], shape (node_count, 3); moved.
        moves: Displacements of the unknowns [m], shape (free_node_count, 3).
        forces: Forces before the move [N], shape (free_node_count, 3); overwritten.
        share: Share of the move that is tried first.
    """
    start, slope = positions.copy(), float(np.vdot(forces, moves))
    for _ in range(MOST_HALVINGS):
        positions[:] = start
        model.nodes.advance(positions, moves, share)
        forces[:] = 0.0
        upright = sum(term.add_forces(positions, forces) for term in model.forces) == 0
        if upright and -float(np.vdot(forces, moves)) <= OVERSHOOT * abs(slope):
            return
        share *= 0.5


def _sunk_reduced(model: Model, positions: np.ndarray) -> list[np.ndarray]:
    """Displacements of all nodes of each reduced body [m]."""
    return [
        body.shown_nodes(np.arange(body.mesh.node_count)).positions(positions)
        - body.mesh.node_positions
        for body in of_kind(model.bodies, ReducedBody)
    ]  # fmt: skip


def _soft_unknowns(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns of free nodes of bodies and of translations of beams, and the nodes of both."""
    nodes = model.nodes
    own = np.arange(sum(body.free_node_count for body in model.bodies))
    soft_nodes = np.setdiff1d(nodes.free_nodes[own], nodes.coordinate_nodes)
    if not model.beams:
        return own, soft_nodes
    origins = np.unique(np.concatenate([beam.carriers.frame_nodes for beam in model.beams]))
    unknowns = nodes.kinds[0].unknowns_of(origins)
    # Hinged frames have no translation of their own; the rest of the beam shows the sag.
    free = (unknowns >= 0) & (unknowns < nodes.free_node_count)
    return (np.concatenate([own, unknowns[free]]), np.concatenate([soft_nodes, origins[free]]))


def _forget_motion(model: Model) -> None:
    """Begin a step of infinite duration, as in statics; free rigid bodies fall for a second."""
    still = np.zeros((model.nodes.free_node_count, 3))
    for term in model.forces:
        if term.remembers_start:
            time_step = 1.0 if term.name == "rigid inertia" else np.inf
            term.begin_step(model.nodes.rest_positions, still, time_step)
