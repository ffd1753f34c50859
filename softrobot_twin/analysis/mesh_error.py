"""Estimate of the discretization error: the same state solved with higher orders on the same mesh.

A body of linear or quadratic tetrahedra is compared with one of cubic tetrahedra: the quadratic
ones, and the correction by cubic bubbles (`cubic_correction.py`). The size of the correction also
gives an estimate of the error of the cubic elements: at sharp inner edges solutions of order p have
an error of about p^-2.2, in smooth bodies far less. So the error of cubic elements is between zero
and 0.7 of the correction. `LEFT_OUT` is the mean on meshes of the Diamond and on bars; where a
cable is held it is a little more (`LEFT_OUT_AT_CABLES`), because of the local indentation.

A cable attached at a single point is attached on a patch here: the displacement under a point load
grows without limit as the mesh gets finer, so that there would be no limit to compare with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from statistics import median
from time import perf_counter, thread_time
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.geometry.cubic_bubbles import add_bubbles
from softrobot_twin.mechanics.cubic_correction import CubicCorrection, CubicPart
from softrobot_twin.scene import Scene
from softrobot_twin.scene.scene_changes import plain_surroundings, without_reductions
from softrobot_twin.simulation.building.actuators import build_groups
from softrobot_twin.simulation.building.deformable_body import cell_values
from softrobot_twin.simulation.building.effector_building import effector_term
from softrobot_twin.simulation.building.scene_layout import lay_out
from softrobot_twin.simulation.command import LONG, CommandEfforts, CommandSetpoints, Hold
from softrobot_twin.simulation.simulation import Simulation
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.time_budget import StageClock

PATCH_SHARE = 0.0125
"""Radius of the patch on which a cable acts, as a share of the body's size."""
COMPARED_ELEMENTS = ("linear", "smoothed", "quadratic")
"""Elements whose error is estimated, the stiffest first."""
CORRECTED_LAWS = ("corotational", "linear")
"""Laws for which `cubic_correction.py` has a correction."""
MOST_TETS = 20_000
"""Meshes with more tetrahedra are not estimated: factorization would take minutes."""
# Time step with a small change of state [s].
_SHORT = 1.0e-3
_TIMED_STEPS = 6
_MOST_ITERATIONS = 15
# A body is in equilibrium where no residual exceeds the first share of all loads, or the second of
# the force that strains a body of this size by one.
_BALANCED, _ROUNDING = 1.0e-4, 1.0e-9
LEFT_OUT = 0.36
"""Error of cubic elements, as a share of their correction of quadratic ones."""
LEFT_OUT_AT_CABLES = 0.46
"""The same for the displacement of a cable by its own tension."""
# A load that moves the effectors by less than this share of the body's largest displacement is
# omitted: the rest is mostly the mesh's lack of symmetry.
_DRIVES = 0.02
LARGE = 0.2
"""A relative error above this one is reported as a warning."""
_NO_NUMBER = float("nan")


class MeshErrorUnknown(SoftRobotTwinError):
    """The error of a scene's mesh cannot be estimated.

    Attributes:
        reason: Why.
    """

    def __init__(self, reason: str):
        self.reason = reason
        super().__init__(f"the error of the mesh is not estimated: {reason}")


def refuse(scene: Scene) -> None:
    """Refuse a scene whose mesh error cannot be estimated.

    Args:
        scene: The scene.

    Raises:
        MeshErrorUnknown: It has no deformable body or no effector, beams, an element that is not compared
            or a law whose cubic correction is not known.
    """
    if not scene.deformables:
        raise MeshErrorUnknown("the scene has no deformable body")
    if scene.beams:
        raise MeshErrorUnknown("the scene has beams, with which it is not built")
    if not scene.effectors:
        raise MeshErrorUnknown("the scene names no effector whose motion could be judged")
    for body in scene.deformables:
        if body.vertebrae:
            raise MeshErrorUnknown(
                f"{body.name} is reduced to vertebrae; ask for the full model, without vertebrae"
            )
        if body.element not in COMPARED_ELEMENTS:
            raise MeshErrorUnknown(f"the element {body.element} is not compared with others")
        laws = [body.material.law, *(other.law for other in body.materials if other.law)]
        for law in laws:
            if law not in CORRECTED_LAWS:
                raise MeshErrorUnknown(
                    f"the law {law} has no cubic correction; {' and '.join(CORRECTED_LAWS)} have "
                    "one"
                )


def _refuse_hexahedra(scene: Scene) -> None:
    """Refuse bodies whose mesh files have hexahedra: cubic bubbles are those of tetrahedra."""
    for body in lay_out(scene, []).bodies:
        if body.entry.element not in COMPARED_ELEMENTS:
            raise MeshErrorUnknown(
                f"the {body.entry.element} elements of {body.name} are not compared with others"
            )


def still(scene: Scene) -> Scene:
    """The scene in statics, without contact, with its actuators without limits.

    Args:
        scene: The scene.
    """
    anything = (-np.inf, np.inf)
    # Free rigid bodies are fixed: without contact they are not supported.
    return scene.with_deformables({"mass": None}).changed(
        integration="quasi_static", **plain_surroundings(scene), slides=(), motors=(), markers=(),
        cables=dict(rate=None, shortening=(-1.0e3, 1.0e3), tension=(0.0, 1.0e9), pulley=None,
                    friction=0.0, presliding=None),
        cavities=dict(rate=None, flow=None, pressure=anything, growth=anything,
                      volume=(0.0, np.inf)),
        rigid_bodies=dict(motion="guided", speed=None, turn_rate=None), effectors=_position_of,
        solver=dict(newton_iterations=_MOST_ITERATIONS),
    )  # fmt: skip


def _position_of(effector):
    """An effector without markers whose position alone is judged."""
    directions = effector.directions or ("x", "y", "z")
    return effector.changed(measured_by=(), orientation=None, directions=directions)


def with_element(scene: Scene, element: str) -> Scene:
    """The scene with all deformable bodies of one kind of element, its volumes kept as usual.

    Args:
        scene: The scene.
        element: Kind of the elements.
    """
    return scene.with_deformables({"element": element, "volume": None})


def exact_simulation(scene: Scene, now: Callable[[], float]) -> Simulation:
    """A simulation that solves equilibria nearly to rounding, its cables on patches.

    Args:
        scene: The scene, as `still` makes it.
        now: Clock by which steps are measured [s].

    Raises:
        MeshErrorUnknown: The mesh has more than `MOST_TETS` tetrahedra.
        SoftRobotTwinError: The scene cannot be built.
    """
    layout = lay_out(scene, [])
    count = sum(body.mesh.cell_count for body in layout.bodies)
    if count > MOST_TETS:
        raise MeshErrorUnknown(f"its {count} tetrahedra are more than {MOST_TETS}")
    stiffness = max(
        part.young_modulus * body.size**2 for body in layout.bodies for part in body.materials
    )
    weight = sum(body.mass for body in layout.bodies) * np.linalg.norm(scene.gravity)
    tolerance = max(_BALANCED * float(weight), _ROUNDING * stiffness)
    exact = scene.changed(
        solver={"residual_tolerance": tolerance},
        cables=lambda cable: cable.changed(
            hold_radius=cable.hold_radius or PATCH_SHARE * _size(layout, cable.body)),
    )  # fmt: skip
    return Simulation(exact, now, with_warnings=False)


def _size(layout, name: str | None) -> float:
    return float(getattr(layout.body_named(name), "size", 0.0))


def step_time(scene: Scene, now: Callable[[], float]) -> float:
    """Median time of a step of one linearization at rest, of the scene itself [s].

    Args:
        scene: The scene.
        now: The clock [s].
    """
    simulation = Simulation(scene.changed(solver={"newton_iterations": 1}), now, with_warnings=False)
    before = simulation.state
    times = []
    for _ in range(_TIMED_STEPS):
        simulation.restore(before)
        times.append(simulation.step(Hold(_SHORT)).report.compute_time)
    return median(times[1:])


def solve_equilibrium(simulation: Simulation, command, poses: Mapping) -> bool:
    """Solve an equilibrium from the last one, or from rest if that fails.

    Args:
        simulation: Result of `exact_simulation`.
        command: Command of its actuators.
        poses: Position [m] and quaternion of each guided body, by name.

    Returns:
        Whether it was found; if not, the simulation is at rest.
    """
    least = simulation.scene.solver.residual_tolerance
    for attempt in range(2):
        if attempt:
            simulation.reset()
        for name, (position, quaternion) in poses.items():
            simulation.model.guides.aim(name, position, quaternion)
        for _ in range(2):
            result = simulation.step(command)
            enough = max(least, _BALANCED * simulation.actuators.load(result.efforts))
            if result.report.residual <= enough and not result.report.inverted_count:
                return True
    simulation.reset()
    return False


class Response(NamedTuple):
    """Compliances of a body at rest.

    Attributes:
        gravity: Motion of the effector rows under gravity [m], shape (effector_row_count,).
        W_ea: By each actuator's effort [m/N, m/Pa], shape (effector_row_count, actuator_count).
        W_aa: Displacement of each actuator by its own effort [m/N, m³/Pa],
            shape (actuator_count,).
        drives: Least motion of the effectors for a load to count; 0 unless known [m, m/N, m/Pa],
            shape (1 + actuator_count,).
    """

    gravity: np.ndarray
    W_ea: np.ndarray
    W_aa: np.ndarray
    drives: np.ndarray


def limit(quadratic: Response, cubic: Response, own_share: np.ndarray) -> Response:
    """Limit of the responses under refinement: the error of cubic elements is a share of their
    correction.

    Args:
        quadratic: Responses of quadratic elements.
        cubic: Responses of cubic ones.
        own_share: This share for the displacement of each actuator by its own effort,
            shape (actuator_count,).
    """
    shares = (LEFT_OUT, LEFT_OUT, own_share)
    limits = (of_cubic + share * (of_cubic - of_quadratic) for of_quadratic, of_cubic, share in
              zip(quadratic[:3], cubic[:3], shares, strict=True))  # fmt: skip
    return Response(*limits, cubic.drives)


class CubicBody:
    """The quadratic body, and the correction by its bubbles."""

    def __init__(self, model):
        self._model, self._newton = model, Newton(model)
        layout = lay_out(model.scene, [])
        parts, bodies, held, bubble_count = [], [], [], 0
        node_count = len(layout.nodes.rest_positions)
        for body in layout.bodies:
            mesh = add_bubbles(body.mesh, node_count + bubble_count - body.first_node)
            bubble_count += len(mesh.bubble_corners)
            held.append(body.held[mesh.bubble_corners].all(axis=1))
            lame, turns = (cell_values(body.materials, name, body.mesh.cell_count)
                           for name in ("lame_parameters", "turns"))  # fmt: skip
            parts.append(CubicPart(mesh, body.first_node, lame, body.density, turns))
            bodies.append(replace(body, mesh=mesh))
        held = np.concatenate(held)
        moving = ~held.all(axis=1)
        places, free_axes = np.where(moving, np.cumsum(moving) - 1, -1), 1.0 - held[moving]
        unknowns = model.nodes.free_node_count
        index = np.where(places >= 0, unknowns + places, -1)
        free = np.where(layout.nodes.free_index < unknowns, layout.nodes.free_index, -1)
        self._correction = CubicCorrection(parts, np.concatenate([free, index]), unknowns, free_axes)
        # Rows of the bubbles alone: the entries of the nodes are those of the model.
        self._bubbles = np.zeros((bubble_count, 3))
        nodes = replace(
            layout.nodes, free_index=np.concatenate([np.full(node_count, -1), places]),
            rest_positions=np.vstack([layout.nodes.rest_positions, self._bubbles]), kinds=(), free_axes=free_axes,
        )  # fmt: skip
        widened = layout._replace(bodies=tuple(bodies), nodes=nodes)
        terms = [group.term for group in build_groups(widened, [])]
        self._rows = RowStack([*terms, effector_term(widened, [])], None, free_axes)
        self._actuator_count = model.actuators.row_count

    def responses(self) -> tuple[Response, Response]:
        """Of the quadratic body and of the cubic one, at rest."""
        model, correction = self._model, self._correction
        rest, gravity = model.nodes.rest_positions, np.array(model.scene.gravity)
        quadratic = response(self._newton, model)
        still = correction.linearize(rest)
        solve = model.factorization.solve
        forces = np.zeros((model.nodes.free_node_count, 3))
        for term in model.forces:
            term.add_forces(rest, forces)
        rows = self._left_rows(rest)
        weight = correction.left_on_bubbles(still + correction.weight(gravity), solve(forces))
        loads = [weight if gravity.any() else None, *rows[: self._actuator_count]]
        moved = [np.zeros_like(still) if load is None else correction.solve(load, solve)
                 for load in loads]  # fmt: skip
        actuators, effectors = rows[: self._actuator_count], rows[self._actuator_count :]
        added = np.array([[np.vdot(row, move) for move in moved] for row in effectors])
        own = [np.vdot(row, move) for row, move in zip(actuators, moved[1:], strict=True)]
        cubic = Response(
            quadratic.gravity + added[:, 0], quadratic.W_ea + added[:, 1:],
            quadratic.W_aa + np.array(own), quadratic.drives,
        )  # fmt: skip
        return quadratic, cubic

    def _left_rows(self, positions: np.ndarray) -> list[np.ndarray]:
        """Force of each row's multiplier on the bubbles, after the nodes' response [1]."""
        model, count = self._model, self._model.nodes.free_node_count
        model.rows.evaluate(positions)
        self._rows.evaluate(np.vstack([positions, self._bubbles]))
        solve, shape = model.factorization.solve, (self._correction.bubble_count, 3)
        left = []
        for row in range(self._rows.row_count):
            on_nodes, on_bubbles = np.zeros((count, 3)), np.zeros(shape)
            multipliers = np.zeros(self._rows.row_count)
            multipliers[row] = 1.0
            model.rows.add_forces(multipliers, on_nodes)
            self._rows.add_forces(multipliers, on_bubbles)
            left.append(self._correction.left_on_bubbles(on_bubbles, solve(on_nodes)))
        return left

    def addition(self, state, setpoints_given: bool) -> np.ndarray:
        """Correction of the effector rows by cubic elements, at an equilibrium of quadratic ones
        [m].

        Args:
            state: The state.
            setpoints_given: True if actuators keep their setpoints: taut cables their lengths,
                cavities their volumes or pressures; False if all keep their efforts.

        Returns:
            The displacement of each effector row [m]; NaN where factorization failed, shape
            (effector_row_count,).
        """
        model, correction, count = self._model, self._correction, self._actuator_count
        clock = StageClock(perf_counter)
        linear = self._newton.linearize(state.positions.copy(), state.efforts, clock)
        if not linear:
            return np.full(self._rows.row_count - count, np.nan)
        forces = correction.linearize(state.positions)
        forces += correction.weight(np.array(model.scene.gravity))
        rows = self._left_rows(state.positions)
        multipliers = np.zeros(self._rows.row_count)
        multipliers[:count] = state.efforts[:count]
        self._rows.add_forces(multipliers, forces)
        solve = model.factorization.solve
        moved = correction.solve(forces, solve)
        effectors, actuators = rows[count:], model.actuators
        added = np.array([np.vdot(row, moved) for row in effectors])
        is_slack = actuators.one_sided & (state.efforts <= 0.0)
        held = np.flatnonzero(~is_slack[:count] & ~actuators.is_effort_driven[:count])
        if not (setpoints_given and len(held)):
            return added
        # Efforts that keep the displacements follow from the compliance of the quadratic body.
        changed = np.array([np.vdot(rows[row], moved) for row in held])
        # For parallel cables the split of the tension does not matter to the effectors.
        change = np.linalg.lstsq(linear.W_aa[np.ix_(held, held)], changed, rcond=None)[0]
        return added - linear.W_ea[:, held] @ change


def response(newton: Newton, model) -> Response:
    """Compliances at rest, by one linearization.

    Args:
        newton: The linearizations of the model.
        model: The model of a simulation.
    """
    rest = model.nodes.rest_positions.copy()
    linear = newton.linearize(rest, np.zeros(len(model.actuators.names)), StageClock(perf_counter))
    if not linear or newton.tangent.is_projected:
        raise MeshErrorUnknown("the body has no stable equilibrium at rest")
    count, rows = len(model.actuators.names), model.rows.row_count
    # No load but gravity, and each actuator with an effort of one beside it.
    loads = np.vstack([np.zeros(rows), np.eye(count, rows)])
    # `expand` returns the same memory each time.
    moves = np.array([model.factorization.expand(load).copy() for load in loads])
    moves[1:] -= moves[0]
    return Response(
        linear.effectors - linear.effectors_now, linear.W_ea, np.diag(linear.W_aa).copy(),
        _DRIVES * np.linalg.norm(moves, axis=2).max(axis=1),
    )  # fmt: skip


class LoadError(NamedTuple):
    """Relative error of the motion of the effectors under one load.

    Attributes:
        load: ``gravity`` or the name of an actuator, which acts alone.
        forces: Error at a given force or pressure.
        lengths: Error at a given length or volume of the actuator; NaN for gravity.
    """

    load: str
    forces: float
    lengths: float


class ElementError(NamedTuple):
    """The loads of one kind of element on a mesh.

    Attributes:
        element: ``linear`` or ``quadratic``.
        loads: By load; those that do not move the effectors are omitted.
        step_time: Time of a step of one linearization [s].
    """

    element: str
    loads: tuple[LoadError, ...]
    step_time: float

    @property
    def forces(self) -> float:
        """The largest error at given forces and pressures; NaN if no load moves the effectors."""
        return _largest(load.forces for load in self.loads)

    @property
    def lengths(self) -> float:
        """The largest error at given lengths and volumes; NaN if no actuator moves the effectors.
        """
        return _largest(load.lengths for load in self.loads)


class MeshError(NamedTuple):
    """Estimated errors of a mesh at rest.

    Attributes:
        own: With the scene's own elements.
        quadratic: With quadratic elements.
        given: What is given, in words: efforts, and displacements.
    """

    own: ElementError
    quadratic: ElementError
    given: tuple[str, str] = ("forces", "lengths")

    def in_words(self) -> str:
        """The estimate in one sentence."""
        own, better = self.own, self.quadratic
        told = f"this mesh of {own.element} elements has an error of about {_shares(own, self.given)}"
        if own.element == "quadratic":
            return f"{told}, {1e3 * own.step_time:.1f} ms a step"
        return (f"{told}, {1e3 * own.step_time:.1f} ms a step; quadratic elements: "
                f"{_shares(better, self.given, False)}, {1e3 * better.step_time:.1f} ms a step")

    @property
    def is_large(self) -> bool:
        """True where the relative error with the scene's own elements is above `LARGE`."""
        return bool(np.fmax(self.own.forces, self.own.lengths) > LARGE)


class ActuatorLoads(NamedTuple):
    """Prescribed quantities of the actuators of a state.

    Attributes:
        forces_given: True if efforts are prescribed, False if setpoints are.
        values: The efforts [N, Pa], or setpoints [m, m³, Pa]; actuators with rows first,
            shape (actuator_count,).
        poses: Position [m] and quaternion of each guided body, by name.
    """

    forces_given: bool
    values: np.ndarray
    poses: dict[str, tuple[np.ndarray, np.ndarray]]

    @classmethod
    def of(cls, simulation: Simulation, forces_given: bool) -> ActuatorLoads:
        """Those of the current state of a simulation.

        Args:
            simulation: The simulation.
            forces_given: Whether efforts are held, in place of setpoints.
        """
        state, poses = simulation.state, simulation.poses()
        guided = (part.name for part in simulation.model.rigid if not part.is_free)
        poses = {name: poses[name] for name in guided}
        return cls(forces_given, state.efforts if forces_given else state.setpoints, poses)


class MeshErrorEstimator:
    """Solves states of a scene with elements of higher order.

    Args:
        scene: The scene. Contact and motion in time are omitted: equilibria are compared.
        now: Clock by which steps are measured [s]: that of this thread alone, so that other
            programs do not count.

    Attributes:
        element: The scene's own elements: the stiffest that any body has.

    Raises:
        MeshErrorUnknown: The scene has no estimate.
    """

    def __init__(self, scene: Scene, now: Callable[[], float] = thread_time):
        refuse(scene)
        # Of a reduced body it is the mesh's error that is asked for here, not the reduction's.
        scene = without_reductions(scene)
        self._scene, self._now = scene, now
        at_rest = still(scene)
        try:
            _refuse_hexahedra(at_rest)
            self._quadratic = exact_simulation(with_element(at_rest, "quadratic"), now)
            self._own = self._quadratic
            named = {body.element for body in scene.deformables}
            self.element = next(one for one in COMPARED_ELEMENTS if one in named)
            if self.element != "quadratic":
                self._own = exact_simulation(at_rest, now)
        except MeshErrorUnknown:
            raise
        except SoftRobotTwinError as error:
            raise MeshErrorUnknown(str(error)) from error
        self._cubic = CubicBody(self._quadratic.model)
        actuators = self._quadratic.actuators
        self._actuator_count = actuators.row_count
        by_cable = np.array([kind.section == "cables" for kind in actuators.kinds], bool)
        self._own_share = np.where(by_cable, LEFT_OUT_AT_CABLES, LEFT_OUT)
        self._given = _given(by_cable)

    def responses(self) -> tuple[Response, Response, Response]:
        """At rest: of the scene's own elements, of quadratic ones, and the limit of both."""
        quadratic, cubic = self._cubic.responses()
        own = quadratic if self.element == "quadratic" else response(Newton(self._own.model), self._own.model)
        return own, quadratic, limit(quadratic, cubic, self._own_share)

    def at_rest(self) -> MeshError:
        """The error under gravity and under each actuator alone, linearized at rest."""
        own, quadratic, best = self.responses()
        names = self._own.actuator_names

        def told(element: str, of: Response, scene: Scene) -> ElementError:
            loads = load_errors(of, best, names)
            return ElementError(element, loads, step_time(scene, self._now))

        better = told("quadratic", quadratic, with_element(self._scene, "quadratic"))
        is_best = self.element == "quadratic"
        coarser = better if is_best else told(self.element, own, self._scene)
        return MeshError(coarser, better, self._given)

    def at(self, asked: ActuatorLoads) -> float:
        """Error of the effectors' positions in an equilibrium [m].

        Args:
            asked: Prescribed quantities of the actuators.

        Returns:
            The largest distance of an effector; NaN where the equilibrium was not found.

        Raises:
            MeshErrorUnknown: The scene's equilibria are not those that can be compared.
        """
        check_judges_states(self._scene)
        limit = self.limit_at(asked)
        if self._own is not self._quadratic and not self._solve(self._own, asked):
            limit = None
        if limit is None:
            return _NO_NUMBER
        apart = limit - self._own.effector_positions()
        return float(np.linalg.norm(apart, axis=1).max())

    def limit_at(self, *asked: ActuatorLoads) -> np.ndarray | None:
        """Positions of the effectors in an equilibrium, in the limit under refinement.

        Args:
            asked: Prescribed quantities of the actuators, those of equilibria on the way first.

        Returns:
            Positions [m], shape (effector_count, 3); None where an equilibrium was not found.
        """
        if not all(self._solve(self._quadratic, one) for one in asked):
            return None
        added = self._cubic.addition(self._quadratic.state, not asked[-1].forces_given)
        positions, term = self._quadratic.effector_positions(), self._quadratic.model.effectors
        positions[term.row_effector, term.row_axis] += (1.0 + LEFT_OUT) * added
        return positions

    def _solve(self, simulation: Simulation, asked: ActuatorLoads) -> bool:
        command = Hold(LONG)
        if self._actuator_count:
            values = asked.values[: self._actuator_count]
            command = (CommandEfforts if asked.forces_given else CommandSetpoints)(values, LONG)
        return solve_equilibrium(simulation, command, asked.poses)


def check_judges_states(scene: Scene) -> None:
    """Refuses scenes whose states cannot be solved with other elements.

    Args:
        scene: The scene.

    Raises:
        MeshErrorUnknown: The scene has contact.
    """
    if scene.contact:
        raise MeshErrorUnknown("where things touch, only the mesh at rest is judged")


def load_errors(own: Response, best: Response, names: tuple[str, ...]) -> tuple[LoadError, ...]:
    """Relative error of a response against a better one, for each load.

    Args:
        own: The response.
        best: The other.
        names: Names of the actuators.
    """
    made = []
    if np.linalg.norm(best.gravity) > best.drives[0]:
        made.append(LoadError("gravity", _relative(own.gravity, best.gravity), _NO_NUMBER))
    for index, name in enumerate(names):
        by_effort, exact = own.W_ea[:, index], best.W_ea[:, index]
        if np.linalg.norm(exact) > best.drives[1 + index]:
            moved = _relative(by_effort / own.W_aa[index], exact / best.W_aa[index])
            made.append(LoadError(name, _relative(by_effort, exact), moved))
    return tuple(made)


def _relative(value: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(value - exact) / np.linalg.norm(exact))


def _largest(values: Iterable[float]) -> float:
    return float(np.fmax.reduce(list(values), initial=_NO_NUMBER))


def _given(by_cable: np.ndarray) -> tuple[str, str]:
    """Efforts and displacements in words; gravity is a force, whatever the actuators are."""
    if by_cable.all():
        return "forces", "lengths"
    if by_cable.any():
        return "forces and pressures", "lengths and volumes"
    return "forces and pressures", "volumes"


def _shares(error: ElementError, words: tuple[str, str], whole: bool = True) -> str:
    """Both errors as text."""
    told = []
    for value, given in zip((error.forces, error.lengths), words, strict=True):
        if value == value:
            told.append(f"{_percent(value)} {'of the displacement ' * (whole and not told)}"
                        f"at given {given}")
    return " and ".join(told) or "an unknown share (no load moves the effectors)"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"
