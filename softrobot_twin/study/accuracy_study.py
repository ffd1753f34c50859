"""Error and time of every mesh, element and law, against a reference solution.

The error of a setting is ‖x - x∞‖ / ‖x∞ - x₀‖ (root mean square over poses and effectors), with
effectors at x, at rest at x₀, and x∞ the limit under refinement: that of `mesh_error.py` on the finest
mesh, or extrapolated from quadratic meshes with v(h) = v∞ + c hᵖ, whichever is less uncertain.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter, thread_time
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from softrobot_twin.analysis.mesh_error import (
    LEFT_OUT,
    ActuatorLoads,
    MeshErrorEstimator,
    MeshErrorUnknown,
)
from softrobot_twin.errors import NamedError, SoftRobotTwinError
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.geometry.uniform_refinement import refine
from softrobot_twin.harness.output_file import writing
from softrobot_twin.harness.study_rows import read_rows
from softrobot_twin.harness.terminal import tracked, warn
from softrobot_twin.harness.timing import spread, without_garbage_collection
from softrobot_twin.mechanics.element_kinds import HEXAHEDRAL
from softrobot_twin.scene import Scene
from softrobot_twin.scene.body_entries import FixedRegion, Material, Reduced
from softrobot_twin.scene.loading import text_of
from softrobot_twin.scene.scene_changes import unlimited, with_mesh_file, with_newton
from softrobot_twin.scene.schema import Solver
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    Simulation,
    State,
)
from softrobot_twin.simulation.building.actuators import build_groups
from softrobot_twin.simulation.building.deformable_body import Body, build_body, law_at_rest
from softrobot_twin.simulation.building.scene_layout import lay_out


class AccuracyError(NamedError):
    """Accuracy cannot be determined for a scene or from a file."""


def write_scene_copy(path: Path, chosen: Scene, setting: Setting, remarks: list[str]) -> None:
    """Writes a scene file for a setting, with all that the scene says besides.

    Args:
        path: File to write.
        chosen: The scene on the chosen mesh, with its element, law and reduced model.
        setting: The chosen setting.
        remarks: Comment lines for the beginning of the file.

    Raises:
        OutputError: The file cannot be written.
    """
    solver = chosen.solver.model_dump(exclude_unset=True) | {"newton_iterations": setting.iterations}
    if chosen.body.reduced is not None:
        solver.pop("factorization", None)  # that of a reduced body is a dense one
    head = "".join(f"# {line}\n" for line in remarks)
    text = head + text_of(chosen.changed(solver=Solver(**solver)), path.resolve().parent)
    with writing(path):
        path.write_text(text, encoding="utf-8")


def _own_level(scene: Scene) -> MeshLevel:
    """The scene on its own mesh, of linear tetrahedra."""
    if scene.body.mesh.file is not None:
        scene = with_mesh_file(scene, scene.mesh_path.resolve())
    return _level(scene.mesh_name, scene)


def with_element(scene: Scene, element: str) -> Scene:
    """The same scene with other elements of tetrahedra.

    Args:
        scene: A scene with one body.
        element: Kind of the elements.
    """
    return scene.changed(body={"element": element})


def with_law(scene: Scene, law: str) -> Scene:
    """The same scene with another material law, of the same moduli at rest.

    Args:
        scene: A scene with one body.
        law: Name of the law.
    """
    material = scene.body.material
    if law == material.law:
        return scene
    return scene.changed(body={"material": _constants_of(material, law)})


def _constants_of(material: Material, law: str) -> dict:
    """The keys of a material with another law, which has no constants of its own."""
    if material.constants is None:
        return {"law": law}
    at_rest = law_at_rest(material, material.law)
    return {"law": law, "constants": None, "bulk_modulus": None,
            "young_modulus": at_rest.young_modulus, "poisson_ratio": at_rest.poisson_ratio}  # fmt: skip


HOLD_SHARE = 0.0125
"""Default radius over which a cable's force is spread, as a share of the body's size."""


def with_hold_radius(scene: Scene, radius: float | None = None) -> Scene:
    """The same scene; cable forces at points are spread over a radius: the displacement under a
    point force grows without bound as the mesh is refined.

    Args:
        scene: The scene.
        radius: For cables without one [m]; None for a share of the body's size, `HOLD_SHARE`.
    """
    own = round(HOLD_SHARE * only_body(scene).size, 6) if radius is None else radius
    return scene.changed(cables=lambda cable: cable.changed(hold_radius=cable.hold_radius or own))


def given_words(scene: Scene) -> tuple[str, str]:
    """What displacements and efforts of a scene's actuators are, such as ``cable lengths``.

    Args:
        scene: The scene.
    """
    if not scene.cavities:
        return "cable lengths", "cable tensions"
    if not scene.cables:
        return "cavity volumes", "cavity pressures"
    return "lengths and volumes", "tensions and pressures"


def check_one_body(scene: Scene) -> None:
    """Refuses a scene whose mesh cannot be compared with finer ones.

    Args:
        scene: The scene.

    Raises:
        AccuracyError: The scene does not have exactly one body, is dynamic, or has contact.
    """
    if scene.body is None:
        count = len(scene.bodies)
        found = f"has {count} under 'bodies'" if count else "has no deformable body"
        raise AccuracyError(scene.name, "meshes, elements and laws are compared on the one body "
                            f"that a scene has under 'body'; this scene {found}")
    if scene.integration != "quasi_static":
        raise AccuracyError(scene.name, "errors are measured at equilibria, which integration "
                            f"{scene.integration} does not compute; use a quasi_static scene")
    if scene.contact is not None:
        raise AccuracyError(scene.name, "contact points differ from mesh to mesh, so the error "
                            "of one mesh has no reference; remove the contact")


def only_body(scene: Scene) -> Body:
    """The scene's only body, with its mesh read and placed.

    Args:
        scene: The scene.

    Raises:
        AccuracyError: See `check_one_body`.
        SoftRobotTwinError: Its mesh cannot be used.
    """
    check_one_body(scene)
    return build_body(scene.body, "body", 0, scene, [])


LOWEST_ORDER, HIGHEST_ORDER = 0.25, 6.0
"""An observed order outside this range is rejected: the meshes are too coarse or too different."""
ASSUMED_ORDER = 1.0
"""Order that is assumed where none is observed. Edges and corners of a body limit the order of all
elements to about this value, so it is a safe choice.
"""


class Extrapolation(NamedTuple):
    """The limit of a sequence.

    Attributes:
        value: Estimated limit v∞, shape of the values.
        order: Observed order p of the error c hᵖ; NaN where none was observed and `ASSUMED_ORDER`
            was used; None where elements of higher order gave the limit.
        uncertainty: Bound on the norm of the estimate's error, in the unit of the values.
    """

    value: np.ndarray
    order: float | None
    uncertainty: float


def extrapolate(sizes: Sequence[float], values: Sequence[np.ndarray]) -> Extrapolation:
    """Estimates the limit v∞ of values on finer and finer meshes.

    Order and limit minimize Σ (1/h) ‖v(h) - v∞ - c hᵖ‖² over all meshes. The values on meshes that
    are not refinements of each other scatter about their trend, so that three of them alone often
    have no observable order.
    The uncertainty is the larger of the scatter and of the difference between limit and finest
    value; where no order was observed, it is at least the difference of the last two values.

    Args:
        sizes: Element sizes, decreasing, at least one.
        values: The values on them.
    """
    stacked = np.array([np.asarray(value, dtype=float).ravel() for value in values])
    shape, finest = np.shape(values[-1]), stacked[-1]
    if len(stacked) < 3:
        gap = np.linalg.norm(finest - stacked[-2]) if len(stacked) == 2 else np.nan
        return Extrapolation(finest.reshape(shape), float("nan"), float(gap))
    scaled = np.asarray(sizes, dtype=float) / sizes[-1]
    found = minimize_scalar(lambda order: _fit(scaled, stacked, order)[1], method="bounded",
                            bounds=(LOWEST_ORDER, HIGHEST_ORDER), options={"xatol": 1e-10})
    order = float(found.x)
    gap = 0.0
    if min(order - LOWEST_ORDER, HIGHEST_ORDER - order) < 1e-3:
        order, gap = float("nan"), float(np.linalg.norm(finest - stacked[-2]))
    limit, scatter = _fit(scaled, stacked, order if np.isfinite(order) else ASSUMED_ORDER)
    uncertainty = max(float(np.linalg.norm(limit - finest)), scatter, gap)
    return Extrapolation(limit.reshape(shape), order, uncertainty)


def _fit(sizes: np.ndarray, values: np.ndarray, order: float) -> tuple[np.ndarray, float]:
    """Limit v∞ for a given order, and the weighted scatter about the fit."""
    weights = (1.0 / sizes) / np.mean(1.0 / sizes)
    terms = np.column_stack([np.ones_like(sizes), sizes**order])
    root = np.sqrt(weights)[:, None]
    coefficients = np.linalg.lstsq(root * terms, root * values, rcond=None)[0]
    left = root * (values - terms @ coefficients)
    return coefficients[0], float(np.linalg.norm(left) / np.sqrt(len(sizes)))


ELEMENTS = ("linear", "smoothed", "quadratic")
"""Elements of tetrahedra that a study measures."""


MESH, REDUCED = "mesh", "reduced"
"""Kinds of rows (column ``knob``): a full model, and a reduced one, whose error includes that of its mesh."""


class Setting(NamedTuple):
    """Mesh, element, law and number of linearizations.

    Attributes:
        mesh: Name of the mesh.
        element: ``linear``, ``quadratic`` or ``hexahedral``.
        law: ``corotational`` or ``linear``.
        iterations: Linearizations per step.
        reduced: Name of the file of a reduced model of this mesh; empty for the full model.
    """

    mesh: str
    element: str
    law: str
    iterations: int
    reduced: str = ""

    @property
    def model(self) -> tuple[str, str, str, str]:
        """The setting without its number of linearizations."""
        return self.mesh, self.element, self.law, self.reduced


@dataclass(frozen=True)
class AccuracyRow:
    """Measurement of one setting. Errors are relative to the reference's displacement from rest.

    Attributes:
        knob: Whether the model is full or reduced.
        setting: Element and law, or modes and points.
        mesh: Name of the mesh.
        element: ``linear``, ``quadratic`` or ``hexahedral``.
        law: ``corotational`` or ``linear``.
        node_count: Nodes, including mid-edge nodes.
        dof_count: Unknowns.
        step_ms: Median time of a step of one linearization [ms].
        step_p99_ms: Its 99th percentile [ms].
        error_lengths: Error with displacements prescribed.
        error_tensions: Error with forces prescribed.
        error_weightless: Error with displacements prescribed and no gravity.
        uncertainty_lengths: Uncertainty of the reference for `error_lengths`.
        uncertainty_tensions: The same of `error_tensions`.
        uncertainty_weightless: The same of `error_weightless`.
        displacement_mm: Displacement of the reference's effectors, displacements prescribed [mm].
        file: Name of the file of a reduced model; empty for a full one.
        mode_count: Its modes, 0 for a full one.
        point_count: Its sampled quadrature points, 0 for a full one.
    """

    knob: str
    setting: str
    mesh: str
    element: str
    law: str
    node_count: int
    dof_count: int
    step_ms: float
    step_p99_ms: float
    error_lengths: float
    error_tensions: float
    error_weightless: float
    uncertainty_lengths: float
    uncertainty_tensions: float
    uncertainty_weightless: float
    displacement_mm: float
    file: str = ""
    mode_count: int = 0
    point_count: int = 0

    @property
    def error(self) -> float:
        """Error by which settings are compared: displacements prescribed, the larger one of the
        errors with and without gravity, because in one of them errors may cancel by chance.
        """
        return max(self.error_lengths, self.error_weightless)

    @property
    def uncertainty(self) -> float:
        """Uncertainty of the reference for `error`."""
        return max(self.uncertainty_lengths, self.uncertainty_weightless)


def read_study(path: Path) -> list[AccuracyRow]:
    """Reads what an earlier study measured of full and reduced models.

    Args:
        path: The CSV file.

    Raises:
        AccuracyError: The file cannot be read as such.
    """
    try:
        return [row for row in read_rows(path, AccuracyRow) if row.knob in (MESH, REDUCED)]
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise AccuracyError(str(path), f"cannot be read as a file of 'accuracy': {error}") from None


# Shortening of the actuated cables and growth of the cavities in each pose, as shares of their
# limits. The last cable of a scene is not actuated: its shortening and tension are zero.
POSE_SHARES = ((0.10, 0.30, 0.20), (0.20, 0.30, 0.15))
# Where forces are prescribed, they are the pressures found with prescribed volumes, and this share
# of the tensions found with prescribed lengths: without the last cable's tension the body deforms
# more.
TENSION_SHARE = 0.15
# Replaces a missing limit of a shortening, as a share of the cable's length, or of a growth, as a
# share of the cavity's volume.
OPEN_SHARE = 0.4
# Parts of the way to a pose.
_SHARES = (0.5, 1.0)
_MOST_ITERATIONS = 25
# Newton's tolerance for the residual, relative to Young's modulus times size².
_RELATIVE_TOLERANCE = 1.0e-10
# A time step that allows any change of length [s].
_LONG = 1.0


class Poses(NamedTuple):
    """Equilibria of one scene.

    Attributes:
        positions: Effectors [m], shape (pose_count, effector_count, 3); NaN where none was found.
        rest: The same at the unloaded rest shape [m], shape (effector_count, 3).
        efforts: Tensions of cables [N] and pressures of cavities [Pa], shape (pose_count,
            actuator_count).
    """

    positions: np.ndarray
    rest: np.ndarray
    efforts: np.ndarray

    @property
    def found(self) -> bool:
        """Whether an equilibrium was found for every pose."""
        return bool(np.all(np.isfinite(self.positions)))


def displacements(scene: Scene) -> np.ndarray:
    """Shortenings of cables [m] and growths of cavities [m³] in the poses, shape (pose_count,
    actuator_count).

    Args:
        scene: A scene with one body.

    Raises:
        AccuracyError: The scene has neither cables nor cavities, or no effector.
    """
    if not (scene.cables or scene.cavities) or not scene.effectors:
        raise AccuracyError(scene.name, "accuracy is measured at an effector that cables or "
                            "cavities move; this scene lacks cables and cavities, or effectors")
    most = [_greatest_shortening(cable) for cable in scene.cables] + _greatest_growths(scene)
    poses = np.zeros((len(POSE_SHARES), len(most)))
    for index, greatest in enumerate(most):
        if index == len(scene.cables) - 1 and index > 0:
            continue
        for pose, shares in zip(poses, POSE_SHARES, strict=True):
            pose[index] = shares[index % len(shares)] * greatest
    return poses


def _greatest_shortening(cable) -> float:
    """Upper limit of a cable's shortening; without a limit, a share of its length [m]."""
    if np.isfinite(cable.shortening[1]):
        return cable.shortening[1]
    stretches = np.diff(np.array([cable.pull_point, *cable.points]), axis=0)
    return OPEN_SHARE * float(np.linalg.norm(stretches, axis=1).sum())


def _greatest_growths(scene: Scene) -> list[float]:
    """Upper limit of each cavity's growth; without a limit, a share of its volume [m³]."""
    if not scene.cavities:
        return []
    groups = build_groups(lay_out(scene, []), [])
    (group,) = (group for group in groups if group.kind.section == "cavities")
    open_growths = OPEN_SHARE * group.displacement_scale
    # Without a limit of the user a cavity may grow until it bursts.
    is_limited = [np.isfinite(min(cavity.growth[1], cavity.volume[1])) for cavity in scene.cavities]
    return np.where(is_limited, group.displacement_bounds[:, 1], open_growths).tolist()


def prescribed_efforts(scene: Scene, efforts: np.ndarray) -> np.ndarray:
    """Tensions [N] and pressures [Pa] to prescribe, from those found at prescribed displacements,
    shape (pose_count, actuator_count).

    Args:
        scene: The scene.
        efforts: Tensions [N] and pressures [Pa] that were found, shape (pose_count,
            actuator_count).
    """
    prescribed, count = efforts.copy(), len(scene.cables)
    prescribed[:, :count] *= TENSION_SHARE
    if count > 1:
        prescribed[:, count - 1] = 0.0
    return prescribed


def exact_simulation(scene: Scene) -> Simulation:
    """A simulation that solves every step to rounding error, without limits of rate or effort.

    Args:
        scene: A scene with one body.
    """
    # The size is that of the corners: linear tetrahedra have no other nodes.
    by_corners = scene if scene.body.element == HEXAHEDRAL else with_element(scene, "linear")
    size = only_body(by_corners).size
    material = scene.body.material
    stiffness = law_at_rest(material, material.law).young_modulus * size**2
    free = unlimited(scene, exact=True)
    exact = with_newton(free, _MOST_ITERATIONS, _RELATIVE_TOLERANCE * stiffness)
    return Simulation(exact, with_warnings=False)


def equilibria(scene: Scene, case: str, loads: Loads) -> Poses:
    """Equilibria of a scene in the poses of a load case, see `CASES`.

    Args:
        scene: A scene with one body.
        case: Name of the load case.
        loads: What actuators are given in each pose.
    """
    scene, forces_given, poses = _given(scene, case, loads)
    simulation = exact_simulation(scene)
    rest, actuators = simulation.effector_positions(), simulation.actuators
    positions, efforts = [], []
    for pose in poses:
        simulation.reset()
        simulation.step(CommandEfforts(np.zeros(actuators.count), _LONG))
        for share in _SHARES:
            result = simulation.step(
                CommandEfforts(share * pose, _LONG) if forces_given
                else CommandSetpoints(actuators.setpoints(share * pose), _LONG)
            )  # fmt: skip
        good = (result.report.residual <= simulation.scene.solver.residual_tolerance
                and not result.report.inverted_count)
        positions.append(result.effector_positions if good else np.full_like(rest, np.nan))
        efforts.append(result.efforts)
    return Poses(np.array(positions), rest, np.array(efforts))


def _given(scene: Scene, case: str, loads: Loads) -> tuple[Scene, bool, np.ndarray]:
    """A scene as a load case has it, whether forces are prescribed, and these or displacements."""
    forces_given = case == "tensions"
    if case == "weightless":
        scene = scene.changed(gravity=(0.0, 0.0, 0.0))
    return scene, forces_given, loads.pressed if forces_given else loads.moved


# Speed of a cable without a rate limit [m/s]; otherwise half of its limit.
_SPEED_SHARE, _SPEED = 0.5, 0.02
# Angular frequency of the path of a scene without cables [rad/s].
_FREQUENCY = 2.0
# Amplitude of the path in displacements, as a share of the largest one of its centre, of cables and
# of cavities.
_RADIUS_SHARE = 0.25
# Newton's method converges quadratically from a near start: after this number of iterations the
# error is rounding error.
_EXACT_ITERATIONS = 6
# Longest duration of a timing [s], and its least number of steps.
_SECONDS, _FEWEST_STEPS = 3.0, 8
# The same for one of several rounds.
_ROUND_SECONDS = 1.0


class LengthPath(NamedTuple):
    """Displacements of all actuators at each step of a path.

    Attributes:
        displacements: Shortenings of cables [m] and growths of cavities [m³], shape
            (step_count + 1, actuator_count); the first is the start.
        time_step: Time between two steps [s].
    """

    displacements: np.ndarray
    time_step: float


class FollowedPath(NamedTuple):
    """Result of following a path.

    Attributes:
        positions: Effectors after each step [m], shape (step_count, effector_count, 3).
        times: Of the steps [s], shape (step_count,).
    """

    positions: np.ndarray
    times: np.ndarray


def length_path(scene: Scene, rate: float, step_count: int) -> LengthPath:
    """A path on which each actuator oscillates about its first pose, each with another phase.

    Args:
        scene: The scene.
        rate: Steps per second [Hz].
        step_count: Number of steps.
    """
    middle, count = displacements(scene)[0], len(scene.cables)
    radius, frequency = np.empty(len(middle)), _FREQUENCY
    radius[count:] = _RADIUS_SHARE * middle[count:].max(initial=0.0)
    if count:
        radius[:count] = _RADIUS_SHARE * middle[:count].max()
        limits = [cable.rate for cable in scene.cables
                  if cable.rate is not None and np.isfinite(cable.rate)]
        frequency = (_SPEED_SHARE * min(limits) if limits else _SPEED) / radius[0]
    angles = frequency / rate * np.arange(step_count + 1)[:, None]
    phases = 2.0 * np.pi * np.arange(len(middle)) / max(1, len(middle) - 1)
    # No cable becomes slack: its amplitude is at most its mean shortening.
    swing = np.minimum(radius, middle) * np.sin(angles + phases)
    return LengthPath(middle + swing, 1.0 / rate)


def follow_exactly(scene: Scene, path: LengthPath) -> tuple[np.ndarray, State]:
    """Follows a path with converged steps: effectors [m], shape (step_count, effector_count, 3),
    and the start.

    Args:
        scene: A scene with one body.
        path: The displacements of its actuators over time.
    """
    simulation = exact_simulation(scene)
    for share in (0.0, 0.5, 1.0):
        setpoints = simulation.actuators.setpoints(share * path.displacements[0])
        simulation.step(CommandSetpoints(setpoints, 1.0))
    start = simulation.state
    return follow_lengths(scene, path, start, _EXACT_ITERATIONS).positions, start


def follow_lengths(scene: Scene, path: LengthPath, start: State, iterations: int, **parts) -> FollowedPath:
    """Follows a path of lengths with a number of linearizations per step, from an equilibrium at
    its start.

    Args:
        scene: A scene with one body.
        path: The displacements of its actuators over time.
        start: The equilibrium at the beginning.
        iterations: Linearizations in each step.
        **parts: Arguments of `Simulation` besides, by name.
    """
    simulation = ready_simulation(scene, iterations, parts)
    return follow(simulation, start, _along(simulation, path))


def rounds_of(
    scene: Scene, path: LengthPath, iterations: int, seconds: float = _ROUND_SECONDS,
    now: Callable[[], float] = thread_time,
) -> Callable[[], np.ndarray]:  # fmt: skip
    """A function that runs the same steps along a path and returns their times [s].

    Args:
        scene: The scene.
        path: The path.
        iterations: Linearizations of a step.
        seconds: Longest time of the steps [s].
        now: The clock; by default the processor time of this thread, in which waiting for other
            programs does not count.
    """
    simulation = ready_simulation(scene, iterations, {"now": now})
    simulation.step(CommandSetpoints(simulation.actuators.setpoints(path.displacements[0]), 1.0))
    start, commands = simulation.state, _along(simulation, path)
    return lambda: follow(simulation, start, commands, seconds).times


def ready_simulation(scene: Scene, iterations: int, parts: dict) -> Simulation:
    """A simulation, warmed up, whose steps take a given number of linearizations.

    Args:
        scene: The scene; its actuators have no limits.
        iterations: Linearizations in each step.
        parts: Arguments of `Simulation` besides, by name.
    """
    # With a tolerance that is never reached, every step makes all its iterations.
    timed = with_newton(unlimited(scene), iterations, 1.0e-300)
    simulation = Simulation(timed, with_warnings=False, **parts)
    simulation.warm_up()
    return simulation


def _along(simulation: Simulation, path: LengthPath) -> list[CommandSetpoints]:
    """Commands of the steps of a path."""
    return [CommandSetpoints(simulation.actuators.setpoints(moved), path.time_step)
            for moved in path.displacements[1:]]


def follow(simulation: Simulation, start: State, commands: list, seconds: float = np.inf) -> FollowedPath:
    """Runs commands from a state.

    Args:
        simulation: Runs them.
        start: The state.
        commands: The commands.
        seconds: The run ends when its steps have taken more [s].
    """
    simulation.restore(start)
    positions, times = [], []
    with without_garbage_collection():
        for command in commands:
            result = simulation.step(command)
            positions.append(result.effector_positions)
            times.append(result.report.compute_time)
            if sum(times) > seconds and len(times) >= _FEWEST_STEPS:
                break
    return FollowedPath(np.array(positions), np.array(times))


VOLUME_TOLERANCE, BOUNDS_TOLERANCE = 0.05, 0.02
"""Allowed relative differences of volume and size between meshes of one body with curved faces."""
HEXAHEDRAL_NAME = "_hexa"
"""Word before the number in the names of files of hexahedra."""
REFINEMENTS = 2
"""Number of refinements of a mesh without a family; each one has eight times as many tetrahedra as
the one before.
"""


class ReducedModel(NamedTuple):
    """A reduced model of a mesh of a family.

    Attributes:
        path: Its file.
        level: The full model, with its element.
        mode_count: Its modes.
        point_count: Its sampled quadrature points.
    """

    path: Path
    level: MeshLevel
    mode_count: int
    point_count: int

    @property
    def scene(self) -> Scene:
        """The scene with it."""
        return self.level.scene.changed(body={"reduced": Reduced(file=self.path.resolve())})

    @property
    def columns(self) -> dict[str, object]:
        """What a row of errors says of it."""
        return {"knob": REDUCED, "setting": f"{self.mode_count} modes, {self.point_count} points",
                "file": self.path.name, "mode_count": self.mode_count, "point_count": self.point_count}


class MeshLevel(NamedTuple):
    """One mesh of a family.

    Attributes:
        name: Name in tables.
        scene: The scene on it.
        tet_count: Its tetrahedra, or its cells of any kind.
        node_count: Its nodes, of hexahedra the corners.
        size: Mean size h of its elements, the cube root of their mean volume [m].
        volume: Volume of the body [m³].
        bounds: Its smallest and largest coordinates [m], shape (2, 3).
    """

    name: str
    scene: Scene
    tet_count: int
    node_count: int
    size: float
    volume: float
    bounds: np.ndarray

    def with_element(self, element: str) -> MeshLevel:
        """The mesh with other elements of tetrahedra.

        Args:
            element: Kind of the elements.
        """
        return self._replace(scene=with_element(self.scene, element))


def mesh_family(scene: Scene, folder: Path) -> list[MeshLevel]:
    """Meshes of a scene's body, the coarsest first, all of linear tetrahedra.

    A family consists of files in one folder whose names differ only in the number at their end,
    such as ``robot_400.vtk`` and ``robot_1600.vtk``, and whose volumes and bounds agree. A mesh
    without a family is refined uniformly, up to `REFINEMENTS` times. The ``v1`` of ``robot_v1.vtk``
    is a version and does not count as such a number. Files that are left out are warned of.

    Args:
        scene: The scene.
        folder: Where refined meshes are written.

    Raises:
        SoftRobotTwinError: A mesh cannot be used, or a mesh with cavities has no family.
    """
    own = _own_level(scene)
    levels = [own, *_family(own, _siblings(scene), "linear")]
    if len(levels) == 1:
        if scene.cavities or scene.sealed_cavities:
            raise AccuracyError(scene.name, f"{scene.body.mesh.label} has no family, and a mesh with "
                                "cavities is not refined: put finer meshes beside it whose names "
                                "differ in the number at the end")
        levels = _refined(scene, folder)
    return sorted(levels, key=lambda level: level.tet_count)


def hexahedral_family(scene: Scene) -> list[MeshLevel]:
    """Meshes of the same body made of hexahedra, the coarsest first.

    They are the files beside the scene's mesh that have ``_hexa`` before the number at the end, such
    as ``robot_hexa_300.vtk`` beside ``robot_400.vtk``, and whose volumes and bounds agree with it.
    A box without a file has itself, made of hexahedra.

    Args:
        scene: The scene, on a mesh of tetrahedra.

    Returns:
        The scene on these meshes; empty without such files.
    """
    if scene.body.mesh.box is not None:
        return [_level(f"{scene.mesh_name}_hexa", scene, HEXAHEDRAL)]
    own = _own_level(scene)
    levels = _family(own, _siblings(scene, HEXAHEDRAL_NAME), HEXAHEDRAL)
    return sorted(levels, key=lambda level: level.tet_count)


def _family(own: MeshLevel, files: Iterable[Path], element: str) -> Iterator[MeshLevel]:
    """The meshes of files that are of the same body as the scene's own."""
    for path in files:
        try:
            level = _level(path.stem, with_mesh_file(own.scene, path.resolve()), element)
        except SoftRobotTwinError as error:
            warn(f"{path.name} is left out: {error}")
            continue
        if reason := _difference(own, level):
            warn(f"{path.name} is left out, not the body of {own.name}: {reason}")
        else:
            yield level


def _siblings(scene: Scene, word: str = "") -> list[Path]:
    """Files in the folder of a scene's mesh whose names differ from its name only in the number at
    the end, and by a word before that number. A box and a CAD file have none."""
    if scene.body.mesh.file is None or scene.body.mesh.is_cad:
        return []
    own = scene.mesh_path
    named = re.fullmatch(r"(.*?)_?\d+", own.stem)
    if not named or re.search(r"(?i)(^|[^a-z])v$", named[1]):
        return []
    pattern = re.compile(re.escape(named[1] + word) + r"_?\d+" + re.escape(own.suffix))
    return [path for path in sorted(own.parent.iterdir())
            if pattern.fullmatch(path.name) and path.name != own.name]


def _difference(own: MeshLevel, other: MeshLevel) -> str:
    """Why two meshes are not of the same body; empty when they are."""
    grown = other.volume / own.volume - 1.0
    if abs(grown) > VOLUME_TOLERANCE:
        return (f"its volume differs by {100.0 * grown:+.1f} % "
                f"(allowed: {100.0 * VOLUME_TOLERANCE:g} %)")
    size = float(np.linalg.norm(own.bounds[1] - own.bounds[0]))
    apart = float(np.abs(other.bounds - own.bounds).max())
    if apart > BOUNDS_TOLERANCE * size:
        return (f"its bounds differ by {1e3 * apart:.2f} mm (allowed: "
                f"{1e3 * BOUNDS_TOLERANCE * size:.2f} mm)")
    return ""


def _level(name: str, scene: Scene, element: str = "linear") -> MeshLevel:
    scene = with_element(scene, element)
    mesh = only_body(scene).mesh
    size = float(np.cbrt(mesh.volume / mesh.cell_count))
    return MeshLevel(name, scene, mesh.cell_count, mesh.corner_mesh.node_count, size,
                     mesh.volume, mesh.bounding_box)


def write_mesh(path: Path, mesh: TetMesh) -> None:
    """Writes a mesh as binary VTK.

    Args:
        path: The file.
        mesh: The mesh.
    """
    import meshio

    content = meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)])
    content.write(path, file_format="vtk42", binary=True)


def _refined(scene: Scene, folder: Path) -> list[MeshLevel]:
    """The scene's own mesh and its refinements, with the same fixed regions."""
    levels = [_own_level(scene)]
    body = only_body(with_element(scene, "linear"))
    mesh, held = body.mesh, body.held
    for number in range(1, REFINEMENTS + 1):
        mesh, ends = refine(mesh)
        held = np.concatenate([held, held[ends].all(axis=1)])
        file = (folder / f"{scene.mesh_name}_refined_{number}.vtk").resolve()
        folder.mkdir(parents=True, exist_ok=True)
        write_mesh(file, mesh)
        regions = tuple(
            FixedRegion(nodes=np.flatnonzero((held == axes).all(axis=1)), axes=np.array(["x", "y", "z"])[axes])
            for axes in np.unique(held, axis=0) if axes.any())
        placed = {"file": file, "box": None, "size": None, "scale": 1.0, "rotation": (0.0,) * 3,
                  "translation": (0.0,) * 3}
        finer = scene.changed(body={"mesh": placed, "fixed": regions})
        levels.append(_level(file.stem, finer))
    return levels


CASES = ("lengths", "tensions", "weightless")
"""Load cases: displacements prescribed, forces prescribed, displacements prescribed without
gravity.
"""
RATE = 100.0
"""Rate of the moving path on which steps are timed [Hz]."""
ASYMPTOTIC = 2.25
"""The extrapolation uses meshes up to this many times coarser than the finest."""


class Limits(NamedTuple):
    """Size limits of a study.

    Attributes:
        timed_dof: Most unknowns of a setting that is measured.
        reference_dof: Most unknowns of a mesh used for the reference.
        timed_steps: Most steps that are timed for a setting.
    """

    timed_dof: int = 60_000
    reference_dof: int = 200_000
    timed_steps: int = 200


class Reference(NamedTuple):
    """The reference solution of one load case.

    Attributes:
        limit: Limit of the effectors' positions [m], with its uncertainty.
        displacement: Root mean square of the effectors' displacement from rest [m].
        meshes: Meshes used for it, the coarsest first.
    """

    limit: Extrapolation
    displacement: float
    meshes: tuple[str, ...]

    @property
    def uncertainty(self) -> float:
        """Uncertainty relative to the displacement."""
        return self.limit.uncertainty / np.sqrt(self.limit.value[..., 0].size) / self.displacement

    def error(self, poses: Poses) -> float:
        """Error of effector positions: root mean square over poses and effectors, relative to the
        displacement.

        Args:
            poses: The equilibria that are judged.
        """
        return mean_distance(poses.positions - self.limit.value) / self.displacement


class Study(NamedTuple):
    """Result of a study.

    Attributes:
        rows: Mesh, element and law, each with its errors and its time.
        references: By load case.
        loads: What is prescribed in the poses.
    """

    rows: list[AccuracyRow]
    references: dict[str, Reference]
    loads: Loads


class Loads(NamedTuple):
    """What is prescribed in the poses.

    Attributes:
        moved: Displacements of the actuators [m, m³], shape (pose_count, actuator_count).
        pressed: Their efforts [N, Pa], same shape; None where only displacements are.
    """

    moved: np.ndarray
    pressed: np.ndarray | None = None


def study_meshes(levels: list[MeshLevel], limits: Limits, hexahedra: Sequence[MeshLevel] = ()) -> Study:
    """Measures every mesh with every element and law, and shows the progress.

    Args:
        levels: Meshes of linear tetrahedra, the coarsest first.
        limits: Size limits.
        hexahedra: Meshes of hexahedra, see `hexahedral_family`; they are no part of the reference.

    Raises:
        AccuracyError: No effector moves, or no reference was found.
    """
    name = levels[0].scene.name
    moved = displacements(levels[0].scene)
    every = [level.with_element(element) for element in ELEMENTS for level in levels]
    used = [level for level in every if level.scene.body.element == "quadratic"
            and dof_count(level) <= limits.reference_dof]
    if len(used) < 2:
        raise AccuracyError(name, "a reference needs two quadratic meshes of at most "
                            f"{limits.reference_dof} dof; there are {len(used)}")
    own = levels[0].scene.body.material.law
    models = [(level, law) for law in dict.fromkeys((own, "corotational", "linear"))
              for level in (*every, *hexahedra) if dof_count(level) <= limits.timed_dof]
    loads, solved = _solve_reference(used, moved)
    references = {case: _reference(name, case, used, solved, loads) for case in CASES}
    rows = []
    for level, law in tracked(models, "meshes", len(models), lambda done: f"{done[0].name}, {done[1]} law"):
        known = solved.get(level.name) if law == own and level in used else None
        rows.append(_judge(level, law, loads, references, known, limits.timed_steps))
    return Study(rows, references, loads)


def dof_count(level: MeshLevel) -> int:
    """Number of unknowns, without building the whole simulation.

    Args:
        level: The mesh, with its scene.
    """
    return 3 * int(np.count_nonzero(~only_body(level.scene).fixed))


def _solve_reference(used: list[MeshLevel], moved: np.ndarray) -> tuple[Loads, dict[str, dict[str, Poses]]]:
    """Equilibria on the quadratic meshes; the finest one determines the prescribed efforts."""
    solved: dict[str, dict[str, Poses]] = {}
    loads = None
    for level in tracked(reversed(used), "reference", len(used), lambda done: done.name):
        lengths = equilibria(level.scene, "lengths", Loads(moved))
        if loads is None:
            loads = Loads(moved, prescribed_efforts(level.scene, lengths.efforts))
        others = {case: equilibria(level.scene, case, loads) for case in CASES[1:]}
        solved[level.name] = {"lengths": lengths, **others}
    return loads, solved


def _reference(name: str, case: str, used: list[MeshLevel], solved, loads: Loads) -> Reference:
    good = [level for level in used if solved[level.name][case].found]
    if len(good) < 2:
        given = "forces" if case == "tensions" else "displacements"
        raise AccuracyError(name, f"no reference for prescribed {given}: Newton's iterations "
                            "converged on fewer than two quadratic meshes")
    corrected = _corrected_limit(case, good, solved, loads)
    asymptotic = [level for level in good if level.size <= ASYMPTOTIC * good[-1].size]
    good = asymptotic if len(asymptotic) > 2 else good[-3:]
    limit = extrapolate([level.size for level in good],
                        [solved[level.name][case].positions for level in good])
    if corrected is not None and corrected[0].uncertainty <= limit.uncertainty:
        limit, good = corrected
    displacement = mean_distance(limit.value - solved[good[-1].name][case].rest)
    return Reference(limit, displacement, tuple(level.name for level in good))


def _corrected_limit(
    case: str, good: list[MeshLevel], solved, loads: Loads
) -> tuple[Extrapolation, list[MeshLevel]] | None:
    """The limit by elements of higher order on the finest mesh that they are built for.

    Its uncertainty is the distance from the same limit on the next coarser mesh, and half of what is
    extrapolated.

    Returns:
        The limit and both meshes, the coarser first; None where there are no such limits on two.
    """
    limits: list[np.ndarray] = []
    used: list[MeshLevel] = []
    for level in reversed(good):
        try:
            found = _limits(level.scene, case, loads)
        except MeshErrorUnknown:
            continue
        if not limits:
            added = found - solved[level.name][case].positions
        limits.append(found)
        used.insert(0, level)
        if len(limits) == 2 and np.isfinite(limits).all():
            guessed = LEFT_OUT / (1.0 + LEFT_OUT) * np.linalg.norm(added)
            doubt = np.linalg.norm(limits[0] - limits[1]) + 0.5 * guessed
            return Extrapolation(limits[0], None, float(doubt)), used
    return None


def _limits(scene: Scene, case: str, loads: Loads) -> np.ndarray:
    """Limits of the effectors' positions in the poses of a case [m]; NaN where none was found.

    Raises:
        MeshErrorUnknown: The scene has no estimate of its mesh's error.
    """
    scene, forces_given, poses = _given(scene, case, loads)
    free = unlimited(scene, exact=True)
    estimator, actuators, found = MeshErrorEstimator(free), Simulation(free, with_warnings=False).actuators, []
    for pose in poses:
        wanted = [share * pose for share in _SHARES]
        values = wanted if forces_given else [actuators.setpoints(one) for one in wanted]
        limit = estimator.limit_at(*(ActuatorLoads(forces_given, one, {}) for one in values))
        found.append(np.full((len(scene.effectors), 3), np.nan) if limit is None else limit)
    return np.array(found)


def _judge(level, law, loads, references, known, timed_steps) -> AccuracyRow:
    element = level.scene.body.element
    scene = with_law(level.scene, law)
    solved = known or {case: equilibria(scene, case, loads) for case in CASES}
    path = length_path(scene, RATE, timed_steps)
    times = spread(rounds_of(scene, path, 1, _SECONDS, perf_counter)())
    simulation = Simulation(scene)
    errors = {f"error_{case}": references[case].error(solved[case]) for case in CASES}
    doubts = {f"uncertainty_{case}": references[case].uncertainty for case in CASES}
    return AccuracyRow(
        MESH, f"{element}, {law}", level.name, element, law, simulation.node_count,
        simulation.dof_count, 1e3 * times.median, 1e3 * times.p99, **errors, **doubts,
        displacement_mm=1e3 * references["lengths"].displacement)


def study_reduced(reduced: ReducedModel, study: Study, timed_steps: int) -> AccuracyRow:
    """Error of a reduced model against the reference of a study, and the time of its step.

    Args:
        reduced: The reduced model of one of the meshes of the study.
        study: The study of the full models.
        timed_steps: Most steps that are timed.
    """
    level = reduced.level._replace(scene=reduced.scene)
    row = _judge(level, level.scene.body.material.law, study.loads, study.references, None, timed_steps)
    return replace(row, **reduced.columns)


class Differences(NamedTuple):
    """How far the effectors of two models of one robot are apart in the poses of a study.

    They are root mean squares over poses and effectors, relative to the displacement of the first
    model; NaN where either has no equilibrium.

    Attributes:
        moved: With displacements prescribed.
        pressed: With efforts prescribed.
    """

    moved: float
    pressed: float


def differences(scene: Scene, other: Scene) -> Differences:
    """Compares two models of one robot in the poses of a study.

    Args:
        scene: A scene with one body.
        other: The same robot by another model.
    """
    loads = Loads(displacements(scene))
    own, others = (equilibria(one, "lengths", loads) for one in (scene, other))
    loads = loads._replace(pressed=prescribed_efforts(scene, own.efforts))
    free, others_free = (equilibria(one, "tensions", loads) for one in (scene, other))
    return Differences(_apart(own, others), _apart(free, others_free))


def _apart(poses: Poses, others: Poses) -> float:
    apart = np.linalg.norm(others.positions - poses.positions)
    return float(apart / np.linalg.norm(poses.positions - poses.rest))


def mean_distance(apart: np.ndarray) -> float:
    """Root mean square of the lengths of vectors, shape (..., 3).

    Args:
        apart: The vectors, shape (..., 3).
    """
    return float(np.linalg.norm(apart) / np.sqrt(apart[..., 0].size))
