"""Walls of cavities: closed triangle surfaces, read from a scene and carried by its bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial, reduce

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.mass_properties import surface_mass_properties
from softrobot_twin.geometry.surface_reading import read_solid_surface, repair_surface
from softrobot_twin.geometry.surface_splitting import split_triangles
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.cavity_surfaces import CavitySurface
from softrobot_twin.scene import Scene
from softrobot_twin.scene.actuator_entries import CavityWall
from softrobot_twin.simulation.building.deformable_body import Body, part_named
from softrobot_twin.simulation.building.mapped_surfaces import nodes_between, split_to_elements

def cavity_surface(
    layout, name: str, walls: tuple[CavityWall, ...], key: str, notes: list[str]
) -> CavitySurface:
    """The walls of one cavity, carried by its bodies.

    Args:
        layout: The bodies, a `Layout`.
        name: Name of the cavity.
        walls: Entries of its walls.
        key: Key of the cavity's entry, such as ``cavities[0]``.
        notes: List to which repairs and warnings are appended.

    Returns:
        All walls as one set of triangles.

    Raises:
        SceneError: A wall is open, intersects itself, does not lie on its body, or is no part of
            its mesh.
    """
    return joined_walls([
        cavity_wall(layout, name, wall, f"{key}.walls[{index}]", notes)
        for index, wall in enumerate(walls)
    ], name)  # fmt: skip


def joined_walls(
    walls: Sequence[CavitySurface], name: str,
    join: Callable = partial(reduce, BarycentricMapping.followed_by),
) -> CavitySurface:
    """Several walls as the surface of one cavity, their vertices joined by a function.

    Args:
        walls: The walls.
        name: Name of the cavity.
        join: Makes one mapping of the vertices of all walls, in their order.
    """
    vertices = join(wall.vertices for wall in walls)
    starts = np.cumsum([0, *(wall.vertices.point_count for wall in walls[:-1])])
    triangles = [wall.triangles + start for wall, start in zip(walls, starts, strict=True)]
    return CavitySurface(name, vertices, np.concatenate(triangles))


def cavity_wall(layout, name: str, wall: CavityWall, key: str, notes: list[str]) -> CavitySurface:
    """Vertices and triangles of one wall of a cavity; see `cavity_surface`."""
    body = layout.body_named(wall.body)
    kind, read = ("file", _from_file) if wall.part is None else ("part", _part)
    try:
        points, triangles = read(layout.scene, body, wall, f"{key}.{kind}", notes)
    except MeshError as error:
        value = str(getattr(wall, kind))
        raise layout.scene.error(f"{key}.{kind}", value, error.reason) from None
    bodies = [body, *(layout.body_named(other) for other in wall.also_on)]
    if kind == "file":
        points, triangles = split_to_elements(bodies, points, triangles, f"{key}.file", notes)
    else:
        # Pressure acts on nodes at the middle of edges too, and on bubbles.
        points, triangles = split_triangles(
            points, triangles, lambda ends: np.full(len(ends), True), nodes_between(body.mesh)
        )
    return CavitySurface(name, layout.carried_by_nearest(bodies, points, key, notes), triangles)


def _from_file(
    scene: Scene, body: Body, wall: CavityWall, key: str, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and outward triangles of a wall's file, placed as the mesh of its body."""
    surface = read_solid_surface(
        scene.file_path(wall.file), notes=notes, scale=wall.scale,
        rotation=body.entry.mesh.rotation, translation=body.entry.mesh.translation,
    )  # fmt: skip
    return surface.points, surface.triangles


def _part(
    scene: Scene, body: Body, wall: CavityWall, key: str, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and outward triangles of a part of a body's mesh."""
    surface = part_named(body, "surface", wall.part, key, scene)
    used, triangles = np.unique(surface, return_inverse=True)
    points = body.mesh.node_positions[used]
    repaired = repair_surface(points, triangles.reshape(-1, 3))
    surface_mass_properties(points, repaired.triangles)
    # Mesh generators orient the triangles of a part as they like.
    notes.extend(f"{key} ({wall.part}): {note}." for note in repaired.notes if "all" not in note)
    return points, repaired.triangles


def check_walls_of_reduced(scene: Scene) -> None:
    """Refuse what is not built of cavities on bodies that are reduced to a basis.

    Args:
        scene: The scene.

    Raises:
        SceneError: Gas is sealed in such a body, liquid fills it, a wall lies on it and on another
            body, or cavities lie on it and on bodies that are not reduced.
    """
    reduced = {body.name for body in scene.deformables if body.reduced}
    if not reduced:
        return
    cavities, sealed = list(scene.keyed("cavities")), list(scene.keyed("sealed_cavities"))
    usual = scene.deformables[0].name
    carriers = {key: [wall.body or usual for wall in cavity.walls]
                for key, cavity in (*cavities, *sealed)}  # fmt: skip
    for key, cavity in (*cavities, *sealed):
        for place, (wall, own) in enumerate(zip(cavity.walls, carriers[key], strict=True)):
            names = {own, *wall.also_on}
            if len(names) > 1 and names & reduced:
                raise scene.error(f"{key}.walls[{place}].also_on", list(wall.also_on),
                                  f"{sorted(names & reduced)[0]} is reduced: a wall that it forms "
                                  "with another body is not built")
    are_reduced = any(reduced & set(carriers[key]) for key, _ in cavities)
    for key, cavity in cavities:
        if reduced & set(carriers[key]) and cavity.liquid_density:
            raise scene.error(f"{key}.liquid_density", cavity.liquid_density,
                              "a liquid filling of a reduced body is not built", unit="kg/m³")
        others = [name for name in carriers[key] if name not in reduced]
        if are_reduced and others:
            raise scene.error(f"{key}.walls", cavity.name,
                              f"lies on {others[0]}, which is not reduced; where one body with "
                              "cavities is reduced, all of them must be")
    for key, cavity in sealed:
        if reduced & set(carriers[key]):
            raise scene.error(f"{key}.walls", cavity.name,
                              "lies on a reduced body: gas sealed there is not built")
