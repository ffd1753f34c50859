"""Runs without commands, and the values that they record besides actuators and effectors.

Bodies sag under gravity and fall while actuators hold. `BodyReadouts` gives displacement
and centre of mass of bodies, displacement and nodes of beams, positions of masses and markers, and
energies.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.beam_masses import BeamWeight
from softrobot_twin.mechanics.inertia import borne_masses
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.runs.input_tables import CommandTable


def no_commands(simulation: Simulation, seconds: float) -> CommandTable:
    """A table of commands in which every actuator keeps its setpoint.

    Args:
        simulation: The scene.
        seconds: Duration [s].
    """
    held = np.tile(simulation.state.setpoints, (2, 1))
    return CommandTable("hold", np.array([0.0, seconds]), held, {}, np.array([True]))


class BodyReadouts:
    """Reads deformable bodies, beams, point masses, markers and energies.

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
        terms = (term.on_points for term in simulation.model.forces)
        self._beam_weight = next((term for term in terms if isinstance(term, BeamWeight)), None)
        self._bodies = simulation.model.bodies
        self._points = [body.shown_nodes(np.arange(body.mesh.node_count))
                        for body in self._bodies]
        self._beams = simulation.model.beams
        self._beam_nodes = [beam.nodes_mapping() for beam in self._beams]
        first = sum(body.scene_node_count for body in self._bodies)
        self._masses = simulation.scene.mass_springs
        self._mass_nodes = slice(first, first + sum(len(entry.points) for entry in self._masses))
        self._shares = [_mass_shares(body) for body in self._bodies]

    @property
    def columns(self) -> list[str]:
        """Names of the values, each with its unit."""
        return [
            *(f"{body.name}_{value}" for body in self._bodies
              for value in ("centre_x_m", "centre_y_m", "centre_z_m", "moved_m")),
            *(f"{beam.name}_{value}" for beam in self._beams
              for value in ("moved_m", *(f"{node}_{axis}_m" for node in range(beam.node_count)
                                         for axis in "xyz"))),
            *(f"{entry.name}_{index}_{axis}_m" for entry in self._masses
              for index in range(len(entry.points)) for axis in "xyz"),
            *(f"marker_{number}_{axis}_m" for number in self._simulation.marker_ids
              for axis in "xyz"),
            "elastic_energy_J", "gravity_energy_J", "kinetic_energy_J"]

    def read(self) -> tuple[float, ...]:
        """The present values, in the order of `columns`."""
        simulation, readouts = self._simulation, []
        positions, velocities = simulation.state.positions, simulation.state.velocities
        for points, shares in zip(self._points, self._shares, strict=True):
            now, before = points.positions(positions), points.positions(self._rest)
            readouts += [*(shares @ now), np.linalg.norm(now - before, axis=1).max()]
        for nodes in self._beam_nodes:
            now, before = nodes.positions(positions), nodes.positions(self._rest)
            readouts += [np.linalg.norm(now - before, axis=1).max(), *now.ravel()]
        readouts += [*positions[self._mass_nodes].ravel(), *simulation.marker_positions().ravel()]
        readouts.append(sum(term.energy(positions) for term in simulation.model.forces))
        displacement = simulation.model.nodes.displacement(self._rest, positions)
        # A rotation about the centre of mass does not change the potential energy.
        energy = 0.0 - np.sum(self._weights * displacement)
        if self._beam_weight is not None:
            energy += self._beam_weight.potential(positions)
            energy -= self._beam_weight.potential(self._rest)
        readouts.append(energy)
        readouts.append(sum(term.kinetic_energy(positions, velocities)
                        for term in simulation.model.forces))
        return tuple(float(value) for value in readouts)

    def lines(self) -> list[tuple[str, str]]:
        """The present values as names and values with units."""
        readouts = dict(zip(self.columns, self.read(), strict=True))
        simulation, lines = self._simulation, []
        for body in self._bodies:
            lines.append((f"{body.name}, largest displacement",
                          f"{1e3 * readouts[f'{body.name}_moved_m']:.4g} mm"))
            centre = [readouts[f"{body.name}_centre_{axis}_m"] for axis in "xyz"]
            lines.append((f"{body.name}, centre of mass", _millimetres(centre)))
        for beam in self._beams:
            lines.append((f"{beam.name}, largest displacement",
                          f"{1e3 * readouts[f'{beam.name}_moved_m']:.4g} mm"))
            end = [readouts[f"{beam.name}_{beam.node_count - 1}_{axis}_m"] for axis in "xyz"]
            lines.append((f"{beam.name}, end", _millimetres(end)))
        for part in simulation.model.rigid:
            origin, _ = part.entry_pose(simulation.state.positions)
            lines.append((f"{part.name}, position", _millimetres(origin)))
        lines += [(f"{word} energy", f"{readouts[f'{word}_energy_J']:.4g} J")
                  for word in ("elastic", "gravity", "kinetic")]
        return lines


def _millimetres(place) -> str:
    return "[" + ", ".join(f"{1e3 * value:.4g}" for value in place) + "] mm"


def _mass_shares(body) -> np.ndarray:
    """Weight of each node in the centre of mass, shape (node_count,)."""
    mesh = body.mesh
    masses = body.density * mesh.volumes
    return borne_masses(mesh, body.density / masses.sum())
