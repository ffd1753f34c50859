"""A picture of a body as it stands: surface, cables by tension, effectors, targets and trails."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from softrobot_twin.study import depth_sorted
from softrobot_twin.study.extras import load_pyplot
from softrobot_twin.study.output_error import OutputError

if TYPE_CHECKING:
    from softrobot_twin.simulation import Simulation

_BODY_COLOUR = np.array([0.60, 0.78, 0.84])
_PULL_POINT_COLOUR = np.array([0.30, 0.30, 0.30])
_EFFECTOR_COLOUR = np.array([0.10, 0.25, 0.45])
_TARGET_COLOUR = np.array([0.85, 0.22, 0.15])
_VIEW = {"elev": 24.0, "azim": -58.0}


class Solid(NamedTuple):
    """Triangles of one colour.

    Attributes:
        triangles: Corners [m], shape (triangle_count, 3, 3).
        colour: Red, green, blue in 0..1, shape (3,).
        is_body: True for the mesh, whose edges are drawn and whose shadows are deep.
    """

    triangles: np.ndarray
    colour: np.ndarray
    is_body: bool


def draw_scene(simulation: Simulation, path: Path | str, targets: np.ndarray | None = None,
               trail: np.ndarray | None = None) -> None:
    """Draws the simulation's present state and writes it as a picture.

    Args:
        simulation: Its present state is drawn.
        path: Picture to write; its ending says the format.
        targets: Where the effectors should be [m], shape (effector_count, 3); NaN for none.
        trail: Where the effectors have been [m], shape (row_count, effector_count, 3).

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    pyplot = load_pyplot()
    surface = simulation.surface_positions()
    size = float(np.linalg.norm(np.ptp(surface, axis=0)))
    colours, tension_map = _tension_colours(pyplot, simulation.state.tensions)
    solids = [Solid(surface[simulation.surface_triangles], _BODY_COLOUR, True)]
    for cable, colour in zip(simulation.cable_paths(), colours):
        solids += [Solid(depth_sorted.tube(cable, 0.004 * size, 0.02 * size), colour, False),
                   Solid(depth_sorted.sphere(cable[0], 0.009 * size), _PULL_POINT_COLOUR, False)]
    solids += [Solid(depth_sorted.sphere(point, 0.014 * size), _EFFECTOR_COLOUR, False)
               for point in simulation.effector_positions()]
    if targets is not None:
        solids += [Solid(depth_sorted.cross(point, 0.08 * size, 0.0035 * size), _TARGET_COLOUR,
                         False)
                   for point in targets if np.isfinite(point).all()]
    figure = pyplot.figure(figsize=(8.0, 6.4))
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    _add_solids(axes, solids)
    if trail is not None:
        for index in range(trail.shape[1]):
            axes.plot(*(1e3 * trail[:, index].T), color=_EFFECTOR_COLOUR, linewidth=1.2)
    _dress(figure, axes, solids, simulation, tension_map, targets is not None)
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=160, bbox_inches="tight", pad_inches=0.1)
    except (OSError, ValueError) as error:
        raise OutputError(path, str(error)) from error
    finally:
        pyplot.close(figure)


def _tension_colours(pyplot, tensions: np.ndarray):
    """A colour for each cable and the map from tension [N] to it."""
    from matplotlib.colors import Normalize
    top = float(np.max(tensions, initial=0.0))
    mapping = pyplot.cm.ScalarMappable(Normalize(0.0, top if top > 0.0 else 1.0), "plasma")
    return np.array([mapping.to_rgba(value)[:3] for value in tensions]), mapping


def _add_solids(axes, solids: list[Solid]) -> None:
    """All solids as one collection in millimetres, lit from the viewer's upper left."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection
    triangles = np.concatenate([solid.triangles for solid in solids])
    counts = [len(solid.triangles) for solid in solids]
    base = np.repeat([solid.colour for solid in solids], counts, axis=0)
    is_body = np.repeat([solid.is_body for solid in solids], counts)[:, None]
    light = _brightness(triangles)[:, None]
    faces = np.clip(base * np.where(is_body, light, 0.6 + 0.4 * light), 0.0, 1.0)
    edges = np.where(is_body, 0.84 * faces, faces)
    axes.add_collection3d(Poly3DCollection(1e3 * triangles, facecolors=faces, edgecolors=edges,
                                           linewidths=0.25))


def _brightness(triangles: np.ndarray) -> np.ndarray:
    """Share of light that each triangle sends back, shape (triangle_count,)."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    azimuth, elevation = np.radians(_VIEW["azim"] - 35.0), np.radians(50.0)
    light = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation),
                      np.sin(elevation)])
    return 0.62 + 0.42 * np.clip(normals @ light, 0.0, None) + 0.08 * normals[:, 2]


def _dress(figure, axes, solids: list[Solid], simulation: Simulation, tension_map,
           has_targets: bool) -> None:
    """Equal axes in millimetres, a legend and the tension scale."""
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator
    corners = 1e3 * np.concatenate([solid.triangles.reshape(-1, 3) for solid in solids])
    low, high = corners.min(axis=0), corners.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]),
             xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set_box_aspect(high - low, zoom=1.15)
    axes.view_init(**_VIEW)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_major_locator(MaxNLocator(5))
        axis.line.set_color("#999999")
    axes.tick_params(labelsize=8, colors="#555555")
    axes.grid(False)
    handles = [Line2D([], [], marker="o", linestyle="", color=_EFFECTOR_COLOUR, label="effector")]
    if has_targets:
        handles.append(Line2D([], [], marker="+", markersize=9, markeredgewidth=2, linestyle="",
                              color=_TARGET_COLOUR, label="target"))
    axes.legend(handles=handles, loc="upper left", frameon=False)
    if simulation.actuator_names:
        figure.colorbar(tension_map, ax=axes, shrink=0.45, pad=0.12, label="cable tension [N]")
    axes.set_title(simulation.scene.name)
