"""Slides: actuators that move a platform, with all attached nodes, by a displacement.

A platform on a slide is a frame with one translation, its position s along the axis a. In statics a
body that is held only by the platform is translated with it, as no inner force changes: seen from
the platform, A does not couple s with anything. So s needs no row of A. The unknown of the slide
is its own displacement u, in place of an effort, and it moves

    x ← x + a u,    δ_e ← δ_e + G_e u,    δ_c ← δ_c + G_c u

with G_e = a in the effectors' directions and G_c = n · a where the platform carries the first side
of a contact, less that where it carries the second.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.geometry.vector3 import dot, row
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.scene.actuator_entries import Slide
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    ActuatorKind,
    Quantity,
    group_of,
)
from softrobot_twin.simulation.building.scene_layout import Layout

NOWHERE = -1


@njit(**KERNEL)
def shift_riders(positions, slide_of_node, axes, moves):
    """Translate every attached node along its slide's axis.

    Args:
        positions: Node positions [m], shape (node_count, 3); changed.
        slide_of_node: Slide that moves each node, `NOWHERE` for none, shape (node_count,).
        axes: Unit direction of each slide, shape (slide_count, 3).
        moves: Move of each slide [m], shape (slide_count,).
    """
    for n in range(len(positions)):
        k = slide_of_node[n]
        if k != NOWHERE:
            for i in range(3):
                positions[n, i] += moves[k] * axes[k, i]


@njit(**KERNEL)
def positions_along(positions, frames, origins, axes):
    """Displacements of some nodes from their origins, along axes [m], shape (count,).

    Args:
        positions: Node positions [m], shape (node_count, 3).
        frames: The nodes, shape (count,).
        origins: Where they are at rest [m], shape (count, 3).
        axes: Unit directions, shape (count, 3).
    """
    along = np.zeros(len(frames))
    for k in range(len(frames)):
        for i in range(3):
            along[k] += (positions[frames[k], i] - origins[k, i]) * axes[k, i]
    return along


@njit(**KERNEL)
def write_contact_columns(slide_of_node, axes, nodes, directions, row_starts, columns):
    """Add the motion of each side along the contacts' directions.

    Args:
        slide_of_node: Slide that moves each node, `NOWHERE` for none, shape (node_count,).
        axes: Unit direction of each slide, shape (slide_count, 3).
        nodes: Nodes of each contact, -1 where there is none, shape (capacity, width).
        directions: Normal and tangents of each contact, shape (capacity, 3, 3).
        row_starts: First row of each contact and the number of rows, shape (contact_count + 1,).
        columns: G_c, shape (contact_row_count, slide_count); added to.
    """
    for c in range(len(row_starts) - 1):
        for side in range(2):
            # All four nodes of a rigid side are frame nodes.
            node = nodes[c, 4 * side : 4 * side + 3].max()
            k = slide_of_node[node] if node >= 0 else NOWHERE
            if k != NOWHERE:
                sign = 1.0 - 2.0 * side
                for i in range(row_starts[c + 1] - row_starts[c]):
                    along = dot(row(directions[c], i), row(axes, k))
                    columns[row_starts[c] + i, k] += sign * along


class Slides:
    """All slides of a scene.

    Attributes:
        count: Number of slides.
        axes: Their unit directions, shape (count, 3).
    """

    def __init__(self, layout: Layout):
        """Find the nodes that each slide moves.

        Args:
            layout: The bodies.

        Raises:
            SceneError: A body on a slide is also held elsewhere or on another slide, or the scene is dynamic.
        """
        scene = layout.scene
        if scene.integration != "quasi_static":
            raise scene.error("slides", scene.slides[0].name,
                              "slides are built for quasi_static scenes only; in others guide the "
                              "body by poses")
        moved = [slide.body for slide in scene.slides]
        for place in (place for place, name in enumerate(moved) if name in moved[:place]):
            raise scene.error("slides", scene.slides[place].name, f"moves {moved[place]}, which another slide moves")
        self.count = len(scene.slides)
        axes = np.array([slide.axis for slide in scene.slides], float)
        self.axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        parts = [layout.body_named(slide.body) for slide in scene.slides]
        self._frames = np.array([part.first_node for part in parts])
        self._rest_origins = np.array([part.origin for part in parts])
        self._slide_of_node = np.full(len(layout.nodes.rest_positions), NOWHERE)
        self._weights = np.zeros(self.count)
        for index, (slide, part) in enumerate(zip(scene.slides, parts, strict=True)):
            self._slide_of_node[part.first_node : part.first_node + 4] = index
            for body in layout.bodies:
                if slide.body in body.riding:
                    _check_rides_whole(layout, body, slide)
                    self._slide_of_node[body.places] = index
                    self._weights[index] += body.mass * self.axes[index] @ np.array(scene.gravity)

    def positions(self, positions: np.ndarray) -> np.ndarray:
        """Positions of the slides [m], shape (count,): displacements of their frames along them.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return positions_along(positions, self._frames, self._rest_origins, self.axes)

    def shift(self, positions: np.ndarray, moves: np.ndarray) -> None:
        """Translate all attached nodes.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            moves: Move of each slide [m], shape (count,).
        """
        shift_riders(positions, self._slide_of_node, self.axes, moves)

    def effector_columns(self, effectors) -> np.ndarray:
        """G_e, shape (effector_row_count, count).

        Args:
            effectors: The term of the effectors.
        """
        columns = np.zeros((effectors.row_count, self.count))
        for row, (index, axis) in enumerate(zip(effectors.row_effector, effectors.row_axis, strict=True)):
            slide = self._slide_of_node[effectors.effectors[index].points.nodes[0, 0]]
            # A slide turns nothing.
            if slide != NOWHERE and axis < 3:
                columns[row, slide] = self.axes[slide, axis]
        return columns

    def contact_columns(self, contacts) -> np.ndarray:
        """G_c of the present contacts, shape (contact_row_count, count).

        Args:
            contacts: The contacts detected last.
        """
        columns = np.zeros((contacts.row_count, self.count))
        write_contact_columns(
            self._slide_of_node, self.axes, contacts.nodes, contacts.directions,
            contacts.row_starts, columns,
        )  # fmt: skip
        return columns

    def columns(self, rows: RowStack, effector_columns: np.ndarray, contacts) -> np.ndarray:
        """Change of the rows evaluated last by displacements of the slides, whose sign is opposite.

        Args:
            rows: All rows.
            effector_columns: G_e.
            contacts: The term of the contacts, or None.

        Returns:
            Shape (row_count, count).
        """
        columns = np.zeros((rows.row_count, self.count))
        columns[rows.groups.effectors] = -effector_columns
        if rows.varies:
            columns[rows.groups.contacts] = -self.contact_columns(contacts)
        return columns

    def loads(self, contact_columns: np.ndarray, contact_forces: np.ndarray) -> np.ndarray:
        """Force with which each slide holds its bodies [N], shape (count,).

        Args:
            contact_columns: Those of `columns`, shape (contact_row_count, count).
            contact_forces: λ of all contact rows [N], shape (contact_row_count,).
        """
        return contact_columns.T @ contact_forces - self._weights


class SlideActuator(ActuatorKind):
    """The kind `slides`; see `ActuatorKind`. Files call its position a length, as a cable's."""

    section = "slides"
    entry = Slide
    setpoint = Quantity("length", "m")
    displacement = Quantity("shortening", "m")
    effort = Quantity("tension", "N")
    # A positive move of a slide is a negative shortening.
    sign = -1
    takes_efforts = False

    def build(self, layout: Layout, entries: tuple[Slide, ...], notes: list[str]) -> ActuatorGroup:
        """See `ActuatorKind.build`."""
        travels = -np.array([slide.travel for slide in entries])[:, ::-1]
        widest = np.abs(travels).max(axis=1)
        count, scales = len(entries), np.where(widest > 0.0, widest, layout.nodes.size)
        return group_of(self, entries, None, scales, np.tile([-np.inf, np.inf], (count, 1)),
                        np.ones(count), moves=Slides(layout), displacement_bounds=travels)  # fmt: skip

    def details(self, entry: Slide, group: ActuatorGroup, index: int) -> str:
        """See `ActuatorKind.details`."""
        return f"moves {entry.body} along {list(entry.axis)}"


def _check_rides_whole(layout: Layout, body, slide) -> None:
    """Refuse bodies on a slide that are also held elsewhere."""
    scene = layout.scene
    held_elsewhere = len(body.entry.fixed) or set(body.riding) != {slide.body}
    own = [cable for cable in scene.cables if body in layout.bodies_of(cable)]
    pulled = [c.name for c in own if c.pull_point_on not in ("body", slide.body) or c.also_on]
    sprung = [spring.name for spring in scene.springs if body.name in {end.on for end in spring.ends}]
    if held_elsewhere or pulled or sprung:
        by = "fixed nodes" if held_elsewhere else ", ".join(pulled or sprung)
        raise scene.error("slides", slide.name,
                          f"{body.name} rides on {slide.body} but is also held elsewhere, by {by}; "
                          "all that holds it must ride with it")
