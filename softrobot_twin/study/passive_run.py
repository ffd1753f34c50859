"""Runs without commands, and the values that they record besides actuators and effectors.

Bodies sag under gravity and fall while actuators hold. `BodyReadouts` gives displacement
and centre of mass of bodies, displacement and nodes of beams, positions of masses, and
energies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from softrobot_twin.mechanics.beam_masses import BeamWeight
from softrobot_twin.mechanics.inertia import borne_masses
from softrobot_twin.simulation import Simulation
from softrobot_twin.tables.column_names import position_columns
from softrobot_twin.tables.input_tables import CommandTable


def no_commands(simulation: Simulation, seconds: float) -> CommandTable:
    """A table of commands in which every actuator keeps its setpoint.

    Args:
        simulation: The scene.
        seconds: Duration [s].
    """
    held = np.tile(simulation.state.setpoints, (2, 1))
    return CommandTable("hold", np.array([0.0, seconds]), held, {}, np.array([True]))


class BodyReadouts:
    """Reads deformable bodies, beams, point masses and energies.

    A run with commands does not record these.
    """

    def __init__(self, simulation: Simulation):
        """Records the rest positions.

        Args:
            simulation: The scene.
        """
        self._simulation = simulation
        self._rest = simulation.model.nodes.rest_positions
        self._weights = sum(term.weights for term in simulation.model.forces
                            if term.name == "gravity")
        self._beam_weight = simulation.model.force_term(BeamWeight)
        self._bodies = simulation.model.bodies
        self._points = [body.shown_nodes(np.arange(body.mesh.node_count)) for body in self._bodies]
        self._beams = simulation.model.beams
        self._beam_nodes = [beam.nodes_mapping() for beam in self._beams]
        first = sum(body.scene_node_count for body in self._bodies)
        self._masses = simulation.scene.mass_springs
        self._mass_nodes = slice(first, first + sum(len(entry.points) for entry in self._masses))
        self._shares = [_mass_shares(body) for body in self._bodies]

    @property
    def columns(self) -> list[str]:
        """Names of the values, each with its unit."""
        return [name for names, _ in self._parts() for name in names]

    def read(self) -> tuple[float, ...]:
        """The present values, in the order of `columns`."""
        return tuple(float(value) for _, values in self._parts() for value in np.ravel(values))

    def _parts(self) -> Iterator[tuple[Sequence[str], object]]:
        """Names of some values, and the values."""
        simulation, forces = self._simulation, self._simulation.model.forces
        positions, velocities = simulation.state.positions, simulation.state.velocities
        for body, points, shares in zip(self._bodies, self._points, self._shares, strict=True):
            now, before = points.positions(positions), points.positions(self._rest)
            yield position_columns(f"{body.name}_centre"), shares @ now
            yield [f"{body.name}_moved_m"], np.linalg.norm(now - before, axis=1).max()
        for beam, nodes in zip(self._beams, self._beam_nodes, strict=True):
            now, before = nodes.positions(positions), nodes.positions(self._rest)
            yield [f"{beam.name}_moved_m"], np.linalg.norm(now - before, axis=1).max()
            yield _places([f"{beam.name}_{node}" for node in range(beam.node_count)]), now
        masses = [f"{entry.name}_{index}" for entry in self._masses
                  for index in range(len(entry.points))]  # fmt: skip
        yield _places(masses), positions[self._mass_nodes]
        yield ["elastic_energy_J"], sum(term.energy(positions) for term in forces)
        displacement = simulation.model.nodes.displacement(self._rest, positions)
        # A rotation about the centre of mass does not change the potential energy.
        energy = 0.0 - np.sum(self._weights * displacement)
        if self._beam_weight is not None:
            energy += self._beam_weight.potential(positions)
            energy -= self._beam_weight.potential(self._rest)
        yield ["gravity_energy_J"], energy
        kinetic = sum(term.kinetic_energy(positions, velocities) for term in forces)
        yield ["kinetic_energy_J"], kinetic

    def lines(self) -> list[tuple[str, str]]:
        """The present values as names and values with units."""
        readouts = dict(zip(self.columns, self.read(), strict=True))
        simulation, lines = self._simulation, []
        watched = [(body.name, "centre of mass", "centre") for body in self._bodies]
        watched += [(beam.name, "end", beam.node_count - 1) for beam in self._beams]
        for name, words, place in watched:
            lines.append((f"{name}, largest displacement", f"{1e3 * readouts[f'{name}_moved_m']:.4g} mm"))
            at = [readouts[column] for column in position_columns(f"{name}_{place}")]
            lines.append((f"{name}, {words}", _millimetres(at)))
        for part in simulation.model.rigid:
            origin, _ = part.entry_pose(simulation.state.positions)
            lines.append((f"{part.name}, position", _millimetres(origin)))
        lines += [(f"{word} energy", f"{readouts[f'{word}_energy_J']:.4g} J")
                  for word in ("elastic", "gravity", "kinetic")]
        return lines


def _places(names: Sequence[str]) -> list[str]:
    """Columns of places."""
    return [column for name in names for column in position_columns(name)]


def _millimetres(place) -> str:
    return "[" + ", ".join(f"{1e3 * value:.4g}" for value in place) + "] mm"


def _mass_shares(body) -> np.ndarray:
    """Weight of each node in the centre of mass, shape (node_count,)."""
    mesh = body.mesh
    masses = body.density * mesh.volumes
    return borne_masses(mesh, body.density / masses.sum())
