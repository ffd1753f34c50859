"""How much a mesh leaves out: the same state solved with the next higher orders on the same mesh.

A body of linear or quadratic tetrahedra is compared with one of cubic tetrahedra: the quadratic
ones, and what cubic bubbles add to them (`cubic_correction.py`). What the bubbles add tells in turn
how much they leave out: where a body has sharp inner edges, solutions of order p err by about
p^-2.2, where it is smooth by far less. So cubic elements leave between nothing and 0.7 of what they
add. `LEFT_OUT` is what they left on average on the meshes of the Diamond and on bars; under a cable
it is a little more (`LEFT_OUT_AT_CABLES`), for the body sinks in there.

Cables that hold on single points hold on a patch here, for under a point a body gives way without
limit as the mesh gets finer: there would be nothing to compare with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import thread_time
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.command import CommandEfforts, CommandSetpoints, Hold
from softrobot_twin.simulation.cubic_body import LEFT_OUT, CubicBody, Response, limit, response
from softrobot_twin.simulation.newton import Newton
from softrobot_twin.simulation.simulation import Simulation
from softrobot_twin.simulation.still_scene import (
    LONG,
    MeshErrorUnknown,
    exact_simulation,
    refuse,
    solve_equilibrium,
    step_time,
    still,
    with_element,
)

LARGE = 0.2
"""A mesh that misses more than this share of a motion is warned of."""
_NO_NUMBER = float("nan")


class LoadError(NamedTuple):
    """What a mesh leaves out of the motion of the effectors, of all of it.

    Attributes:
        load: ``gravity`` or the name of a cable, which pulls alone.
        forces: Where the load is given as a force.
        lengths: Where the cable's length is given; NaN for gravity.
    """

    load: str
    forces: float
    lengths: float


class ElementError(NamedTuple):
    """The loads of one kind of element on a mesh.

    Attributes:
        element: ``linear`` or ``quadratic``.
        loads: By load; those that do not move the effectors are left out.
        step_time: Time of a step of one linearization [s].
    """

    element: str
    loads: tuple[LoadError, ...]
    step_time: float

    @property
    def forces(self) -> float:
        """The largest where forces are given; NaN where no load moves the effectors."""
        return _largest(load.forces for load in self.loads)

    @property
    def lengths(self) -> float:
        """The largest where lengths are given; NaN where no cable moves the effectors."""
        return _largest(load.lengths for load in self.loads)


class MeshError(NamedTuple):
    """What was estimated of a mesh at rest.

    Attributes:
        own: With the elements that the scene asks for.
        quadratic: With quadratic elements.
    """

    own: ElementError
    quadratic: ElementError

    def in_words(self) -> str:
        """The estimate in one sentence."""
        own, better = self.own, self.quadratic
        told = f"this mesh of {own.element} elements errs by about {_shares(own)}"
        if own.element == "quadratic":
            return f"{told}, {1e3 * own.step_time:.1f} ms a step"
        return (f"{told}, {1e3 * own.step_time:.1f} ms a step; quadratic elements: "
                f"{_shares(better, False)}, {1e3 * better.step_time:.1f} ms a step")

    @property
    def is_large(self) -> bool:
        """True where the scene's own elements miss much of what a load does."""
        return max(self.own.forces, self.own.lengths, key=_known) > LARGE


class Asked(NamedTuple):
    """What the actuators of a state do.

    Attributes:
        forces_given: Whether they keep their tensions, or their lengths.
        values: The tensions [N], or lengths [m]; cables first, shape (actuator_count,).
        poses: Position [m] and quaternion of each guided body, by name.
    """

    forces_given: bool
    values: np.ndarray
    poses: dict[str, tuple[np.ndarray, np.ndarray]]

    @classmethod
    def of(cls, simulation: Simulation, forces_given: bool) -> Asked:
        """What they do where a simulation is now."""
        state, poses = simulation.state, {}
        if simulation.rigid_names:
            places = zip(*simulation.rigid_poses(), strict=True)
            named = dict(zip(simulation.rigid_names, places, strict=True))
            guided = (part for part in simulation.model.rigid if not part.is_free)
            poses = {part.name: named[part.name] for part in guided}
        return cls(forces_given, state.efforts if forces_given else state.setpoints, poses)


class MeshErrorEstimator:
    """Solves states of a scene with elements of higher order.

    Args:
        scene: The scene. What touches is left out, motion in time too: equilibria are compared.
        now: Gives the time that steps are measured by [s]: that of this thread alone, so that
            other programs do not count.

    Attributes:
        element: The scene's own elements: ``linear`` where any body has them.

    Raises:
        MeshErrorUnknown: There is nothing to compare.
    """

    def __init__(self, scene: Scene, now: Callable[[], float] = thread_time):
        refuse(scene)
        self._scene, self._now = scene, now
        at_rest = still(scene)
        try:
            self._quadratic = exact_simulation(with_element(at_rest, "quadratic"), now)
            self._own = self._quadratic
            self.element = "quadratic"
            if any(body.element == "linear" for body in scene.deformables):
                self._own, self.element = exact_simulation(at_rest, now), "linear"
        except SoftRobotTwinError as error:
            raise MeshErrorUnknown(str(error)) from error
        self._cubic = CubicBody(self._quadratic.model)
        self._cables = len(scene.cables)

    def responses(self) -> tuple[Response, Response, Response]:
        """At rest: of the scene's own elements, of quadratic ones, and what both tend to."""
        quadratic, cubic = self._cubic.responses()
        own = quadratic
        if self.element == "linear":
            own = response(Newton(self._own.model), self._own.model)
        return own, quadratic, limit(quadratic, cubic)

    def at_rest(self) -> MeshError:
        """The error under gravity and under each cable alone, linearized at rest."""
        own, quadratic, best = self.responses()
        names = self._own.actuator_names
        better = ElementError(
            "quadratic", load_errors(quadratic, best, names),
            step_time(with_element(self._scene, "quadratic"), self._now),
        )  # fmt: skip
        if self.element == "quadratic":
            return MeshError(better, better)
        loads = load_errors(own, best, names)
        return MeshError(ElementError("linear", loads, step_time(self._scene, self._now)), better)

    def at(self, asked: Asked) -> float:
        """How far the mesh puts the effectors off in an equilibrium [m].

        Args:
            asked: What the actuators do.

        Returns:
            The largest distance of an effector; NaN where the equilibrium was not found.

        Raises:
            MeshErrorUnknown: The scene's equilibria are not those that can be compared.
        """
        check_judges_states(self._scene)
        values, poses = asked.values[: self._cables], asked.poses
        command = Hold(LONG)
        if self._cables:
            command = (CommandEfforts if asked.forces_given else CommandSetpoints)(values, LONG)
        solved = [solve_equilibrium(self._quadratic, command, poses)]
        if self._own is not self._quadratic:
            solved.append(solve_equilibrium(self._own, command, poses))
        if not all(solved):
            return _NO_NUMBER
        added = self._cubic.addition(self._quadratic.state, not asked.forces_given)
        quadratic = self._quadratic.effector_positions()
        apart = quadratic - self._own.effector_positions()
        term = self._quadratic.model.effectors
        apart[term.row_effector, term.row_axis] += (1.0 + LEFT_OUT) * added
        return float(np.linalg.norm(apart, axis=1).max())


def discretization_error(simulation: Simulation, forces_given: bool = False) -> float:
    """Estimate how far the mesh puts the effectors off, at the current state [m].

    The same state is solved with elements of higher order. That takes as long as some steps of
    quadratic elements, and these elements are built first: ask where time does not matter.

    Args:
        simulation: The simulation; it is left as it is.
        forces_given: Whether its actuators keep their efforts, or their setpoints.

    Returns:
        The largest distance of an effector; NaN where there is no estimate.
    """
    try:
        check_judges_states(simulation.scene)
        return MeshErrorEstimator(simulation.scene).at(Asked.of(simulation, forces_given))
    except MeshErrorUnknown:
        return _NO_NUMBER


def check_judges_states(scene: Scene) -> None:
    """Refuses scenes whose states cannot be solved with other elements.

    Raises:
        MeshErrorUnknown: Things may touch.
    """
    if scene.contact is not None:
        raise MeshErrorUnknown("where things touch, only the mesh at rest is judged")


def load_errors(own: Response, best: Response, names: tuple[str, ...]) -> tuple[LoadError, ...]:
    """What a response leaves out of another, load by load.

    Args:
        own: The response.
        best: The other.
        names: Names of the cables.
    """
    made = []
    if np.linalg.norm(best.gravity) > best.drives[0]:
        made.append(LoadError("gravity", _relative(own.gravity, best.gravity), _NO_NUMBER))
    for cable, name in enumerate(names):
        force, exact = own.W_ea[:, cable], best.W_ea[:, cable]
        if np.linalg.norm(exact) > best.drives[1 + cable]:
            wound = _relative(force / own.W_aa[cable], exact / best.W_aa[cable])
            made.append(LoadError(name, _relative(force, exact), wound))
    return tuple(made)


def _relative(value: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(value - exact) / np.linalg.norm(exact))


def _largest(values: Iterable[float]) -> float:
    return max((value for value in values if value == value), default=_NO_NUMBER)


def _known(value: float) -> float:
    return value if value == value else 0.0


def _shares(error: ElementError, whole: bool = True) -> str:
    """Both figures in words."""
    told = []
    for value, given in ((error.forces, "forces"), (error.lengths, "lengths")):
        if value == value:
            told.append(f"{_percent(value)} {'of the displacement ' * (whole and not told)}"
                        f"at given {given}")
    return " and ".join(told) or "an unknown share (no load moves the effectors)"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"
