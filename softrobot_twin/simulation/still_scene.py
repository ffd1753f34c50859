"""A scene as it is compared from element to element: at rest, free of contact, without limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from statistics import median

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.command import Hold
from softrobot_twin.simulation.scene_layout import lay_out
from softrobot_twin.simulation.simulation import Simulation

PATCH_SHARE = 0.0125
"""Radius of the patch that a cable holds on, as a share of the body's size."""
MOST_TETS = 20_000
"""Meshes with more tetrahedra are not judged: the factor of a finer body would take minutes."""
LONG = 1.0e3
"""Time enough for any change of length [s]."""
# A step in time that changes little [s].
_SHORT = 1.0e-3
_TIMED_STEPS = 6
_MOST_ITERATIONS = 15
# A body is in balance when no node is out of it by more than this share of all loads, or of the
# force that strains a body of this size by one.
_BALANCED, _ROUNDING = 1.0e-4, 1.0e-9


class MeshErrorUnknown(SoftRobotTwinError):
    """The error of a scene's mesh cannot be estimated.

    Attributes:
        reason: Why.
    """

    def __init__(self, reason: str):
        self.reason = reason
        super().__init__(f"the error of the mesh is not estimated: {reason}")


def refuse(scene: Scene) -> None:
    """Refuses a scene in which there is nothing to compare.

    Args:
        scene: The scene.

    Raises:
        MeshErrorUnknown: It has no deformable body, or no effector.
    """
    if not scene.deformables:
        raise MeshErrorUnknown("the scene has no deformable body")
    if not scene.effectors:
        raise MeshErrorUnknown("the scene names no effector whose motion could be judged")


def still(scene: Scene) -> Scene:
    """The scene at rest, free of contact, its cables on patches and without limits."""
    bodies = tuple(body.model_copy(update={"mass": None}) for body in scene.deformables)
    cables = tuple(
        cable.model_copy(update={
            "rate": None, "shortening": (-1.0e3, 1.0e3), "tension": (0.0, 1.0e9),
        })
        for cable in scene.cables
    )  # fmt: skip
    solver = scene.solver.model_copy(update={"newton_iterations": _MOST_ITERATIONS})
    # Rigid bodies that move by themselves stand still: without contact nothing holds them.
    placed = {"motion": "guided", "speed": None, "turn_rate": None}
    rigid = tuple(body.model_copy(update=placed) for body in scene.rigid_bodies)
    return _with_bodies(scene, bodies).model_copy(update={
        "integration": "quasi_static", "contact": None, "obstacles": (), "slides": (),
        "motors": (), "markers": (), "cables": cables, "solver": solver, "rigid_bodies": rigid,
        "effectors": tuple(e.model_copy(update={"measured_by": ()}) for e in scene.effectors),
    })  # fmt: skip


def _with_bodies(scene: Scene, bodies: tuple) -> Scene:
    if scene.body is not None:
        return scene.model_copy(update={"body": bodies[0]})
    return scene.model_copy(update={"bodies": bodies})


def with_element(scene: Scene, element: str) -> Scene:
    """The scene with all deformable bodies of one kind of element, ``linear`` or ``quadratic``."""
    bodies = [body.model_copy(update={"element": element}) for body in scene.deformables]
    return _with_bodies(scene, tuple(bodies))


def exact_simulation(scene: Scene, now: Callable[[], float]) -> Simulation:
    """A simulation that solves equilibria nearly to rounding, its cables on patches.

    Args:
        scene: The scene, as `still` makes it.
        now: Gives the time that steps are measured by [s].

    Raises:
        MeshErrorUnknown: The mesh has more than `MOST_TETS` tetrahedra.
        SoftRobotTwinError: The scene cannot be built.
    """
    layout = lay_out(scene, [])
    count = sum(body.mesh.cell_count for body in layout.bodies)
    if count > MOST_TETS:
        raise MeshErrorUnknown(f"its {count} tetrahedra are more than {MOST_TETS}")
    cables = tuple(
        cable.model_copy(update={
            "hold_radius": cable.hold_radius or PATCH_SHARE * _size(layout, cable.body)})
        for cable in scene.cables
    )  # fmt: skip
    stiffness = max(body.entry.material.young_modulus * body.size**2 for body in layout.bodies)
    weight = sum(body.mass for body in layout.bodies) * np.linalg.norm(scene.gravity)
    solver = scene.solver.model_copy(update={
        "residual_tolerance": max(_BALANCED * float(weight), _ROUNDING * stiffness)})
    exact = scene.model_copy(update={"cables": cables, "solver": solver})
    return Simulation(exact, now, with_warnings=False)


def _size(layout, name: str | None) -> float:
    return float(getattr(layout.body_named(name), "size", 0.0))


def step_time(scene: Scene, now: Callable[[], float]) -> float:
    """Median time of a step of one linearization at rest, as the scene is [s]."""
    solver = scene.solver.model_copy(update={"newton_iterations": 1})
    simulation = Simulation(
        scene.model_copy(update={"solver": solver}), now, with_warnings=False
    )
    before = simulation.state
    times = []
    for _ in range(_TIMED_STEPS):
        simulation.restore(before)
        times.append(simulation.step(Hold(_SHORT)).report.compute_time)
    return median(times[1:])


def solve_equilibrium(simulation: Simulation, command, poses: Mapping) -> bool:
    """Go on to an equilibrium from the last one, or from rest where that fails.

    Args:
        simulation: As `exact_simulation` makes it.
        command: What its actuators do.
        poses: Position [m] and quaternion of each guided body, by name.

    Returns:
        Whether it was found; where not, the simulation is at rest.
    """
    least = simulation.scene.solver.residual_tolerance
    for attempt in range(2):
        if attempt:
            simulation.reset()
        for name, (position, quaternion) in poses.items():
            simulation.model.guides.aim(name, position, quaternion)
        for _ in range(2):
            result = simulation.step(command)
            enough = max(least, _BALANCED * float(np.abs(result.efforts).sum()))
            if result.report.residual <= enough and not result.report.inverted_count:
                return True
    simulation.reset()
    return False
