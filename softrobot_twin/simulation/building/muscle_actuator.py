"""Muscles as actuators, by their activation: threads, or regions whose material contracts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.constraints.muscles import Fibres, Muscles
from softrobot_twin.geometry.cell_mesh import node_counts_of, points_of
from softrobot_twin.mechanics.springs import segments, vectors_between
from softrobot_twin.scene.actuator_entries import Muscle
from softrobot_twin.scene.words import count, vector, words
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    ActuatorKind,
    Quantity,
    group_of,
    numbers_of,
)
from softrobot_twin.simulation.building.deformable_body import claimed_cells
from softrobot_twin.simulation.building.limits import efforts_at_scale, unlikely
from softrobot_twin.simulation.building.scene_layout import Layout

FULL_RANGE = (2.0e-2, 1.0e3)
"""Activations beyond this, which would contract a muscle to nothing, are reported."""


class MuscleActuator(ActuatorKind):
    """The kind `muscles`; see `ActuatorKind`."""

    section = "muscles"
    entry = Muscle
    setpoint = effort = Quantity("activation", "")
    displacement = extent = Quantity("work", "J")
    is_effort_driven = True

    def build(self, layout: Layout, entries: tuple[Muscle, ...], notes: list[str]) -> ActuatorGroup:
        """See `ActuatorKind.build`."""
        fibres = tuple(
            (_thread if entry.points else _region)(layout, key, entry, notes)
            for key, entry in layout.scene.keyed(self.section)
        )
        term = Muscles(fibres, layout.nodes.free_index, layout.nodes.carried)
        size = layout.nodes.size
        forces = [entry.force or scale / size for entry, scale in zip(entries, term.scales, strict=True)]
        return group_of(self, entries, term, term.scales, numbers_of(entries, "activation"), np.array(forces))

    def doubts(self, model, group: ActuatorGroup) -> Iterator[str]:
        """Forces and stresses that are out of scale; see `ActuatorKind.doubts`."""
        full = efforts_at_scale(model, group.term)
        for index, (key, entry) in enumerate(model.scene.keyed(self.section) if full is not None else ()):
            word = "force" if entry.points else "stress"
            value, unit = getattr(entry, word), "N" if word == "force" else "Pa"
            yield from unlikely(
                f"{key}.{word}", value, unit, value * float(full[index]),
                (1.0 / FULL_RANGE[1], 1.0 / FULL_RANGE[0]),
                f"some {value * full[index]:.2g} {unit} would contract {entry.name} to nothing; is "
                f"the {word} in {unit}?",
            )  # fmt: skip

    def details(self, entry: Muscle, group: ActuatorGroup, index: int) -> str:
        """See `ActuatorKind.details`."""
        if entry.points:
            place = f"a thread of {count(entry.points, 'point')}, {entry.force:.6g} N"
        else:
            place = entry.box.describe() if entry.region is None else f"region {entry.region}"
            place += f" along {vector(entry.direction)}, {1e-3 * entry.stress:.6g} kPa"
        free, bell = entry.free_contraction, entry.force_length
        by_length = None if free is None else f"contracts freely by {100.0 * free:.6g} %"
        return words(place, by_length, None if bell is None else bell.describe())


def _law(entry: Muscle) -> tuple[float, float, float]:
    """Slope 1/c, optimum and width of its force by its length."""
    if entry.force_length:
        return 0.0, entry.force_length.optimum, entry.force_length.width
    return (1.0 / entry.free_contraction if entry.free_contraction else 0.0), 0.0, 0.0


def _thread(layout: Layout, key: str, entry: Muscle, notes: list[str]) -> list[Fibres]:
    """A fibre between each two points of a thread."""
    path = layout.carried_along(entry, entry.points, f"{key}.points", notes)
    first, second, lengths = segments(path, layout.nodes.rest_positions)
    if not len(lengths):
        raise layout.scene.error(f"{key}.points", entry.name, "all its points are one place")
    nodes, coefficients = vectors_between(first, second)
    return [Fibres(nodes, coefficients, lengths, np.full(len(lengths), entry.force), _law(entry))]


def _region(layout: Layout, key: str, entry: Muscle, notes: list[str]) -> list[Fibres]:
    """A fibre at each quadrature point of the cells of a region, by kind of cells."""
    body = layout.unreduced(entry.body, key, "a muscle in a region of it is not built; give points")
    cells = claimed_cells(entry, key, body.entry, body.mesh, body.parts, layout.scene, notes)
    direction = np.array(entry.direction) / np.linalg.norm(entry.direction)
    found = []
    for block in layout.mesh_among_nodes(body).strained_blocks(cells):
        (gradients, volumes), mesh = points_of(block.mesh), block.mesh
        present = np.arange(mesh.cells.shape[1]) < node_counts_of(mesh)[:, None]
        nodes = np.repeat(np.where(present, mesh.cells, -1), volumes.shape[1], axis=0)
        slopes = (gradients @ direction).reshape(nodes.shape)
        volumes = volumes.ravel()
        found.append(Fibres(nodes, np.where(nodes >= 0, slopes, 0.0), np.ones(len(volumes)),
                            entry.stress * volumes, _law(entry)))  # fmt: skip
    return found
