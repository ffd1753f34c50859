"""Meshes a part with gmsh, or writes a mesh of gmsh anew: ``python gmsh_mesher.py FOLDER``.

A process of its own keeps gmsh, its threads and its libraries of windows out of a running twin, can
be stopped at any time, and an abort of gmsh on a bad file ends only it. `gmsh_process` writes
``job.json`` and, of surfaces, ``shells.npz`` to the folder; ``mesh.npz`` or ``error.json`` is read.
All lengths are in millimetres here, in which gmsh's tolerances suit parts of robots. Only numpy and
gmsh are imported.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

# Angle between two facets above which their common edge is kept [rad].
_SHARP = np.radians(35.0)
# Angle between two segments of such an edge above which their common point is kept [rad].
_CORNER = np.radians(60.0)
# Share of a chamber's volume that facets of its curved walls may cut off: 16 a turn of a tube.
_CHAMBER_LOSS = 0.033
# Walls of chambers are not meshed finer than this share of the size: the work is bounded.
_FINEST = 0.125
# Places along each parameter of a face where its curvature is taken.
_SAMPLES = 6
# Tetrahedra of edge length 1 in a unit of volume.
TETS_PER_VOLUME = 6.0 * 2.0**0.5


class Chamber(NamedTuple):
    """A closed surface inside the part.

    Attributes:
        faces: Tags of its faces.
        volume: Volume that it encloses [mm³].
    """

    faces: list[int]
    volume: float

    def row(self, gmsh) -> list[float]:
        """The middle of its bounding box [mm] and its volume [mm³].

        Args:
            gmsh: The library.
        """
        low, high = _bounds(gmsh, self.faces)
        return [*(0.5 * (low + high)), self.volume]


class Refused(Exception):
    """The part cannot be meshed; the message says why."""


def main(folder: Path) -> int:
    """Meshes the part of a folder and returns the exit code.

    Args:
        folder: Folder with the file ``job.json`` and the part; the mesh or the error is written
            there.
    """
    job = json.loads((folder / "job.json").read_text())
    try:
        import gmsh
    except ModuleNotFoundError as error:
        return _failed(folder, "not installed", str(error))
    except OSError as error:
        return _failed(folder, "library", str(error))
    gmsh.initialize(["gmsh"], readConfigFiles=False, interruptible=False)
    gmsh.logger.start()
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        if "rewrite" in job:
            np.savez(folder / "mesh.npz", content=_without_parameters(gmsh, job, folder))
            return 0
        if job["size"] is None:
            _, extents, volume = _imported(gmsh, job["file"])
            np.savez(folder / "mesh.npz", extents=extents, volume=volume)
            return 0
        _set_options(gmsh, job["size"])
        if "shells" in job:
            of_shell = _solids_of_shells(gmsh, np.load(folder / "shells.npz"), job["solids"])
            names, volume = [""] * len(job["solids"]), job["volume"]
            chambers = [Chamber(of_shell[shell], own) for shell, own in job["chambers"]]
        else:
            names, volume = _solids_of_file(gmsh, job)
            chambers = _chambers_of_solids(gmsh)
        _refine(gmsh, job, chambers)
        _mesh(gmsh)
        nodes, tets, solids = _tets(gmsh)
    except Refused as error:
        return _failed(folder, "refused", str(error))
    except Exception as error:  # gmsh raises Exception itself
        lines = [line for line in gmsh.logger.get() if line.startswith(("Error", "Warning"))]
        return _failed(folder, "gmsh", " ".join([str(error), *lines[-3:]]))
    np.savez(folder / "mesh.npz", nodes=nodes, tets=tets, solids=solids, names=np.array(names),
             volume=volume, version=np.array(gmsh.__version__),
             chambers=np.array([chamber.row(gmsh) for chamber in chambers]).reshape(-1, 4))
    return 0


def _failed(folder: Path, kind: str, text: str) -> int:
    (folder / "error.json").write_text(json.dumps({"kind": kind, "text": text}))
    return 1


def _set_options(gmsh, size: float) -> None:
    """The same edge length everywhere, and one thread, so that each run gives the same mesh."""
    options = {
        "General.NumThreads": 1, "Mesh.MeshSizeMax": size,
        "Mesh.MeshSizeFromPoints": 0, "Mesh.MeshSizeFromCurvature": 0,
        "Mesh.MeshSizeExtendFromBoundary": 0, "Mesh.Algorithm": 6, "Mesh.Algorithm3D": 1,
        "Mesh.Optimize": 1, "Mesh.OptimizeNetgen": 1, "Mesh.ElementOrder": 1,
    }  # fmt: skip
    for name, value in options.items():
        gmsh.option.setNumber(name, value)


def _without_parameters(gmsh, job: dict, folder: Path) -> np.ndarray:
    """The bytes of a mesh of gmsh as a file whose nodes have no parameters."""
    gmsh.open(job["rewrite"])
    gmsh.option.setNumber("Mesh.SaveParametric", 0)
    gmsh.option.setNumber("Mesh.SaveAll", 1)  # cells without a physical group too
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
    gmsh.option.setNumber("Mesh.Binary", 1)
    gmsh.write(str(folder / "plain.msh"))
    return np.fromfile(folder / "plain.msh", np.uint8)


def _solids_of_shells(gmsh, shells, solids: list[list[int]]) -> dict[int, list[int]]:
    """Solids between closed surfaces of triangles; returns the faces of each shell.

    Args:
        gmsh: The library.
        shells: Arrays `points` [mm], `triangles`, and the shell of each triangle, `shells`.
        solids: Outer shell of each solid, and those of its cavities.
    """
    points, triangles, shell_of = shells["points"], shells["triangles"], shells["shells"]
    places = {}
    first = 0
    for shell in range(shell_of.max() + 1):
        used, corners = np.unique(triangles[shell_of == shell], return_inverse=True)
        surface = gmsh.model.addDiscreteEntity(2)
        tags = first + 1 + np.arange(len(used))
        gmsh.model.mesh.addNodes(2, surface, tags, points[used].ravel())
        gmsh.model.mesh.addElementsByType(surface, 2, [], (first + 1 + corners).ravel())
        places.update((row.tobytes(), shell) for row in points[used])
        first += len(used)
    gmsh.model.mesh.classifySurfaces(_SHARP, True, True, _CORNER)
    gmsh.model.mesh.createGeometry()
    of_shell: dict[int, list[int]] = {}
    for _, surface in gmsh.model.getEntities(2):
        _, coordinates, _ = gmsh.model.mesh.getNodes(2, surface, includeBoundary=True)
        found = {places[row.tobytes()] for row in np.reshape(coordinates, (-1, 3))
                 if row.tobytes() in places}  # fmt: skip
        if len(found) != 1:
            raise Refused(f"its surface could not be divided into patches (patch {surface})")
        of_shell.setdefault(found.pop(), []).append(surface)
    for own in solids:
        loops = [gmsh.model.geo.addSurfaceLoop(of_shell[shell]) for shell in own]
        gmsh.model.geo.addVolume(loops)
    gmsh.model.geo.synchronize()
    return of_shell


def _bounds(gmsh, faces: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of the bounding box of faces [mm]."""
    boxes = np.array([gmsh.model.getBoundingBox(2, face) for face in faces])
    return boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)


def _chambers_of_solids(gmsh) -> list[Chamber]:
    """The closed surfaces of the solids of a STEP file that lie within others."""
    outer = gmsh.model.getBoundary(gmsh.model.getEntities(3), combined=True, oriented=False)
    group_of_curve, groups = {}, []
    for _, face in outer:
        curves = {tag for _, tag in gmsh.model.getBoundary([(2, face)], oriented=False)}
        joined = [own for own in groups if any(group_of_curve.get(curve) is own for curve in curves)]
        group = sum(joined, [face])
        groups = [own for own in groups if not any(own is other for other in joined)] + [group]
        for other in joined:
            for curve, own in group_of_curve.items():
                group_of_curve[curve] = group if own is other else own
        group_of_curve.update(dict.fromkeys(curves, group))
    boxes = [_bounds(gmsh, group) for group in groups]
    chambers = []
    for group, (low, high) in zip(groups, boxes, strict=True):
        if any((around[0] < low).all() and (high < around[1]).all() for around in boxes):
            volume = gmsh.model.occ.addVolume([gmsh.model.occ.addSurfaceLoop(group)])
            chambers.append(Chamber(group, abs(gmsh.model.occ.getMass(3, volume))))
            gmsh.model.occ.remove([(3, volume)])
    return chambers


def _refine(gmsh, job: dict, chambers: list[Chamber]) -> None:
    """Sizes on curved faces: as asked for a full turn on all of them, or as the walls of each chamber
    need to lose little of its volume.

    Edges of length s cut s²/12 ∫ (|κ1| + |κ2|) dA off the space inside a curved wall.
    """
    size, turn, sizes = job["size"], job["turn"], {}
    curved = {face: _curvature(gmsh, face) for _, face in gmsh.model.getEntities(2)}
    if turn is not None:
        wanted = [(face, 2.0 * np.pi / (turn * highest)) for face, (_, highest) in curved.items()
                  if turn and highest * size > 1e-3]  # fmt: skip
    else:
        wanted = []
        for chamber in chambers:
            total = sum(curved[face][0] for face in chamber.faces)
            if total > 0.0:
                edge = max((12.0 * _CHAMBER_LOSS * chamber.volume / total) ** 0.5, _FINEST * size)
                wanted += [(face, edge) for face in chamber.faces if curved[face][1] * size > 1e-3]
    for face, edge in wanted:
        # Seams too: they are on both sides of their face.
        curves = gmsh.model.getBoundary([(2, face)], combined=False, oriented=False)
        for entity in [(2, face), *curves]:
            sizes[entity] = min(edge, sizes.get(entity, size))
    if any(edge < size for edge in sizes.values()):
        gmsh.model.mesh.setSizeCallback(
            lambda dimension, tag, x, y, z, edge: min(edge, sizes.get((dimension, tag), size))
        )


def _curvature(gmsh, face: int) -> tuple[float, float]:
    """∫ (|κ1| + |κ2|) dA [mm] of a face, and its greatest curvature, or mean of facets [1/mm]."""
    kind = gmsh.model.getType(2, face)
    if kind == "Plane":
        return 0.0, 0.0
    if kind != "Discrete surface":
        low, high = gmsh.model.getParametrizationBounds(2, face)
        # In the middle of intervals: not at poles.
        shares = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        places = [low + (high - low) * [u, v] for u in shares for v in shares]
        highest, lowest, *_ = gmsh.model.getPrincipalCurvatures(face, np.ravel(places))
        each = np.abs(highest) + np.abs(lowest)
        area = gmsh.model.occ.getMass(2, face)
        return float(each.mean() * area), float(np.maximum(np.abs(highest), np.abs(lowest)).max())
    _, corners = gmsh.model.mesh.getElementsByType(2, face)
    tags, nodes = np.unique(corners, return_inverse=True)
    points = np.array([gmsh.model.mesh.getNode(tag)[0] for tag in tags])
    triangles = nodes.reshape(-1, 3)
    normals = np.cross(points[triangles[:, 1]] - points[triangles[:, 0]],
                       points[triangles[:, 2]] - points[triangles[:, 0]])  # fmt: skip
    areas = np.linalg.norm(normals, axis=1)
    normals /= np.where(areas > 0.0, areas, 1.0)[:, None]
    halves = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2))
    edges, place, counts = np.unique(halves, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(place.ravel(), kind="stable")[np.repeat(counts == 2, counts)].reshape(-1, 2)
    one, other = normals[order[:, 0] // 3], normals[order[:, 1] // 3]
    ends = edges[counts == 2]
    # An edge is hollow where the far corner of one triangle lies above the other one.
    far = points[triangles.ravel()[3 * (order[:, 1] // 3) + (order[:, 1] + 2) % 3]]
    signs = -np.sign(np.einsum("ni,ni->n", one, far - points[ends[:, 0]]))
    angles = signs * np.arctan2(np.linalg.norm(np.cross(one, other), axis=1),
                                np.einsum("ni,ni->n", one, other))  # fmt: skip
    lengths = np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1)
    # Facets of a smooth wall bend to both sides; around a point that cancels.
    at_points = np.zeros(len(points))
    np.add.at(at_points, ends, 0.5 * (angles * lengths)[:, None])
    total = float(np.abs(at_points).sum())
    return total, total / (0.5 * float(areas.sum()))


def _solids_of_file(gmsh, job: dict) -> tuple[list[str], float]:
    """The solids of a STEP file, joined where they touch; returns their names and volume [mm³]."""
    solids, extents, volume = _imported(gmsh, job["file"])
    refuse_size(job["size"], extents, volume, job["most_tets"])
    occ = gmsh.model.occ
    names = [gmsh.model.getEntityName(*one).rpartition("/")[2] for one in solids]
    if len(solids) > 1:
        _, pieces = occ.fragment(solids, [])
        occ.synchronize()
        owner = {}
        for index, own in enumerate(pieces):
            for one in own:
                if owner.setdefault(one, index) != index:
                    raise Refused(f"two of its {len(solids)} solids overlap "
                                  f"({names[owner[one]] or owner[one]}, {names[index] or index})")
        names = [names[owner.get(one, 0)] for one in gmsh.model.getEntities(3)]
    return names, volume


def _imported(gmsh, file: str) -> tuple[list[tuple[int, int]], np.ndarray, float]:
    """The solids of a STEP file, the edges of their bounding box [mm] and their volume [mm³]."""
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
    gmsh.option.setNumber("Geometry.OCCImportLabels", 1)
    occ = gmsh.model.occ
    try:
        found = occ.importShapes(file, highestDimOnly=True)
    except Exception as error:
        raise Refused(f"cannot be read as STEP ({error})") from None
    occ.synchronize()
    solids = [one for one in found if one[0] == 3]
    if not solids:
        raise Refused("has no solids; export the part as a solid, not as surfaces or curves"
                      if found else "has no shapes")  # fmt: skip
    boxes = np.array([occ.getBoundingBox(*one) for one in solids])
    volume = sum(occ.getMass(*one) for one in solids)
    return solids, boxes[:, 3:].max(axis=0) - boxes[:, :3].min(axis=0), volume


def refuse_size(size: float, extents: np.ndarray, volume: float, most_tets: int) -> None:
    """Refuses an edge length that does not suit a part.

    Args:
        size: Edge length [mm].
        extents: Edges of the part's bounding box [mm], shape (3,).
        volume: Its volume [mm³].
        most_tets: Greatest number of tetrahedra.

    Raises:
        Refused: It is longer than the part, or makes too many tetrahedra.
    """
    shown = " × ".join(f"{extent:.4g}" for extent in extents)
    if size > extents.max():
        raise Refused(f"a size of {size:.4g} mm is larger than the part, {shown} mm")
    count = TETS_PER_VOLUME * volume / size**3
    if count > most_tets:
        least = (TETS_PER_VOLUME * volume / most_tets) ** (1.0 / 3.0)
        raise Refused(f"a size of {size:.4g} mm makes about {count:.2g} tetrahedra of a part of "
                      f"{shown} mm, more than {most_tets}; give at least {least:.3g} mm, and check "
                      "the unit")  # fmt: skip


def _mesh(gmsh) -> None:
    """Curves, surfaces, solids; a failure of one says which."""
    for dimension, what in enumerate(("edges", "surfaces", "inside"), start=1):
        try:
            gmsh.model.mesh.generate(dimension)
        except Exception as error:
            raise Refused(f"gmsh cannot mesh its {what} with this size ({error}); give a smaller "
                          "size, or export the part with fewer facets, or as STEP",
                          ) from None  # fmt: skip


def _tets(gmsh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes [mm], tetrahedra, and the solid of each tetrahedron."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    number = np.zeros(int(tags.max()) + 1, np.int64)
    number[tags] = np.arange(len(tags))
    tets, solids = [], []
    for index, (_, volume) in enumerate(gmsh.model.getEntities(3)):
        _, corners = gmsh.model.mesh.getElementsByType(4, volume)
        tets.append(number[corners].reshape(-1, 4))
        solids.append(np.full(len(tets[-1]), index))
    if sum(map(len, tets)) == 0:
        raise Refused("gmsh made no tetrahedra inside its surface")
    return coordinates.reshape(-1, 3), np.concatenate(tets), np.concatenate(solids)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
