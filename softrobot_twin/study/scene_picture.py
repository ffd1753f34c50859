"""Draws a scene's present state, or several states side by side.

The file contains, in this order: triangles of simple shapes, the snapshot of a state, the drawing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.scene.body_entries import PlaneShape
from softrobot_twin.simulation.scene_layout import build_shape
from softrobot_twin.study.figure import load_pyplot
from softrobot_twin.study.output_file import OutputError, output_file

if TYPE_CHECKING:
    from softrobot_twin.simulation import Simulation
    from softrobot_twin.simulation.contact_forces import ContactForces


_SIDES = 8


def tube(path: np.ndarray, radius: float, segment_length: float) -> np.ndarray:
    """Triangles of a tube along a polyline.

    Args:
        path: Points of the polyline [m], shape (point_count, 3).
        radius: Radius of the tube [m].
        segment_length: Longest segment along the path [m]; short segments are sorted better by
            depth.

    Returns:
        Corners of the triangles [m], shape (triangle_count, 3, 3).
    """
    pieces = [_straight_tube(start, end, radius, segment_length)
              for start, end in zip(path[:-1], path[1:]) if np.linalg.norm(end - start) > 0.0]
    return np.concatenate(pieces) if pieces else np.empty((0, 3, 3))


def _straight_tube(start: np.ndarray, end: np.ndarray, radius: float,
                   segment_length: float) -> np.ndarray:
    direction = (end - start) / np.linalg.norm(end - start)
    across = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    across /= np.linalg.norm(across)
    angles = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    ring = radius * (np.outer(np.cos(angles), across)
                     + np.outer(np.sin(angles), np.cross(direction, across)))
    count = max(1, int(np.ceil(np.linalg.norm(end - start) / segment_length)))
    centres = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (end - start)
    rings = centres[:, None, :] + ring[None, :, :]
    return _grid_triangles(rings)


def sphere(centre: np.ndarray, radius: float) -> np.ndarray:
    """Triangles of a sphere, corners [m], shape (triangle_count, 3, 3)."""
    polar = np.linspace(0.0, np.pi, _SIDES + 1)
    turn = np.linspace(0.0, 2.0 * np.pi, 2 * _SIDES, endpoint=False)
    rings = np.stack([np.outer(np.sin(polar), np.cos(turn)),
                      np.outer(np.sin(polar), np.sin(turn)),
                      np.broadcast_to(np.cos(polar)[:, None], (len(polar), len(turn)))], axis=2)
    # Triangles at the poles have no area and are left out.
    triangles = _grid_triangles(centre + radius * rings)
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0],
                                    triangles[:, 2] - triangles[:, 0]), axis=1)
    return triangles[areas > 1e-9 * radius**2]


def cross(centre: np.ndarray, length: float, radius: float) -> np.ndarray:
    """Triangles of three crossed bars along the axes, corners [m], (triangle_count, 3, 3)."""
    half = 0.5 * length * np.eye(3)
    return np.concatenate([tube(np.array([centre - arm, centre + arm]), radius, 0.25 * length)
                           for arm in half])


def subdivide(triangles: np.ndarray, longest: float) -> np.ndarray:
    """Subdivides triangles into four until no edge is longer than a limit [m].

    Args:
        triangles: Corners [m], shape (triangle_count, 3, 3).
        longest: Longest edge to leave [m].

    Returns:
        Corners of the new triangles [m], shape (new_count, 3, 3), with the same orientation.
    """
    done = []
    while len(triangles):
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        is_long = edges.max(axis=1) > longest
        done.append(triangles[~is_long])
        a, b, c = np.moveaxis(triangles[is_long], 1, 0)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        triangles = np.concatenate([
            np.stack(piece, axis=1)
            for piece in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return np.concatenate(done) if done else np.empty((0, 3, 3))


def creases(points: np.ndarray, triangles: np.ndarray, angle: float) -> np.ndarray:
    """Sharp edges of a surface.

    Args:
        points: Of a closed surface [m], shape (point_count, 3).
        triangles: Indices of them, shape (triangle_count, 3).
        angle: Least angle between the normals on both sides [rad].

    Returns:
        Ends of the edges [m], shape (crease_count, 2, 3).
    """
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    of = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort(edges.T)
    edges, of = edges[order], of[order]
    twin = np.flatnonzero((edges[:-1] == edges[1:]).all(axis=1))
    cosines = np.einsum("ei,ei->e", normals[of[twin]], normals[of[twin + 1]])
    return points[edges[twin[cosines < np.cos(angle)]]]


def _grid_triangles(rings: np.ndarray) -> np.ndarray:
    """Two triangles for every cell between neighbouring rings."""
    here, there = rings[:-1], rings[1:]
    here_next, there_next = np.roll(here, -1, axis=1), np.roll(there, -1, axis=1)
    lower = np.stack([here, here_next, there_next], axis=2)
    upper = np.stack([here, there_next, there], axis=2)
    return np.concatenate([lower.reshape(-1, 3, 3), upper.reshape(-1, 3, 3)])


BODY_COLOUR = np.array([0.60, 0.78, 0.84])
FREE_COLOUR = np.array([0.93, 0.73, 0.42])
GUIDED_COLOUR = np.array([0.72, 0.72, 0.74])
OBSTACLE_COLOUR = np.array([0.80, 0.79, 0.75])
SPRING_COLOUR = np.array([0.45, 0.45, 0.50])
PULL_POINT_COLOUR = np.array([0.30, 0.30, 0.30])
AXIS_COLOUR = np.array([0.25, 0.25, 0.28])
EFFECTOR_COLOUR = np.array([0.10, 0.25, 0.45])
TARGET_COLOUR = np.array([0.85, 0.22, 0.15])
AXIS_COLOURS = np.array([[0.80, 0.25, 0.22], [0.25, 0.60, 0.28], [0.20, 0.38, 0.75]])
"""Of the axes x, y and z of an orientation."""
# Length of the facets of round shapes, as a share of their radius.
_FACETS = 0.2
# Edges of a rigid surface with a larger angle [rad] are drawn.
_SHARP = 0.6
# Longest edge of rigid triangles as a share of the scene's size; larger ones cannot be sorted by
# depth.
_LONGEST_EDGE = 0.04


class Solid(NamedTuple):
    """Triangles of one colour.

    Attributes:
        triangles: Corners [m], shape (triangle_count, 3, 3).
        colour: Red, green, blue in 0..1, shape (3,).
        look: ``mesh`` with edges and strong shading, ``clear`` the same but translucent, ``rigid``
            without edges, ``thin`` with weak shading.
    """

    triangles: np.ndarray
    colour: np.ndarray
    look: str


class CableLine(NamedTuple):
    """A cable: its points [m], shape (point_count, 3), and its tension [N]."""

    points: np.ndarray
    tension: float


class CavityWalls(NamedTuple):
    """A cavity: triangles of its walls [m], shape (triangle_count, 3, 3), and gauge pressure [Pa].
    """

    triangles: np.ndarray
    pressure: float


class Snapshot(NamedTuple):
    """One state, ready to be drawn.

    Attributes:
        title: Title of the panel.
        size: Size of the largest body [m], which scales lines and marks.
        solids: Bodies, rigid bodies, obstacles, springs, effectors and targets.
        cables: Cables.
        cavities: Cavities, inside bodies that are drawn translucent.
        planes: Point [m] and unit normal of each plane.
        forces: Contact points [m] and forces on the first body [N], both of shape
            (contact_count, 3).
        has_effectors: Effectors are among the solids.
        has_targets: Targets are among the solids.
        effector_path: Positions of the effectors so far [m], shape (row_count, effector_count, 3),
            or None.
    """

    title: str
    size: float
    solids: list[Solid]
    cables: list[CableLine]
    cavities: list[CavityWalls]
    planes: list[tuple[np.ndarray, np.ndarray]]
    forces: tuple[np.ndarray, np.ndarray]
    has_effectors: bool
    has_targets: bool
    effector_path: np.ndarray | None


def take_snapshot(simulation: Simulation, contacts: ContactForces | None, title: str,
         targets: np.ndarray | None = None, effector_path: np.ndarray | None = None) -> Snapshot:
    """Takes a snapshot of a simulation's present state.

    Args:
        simulation: The simulation.
        contacts: Contacts of its last step, or None.
        title: Title of the panel.
        targets: Targets of the effectors [m], shape (effector_count, 3); NaN for none.
        effector_path: Positions of the effectors so far [m], shape (row_count, effector_count, 3).
    """
    size = simulation.model.nodes.size
    effectors = simulation.effector_positions()
    shown = [] if targets is None else [t for t in targets if np.isfinite(t).all()]
    solids = [*_bodies(simulation), *_beams(simulation, size), *_rigid(simulation, size), *_springs(simulation, size)]
    obstacles, planes = _obstacles(simulation, size)
    solids += obstacles
    solids += [Solid(sphere(point, 0.014 * size), EFFECTOR_COLOUR, "thin")
               for point in effectors]
    solids += _axes_of_effectors(simulation, size)
    solids += [Solid(cross(point, 0.08 * size, 0.0035 * size), TARGET_COLOUR, "thin")
               for point in shown]
    efforts = dict(zip(simulation.actuator_names, simulation.state.efforts, strict=True))
    paths, kind_of = simulation.actuator_paths(), simulation.actuators.kind_of
    cables = [CableLine(path, float(efforts[name])) for name, path in paths.items()
              if kind_of[name].effort.unit == "N"]
    solids += [Solid(tube(path, 0.008 * size, 0.04 * size), AXIS_COLOUR, "thin")
               for name, path in paths.items() if kind_of[name].effort.unit != "N"]
    cavities = [CavityWalls(points[skin.triangles], float(pressure))
                for skin, points, pressure in zip(
                    simulation.cavities.skins, simulation.cavity_positions(),
                    simulation.cavities.pressures(simulation.state), strict=True)]
    nothing = np.empty((0, 3))
    forces = (nothing, nothing) if contacts is None else (contacts.positions, contacts.forces)
    return Snapshot(title, size, solids, cables, cavities, planes, forces, bool(len(effectors)),
                    targets is not None, effector_path)


def _bodies(simulation: Simulation) -> list[Solid]:
    of_beams = sum(len(skin.triangles) for skin in _beam_skins(simulation))
    triangles = simulation.surface_triangles[: len(simulation.surface_triangles) - of_beams]
    if not len(triangles):
        return []
    surface = simulation.surface_positions()
    look = "clear" if simulation.cavities.skins else "mesh"
    return [Solid(surface[triangles], BODY_COLOUR, look)]


def _beam_skins(simulation: Simulation) -> tuple:
    return simulation.skins[len(simulation.model.bodies):]


def _beams(simulation: Simulation, size: float) -> list[Solid]:
    positions = simulation.state.positions
    return [Solid(subdivide(skin.positions(positions)[skin.triangles], 0.5 * _LONGEST_EDGE * size),
                  BODY_COLOUR, "rigid") for skin in _beam_skins(simulation)]


def _rigid(simulation: Simulation, size: float) -> list[Solid]:
    solids = []
    for part in simulation.model.rigid:
        frame = simulation.state.positions[part.first_node : part.first_node + 4]
        colour = FREE_COLOUR if part.is_free else GUIDED_COLOUR
        solids += _solid_shape(part.shape, frame[0], (frame[1:] - frame[0]).T, colour, size)
    return solids


def _solid_shape(shape, origin, rotation, colour: np.ndarray, size: float) -> list[Solid]:
    """A rigid shape and its sharp edges."""
    points, triangles = shape.surface(_FACETS * getattr(shape, "radius", np.inf))
    placed = np.asarray(origin) + points @ rotation.T
    solids = [Solid(subdivide(placed[triangles], _LONGEST_EDGE * size), colour, "rigid")]
    for edge in creases(placed, triangles, _SHARP):
        bar = tube(edge, 0.002 * size, 0.015 * size)
        solids.append(Solid(bar, 0.7 * colour, "thin"))
    return solids


def _obstacles(simulation: Simulation, size: float) -> tuple[list[Solid], list[tuple]]:
    scene, solids, planes = simulation.scene, [], []
    for entry in scene.obstacles:
        turn = Rotation.from_euler("xyz", entry.rotation).as_matrix()
        shape = build_shape(entry.shape, scene, [])
        if isinstance(entry.shape, PlaneShape):
            planes.append((entry.position + turn @ shape.point, turn @ shape.normal))
            continue
        solids += _solid_shape(shape, entry.position, turn, OBSTACLE_COLOUR, size)
    return solids, planes


def _axes_of_effectors(simulation: Simulation, size: float) -> list[Solid]:
    """Axes of the effectors with orientation, x red, y green, z blue; of one that points, it alone.
    """
    turns = simulation.effector_orientations()
    if turns is None:
        return []
    solids, places = [], simulation.effector_positions()
    for effector, place, turn in zip(simulation.scene.effectors, places, turns, strict=True):
        if effector.orientation is None:
            continue
        axes, colours = np.eye(3), AXIS_COLOURS
        if effector.orientation.pointing is not None:
            axis = np.array(effector.orientation.pointing)
            axes, colours = [axis / np.linalg.norm(axis)], AXIS_COLOURS[2:]
        for axis, colour in zip(Rotation.from_quat(turn).apply(axes), colours, strict=True):
            ends = np.array([place, place + 0.1 * size * axis])
            solids.append(Solid(tube(ends, 0.005 * size, 0.1 * size), colour, "thin"))
    return solids


def _springs(simulation: Simulation, size: float) -> list[Solid]:
    """Mass-spring bodies: balls at their points, bars for their springs."""
    solids = []
    first = sum(body.mesh.node_count for body in simulation.model.bodies if not body.vertebrae)
    for entry in simulation.scene.mass_springs:
        points = simulation.state.positions[first : first + len(entry.points)]
        first += len(entry.points)
        solids += [Solid(sphere(point, 0.012 * size), SPRING_COLOUR, "rigid")
                   for point in points]
        solids += [Solid(tube(points[list(pair)], 0.004 * size, 0.02 * size),
                         SPRING_COLOUR, "thin") for pair in entry.springs]
    return solids


_VIEW = (24.0, -58.0)
"""Elevation and azimuth of the eye [degrees]."""
_FORCE_COLOUR = "#b3123f"
# Length of the longest arrow, as a share of the scene's size.
_LONGEST_ARROW = 0.16
# Opacity of bodies with cavities inside.
_CLEAR = 0.14
_PLANE_CELLS = 8
_PLANE_COLOUR, _PLANE_LINES = (0.955, 0.95, 0.935), (0.87, 0.86, 0.84)


def check_picture(path: Path) -> None:
    """Checks before a run that a picture can be drawn.

    Args:
        path: Picture to write; its suffix determines the format.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: There is no such format.
    """
    pyplot = load_pyplot()
    figure = pyplot.figure()
    formats = sorted(figure.canvas.get_supported_filetypes())
    pyplot.close(figure)
    ending = path.suffix.lower().removeprefix(".")
    if ending not in formats:
        raise OutputError(path, f"there is no picture format '{path.suffix}'; use one of "
                          f"{', '.join(formats)}")


def draw_snapshots(snapshots: Sequence[Snapshot], path: Path | str, title: str,
                   view: tuple[float, float] | None = None) -> None:
    """Draws states side by side at the same scale and writes the picture.

    Args:
        snapshots: States; a single one has numbered axes, several have a scale bar.
        path: Picture to write; its suffix determines the format.
        title: Title of a single state.
        view: Elevation and azimuth of the eye [degrees], or None for the default.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    pyplot = load_pyplot()
    view = view or _VIEW
    box = _box_around(snapshots)
    maps = ColourMaps(_tension_map(pyplot, snapshots), _pressure_map(pyplot, snapshots))
    most = max((_most_force(snapshot) for snapshot in snapshots), default=0.0)
    count = len(snapshots)
    figure = pyplot.figure(figsize=(8.0, 6.4) if count == 1 else (4.6 * count, 5.4))
    panels = [figure.add_subplot(1, count, place + 1, projection="3d", computed_zorder=False)
              for place in range(count)]
    for axes, snapshot in zip(panels, snapshots, strict=True):
        # A panel without numbered axes can be drawn larger.
        _draw_panel(axes, snapshot, box, view, maps, most, 1.15 if count == 1 else 1.1)
        axes.set_title(title if count == 1 else snapshot.title)
        if count > 1:
            axes.set_axis_off()
    if count == 1:
        _label_axes(panels[0])
    else:
        figure.subplots_adjust(left=0.0, right=0.93, bottom=0.08, top=0.93, wspace=0.0)
        _add_scale_bar(panels[0], box, view)
    _add_legends(figure, panels, snapshots, maps, most)
    try:
        with output_file(path) as partial:
            figure.savefig(partial, dpi=160, bbox_inches="tight", pad_inches=0.1)
    except ValueError as error:  # There is no format with this suffix.
        raise OutputError(path, str(error)) from error
    finally:
        pyplot.close(figure)


class ColourMaps(NamedTuple):
    """Maps from tension [N] and from gauge pressure [kPa] to colour."""

    tension: object
    pressure: object


def _draw_panel(axes, snapshot: Snapshot, box, view, maps: ColourMaps, most: float,
                zoom: float) -> None:
    axes.set_proj_type("ortho")
    solids = list(snapshot.solids)
    for cable in snapshot.cables:
        colour = np.array(maps.tension.to_rgba(cable.tension)[:3])
        path = tube(cable.points, 0.004 * snapshot.size, 0.02 * snapshot.size)
        start = sphere(cable.points[0], 0.009 * snapshot.size)
        solids += [Solid(path, colour, "thin"), Solid(start, PULL_POINT_COLOUR, "thin")]
    for cavity in snapshot.cavities:
        colour = np.array(maps.pressure.to_rgba(1e-3 * cavity.pressure)[:3])
        # The far side of an opaque wall is hidden; without it the depths are sorted better.
        seen = cavity.triangles[_normals(cavity.triangles) @ _eye(view) > 0.0]
        solids.append(Solid(subdivide(seen, _LONGEST_EDGE * snapshot.size), colour, "rigid"))
    for point, normal in snapshot.planes:
        _add_plane(axes, point, normal, box, view)
    _add_solids(axes, solids, view)
    _add_forces(axes, snapshot, most)
    if snapshot.effector_path is not None:
        for index in range(snapshot.effector_path.shape[1]):
            path = 1e3 * snapshot.effector_path[:, index].T
            axes.plot(*path, color=EFFECTOR_COLOUR, linewidth=1.2)
    low, high = box
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=zoom)
    axes.view_init(*view)


def _box_around(snapshots: Sequence[Snapshot]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box that contains all states and the planes below them [mm]."""
    corners = np.concatenate([solid.triangles.reshape(-1, 3)
                              for snapshot in snapshots for solid in snapshot.solids]
                             + [cable.points for snapshot in snapshots
                                for cable in snapshot.cables])
    low, high = corners.min(axis=0), corners.max(axis=0)
    # A side of length zero cannot be drawn.
    thin = np.maximum(0.0, 0.05 * (high - low).max() - (high - low))
    return 1e3 * (low - 0.5 * thin), 1e3 * (high + 0.5 * thin)


def _tension_map(pyplot, snapshots: Sequence[Snapshot]):
    """The map from tension [N] to colour."""
    from matplotlib.colors import Normalize
    top = max((cable.tension for snapshot in snapshots for cable in snapshot.cables), default=0.0)
    return pyplot.cm.ScalarMappable(Normalize(0.0, top if top > 0.0 else 1.0), "plasma")


# From the greatest pressure as a vacuum by way of no pressure to the greatest pressure; as in the
# live view.
_PRESSURE_COLOURS = ("#2b62c9", "#96989e", "#e2b042", "#d62020")
_PRESSURE_PLACES = (0.0, 0.5, 0.75, 1.0)


def _pressure_map(pyplot, snapshots: Sequence[Snapshot]):
    """The map from gauge pressure [kPa] to colour: grey at 0, blue in a vacuum.

    Pressures and vacuums of the same magnitude have colours of the same strength.
    """
    from matplotlib.colors import LinearSegmentedColormap, ListedColormap, Normalize
    pressures = [1e-3 * cavity.pressure for shot in snapshots for cavity in shot.cavities]
    low, high = min([0.0, *pressures]), max([0.0, *pressures])
    if low == high:
        high = 1.0
    whole = LinearSegmentedColormap.from_list(
        "pressure", list(zip(_PRESSURE_PLACES, _PRESSURE_COLOURS, strict=True)))
    shares = np.linspace(low, high, 256) / max(-low, high)
    colours = ListedColormap(whole(0.5 + 0.5 * shares))
    return pyplot.cm.ScalarMappable(Normalize(low, high), colours)


def _most_force(snapshot: Snapshot) -> float:
    return float(np.linalg.norm(snapshot.forces[1], axis=1).max(initial=0.0))


def _add_solids(axes, solids: list[Solid], view) -> None:
    """Adds all solids as one collection [mm], lit from the viewer's upper left."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection
    triangles = np.concatenate([solid.triangles for solid in solids])
    counts = [len(solid.triangles) for solid in solids]
    base = np.repeat([solid.colour for solid in solids], counts, axis=0)
    look = np.repeat([solid.look for solid in solids], counts)[:, None]
    light = _brightness(triangles, view)[:, None]
    faces = np.clip(base * np.where(look == "thin", 0.6 + 0.4 * light, light), 0.0, 1.0)
    edges = np.where((look == "mesh") | (look == "clear"), 0.84 * faces, faces)
    if (look == "clear").any():
        faces = np.hstack([faces, np.where(look == "clear", _CLEAR, 1.0)])
        edges = np.hstack([edges, np.where(look == "clear", _CLEAR, 1.0)])
    axes.add_collection3d(Poly3DCollection(1e3 * triangles, facecolors=faces, edgecolors=edges,
                                           linewidths=0.25, zorder=2, clip_on=False))


def _brightness(triangles: np.ndarray, view) -> np.ndarray:
    """Share of light reflected by each triangle, shape (triangle_count,)."""
    normals, light = _normals(triangles), _eye((50.0, view[1] - 35.0))
    return 0.62 + 0.42 * np.clip(normals @ light, 0.0, None) + 0.08 * normals[:, 2]


def _normals(triangles: np.ndarray) -> np.ndarray:
    """Unit normals of triangles, shape (triangle_count, 3)."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def _eye(view) -> np.ndarray:
    """Unit vector towards an elevation and an azimuth [degrees]."""
    elevation, azimuth = np.radians(view)
    return np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation),
                     np.sin(elevation)])


def _add_plane(axes, point: np.ndarray, normal: np.ndarray, box, view) -> None:
    """Adds a square part of a plane behind everything; from below only its lines are drawn."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
    low, high = box
    middle = 0.5 * (low + high)
    middle = middle + ((1e3 * point - middle) @ normal) * normal
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    # A level plane is aligned with the scene's axes.
    along = np.cross(normal, across)
    half = 0.6 * (high - low)[:2].max()
    places = np.linspace(-half, half, _PLANE_CELLS + 1)
    lines = [[middle + a * across - half * along, middle + a * across + half * along]
             for a in places]
    lines += [[middle - half * across + a * along, middle + half * across + a * along]
              for a in places]
    if _eye(view) @ normal > 0.0:
        corners = [middle + a * across + b * along
                   for a, b in ((-half, -half), (half, -half), (half, half), (-half, half))]
        axes.add_collection3d(Poly3DCollection([corners], facecolors=[_PLANE_COLOUR],
                                               edgecolors="none", zorder=0, clip_on=False))
    axes.add_collection3d(Line3DCollection(lines, colors=[_PLANE_LINES], linewidths=0.6,
                                           zorder=1, clip_on=False))


def _add_forces(axes, snapshot: Snapshot, most: float) -> None:
    """Adds arrows of contact forces in front of everything, because most contacts lie inside."""
    positions, forces = snapshot.forces
    if not len(positions) or most == 0.0:
        return
    arrows = forces * (_LONGEST_ARROW * snapshot.size / most)
    axes.quiver(*(1e3 * positions.T), *(1e3 * arrows.T), color=_FORCE_COLOUR, linewidth=1.4,
                arrow_length_ratio=0.25, zorder=4)


def _label_axes(axes) -> None:
    """Axes in millimetres."""
    from matplotlib.ticker import MaxNLocator
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_major_locator(MaxNLocator(5))
        axis.line.set_color("#999999")
    axes.tick_params(labelsize=8, colors="#555555")
    axes.grid(False)


def _add_scale_bar(axes, box, view) -> None:
    """Adds a scale bar below the first state, perpendicular to the line of sight."""
    low, high = box
    azimuth = np.radians(view[1])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    length = 10.0 ** np.floor(np.log10(0.5 * (high - low).max()))
    length *= 5.0 if 5.0 * length < 0.5 * (high - low).max() else 1.0
    middle = 0.5 * (low + high)
    middle[2] = low[2]
    start = middle + 0.9 * (high - low)[:2].max() * towards - 0.5 * length * right
    ends = np.array([start, start + length * right])
    axes.plot(*ends.T, color="#444444", linewidth=2.0, zorder=5, solid_capstyle="butt",
              clip_on=False)
    axes.text(*(ends.mean(axis=0) - [0.0, 0.0, 0.03 * (high - low).max()]), f"{length:g} mm",
              ha="center", va="top", fontsize=9, color="#444444", zorder=5)


def _add_legends(figure, panels, snapshots, maps: ColourMaps, most: float) -> None:
    """Adds the legend of the marks and the scales of tensions and pressures."""
    from matplotlib.lines import Line2D
    handles = []
    if any(snapshot.has_effectors for snapshot in snapshots):
        handles.append(Line2D([], [], marker="o", linestyle="", color=EFFECTOR_COLOUR,
                              label="effector"))
    if any(snapshot.has_targets for snapshot in snapshots):
        handles.append(Line2D([], [], marker="+", markersize=9, markeredgewidth=2, linestyle="",
                              color=TARGET_COLOUR, label="target"))
    if most > 0.0:
        handles.append(Line2D([], [], color=_FORCE_COLOUR, linewidth=1.6,
                              label=f"contact force, longest {most:.2g} N"))
    if handles and len(panels) == 1:
        panels[0].legend(handles=handles, loc="upper left", frameon=False, fontsize=9)
    elif handles:
        figure.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.47, 0.03),
                      ncols=len(handles), frameon=False)
    shown = [(maps.tension, "cable tension [N]", "cables"),
             (maps.pressure, "gauge pressure [kPa]", "cavities")]
    for scale, label, kind in shown:
        if any(getattr(snapshot, kind) for snapshot in snapshots):
            figure.colorbar(scale, ax=panels, label=label, shrink=0.45,
                            pad=0.12 if len(panels) == 1 else 0.01)
