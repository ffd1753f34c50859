"""What a mounted robot stores, and how it pulls at its mounts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.scene.body_entries import Shaped
from softrobot_twin.scene.shapes import Sphere
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.build import build_terms


class Prestress(NamedTuple):
    """What a mounted robot stores, and how it pulls at its mounts.

    Attributes:
        energy: Elastic energy [J].
        forces: On each fixed or guided body that its mounting moves, by name [N], shape (3,) each.
        torques: On each about its origin, by name [N m], shape (3,) each.
    """

    energy: float
    forces: dict[str, np.ndarray]
    torques: dict[str, np.ndarray]


def prestress(simulation: Simulation) -> Prestress:
    """What a robot at rest stores and how it pulls at its mounts.

    Args:
        simulation: A simulation of a scene with a mounting.
    """
    scene, mounted = simulation.model.scene, simulation.mounted
    moved = {move.body for stage in scene.mounting for move in stage.bodies}

    def loose(body):
        free = dict.fromkeys(Shaped.one_of) | dict(sphere=Sphere(radius=1.0), speed=None, turn_rate=None)
        return body.changed(motion="free", mass=1.0e-12, **free) if body.name in moved else body

    # Were these bodies free, the forces on their unknowns would be what their mounts bear.
    terms = build_terms(scene.changed(rigid_bodies=loose, integration="dynamic"), mounted.positions)
    nodes = terms.layout.nodes
    terms.bind_alone()
    forces = terms.passive_forces(mounted.positions)
    rows = RowStack(terms.actuators.terms, nodes.carried, nodes.free_axes)
    rows.tell_efforts(mounted.efforts)
    rows.evaluate(mounted.positions)
    rows.add_forces(rows.multipliers(mounted.efforts), forces)
    energy = sum(term.energy(mounted.positions) for term in simulation.model.forces)
    first = {
        part.name: int(nodes.kinds[0].unknowns_of(np.array([part.first_node]))[0])
        for part in terms.layout.rigid if part.name in moved
    }  # fmt: skip
    return Prestress(float(energy), {name: forces[place] for name, place in first.items()},
                     {name: forces[place + 1] for name, place in first.items()})  # fmt: skip
