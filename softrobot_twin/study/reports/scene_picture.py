"""A picture of a scene as it stands, or of several states side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softrobot_twin.study.reports import depth_sorted
from softrobot_twin.study.reports.extras import load_pyplot
from softrobot_twin.study.reports.output_error import OutputError
from softrobot_twin.study.reports.output_file import output_file
from softrobot_twin.study.reports.scene_snapshot import (
    EFFECTOR_COLOUR,
    PULL_POINT_COLOUR,
    TARGET_COLOUR,
    Snapshot,
    Solid,
)

_VIEW = (24.0, -58.0)
"""Elevation and azimuth of the eye [degrees]."""
_FORCE_COLOUR = "#b3123f"
# Length of the longest arrow, as a share of the scene's size.
_LONGEST_ARROW = 0.16
_PLANE_CELLS = 8
_PLANE_COLOUR, _PLANE_LINES = (0.955, 0.95, 0.935), (0.87, 0.86, 0.84)


def check_picture(path: Path) -> None:
    """Refuses a picture that could not be drawn, before anything is run for it.

    Args:
        path: Picture to write; its ending says the format.

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
        raise OutputError(path, f"no picture ends in '{path.suffix}'; one of "
                          f"{', '.join(formats)} is meant")


def draw_snapshots(snapshots: Sequence[Snapshot], path: Path | str, title: str,
                   view: tuple[float, float] | None = None) -> None:
    """Draws states side by side, to the same scale, and writes the picture.

    Args:
        snapshots: States; one alone gets axes with numbers, several a scale bar.
        path: Picture to write; its ending says the format.
        title: What stands above a single state.
        view: Elevation and azimuth of the eye [degrees], or None for the usual ones.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    pyplot = load_pyplot()
    view = view or _VIEW
    box = _box_around(snapshots)
    tension_map = _tension_map(pyplot, snapshots)
    most = max((_most_force(snapshot) for snapshot in snapshots), default=0.0)
    count = len(snapshots)
    figure = pyplot.figure(figsize=(8.0, 6.4) if count == 1 else (4.6 * count, 5.4))
    panels = [figure.add_subplot(1, count, place + 1, projection="3d", computed_zorder=False)
              for place in range(count)]
    for axes, snapshot in zip(panels, snapshots, strict=True):
        # Without numbers at its axes a panel has room to spare.
        _draw_panel(axes, snapshot, box, view, tension_map, most, 1.15 if count == 1 else 1.1)
        axes.set_title(title if count == 1 else snapshot.title)
        if count > 1:
            axes.set_axis_off()
    if count == 1:
        _dress_axes(panels[0])
    else:
        figure.subplots_adjust(left=0.0, right=0.93, bottom=0.08, top=0.93, wspace=0.0)
        _add_scale_bar(panels[0], box, view)
    _add_legends(figure, panels, snapshots, tension_map, most)
    try:
        with output_file(path) as partial:
            figure.savefig(partial, dpi=160, bbox_inches="tight", pad_inches=0.1)
    except ValueError as error:  # no format has this ending
        raise OutputError(path, str(error)) from error
    finally:
        pyplot.close(figure)


def _draw_panel(axes, snapshot: Snapshot, box, view, tension_map, most: float,
                zoom: float) -> None:
    axes.set_proj_type("ortho")
    solids = list(snapshot.solids)
    for cable in snapshot.cables:
        colour = np.array(tension_map.to_rgba(cable.tension)[:3])
        tube = depth_sorted.tube(cable.points, 0.004 * snapshot.size, 0.02 * snapshot.size)
        start = depth_sorted.sphere(cable.points[0], 0.009 * snapshot.size)
        solids += [Solid(tube, colour, "thin"), Solid(start, PULL_POINT_COLOUR, "thin")]
    for point, normal in snapshot.planes:
        _add_plane(axes, point, normal, box, view)
    _add_solids(axes, solids, view)
    _add_forces(axes, snapshot, most)
    if snapshot.trail is not None:
        for index in range(snapshot.trail.shape[1]):
            axes.plot(*(1e3 * snapshot.trail[:, index].T), color=EFFECTOR_COLOUR, linewidth=1.2)
    low, high = box
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=zoom)
    axes.view_init(*view)


def _box_around(snapshots: Sequence[Snapshot]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box that holds all states, planes where they pass below [mm]."""
    corners = np.concatenate([solid.triangles.reshape(-1, 3)
                              for snapshot in snapshots for solid in snapshot.solids]
                             + [cable.points for snapshot in snapshots
                                for cable in snapshot.cables])
    low, high = corners.min(axis=0), corners.max(axis=0)
    # A side without width cannot be drawn.
    thin = np.maximum(0.0, 0.05 * (high - low).max() - (high - low))
    return 1e3 * (low - 0.5 * thin), 1e3 * (high + 0.5 * thin)


def _tension_map(pyplot, snapshots: Sequence[Snapshot]):
    """The map from tension [N] to colour."""
    from matplotlib.colors import Normalize
    top = max((cable.tension for snapshot in snapshots for cable in snapshot.cables), default=0.0)
    return pyplot.cm.ScalarMappable(Normalize(0.0, top if top > 0.0 else 1.0), "plasma")


def _most_force(snapshot: Snapshot) -> float:
    return float(np.linalg.norm(snapshot.forces[1], axis=1).max(initial=0.0))


def _add_solids(axes, solids: list[Solid], view) -> None:
    """All solids as one collection in millimetres, lit from the viewer's upper left."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection
    triangles = np.concatenate([solid.triangles for solid in solids])
    counts = [len(solid.triangles) for solid in solids]
    base = np.repeat([solid.colour for solid in solids], counts, axis=0)
    look = np.repeat([solid.look for solid in solids], counts)[:, None]
    light = _brightness(triangles, view)[:, None]
    faces = np.clip(base * np.where(look == "thin", 0.6 + 0.4 * light, light), 0.0, 1.0)
    edges = np.where(look == "mesh", 0.84 * faces, faces)
    axes.add_collection3d(Poly3DCollection(1e3 * triangles, facecolors=faces, edgecolors=edges,
                                           linewidths=0.25, zorder=2, clip_on=False))


def _brightness(triangles: np.ndarray, view) -> np.ndarray:
    """Share of light that each triangle sends back, shape (triangle_count,)."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    azimuth, elevation = np.radians(view[1] - 35.0), np.radians(50.0)
    light = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation),
                      np.sin(elevation)])
    return 0.62 + 0.42 * np.clip(normals @ light, 0.0, None) + 0.08 * normals[:, 2]


def _add_plane(axes, point: np.ndarray, normal: np.ndarray, box, view) -> None:
    """A square patch under the scene, behind everything; seen from below, its lines only."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
    low, high = box
    middle = 0.5 * (low + high)
    middle = middle + ((1e3 * point - middle) @ normal) * normal
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    # Aligned with the scene's own axes where the plane is level.
    along = np.cross(normal, across)
    half = 0.6 * (high - low)[:2].max()
    ways = np.linspace(-half, half, _PLANE_CELLS + 1)
    lines = [[middle + a * across - half * along, middle + a * across + half * along]
             for a in ways]
    lines += [[middle - half * across + a * along, middle + half * across + a * along]
              for a in ways]
    azimuth, elevation = np.radians(view[1]), np.radians(view[0])
    eye = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation),
                    np.sin(elevation)])
    if eye @ normal > 0.0:
        corners = [middle + a * across + b * along
                   for a, b in ((-half, -half), (half, -half), (half, half), (-half, half))]
        axes.add_collection3d(Poly3DCollection([corners], facecolors=[_PLANE_COLOUR],
                                               edgecolors="none", zorder=0, clip_on=False))
    axes.add_collection3d(Line3DCollection(lines, colors=[_PLANE_LINES], linewidths=0.6,
                                           zorder=1, clip_on=False))


def _add_forces(axes, snapshot: Snapshot, most: float) -> None:
    """Arrows away from where they push, over everything: most contacts lie inside."""
    positions, forces = snapshot.forces
    if not len(positions) or most == 0.0:
        return
    ways = forces * (_LONGEST_ARROW * snapshot.size / most)
    axes.quiver(*(1e3 * positions.T), *(1e3 * ways.T), color=_FORCE_COLOUR, linewidth=1.4,
                arrow_length_ratio=0.25, zorder=4)


def _dress_axes(axes) -> None:
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
    """A bar across the line of sight, at the foot of the first state."""
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


def _add_legends(figure, panels, snapshots, tension_map, most: float) -> None:
    """What the marks mean, and the tension scale."""
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
    if any(snapshot.cables for snapshot in snapshots):
        figure.colorbar(tension_map, ax=panels, label="cable tension [N]",
                        shrink=0.45, pad=0.12 if len(panels) == 1 else 0.01)
