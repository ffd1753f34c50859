"""Random bodies with thin walls, meshed with tetrahedra that are longer than the walls are thick."""

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.closed_surface import closed_surface
from softrobot_twin.geometry.surface import boundary_triangles

BLOCK = np.array([30e-3, 20e-3, 16e-3])


def _void(occ, random, low, high):
    """A prism, cylinder, wedge, box or ball that fills a box; gmsh volumes."""
    size = high - low
    kind = random.choice(["prism", "prism", "cylinder", "box", "ball", "cone"])
    if kind == "prism":
        # Of triangular section along a random axis, its tip anywhere on the far side.
        axis = int(random.integers(3))
        u, v = [k for k in range(3) if k != axis]
        if random.random() < 0.5:
            u, v = v, u
        corners = np.tile(low, (3, 1))
        corners[1, v] = high[v]
        corners[2, u], corners[2, v] = high[u], random.uniform(low[v], high[v])
        if random.random() < 0.5:
            corners[:, u] = low[u] + high[u] - corners[:, u]
        points = [occ.addPoint(*corner) for corner in corners]
        loop = occ.addCurveLoop([occ.addLine(points[i], points[i - 2]) for i in range(3)])
        along = np.zeros(3)
        along[axis] = size[axis]
        made = occ.extrude([(2, occ.addPlaneSurface([loop]))], *along)
        return [entity for entity in made if entity[0] == 3]
    if kind == "box":
        return [(3, occ.addBox(*low, *size))]
    if kind == "ball":
        return [(3, occ.addSphere(*(0.5 * (low + high)), 0.5 * float(size.min())))]
    axis = int(np.argmax(size))
    radius = 0.5 * float(np.delete(size, axis).min())
    start, along = 0.5 * (low + high), np.zeros(3)
    start[axis], along[axis] = low[axis], size[axis]
    if kind == "cone":
        return [(3, occ.addCone(*start, *along, radius, random.uniform(0.0, 0.3) * radius))]
    return [(3, occ.addCylinder(*start, *along, radius))]


def thin_walled_mesh(random):
    """Nodes [m] and tetrahedra of a block with chambers and slots side by side.

    Walls of 0.2 to 2 mm are between them, and around some of them; elements are of 2.5 to 8 mm.

    Args:
        random: Random numbers.

    Raises:
        Exception: gmsh does not mesh it.
    """
    import gmsh

    wall = random.uniform(0.2e-3, 2e-3)
    cells = random.integers(1, 4, 3)
    cells[np.argmin(cells)] += 1
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        # No coordinate is smaller than what gmsh takes for the same point.
        gmsh.option.setNumber("Geometry.Tolerance", 1e-9)
        occ, voids = gmsh.model.occ, []
        size = BLOCK / cells
        for cell in np.ndindex(*cells):
            if random.random() < 0.7 or not voids:
                # Some slots are open at the outside.
                gap = np.where(random.random((2, 3)) < 0.1, -0.1e-3, 0.5 * wall)
                low = size * cell + gap[0]
                voids += _void(occ, random, low, size * (np.array(cell) + 1) - gap[1])
        occ.cut([(3, occ.addBox(0, 0, 0, *BLOCK))], voids)
        occ.synchronize()
        length = random.uniform(2.5e-3, 8e-3)
        for option in ("Mesh.MeshSizeMax", "Mesh.MeshSizeMin"):
            gmsh.option.setNumber(option, length)
        gmsh.model.mesh.generate(3)
        tags, points, _ = gmsh.model.mesh.getNodes()
        _, corners = gmsh.model.mesh.getElementsByType(4)
    finally:
        gmsh.finalize()
    place = np.zeros(int(tags.max()) + 1, np.int64)
    place[tags.astype(np.int64)] = np.arange(len(tags))
    used, cells = np.unique(place[corners.astype(np.int64)], return_inverse=True)
    return points.reshape(-1, 3)[used], cells.reshape(-1, 4)


def halved(points, triangles):
    """Triangles of a surface each divided into four, as the faces of quadratic elements are."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    ends, place = np.unique(edges, axis=0, return_inverse=True)
    middle = len(points) + place.reshape(-1, 3)
    points = np.concatenate([points, points[ends].mean(axis=1)])
    a, b, c = triangles.T
    ab, bc, ca = middle.T
    fine = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return points, np.concatenate([np.stack(three, axis=1) for three in fine])


def bent(points, random, strain):
    """A smooth random deformation whose strain is about a number.

    Args:
        points: Points [m], shape (point_count, 3).
        random: Random numbers.
        strain: The number.
    """
    moved = points.copy()
    for _ in range(3):
        # As many sines along random directions.
        wave, way = random.normal(0.0, 1.0, (2, 3)) / BLOCK.max()
        way *= strain / (np.linalg.norm(wave) * np.linalg.norm(way))
        moved += np.sin(2.0 * (points - 0.5 * BLOCK) @ wave + random.uniform(0, 6))[:, None] * way / 6
    return moved


def random_thin_walls(random):
    """Nodes [m] and tetrahedra of a body of `thin_walled_mesh` whose surface is one closed surface.

    What touches itself along an edge is refused by name, and what gmsh does not mesh is no mesh.

    Args:
        random: Random numbers.
    """
    while True:
        try:
            points, cells = thin_walled_mesh(random)
            closed_surface(boundary_triangles(cells), len(points))
        except MeshError:
            continue
        except Exception as error:
            if type(error) is Exception:  # as gmsh raises
                continue
            raise
        return points, cells
