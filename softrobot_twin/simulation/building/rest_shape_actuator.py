"""Rest shapes of beams as actuators: their curvature, twist or length without load."""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.scaled_forces import RestShape, ScaledForces
from softrobot_twin.mechanics.beams import GREATEST_TURN, BeamElements
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.hinged_frames import HingedTwists
from softrobot_twin.mechanics.kinematics import on_unknowns
from softrobot_twin.scene.actuator_entries import RestShape as RestShapeEntry
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    ActuatorKind,
    Quantity,
    group_of,
)
from softrobot_twin.simulation.building.scene_layout import Layout

COMPONENTS = {"elongation": 0, "twist": 3, "bend_sideways": 4, "bend": 5}
"""Place of each change among s and ψ of an element."""
SHORTEST = 0.1
"""A beam keeps at least this share of its length."""


class RestShapeActuator(ActuatorKind):
    """The kind `rest_shapes`; see `ActuatorKind`. Its setpoint is the change of the rest shape.

    Its displacement is the mean moment, or force, with which the beam resists a change.
    """

    section = "rest_shapes"
    entry = RestShapeEntry
    is_effort_driven = True

    def __init__(self, change: str = "bend"):
        """Take what is commanded.

        Args:
            change: A key of `COMPONENTS`.
        """
        is_length = change == "elongation"
        self.setpoint = self.effort = Quantity(f"rest_{change}", "m" if is_length else "rad")
        self.displacement = Quantity("force", "N") if is_length else Quantity("moment", "Nm")
        self.extent = self.displacement

    def build(self, layout: Layout, entries: tuple[RestShapeEntry, ...], notes: list[str]) -> ActuatorGroup:
        """See `ActuatorKind.build`."""
        parts, scales, limits = [], [], []
        for key, entry in layout.scene.keyed(self.section):
            terms, stiffness = _driven(layout, key, entry)
            limits.append(getattr(entry, entry.change))
            parts.append(terms)
            scales.append(stiffness * (np.abs(limits[-1]).max() or 1.0))
        term = ScaledForces("rest shapes", tuple(parts), np.ones(len(entries)),
                            np.array(scales), layout.nodes.free_node_count, False)  # fmt: skip
        length = np.array([layout.body_named(entry.beam).lengths.sum() for entry in entries])
        per_effort = np.array(scales) / np.abs(limits).max(axis=1).clip(1e-300)
        is_turn = np.array([entry.change != "elongation" for entry in entries])
        forces = np.where(is_turn, per_effort / length, per_effort)
        kinds = tuple(RestShapeActuator(entry.change) for entry in entries)
        return group_of(self, entries, term, term.scales, np.array(limits), forces, kinds=kinds)

    def details(self, entry: RestShapeEntry, group: ActuatorGroup, index: int) -> str:
        """See `ActuatorKind.details`."""
        return f"{entry.change.replace('_', ' ')} of {entry.beam}"


def _driven(layout: Layout, key: str, entry: RestShapeEntry) -> tuple[tuple[ForceTerm, ...], float]:
    """Force terms of a change of one, and the stiffness of the beam against it."""
    beam, component = layout.body_named(entry.beam), COMPONENTS[entry.change]
    low, high = getattr(entry, entry.change)
    shares = beam.lengths / beam.lengths.sum()
    if component > 3 and not beam.entry.thickness_direction:
        raise layout.scene.error(f"{key}.{entry.change}", [low, high],
                                 f"{beam.name} has no thickness_direction, which says which way")
    if component == 0 and low < (SHORTEST - 1.0) * beam.lengths.sum():
        raise layout.scene.error(f"{key}.elongation", [low, high],
                                 f"{beam.name} is {beam.lengths.sum():.4g} m long", unit="m")
    if component and max(-low, high) * shares.max() > GREATEST_TURN:
        raise layout.scene.error(f"{key}.{entry.change}", [low, high],
                                 f"an element of {beam.name} would turn by more than "
                                 f"{GREATEST_TURN:.2g} rad: give it more elements", unit="rad")
    elements = beam.elements(layout.drawn_positions, layout.frames)
    change = np.zeros((len(shares), 6))
    change[:, component] = shares
    stiffness = float(np.sum(elements.stiffness[:, component] * shares**2))
    at_hinge = (elements.unknowns >= layout.nodes.free_node_count).any(axis=1)
    terms = []
    for own in (~at_hinge, at_hinge):
        if own.any():
            term = RestShape(BeamElements(*(field[own] for field in elements)), change[own])
            terms.append(on_unknowns(term, HingedTwists(layout.hinged)) if own is at_hinge else term)
    return tuple(terms), stiffness
