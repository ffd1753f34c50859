"""A scene that is left to itself: a body sags, a cube falls, cables hold their lengths."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.input_tables import CommandTable


def left_alone(simulation: Simulation, seconds: float) -> CommandTable:
    """Commands that ask for nothing.

    Args:
        simulation: The scene.
        seconds: How long [s].
    """
    held = np.tile(simulation.state.setpoints, (2, 1))
    return CommandTable("hold", np.array([0.0, seconds]), held, {}, np.array([True]))


class Onlooker:
    """Watches deformable bodies, point masses, markers and energies.

    A commanded run does not record these.
    """

    def __init__(self, simulation: Simulation):
        """Look at the scene at rest.

        Args:
            simulation: The scene.
        """
        self._simulation = simulation
        self._rest = simulation.model.nodes.rest_positions
        self._weights = sum(term.weights for term in simulation.model.forces
                            if term.name == "gravity")
        self._bodies = simulation.model.bodies
        first = sum(body.mesh.node_count for body in self._bodies)
        self._masses = simulation.scene.mass_springs
        self._mass_nodes = slice(first, first + sum(len(entry.points) for entry in self._masses))
        self._shares = [_volume_shares(body.mesh) for body in self._bodies]

    @property
    def columns(self) -> list[str]:
        """Names of what is seen, each with its unit."""
        return [
            *(f"{body.name}_{value}" for body in self._bodies
              for value in ("centre_x_m", "centre_y_m", "centre_z_m", "moved_m")),
            *(f"{entry.name}_{index}_{axis}_m" for entry in self._masses
              for index in range(len(entry.points)) for axis in "xyz"),
            *(f"marker_{number}_{axis}_m" for number in self._simulation.marker_ids
              for axis in "xyz"),
            "elastic_energy_J", "gravity_energy_J", "kinetic_energy_J"]

    def look(self) -> tuple[float, ...]:
        """What is seen now, in the order of `columns`."""
        simulation, seen = self._simulation, []
        positions, velocities = simulation.state.positions, simulation.state.velocities
        for body, shares in zip(self._bodies, self._shares, strict=True):
            own = slice(body.first_node, body.first_node + body.mesh.node_count)
            seen += [*(shares @ positions[own]),
                     np.linalg.norm(positions[own] - self._rest[own], axis=1).max()]
        seen += [*positions[self._mass_nodes].ravel(), *simulation.marker_positions().ravel()]
        seen.append(sum(term.energy(positions) for term in simulation.model.forces))
        way = simulation.model.nodes.displacement(self._rest, positions)
        # Turning about the centre of mass does not lift it: rotations weigh nothing.
        seen.append(0.0 - np.sum(self._weights * way))
        seen.append(sum(term.kinetic_energy(positions, velocities)
                        for term in simulation.model.forces))
        return tuple(float(value) for value in seen)

    def lines(self) -> list[tuple[str, str]]:
        """What is seen now, as name and value with its unit."""
        seen = dict(zip(self.columns, self.look(), strict=True))
        simulation, lines = self._simulation, []
        for body in self._bodies:
            lines.append((f"{body.name}, largest displacement",
                          f"{1e3 * seen[f'{body.name}_moved_m']:.4g} mm"))
            centre = [seen[f"{body.name}_centre_{axis}_m"] for axis in "xyz"]
            lines.append((f"{body.name}, centre of mass", _millimetres(centre)))
        for part in simulation.model.rigid:
            origin, _ = part.entry_pose(simulation.state.positions)
            lines.append((f"{part.name}, position", _millimetres(origin)))
        lines += [(f"{word} energy", f"{seen[f'{word}_energy_J']:.4g} J")
                  for word in ("elastic", "gravity", "kinetic")]
        return lines


def _millimetres(place) -> str:
    return "[" + ", ".join(f"{1e3 * value:.4g}" for value in place) + "] mm"


def _volume_shares(mesh) -> np.ndarray:
    """Share of each node in the place of the centre of mass, shape (node_count,)."""
    shares = np.outer(mesh.volumes / mesh.volume, mesh.load_shares)
    return np.bincount(mesh.cells.ravel(), weights=shares.ravel(), minlength=mesh.node_count)
