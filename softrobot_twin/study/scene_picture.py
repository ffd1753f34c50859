"""Draws a scene's present state, or several states side by side.

What lies inside bodies shows through them: cables, pull points, cavities, fixed nodes.

The file contains, in this order: triangles of simple shapes, the snapshot of a state, the names
in a picture, the drawing.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.surface import half_edges
from softrobot_twin.harness.figure import load_pyplot, write_figure
from softrobot_twin.harness.output_file import OutputError
from softrobot_twin.harness.terminal import by_key
from softrobot_twin.scene.shapes import Sphere
from softrobot_twin.study.triangle_drawing import Camera, Solid, camera_at, draw_solids, unit_normals
from softrobot_twin.view.colours import pressure_colours
from softrobot_twin.view.draw_list import DrawList, Shown
from softrobot_twin.view.frame import Drawn, Entity

if TYPE_CHECKING:
    from softrobot_twin.simulation import Simulation
    from softrobot_twin.simulation.result import ContactForces


_SIDES = 8


def swept(
    starts: np.ndarray, vectors: np.ndarray, radii: Sequence[float],
    shares: Sequence[float] = (0.0, 1.0),
) -> np.ndarray:  # fmt: skip
    """Triangles of round shapes about straight axes; none about an axis without length.

    Args:
        starts: Where the axes begin [m], shape (axis_count, 3).
        vectors: From there to their ends [m], shape (axis_count, 3).
        radii: Radii at the shares [m], shape (share_count,).
        shares: Places along the axes, from 0 to 1, shape (share_count,).

    Returns:
        Corners of the triangles [m], shape (triangle_count, 3, 3).
    """
    lengths = np.linalg.norm(vectors, axis=1)
    starts, vectors, lengths = (one[lengths > 0.0] for one in (starts, vectors, lengths))
    circles = _circle(vectors / lengths[:, None], _SIDES)[:, None, :-1]
    centres = starts[:, None] + np.asarray(shares)[:, None] * vectors[:, None]
    rings = centres[:, :, None] + np.asarray(radii)[:, None, None] * circles
    here, there = rings[:, :-1], rings[:, 1:]
    here_next, there_next = np.roll(here, -1, axis=2), np.roll(there, -1, axis=2)
    both = np.stack([here, here_next, there_next, here, there_next, there], axis=3)
    return both.reshape(-1, 3, 3)


def tubes(paths: Sequence[np.ndarray], radius: float) -> np.ndarray:
    """Triangles of tubes along polylines.

    Args:
        paths: Points of each polyline [m], shape (point_count, 3).
        radius: Radius of the tubes [m].

    Returns:
        Corners of the triangles [m], shape (triangle_count, 3, 3).
    """
    starts = np.concatenate([np.empty((0, 3)), *(path[:-1] for path in paths)])
    ends = np.concatenate([np.empty((0, 3)), *(path[1:] for path in paths)])
    return swept(starts, ends - starts, (radius, radius))


def across_of(axes: np.ndarray) -> np.ndarray:
    """Unit vectors at right angles to axes, shape (..., 3).

    Args:
        axes: The axes, not zero, shape (..., 3).
    """
    across = np.cross(axes, np.eye(3)[np.argmin(np.abs(axes), axis=-1)])
    return across / np.linalg.norm(across, axis=-1, keepdims=True)


def _circle(axes: np.ndarray, sides: int) -> np.ndarray:
    """Unit circles about unit axes, the last point the first again, shape (..., sides + 1, 3)."""
    across, angles = across_of(axes), np.linspace(0.0, 2.0 * np.pi, sides + 1)[:, None]
    aside = np.cross(axes, across)[..., None, :]
    return np.cos(angles) * across[..., None, :] + np.sin(angles) * aside


def balls(centres: np.ndarray, radius: float) -> np.ndarray:
    """Triangles of spheres, corners [m], shape (triangle_count, 3, 3).

    Args:
        centres: Their centres [m], shape (ball_count, 3).
        radius: Their radius [m].
    """
    points, triangles = Sphere(radius=radius).surface(np.pi * radius / _SIDES)
    return (centres[:, None, None] + points[triangles]).reshape(-1, 3, 3)


def arrow(start: np.ndarray, vector: np.ndarray, radius: float) -> np.ndarray:
    """Triangles of an arrow, corners [m], shape (triangle_count, 3, 3).

    Args:
        start: Where it begins [m], shape (3,).
        vector: From there to its tip [m], shape (3,).
        radius: Radius of its shaft [m].
    """
    length = np.linalg.norm(vector)
    head = min(6.0 * radius, 0.6 * length)
    neck = 1.0 - head / length
    return swept(start[None], vector[None], (radius, radius, 0.5 * head, 0.0), (0.0, neck, neck, 1.0))


def creases(points: np.ndarray, triangles: np.ndarray, angle: float) -> np.ndarray:
    """Sharp edges of a surface.

    Args:
        points: Of a closed surface [m], shape (point_count, 3).
        triangles: Indices of them, shape (triangle_count, 3).
        angle: Least angle between the normals on both sides [rad].

    Returns:
        Ends of the edges [m], shape (crease_count, 2, 3).
    """
    normals = unit_normals(points[triangles])
    _, edges, place, _ = half_edges(triangles)
    sides = normals[np.argsort(place, kind="stable").reshape(-1, 2) // 3]
    cosines = np.einsum("ei,ei->e", sides[:, 0], sides[:, 1])
    return points[edges[cosines < np.cos(angle)]]


BODY_COLOUR = np.array([0.60, 0.78, 0.84])
FREE_COLOUR = np.array([0.93, 0.73, 0.42])
GUIDED_COLOUR = np.array([0.72, 0.72, 0.74])
OBSTACLE_COLOUR = np.array([0.80, 0.79, 0.75])
AXIS_COLOURS = np.array([[0.80, 0.25, 0.22], [0.25, 0.60, 0.28], [0.20, 0.38, 0.75]])
"""Of the axes x, y and z of an orientation."""
LEGEND = {
    kind: (mark, np.array(colour), text) for kind, mark, colour, text in (
        ("fixed", "o", (0.36, 0.36, 0.40), "fixed"),
        ("cable", "_", (0.16, 0.05, 0.52), "cable"),
        ("pull point", "o", (0.10, 0.10, 0.10), "pull point"),
        ("hold", "ring", (0.55, 0.15, 0.50), "hold radius"),
        ("thread", "_", (0.45, 0.45, 0.50), "tube or fibre"),
        ("spring", "_", (0.45, 0.45, 0.50), "spring"),
        ("axis", "_", (0.25, 0.25, 0.28), "motor axis"),
        ("cavity", "s", (0.59, 0.60, 0.62), "cavity"),
        ("frame", "axes", AXIS_COLOURS[0], "frame: x, y, z"),
        ("marker", "o", (0.15, 0.50, 0.30), "marker"),
        ("touch", "ring", (0.80, 0.45, 0.10), "touch"),
        ("effector", "o", (0.10, 0.25, 0.45), "effector"),
        ("target", "+", (0.85, 0.22, 0.15), "target"),
        ("force", "_", (0.70, 0.07, 0.25), "contact force"),
    )
}  # fmt: skip
"""Mark, colour and text of each kind of thing, in the order of the legend."""
# Length of the facets of round shapes, as a share of their radius.
_FACETS = 0.2
# Edges of a rigid surface with a larger angle [rad] are drawn.
_SHARP = 0.6


class _Look(NamedTuple):
    """How the entities of a kind are drawn: their look, colour, and radius as a share of the size."""

    look: str
    colour: np.ndarray
    radius: float = 0.0
    legend: str = ""


_LOOKS = {
    "body": _Look("mesh", BODY_COLOUR), "clear body": _Look("clear", BODY_COLOUR),
    "beam": _Look("rigid", BODY_COLOUR), "free body": _Look("rigid", FREE_COLOUR),
    "guided body": _Look("rigid", GUIDED_COLOUR), "obstacle": _Look("rigid", OBSTACLE_COLOUR),
    "cavity": _Look("rigid", LEGEND["cavity"][1], legend="cavity"),
    "mass": _Look("rigid", LEGEND["spring"][1], 0.012),
    "fixed end": _Look("thin", LEGEND["fixed"][1], 0.014, "fixed"),
    **{kind: _Look("thin", LEGEND[kind][1], radius, kind) for kind, radius in (
        ("fixed", 0.0055), ("cable", 0.004), ("pull point", 0.010), ("axis", 0.008),
        ("thread", 0.0015), ("spring", 0.004), ("marker", 0.008), ("effector", 0.014),
        ("target", 0.0035), ("frame", 0.0),
    )},
}  # fmt: skip
"""Look of each kind of entity; planes, forces and touches are drawn in ways of their own."""


class Ring(NamedTuple):
    """A ring that faces the viewer: its kind in `LEGEND`, centre, radius and width [m]."""

    kind: str
    centre: np.ndarray
    radius: float
    width: float


class Label(NamedTuple):
    """A name in a picture: its text, and the place that it names [m], shape (3,)."""

    text: str
    place: np.ndarray


class Snapshot(NamedTuple):
    """One state, ready to be drawn.

    Attributes:
        title: Title of the panel.
        size: Scales lines and marks [m], about the size of the largest body.
        solids: All that has a shape; cavities lie inside bodies that are drawn translucent.
        rings: Where cables act on a ball of material, and what may be touched.
        planes: Point [m] and unit normal of each plane.
        forces: Points of contacts and touches [m] and forces on the first body [N], both of shape
            (force_count, 3).
        labels: Names of everything.
    """

    title: str
    size: float
    solids: list[Solid]
    rings: list[Ring]
    planes: list[tuple[np.ndarray, np.ndarray]]
    forces: tuple[np.ndarray, np.ndarray]
    labels: list[Label]


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
    known = {} if contacts is None else {"contacts": (contacts.positions, contacts.forces)}
    known |= {} if targets is None else {"targets": targets}
    drawing = DrawList(simulation, 1.0, _FACETS)
    size, now = drawing.size, drawing.drawn(Shown.of(simulation)._replace(**known))
    every = [(entity, now.get(entity.path, Drawn(entity.points))) for entity in drawing.entities]
    solids = [solid for entity, drawn in every for solid in _solids(entity, drawn, size)]
    if effector_path is not None and len(effector_path) > 1:
        solids += [Solid(tubes([path], 0.0022 * size), LEGEND["effector"][1], "thin")
                   for path in np.moveaxis(effector_path, 1, 0)]
    paths = simulation.actuator_paths()
    rings = [Ring("hold", place, cable.hold_radius, 0.004 * size)
             for cable in simulation.scene.cables if cable.hold_radius > 0.0
             for place in paths[cable.name][-len(cable.points):]]
    rings += [Ring("touch", place, 0.02 * size, 0.006 * size)
              for entity, drawn in every if entity.kind == "touch" for place in drawn.points]
    planes = [_plane(entity) for entity, _ in every if entity.kind == "plane"]
    forces = [drawn for entity, drawn in every if entity.kind == "force"]
    joined = tuple(np.concatenate([np.empty((0, 3)), *arrays])
                   for arrays in ([one.points for one in forces], [one.vectors for one in forces]))
    return Snapshot(title, size, solids, rings, planes, joined, list(labels(every, size)))


def _plane(entity: Entity) -> tuple[np.ndarray, np.ndarray]:
    """A point of a plane, and its normal."""
    return entity.points.mean(axis=0), unit_normals(entity.points[entity.triangles[:1]])[0]


def _solids(entity: Entity, drawn: Drawn, size: float) -> Iterator[Solid]:
    """An entity as a picture draws it; nothing for kinds without a look."""
    if entity.kind not in _LOOKS:
        return
    look = _LOOKS[entity.kind]
    if entity.shape in ("surface", "solid"):
        points = _points(entity, drawn)
        value = 0.0 if drawn.values is None else 1e-3 * float(drawn.values[0])
        yield Solid(points[entity.triangles], look.colour, look.look, look.legend, value)
        if entity.shape == "solid":
            edges = creases(points, entity.triangles, _SHARP)
            yield Solid(tubes(edges, 0.0015 * size), 0.7 * look.colour, "rigid")
    elif entity.shape == "arrows":
        for start, vector, number in zip(*drawn, strict=True):
            bar = swept(start[None], vector[None], 2 * (0.045 * np.linalg.norm(vector),))
            yield Solid(bar, AXIS_COLOURS[number], look.look, look.legend)
    elif entity.shape == "points":
        places = drawn.points[np.isfinite(drawn.points).all(axis=1)]
        arms = 0.04 * size * np.eye(3)
        marks = balls(places, look.radius * size) if entity.kind != "target" else tubes(
            [place + side for place in places for side in np.stack([-arms, arms], axis=1)],
            look.radius * size)  # fmt: skip
        if len(places):
            yield Solid(marks, look.colour, look.look, look.legend)
    elif drawn.values is None:
        yield Solid(tubes(drawn.points, look.radius * size), look.colour, look.look, look.legend)
    else:
        for path, value in zip(drawn.points, drawn.values, strict=True):
            mark = tubes([path], look.radius * size)
            yield Solid(mark, look.colour, look.look, look.legend, float(value))


def _mark(triangles: np.ndarray, kind: str) -> Solid:
    """A mark or line of a kind, in the colour of the legend."""
    return Solid(triangles, LEGEND[kind][1], "thin", kind)


def _points(entity: Entity, drawn: Drawn) -> np.ndarray:
    """Points of a surface or solid where it is now [m], shape (point_count, 3)."""
    if entity.shape == "surface" or drawn.vectors is None:
        return drawn.points
    return drawn.points + Rotation.from_quat(drawn.vectors).apply(entity.points)


# More things of one kind than this share one label for each pattern of their names.
_MOST_LABELS = 6


def labels(every: Sequence[tuple[Entity, Drawn]], size: float) -> Iterator[Label]:
    """Names of all things of a scene, at their present places.

    Args:
        every: All entities, and where they are.
        size: About the size of the largest body [m].

    Yields:
        The labels; many things with alike names share one, such as ``hub_0 … hub_17 (18)``.
    """
    named = by_key((entity.noun, thing) for entity, drawn in every
                   for thing in zip(entity.labels, _label_places(entity, drawn, size)) if entity.noun)
    for noun, things in named.items():
        yield from _grouped(noun, things)
    for entity, drawn in every:
        if entity.kind.startswith("fixed"):
            many = len(drawn.points)
            yield Label(f"fixed, {many} {entity.noun}{'' if many == 1 else 's'}",
                        _nearest(drawn.points, drawn.points.mean(axis=0)))


def _label_places(entity: Entity, drawn: Drawn, size: float) -> Sequence[np.ndarray]:
    """Where the labels of an entity stand [m], each of shape (3,)."""
    if entity.shape == "surface":
        return drawn.points[entity.anchors]
    if entity.kind == "plane":  # beside what stands on it
        (point, normal), aside = _plane(entity), np.array([0.5, -0.3, 0.0]) * size
        return [point + aside - (aside @ normal) * normal]
    if entity.shape == "solid":
        points = _points(entity, drawn)
        return [0.5 * (points.min(axis=0) + points.max(axis=0))]
    if entity.shape == "lines":
        return [path[:2].mean(axis=0) for path in drawn.points]
    return drawn.points


def _nearest(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    return points[np.argmin(np.linalg.norm(points - place, axis=1))]


_PLURALS = {"body": "bodies", "rigid body": "rigid bodies", "cavity": "cavities",
            "sealed cavity": "sealed cavities", "touch": "touches"}


def _grouped(noun: str, things: list[tuple[str, np.ndarray]]) -> Iterator[Label]:
    """A label for each thing, or one for all with alike names where there are many."""
    alike = by_key((name if len(things) <= _MOST_LABELS else re.sub(r"\d+", "#", name),
                    (name, place)) for name, place in things)  # fmt: skip
    for members in alike.values():
        (first, place), (last, _) = members[0], members[-1]
        if len(members) == 1:
            told = first.startswith(noun.split()[-1])
            yield Label(first if told else f"{noun} {first}", place)
        else:
            yield Label(f"{_PLURALS.get(noun, noun + 's')} {first} … {last} ({len(members)})", place)


_VIEW = (24.0, -58.0)
"""Elevation and azimuth of the eye [degrees]."""
# Length of the longest arrow, as a share of the scene's size.
_LONGEST_ARROW = 0.16
_PLANE_CELLS = 8
_PLANE_COLOUR, _PLANE_LINES = (0.955, 0.95, 0.935), (0.87, 0.86, 0.84)
# Pixels per inch.
_SHARPNESS = 150
# Space for the drawing of one state alone, and of one of several [inch].
_ALONE, _BESIDE = (6.2, 5.2), (4.2, 4.4)
# Space between states; for a colour bar [inch].
_GAP, _COLOUR_BAR = 0.3, 0.95
# A legend may be as wide as this where the picture is narrower [inch].
_LEGEND_WIDTH = 5.0
# Around all that is drawn; between that and title, legend and colour bars [inch].
_MARGIN, _APART = 0.1, 0.12


def check_picture(path: Path) -> None:
    """Checks before a run that a picture can be drawn.

    Args:
        path: Picture to write; its suffix determines the format.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: There is no such format.
    """
    load_pyplot()
    from matplotlib.backend_bases import FigureCanvasBase
    formats = sorted(FigureCanvasBase.get_supported_filetypes())
    ending = path.suffix.lower().removeprefix(".")
    if ending not in formats:
        raise OutputError(path, f"there is no picture format '{path.suffix}'; use one of "
                          f"{', '.join(formats)}")


def draw_snapshots(snapshots: Sequence[Snapshot], path: Path | str, title: str,
                   view: tuple[float, float] | None = None, labelled: bool = False) -> None:
    """Draws states side by side at the same scale and writes the picture.

    Args:
        snapshots: States; a single one has numbered axes, several have a scale bar.
        path: Picture to write; its suffix determines the format.
        title: Title of a single state.
        view: Elevation and azimuth of the eye [degrees], or None for the default.
        labelled: Whether the names of all things stand beside a single state.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    write_figure(figure_of(snapshots, title, view, labelled), path, _SHARPNESS)


def figure_of(snapshots: Sequence[Snapshot], title: str, view: tuple[float, float] | None = None,
              labelled: bool = False):
    """The matplotlib figure of states side by side; see `draw_snapshots`.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    pyplot = load_pyplot()
    camera = camera_at(*(view or _VIEW))
    alone = len(snapshots) == 1
    maps = _colour_maps(snapshots)
    most = max((float(np.linalg.norm(snapshot.forces[1], axis=1).max(initial=0.0))
                for snapshot in snapshots), default=0.0)
    box = _box_around(snapshots)
    scene = [_all_solids(snapshot, maps, camera, most) for snapshot in snapshots]
    window = _window(scene, snapshots, box, camera)
    extent = window[[1, 3]] - window[[0, 2]]
    scale = float((np.array(_ALONE if alone else _BESIDE) / extent).min())  # inches per mm
    width, height = size = scale * extent
    step = width + max(_GAP, 0.9 - width)
    whole = width + step * (len(snapshots) - 1)
    figure = pyplot.figure(figsize=(whole, height))
    panels = [figure.add_axes((place * step / whole, 0.0, width / whole, 1.0))
              for place in range(len(snapshots))]
    for axes, snapshot, solids in zip(panels, snapshots, scene, strict=True):
        axes.set(xlim=window[:2], ylim=window[2:])
        axes.set_axis_off()
        for point, normal in snapshot.planes:
            _add_plane(axes, point, normal, box, camera)
        draw_solids(axes, solids, camera, 1e3)
    _add_scale_bar(panels[0], window, camera, scale)
    if alone and labelled:
        _add_labels(panels[0], snapshots[0].labels, window, camera, scale)
    drawn = figure.get_tightbbox()
    for axes, snapshot in zip(panels, snapshots, strict=True):
        axes.set_title(title if alone else snapshot.title, fontsize=12, y=(drawn.y1 + _APART) / height)
    bars = [kind for kind in maps if any(_values(snapshots, kind))]
    for place, kind in enumerate(bars):
        tall = min(0.75 * height, 2.6)
        beside = drawn.x1 - (whole - width) + _APART + place * _COLOUR_BAR
        bar = panels[-1].inset_axes((beside / width, 0.5 * (1.0 - tall / height), 0.13 / width, tall / height))
        figure.colorbar(maps[kind], cax=bar)
        bar.set_ylabel(_BAR_TITLES[kind], fontsize=9)
        bar.tick_params(labelsize=8)
    kinds = {solid.kind for solids in scene for solid in solids}
    middle = np.array([0.5 * (drawn.x0 + drawn.x1), drawn.y0 - _APART]) / size
    # Colour bars name what they show.
    _add_legend(panels[0], kinds - set(bars), most, max(drawn.width, _LEGEND_WIDTH), middle)
    _fit(figure)
    return figure


def _fit(figure) -> None:
    """Gives a figure the size of all that is drawn on it; its panels keep theirs."""
    from matplotlib.transforms import Bbox
    box, before = figure.get_tightbbox().padded(_MARGIN), figure.get_size_inches()
    for axes in figure.axes:
        axes.set_position(Bbox((axes.get_position().get_points() * before - box.min) / box.size))
    figure.set_size_inches(box.size)


def _all_solids(snapshot: Snapshot, maps: dict, camera: Camera, most: float) -> list[Solid]:
    """All that is drawn of a state: its solids in their colours, rings, and forces as arrows."""
    size = snapshot.size
    solids = [solid._replace(colour=np.array(maps[solid.kind].to_rgba(solid.value)[:3]))
              if solid.kind in maps else solid for solid in snapshot.solids]
    solids += [_mark(tubes([ring.centre + ring.radius * _circle(camera.eye, 24)],
                           0.5 * ring.width), ring.kind) for ring in snapshot.rings]  # fmt: skip
    return solids + [
        _mark(arrow(start, force * (_LONGEST_ARROW * size / most), 0.005 * size), "force")
        for start, force in zip(*snapshot.forces, strict=True) if force.any()]


def _box_around(snapshots: Sequence[Snapshot]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box that contains all states [mm]."""
    corners = np.concatenate([solid.triangles.reshape(-1, 3)
                              for snapshot in snapshots for solid in snapshot.solids])
    low, high = corners.min(axis=0), corners.max(axis=0)
    # A side of length zero cannot be drawn.
    thin = np.maximum(0.0, 0.05 * (high - low).max() - (high - low))
    return 1e3 * (low - 0.5 * thin), 1e3 * (high + 0.5 * thin)


def _window(scene: list[list[Solid]], snapshots: Sequence[Snapshot], box, camera: Camera) -> np.ndarray:
    """Left, right, bottom and top of what is drawn [mm]."""
    seen = [1e3 * solid.triangles.reshape(-1, 3) for solids in scene for solid in solids]
    seen += [_square(point, normal, box)[0] for snapshot in snapshots
             for point, normal in snapshot.planes]
    places = camera.project(np.concatenate(seen))
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    # A margin keeps outlines whole; a flat picture has some height.
    margin = 0.01 * (high - low).max()
    thin = np.maximum(0.0, 0.1 * (high - low).max() - (high - low))
    low, high = low - margin - 0.5 * thin, high + margin + 0.5 * thin
    return np.array([low[0], high[0], low[1], high[1]])


_BAR_TITLES = {"cable": "cable tension [N]", "cavity": "gauge pressure [kPa]"}


def _values(snapshots: Sequence[Snapshot], kind: str) -> list[float]:
    """Values of the solids of a kind, and 0."""
    return [0.0, *(solid.value for shot in snapshots for solid in shot.solids if solid.kind == kind)]


def _colour_maps(snapshots: Sequence[Snapshot]) -> dict:
    """Maps from tension [N] and from gauge pressure [kPa] to colour; pressures as in the live view.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize
    pressures = _values(snapshots, "cavity")
    ends = min(pressures), max(pressures)
    if ends[0] == ends[1]:
        ends = 0.0, 1.0
    scale = ListedColormap(pressure_colours(np.linspace(*ends, 256), ends) / 255.0)
    tensions = Normalize(0.0, max(_values(snapshots, "cable")) or 1.0)
    return {"cable": ScalarMappable(tensions, "plasma"), "cavity": ScalarMappable(Normalize(*ends), scale)}


def _square(point: np.ndarray, normal: np.ndarray, box) -> tuple[np.ndarray, list]:
    """Corners of the part of a plane that is drawn, and its lines [mm]."""
    low, high = box
    middle = 0.5 * (low + high)
    middle = middle + ((1e3 * point - middle) @ normal) * normal
    across = across_of(normal)
    # A level plane is aligned with the scene's axes.
    along = np.cross(normal, across)
    half = 0.6 * (high - low)[:2].max()
    lines = [[middle + place * one - half * other, middle + place * one + half * other]
             for one, other in ((across, along), (along, across))
             for place in np.linspace(-half, half, _PLANE_CELLS + 1)]
    corners = middle + half * np.array([-across - along, across - along, across + along, along - across])
    return corners, lines


def _add_plane(axes, point: np.ndarray, normal: np.ndarray, box, camera: Camera) -> None:
    """Adds a square part of a plane behind everything; from below only its lines are drawn."""
    from matplotlib.collections import LineCollection
    corners, lines = _square(point, normal, box)
    if camera.eye @ normal > 0.0:
        axes.fill(*camera.project(corners)[:, :2].T, color=_PLANE_COLOUR, zorder=0, linewidth=0)
    axes.add_collection(LineCollection(camera.project(lines)[..., :2], colors=[_PLANE_LINES],
                                       linewidths=0.6, zorder=1))


# Between two labels, and between the drawing and the labels [inch].
_LABEL_STEP, _LABEL_GAP = 0.19, 0.08


def _add_labels(axes, names: Sequence[Label], window: np.ndarray, camera: Camera, scale: float) -> None:
    """Adds labels in a column at each side, in the order of the heights of what they name, each with
    a line to it."""
    left, right, _, _ = window
    inch = 1.0 / scale
    placed = sorted(((label.text, camera.project(1e3 * label.place)[:2]) for label in names),
                    key=lambda one: one[1][0])
    half = len(placed) // 2
    for side, sign, own in ((left, -1.0, placed[:half]), (right, 1.0, placed[half:])):
        own.sort(key=lambda one: one[1][1])
        x = side + sign * _LABEL_GAP * inch
        heights = spread([place[1] for _, place in own], _LABEL_STEP * inch)
        for (text, place), y in zip(own, heights, strict=True):
            axes.text(x, y, text, fontsize=9, color="#222222", va="center",
                      ha="right" if sign < 0.0 else "left", zorder=4)
            axes.plot([x - 0.5 * sign * _LABEL_GAP * inch, place[0]], [y, place[1]], color="#333333",
                      linewidth=0.6, alpha=0.75, clip_on=False, zorder=3)
            axes.plot(*place, marker="o", markersize=2.2, color="#222222", clip_on=False, zorder=3)


def spread(heights: list[float], step: float) -> list[float]:
    """Heights nearest to some increasing ones that are at least a step apart, all in one unit.

    Args:
        heights: The heights, increasing.
        step: The least distance of two neighbours.
    """
    # Runs of labels that touch, each with the mean of what its first label would need, and length.
    runs: list[tuple[float, int]] = []
    for index, height in enumerate(heights):
        mean, length = height - index * step, 1
        while runs and runs[-1][0] > mean:
            before, many = runs.pop()
            mean = (before * many + mean * length) / (many + length)
            length += many
        runs.append((mean, length))
    firsts = [mean for mean, length in runs for _ in range(length)]
    return [first + index * step for index, first in enumerate(firsts)]


def _add_scale_bar(axes, window: np.ndarray, camera: Camera, scale: float) -> None:
    """Adds a scale bar below a state, with the directions of the axes."""
    left, right, bottom, _ = window
    inch = 1.0 / scale
    longest = 0.45 * (right - left)
    length = 10.0 ** np.floor(np.log10(longest))
    length *= next(factor for factor in (5.0, 2.0, 1.0) if factor * length <= longest)
    middle, y = 0.5 * (left + right), bottom - 0.36 * inch
    axes.plot(middle + np.array([-0.5, 0.5]) * length, [y, y], color="#444444", linewidth=2.0,
              solid_capstyle="butt", clip_on=False)
    axes.text(middle, y - 0.06 * inch, f"{length:g} mm", ha="center", va="top", fontsize=9, color="#444444")
    # Left of the bar and its text.
    origin = np.array([middle - max(0.5 * length, 0.3 * inch) - 0.5 * inch, bottom - 0.42 * inch])
    for name, arm, colour in zip("xyz", np.eye(3), AXIS_COLOURS, strict=True):
        to = camera.project(arm)[:2]
        if np.linalg.norm(to) >= 0.15:
            tip = origin + 0.2 * inch * to
            axes.plot(*np.array([origin, tip]).T, color=colour, linewidth=1.3, clip_on=False)
            axes.text(*(tip + 0.09 * inch * to / np.linalg.norm(to)), name, ha="center",
                      va="center", fontsize=7, color=colour)


def _add_legend(axes, kinds: set[str], most: float, wide: float, place: np.ndarray) -> None:
    """Adds the legend of what is shown below a place, in as many columns as fit into a width [inch]."""
    from matplotlib.legend_handler import HandlerTuple
    handles, texts = [], []
    for kind, (mark, colour, text) in LEGEND.items():
        if kind in kinds:
            handles.append(_handle(mark, colour))
            texts.append(f"force, longest {most:.2g} N" if kind == "force" else text)
    for columns in range(len(handles), 0, -1):
        legend = axes.legend(handles, texts, loc="upper center", bbox_to_anchor=place, ncols=columns,
                             frameon=False, fontsize=9, borderaxespad=0.0, columnspacing=1.4,
                             handletextpad=0.6, handlelength=1.5,
                             handler_map={tuple: HandlerTuple(ndivide=None, pad=0.0)})
        if legend.get_window_extent().width <= wide * axes.figure.dpi:
            break


def _handle(mark: str, colour: np.ndarray):
    """A mark of the legend."""
    from matplotlib.lines import Line2D
    if mark == "axes":
        return tuple(Line2D([], [], color=own, linewidth=2.0) for own in AXIS_COLOURS)
    if mark == "_":
        return Line2D([], [], color=colour, linewidth=2.0)
    look = {"ring": {"marker": "o", "markersize": 7, "fillstyle": "none"},
            "+": {"marker": "+", "markersize": 9, "markeredgewidth": 2},
            }.get(mark, {"marker": mark, "markersize": 6})  # fmt: skip
    return Line2D([], [], linestyle="", color=colour, **look)
