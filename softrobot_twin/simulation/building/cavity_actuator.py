"""Cavities as actuators: by pressure or by volume (Coevoet 2017, eq. 3 and section 4.2.2)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from softrobot_twin.constraints.cavity import EMPTY, Cavities
from softrobot_twin.constraints.reduced_cavities import ReducedCavities, ReducedWalls
from softrobot_twin.constraints.superelement_cavities import SuperelementCavities
from softrobot_twin.mechanics.cavity_surfaces import CavitySurface
from softrobot_twin.scene.actuator_entries import Cavity, SealedCavity
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    ActuatorKind,
    Quantity,
    group_of,
    numbers_of,
)
from softrobot_twin.simulation.building.cavity_walls import cavity_surface, joined_walls
from softrobot_twin.simulation.building.deformable_body import of_kind
from softrobot_twin.simulation.building.limits import efforts_at_scale, unlikely
from softrobot_twin.simulation.building.reduced_body import Placed, ReducedBody
from softrobot_twin.simulation.building.scene_layout import Layout, walls_on, whole_layout
from softrobot_twin.simulation.building.vertebrae import VertebraBody

# Limits outside these shares of a cavity's natural scales are reported: a wrong unit is a factor of
# a thousand or more.
PRESSURE_RANGE = (2.0e-3, 50.0)
"""Of the pressure that would double the volume, if the body were linear."""
GROWTH_RANGE = (1.0e-3, 100.0)
"""Of the volume at rest."""
LARGEST_STRETCH = 3.0
"""Without a limit, a cavity grows up to the sphere of its walls, each stretched by this factor. A body
without equilibrium at its pressure is stopped there."""


class CavityActuator(ActuatorKind):
    """The kind `cavities`; see `ActuatorKind`. Its setpoint is what the entry controls."""

    section = "cavities"
    entry = Cavity
    displacement = Quantity("growth", "m3")
    effort = Quantity("pressure", "Pa")
    extent = Quantity("volume", "m3")

    def __init__(self, control: str = "pressure"):
        """Take what is commanded.

        Args:
            control: ``pressure`` or ``volume``.
        """
        self.is_effort_driven = control == "pressure"
        self.setpoint = self.effort if self.is_effort_driven else self.extent
        self.least_setpoint = -np.inf if self.is_effort_driven else 0.0

    def build(self, layout: Layout, entries: tuple[Cavity, ...], notes: list[str]) -> ActuatorGroup:
        """See `ActuatorKind.build`. A cavity is empty at a hundredth of its volume at rest.

        Without a limit it may grow up to a stretch of `LARGEST_STRETCH`.
        """
        carriers = [layout.body_named(wall.body) for cavity in entries for wall in cavity.walls]
        if of_kind(carriers, VertebraBody):
            term = _superelement_term(layout, entries)
        elif of_kind(carriers, ReducedBody):
            term = reduced_cavity_term(layout, entries, notes)
        else:
            surfaces = tuple(cavity_surface(layout, cavity.name, cavity.walls, key, notes)
                             for key, cavity in layout.scene.keyed(self.section))
            nodes = layout.nodes
            term = Cavities(surfaces, nodes.free_index, nodes.rest_positions, nodes.carried)
            _check_walls_move(term, layout)
        kinds = tuple(CavityActuator(cavity.control) for cavity in entries)
        by_volume = np.array([not kind.is_effort_driven for kind in kinds])
        zeros = numbers_of(entries, "pressure_offset")
        return group_of(
            self, entries, term, term.rest_volumes, numbers_of(entries, "pressure"), term.rest_areas,
            rest_setpoints=np.where(by_volume, term.rest_volumes, zeros), kinds=kinds,
            displacement_bounds=_growths(term, entries, layout), flows=numbers_of(entries, "flow"),
            rest_extents=term.rest_volumes, effort_zeros=zeros,
            effort_gains=numbers_of(entries, "pressure_gain"),
        )  # fmt: skip

    def doubts(self, model, group: ActuatorGroup) -> Iterator[str]:
        """Limits that are a thousand times out of scale; see `ActuatorKind.doubts`."""
        ends = [max(map(abs, cavity.pressure)) for cavity in model.scene.cavities]
        asked = any(0.0 < end < np.inf for end in ends)
        doubling = efforts_at_scale(model, group.term) if asked else None
        for index, (key, cavity) in enumerate(model.scene.keyed("cavities")):
            volume = float(group.term.rest_volumes[index])
            growth = max((abs(end) for end in cavity.growth if np.isfinite(end)), default=0.0)
            yield from unlikely(
                f"{key}.growth", growth, "m³", volume, GROWTH_RANGE,
                f"the cavity holds {volume:.3g} m³ at rest; is the limit in cubic metres?",
            )  # fmt: skip
            if doubling is not None:
                yield from unlikely(
                    f"{key}.pressure", ends[index], "Pa", float(doubling[index]), PRESSURE_RANGE,
                    f"some {doubling[index]:.2g} Pa would double its volume; is the limit in "
                    "pascals?",
                )  # fmt: skip

    def details(self, entry: Cavity, group: ActuatorGroup, index: int) -> str:
        """See `ActuatorKind.details`."""
        walls = group.term.walls
        words = [wall_details(entry, walls.rest_volumes[index], walls.rest_areas[index])]
        if entry.liquid_density:
            words.append(f"liquid of {entry.liquid_density:.6g} kg/m³")
        words.append(f"driven by {entry.control}")
        if entry.flow:
            words.append(f"flow {1e6 * entry.flow:.6g} cm³/s")
        if entry.pressure_offset:
            words.append(f"zero error {1e-3 * entry.pressure_offset:.6g} kPa")
        if entry.pressure_gain != 1.0:
            words.append(f"gain {entry.pressure_gain:.6g}")
        return ", ".join(words)


def wall_details(entry: Cavity | SealedCavity, volume: float, area: float) -> str:
    """Text of `explain` for the walls of a cavity.

    Args:
        entry: Its entry.
        volume: Volume at rest [m³].
        area: Area of its walls at rest [m²].
    """
    walls = [str(wall.file) if wall.file else f"part {wall.part}" for wall in entry.walls]
    behind = "" if len(walls) == 1 else " as one cavity"
    return (f"{' and '.join(walls)}{behind}, {1e6 * volume:.6g} cm³ at rest, walls of "
            f"{1e4 * area:.6g} cm²")  # fmt: skip


def _superelement_term(layout: Layout, entries: tuple[Cavity, ...]) -> SuperelementCavities:
    """The term of cavities on bodies with vertebrae."""
    volumes, areas, names = np.zeros(len(entries)), np.zeros(len(entries)), []
    order = [cavity.name for cavity in entries]
    for body in of_kind(layout.bodies, VertebraBody):
        places = [order.index(name) for name in body.division.cavities]
        volumes[places] += body.reduction.rest_volumes
        areas[places] += body.reduction.rest_areas
        names += [wall.name for wall in body.division.walls]
    scene = layout.scene
    for key, cavity in scene.keyed("cavities"):
        if cavity.liquid_density:
            raise scene.error(f"{key}.liquid_density", cavity.liquid_density,
                              "a liquid filling of a body with vertebrae is not built", "kg/m³")
        if names.count(cavity.name) != len(cavity.walls):
            raise scene.error(f"{key}.walls", cavity.name,
                              "lies on a body without vertebrae; where one body with cavities has "
                              "vertebrae, all of them must have some")
    surfaces = tuple(_drawn_surface(layout, name) for name in order)
    return SuperelementCavities(tuple(layout.superelements.values()), volumes, areas, surfaces)


def _drawn_surface(layout: Layout, name: str) -> CavitySurface:
    """The walls of a cavity on bodies with vertebrae, carried by these."""
    own = [
        wall._replace(vertices=body.carried_by(wall.vertices))
        for body in of_kind(layout.bodies, VertebraBody)
        for wall in body.division.walls if wall.name == name
    ]  # fmt: skip
    return joined_walls(own, name)


class _JoinedPoints:
    """Points on several reduced bodies, one body after the other; see `Placed`."""

    def __init__(self, parts: Iterable[Placed]):
        """Take those on each."""
        self._parts = tuple(parts)

    def positions(self, node_positions: np.ndarray) -> np.ndarray:
        """Positions of the points [m], shape (point_count, 3); see `Placed.positions`."""
        return np.concatenate([part.positions(node_positions) for part in self._parts])


def reduced_cavity_term(layout: Layout, entries: tuple[Cavity, ...], notes: list[str]) -> ReducedCavities:
    """The term of cavities on bodies that are reduced to a basis.

    Their walls are carried by the modes: they ask for no points.

    Args:
        layout: The bodies.
        entries: The cavities.
        notes: List to which repairs and warnings are appended.

    Raises:
        SceneError: See `cavity_surface`; or the walls of a cavity are all fixed.
    """
    # Points on the nodes of the meshes.
    whole = whole_layout(layout.scene, [replace(body.whole, first_node=0) for body in layout.bodies])
    walls = [(body, walls_on(body, whole, notes)) for body in of_kind(layout.bodies, ReducedBody)]
    parts = [ReducedWalls(own, body.mesh.node_positions, body.basis, body.coordinate_nodes)
             for body, own in walls if own]  # fmt: skip
    names = tuple(cavity.name for cavity in entries)
    shown = [wall._replace(vertices=body.shown(wall.vertices)) for body, own in walls for wall in own]
    surfaces = tuple(
        joined_walls([wall for wall in shown if wall.name == name], name, _JoinedPoints)
        for name in names
    )
    term = ReducedCavities(names, parts, layout.nodes.free_index, surfaces)
    _check_walls_move(term, layout)
    return term


def _growths(
    term: Cavities | SuperelementCavities | ReducedCavities, entries: tuple[Cavity, ...],
    layout: Layout,
) -> np.ndarray:
    """Least and greatest growth of each cavity [m³], shape (count, 2)."""
    growths = np.empty((len(entries), 2))
    for index, (cavity, volume) in enumerate(zip(entries, term.rest_volumes, strict=True)):
        if not cavity.volume[0] <= volume <= cavity.volume[1]:
            raise layout.scene.error(f"cavities[{index}].volume", list(cavity.volume),
                                     f"the volume at rest, {volume:.4g} m³, must lie within its "
                                     "limits", unit="m³")
        growths[index, 0] = max(cavity.growth[0], cavity.volume[0] - volume, (EMPTY - 1.0) * volume)
        growths[index, 1] = min(cavity.growth[1], cavity.volume[1] - volume)
        if np.isinf(growths[index, 1]):
            sphere = LARGEST_STRETCH**3 * float(term.walls.sphere_volumes[index])
            growths[index, 1] = sphere - volume
    return growths


def _check_walls_move(term: Cavities | ReducedCavities, layout: Layout) -> None:
    """Refuse cavities whose walls are all fixed: they have a volume that nothing changes."""
    for index in np.setdiff1d(np.arange(term.row_count), term.entry_rows):
        raise layout.scene.error(f"cavities[{index}].walls", term.surfaces[index].name,
                                 "lie wholly in what is fixed: nothing changes its volume")
