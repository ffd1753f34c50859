"""Stiffeners as actuators: Young's modulus of a region, within limits."""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.scaled_forces import ScaledForces
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.kinematics import on_unknowns
from softrobot_twin.scene.actuator_entries import Stiffener
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    ActuatorKind,
    Quantity,
    group_of,
    numbers_of,
)
from softrobot_twin.simulation.building.deformable_body import MaterialPart, claimed_cells, strained_terms
from softrobot_twin.simulation.building.scene_layout import Layout


class StiffenerActuator(ActuatorKind):
    """The kind `stiffeners`; see `ActuatorKind`. Its setpoint is Young's modulus.

    Its displacement is the elastic energy of the region by its modulus, with a minus. Other elastic
    constants of the material change in proportion; damping and mass stay.
    """

    section = "stiffeners"
    entry = Stiffener
    setpoint = effort = Quantity("young_modulus", "Pa")
    displacement = extent = Quantity("strained_volume", "m3")
    is_effort_driven = True
    acts_at_rest = False

    def build(self, layout: Layout, entries: tuple[Stiffener, ...], notes: list[str]) -> ActuatorGroup:
        """See `ActuatorKind.build`."""
        parts = [_part(layout, key, entry, notes) for key, entry in layout.scene.keyed(self.section)]
        for index, part in enumerate(parts):
            if part in parts[:index]:
                raise layout.scene.error(f"stiffeners[{index}]", entries[index].name,
                                         f"changes what {entries[parts.index(part)].name} does")
        zeros = np.array([part.young_modulus for part in parts])
        volumes = np.array([part.volume for part in parts])
        terms = tuple(_terms(layout, *pair) for pair in zip(entries, parts, strict=True))
        term = ScaledForces("stiffeners", terms, 1.0 / zeros, volumes, layout.nodes.free_node_count, True)
        return group_of(
            self, entries, term, volumes, numbers_of(entries, "young_modulus") - zeros[:, None],
            volumes / layout.nodes.size, rest_setpoints=zeros, effort_zeros=zeros, has_rest_efforts=True,
        )  # fmt: skip

    def details(self, entry: Stiffener, group: ActuatorGroup, index: int) -> str:
        """See `ActuatorKind.details`."""
        whole = entry.box.describe() if entry.box else "the whole body"
        place = whole if entry.region is None else f"region {entry.region}"
        return f"{place}, E {1e-3 * group.rest_setpoints[index]:.6g} kPa at rest"


def _part(layout: Layout, key: str, entry: Stiffener, notes: list[str]) -> MaterialPart:
    """The material whose modulus changes: that of the cells of an entry.

    Raises:
        SceneError: The cells are not those of one elastic material, or its modulus is not within
            the limits.
    """
    body, scene = layout.unreduced(entry.body, key, "its modulus cannot change"), layout.scene
    cells = np.arange(body.mesh.cell_count)
    if entry.given(("region", "box")):
        cells = claimed_cells(entry, key, body.entry, body.mesh, body.parts, scene, notes)
    own = [part for part in body.materials if np.array_equal(cells, part.cells_in(body.mesh))]
    if not own:
        raise scene.error(key, entry.name, "is not the whole of one material: give these cells an "
                          f"entry of {body.key}.materials")
    (part,) = own
    if part.viscosity or part.softening:
        raise scene.error(key, entry.name, f"is not built for what remembers, as {part.key} does")
    low, high = entry.young_modulus
    if not low <= part.young_modulus <= high:
        raise scene.error(f"{key}.young_modulus", [low, high], f"that of {part.key}, "
                          f"{part.young_modulus:g}, must lie within the limits", unit="Pa")
    return part


def _terms(layout: Layout, entry: Stiffener, part: MaterialPart) -> tuple[ForceTerm, ...]:
    """The elastic terms of the material once more."""
    body, nodes = layout.body_named(entry.body), layout.nodes
    mesh = layout.mesh_among_nodes(body)
    terms = strained_terms(mesh, part, part.cells, nodes.free_index, body.entry.has_patches)
    return tuple(on_unknowns(term, nodes.carried) for term in terms)
