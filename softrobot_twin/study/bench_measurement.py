"""Measurements of ``bench``: the cases, their commands, and the timing of their steps.

A case moves its effectors on a circle, moves its actuators over their limits, repeats the longest
constant part of a commands file, or follows a part of a targets file. Beside the steps, SuperLU and
dense products are timed.
"""

from __future__ import annotations

import cProfile
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count, cycle, repeat
from pathlib import Path
from time import perf_counter, thread_time
from typing import NamedTuple

import numpy as np
from numba.core.registry import CPUDispatcher
from scipy.interpolate import interp1d

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.force_observer import USUAL_NOISE, ForceObserver
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.errors import NamedError, SoftRobotTwinError
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.actuator_entries import Cable
from softrobot_twin.scene.body_entries import Body, BoxMesh, BoxRegion, Mesh, Region
from softrobot_twin.scene.loading import changes_of
from softrobot_twin.scene.scene_changes import with_mesh_file
from softrobot_twin.scene.scene_parameters import changed_scene
from softrobot_twin.scene.schema import Effector
from softrobot_twin.shared_files import shared_folders
from softrobot_twin.simulation import (
    CommandSetpoints,
    FollowTargets,
    Hold,
    Simulation,
    Status,
    StepReport,
)
from softrobot_twin.simulation.command import Command
from softrobot_twin.simulation.runs.input_tables import read_commands, read_targets
from softrobot_twin.solvers.dense_stiffness import without_rows
from softrobot_twin.solvers.factorization import Factorization
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.multifrontal.condensation import ConstraintColumns
from softrobot_twin.solvers.multifrontal.symbolic import NONE
from softrobot_twin.study.accuracy_study import OPEN_SHARE
from softrobot_twin.study.direct_run import run_commands
from softrobot_twin.study.machine_facts import resident_bytes
from softrobot_twin.study.timing import (
    DenseSpeed,
    Spread,
    SuperLUReference,
    spread,
    without_garbage_collection,
)


def growth_exponent(sizes, times) -> float:
    """Slope of a straight line through (log size, log time), by least squares.

    Args:
        sizes: Sizes, above zero, shape (count,).
        times: Times, same shape; points without a positive time are left out.

    Returns:
        The exponent; NaN when fewer than two different sizes are left.
    """
    sizes, times = np.asarray(sizes, dtype=float), np.asarray(times, dtype=float)
    known = np.isfinite(times) & (times > 0.0)
    x, y = np.log(sizes[known]), np.log(times[known])
    return float(np.polyfit(x, y, 1)[0]) if len(np.unique(x)) > 1 else float("nan")


class FlopCount(NamedTuple):
    """Number of floating-point operations.

    Attributes:
        factor: Of the numeric factorization.
        solves: Of Y = L⁻¹Hᵀ, y = L⁻¹b, W = YᵀY, and the solve back.
    """

    factor: float
    solves: float


def flop_count(
    factorization: Factorization, row_nodes: np.ndarray, row_count: int
) -> FlopCount | None:
    """Counts operations, including those on zeros inside fronts.

    Args:
        factorization: The factorization.
        row_nodes: Free nodes that rows H touch.
        row_count: Rows of H.

    Returns:
        The counts; None for a factorization that has no fronts to count on.
    """
    if not isinstance(factorization, Multifrontal):
        return None
    fronts = factorization.layout.fronts
    rows, columns = fronts["rows"].astype(float), fronts["columns"].astype(float)
    # A column of height h costs h²: a root, h - 1 quotients, and h (h - 1) for the rest.
    factor = float(np.sum(_squares(rows) - _squares(rows - columns)))
    entries = _heights(rows) - _heights(rows - columns)
    reach = ConstraintColumns(factorization.elimination)
    reach.most_sizes(factorization.elimination_rank[row_nodes], row_count)
    reached = reach.places[fronts["first_rank"]] != NONE
    # An entry of L is a multiplication and an addition for every right-hand side.
    forward = 2.0 * (row_count * entries[reached].sum() + entries.sum())
    gram = (row_count + 1) * (row_count + 2) * reach.trees["dof_count"].sum()
    return FlopCount(factor, float(forward + gram + 2.0 * entries.sum()))


def _squares(n: np.ndarray) -> np.ndarray:
    """1² + 2² + … + n²."""
    return n * (n + 1.0) * (2.0 * n + 1.0) / 6.0


def _heights(n: np.ndarray) -> np.ndarray:
    """1 + 2 + … + n."""
    return 0.5 * n * (n + 1.0)


CIRCLE_TIME_STEP = 0.01
"""Time from one target to the next [s]."""
# Initial shortening of every cable and pressure of every cavity as a share of its limit, so that no
# cable is slack.
_PRETENSION_SHARE = 0.25
# A displacement of more than this multiple of its scale is that at which a cavity bursts.
_BURST_SHARE = 10.0
_PRETENSION_STEPS = 60
_STEPS_A_ROUND = 500
# Radius of the circle, as a share of the body's size.
_RADIUS_SHARE = 0.03
_APPROACH_STEPS = 30


class NothingToFollowError(NamedError):
    """A scene has no actuator, none with a limit, or has contact."""

    def __init__(self, scene: str, reason: str):
        super().__init__(scene, "a benchmark moves effectors on a circle, or actuators over their "
                         f"limits where there is no effector; {reason}")


def largest_drives(simulation: Simulation) -> np.ndarray:
    """What the setpoints hold at most: displacements, or efforts, shape (actuator_count,).

    Args:
        simulation: The scene. A displacement without a limit is limited to a share of its scale.

    Raises:
        NothingToFollowError: A pressure has no limit.
    """
    limits, actuators = simulation.limits, simulation.actuators
    # A cable without a limit is limited by its length at rest, a cavity by where it bursts.
    scales = np.where(actuators.one_sided, 1.0, _BURST_SHARE) * limits.displacement_scale
    is_open = ~actuators.is_effort_driven & (limits.drive_max >= scales)
    most = np.where(is_open, OPEN_SHARE * limits.displacement_scale, limits.drive_max)
    for index in np.flatnonzero(~np.isfinite(most)):
        word = actuators.driven_quantities(actuators.is_effort_driven)[index].word
        raise NothingToFollowError(
            simulation.scene.name, f"{actuators.names[index]}.{word} has no upper limit")
    return most


def circle_targets(simulation: Simulation) -> Iterator[FollowTargets]:
    """Targets on a horizontal circle of all effectors about their position with pretensioned
    cables.

    Moves the actuators, and the effectors onto the circle; these steps are not timed.

    Args:
        simulation: At rest; stays at the beginning of the circle.

    Raises:
        NothingToFollowError: The scene has no actuators, none with a limit, or has contact.
    """
    _check_can_be_driven(simulation)
    setpoints = simulation.actuators.setpoints(_PRETENSION_SHARE * largest_drives(simulation))
    for _ in range(_PRETENSION_STEPS):
        simulation.step(CommandSetpoints(setpoints, 5.0 * CIRCLE_TIME_STEP))
    centre = simulation.effector_positions()
    radius = _RADIUS_SHARE * simulation.model.nodes.size

    def command(number: int) -> FollowTargets:
        angle = 2.0 * math.pi * number / _STEPS_A_ROUND
        offset = radius * np.array([math.cos(angle), math.sin(angle), 0.0])
        return FollowTargets(centre + offset, CIRCLE_TIME_STEP)

    for _ in range(_APPROACH_STEPS):
        simulation.step(command(0))
    return map(command, count(1))


def swept_setpoints(simulation: Simulation) -> Iterator[CommandSetpoints]:
    """Setpoints that oscillate between the limits of their actuators, each with another phase.

    Moves the actuators to the beginning; these steps are not timed.

    Args:
        simulation: At rest.

    Raises:
        NothingToFollowError: See `circle_targets`.
    """
    _check_can_be_driven(simulation)
    actuators, limits = simulation.actuators, simulation.limits
    most = largest_drives(simulation)
    # What has no vacuum, or a lower limit of a displacement, begins at rest.
    by_effort = actuators.is_effort_driven
    least = np.where(by_effort & np.isfinite(limits.drive_min), limits.drive_min, 0.0)
    middle, swing = 0.5 * (most + least), 0.5 * (most - least)
    phases = 2.0 * math.pi * np.arange(actuators.count) / max(1, actuators.count)

    def command(number: int) -> CommandSetpoints:
        angles = 2.0 * math.pi * number / _STEPS_A_ROUND + phases
        return CommandSetpoints(actuators.setpoints(middle - swing * np.cos(angles)),
                                CIRCLE_TIME_STEP)

    for _ in range(_PRETENSION_STEPS):
        simulation.step(command(0))
    return map(command, count(1))


def _check_can_be_driven(simulation: Simulation) -> None:
    """Refuses scenes without actuators, and with contact."""
    if not simulation.actuator_names:
        raise NothingToFollowError(simulation.scene.name, "this scene has no actuators")
    if simulation.model.contacts is not None:
        raise NothingToFollowError(
            simulation.scene.name, "in contact neither is done: 'bench --commands FILE.csv' times "
            "this scene along a commands file")


RATE = 250.0
"""Steps a second [Hz]."""
# Oscillations after the motion decay during this share of the hold.
_SETTLING_SHARE = 0.25


class NoHoldError(NamedError):
    """A commands file has no part with constant commands."""


def held_commands(simulation: Simulation, path: Path) -> Iterator[Command]:
    """Commands of the longest hold of a commands file, for any number of steps; guided bodies keep
    their poses.

    Runs the file up to the hold; these steps are not timed.

    Args:
        simulation: At rest; stays in the hold, after the motion before it has decayed.
        path: The commands file.

    Raises:
        NoHoldError: The file has no hold.
        TableFileError: The file does not fit the scene.
    """
    commanded = read_commands(path, simulation)
    begin, end = commanded.longest_hold
    if math.isnan(begin):
        raise NoHoldError(path, "a benchmark times the longest hold, an interval in which no "
                          "command changes; there is none")
    time = begin + _SETTLING_SHARE * (end - begin)
    for row in run_commands(simulation, commanded, RATE):
        if row.time >= time:
            break
    return repeat(commanded.command(time, 1.0 / RATE))


INTERVAL_TIME_STEP = 0.02
"""Time between two targets [s]."""
_SETTLING_STEPS = 40


class FileInterval(NamedTuple):
    """A time interval of a targets file.

    Attributes:
        path: The file.
        begin: Start of the interval [s].
        end: End of the interval [s].
    """

    path: Path
    begin: float
    end: float


def interval_targets(simulation: Simulation, interval: FileInterval) -> Iterator[FollowTargets]:
    """Targets of an interval, followed forwards and backwards for any number of steps.

    Follows the file up to the interval; these steps are not timed.

    Args:
        simulation: At rest.
        interval: The interval of the file.

    Raises:
        TableFileError: The file does not fit the scene.
    """
    table = read_targets(interval.path, simulation)
    between_rows = interp1d(table.times, table.values, axis=0)

    def command(time: float) -> FollowTargets:
        return FollowTargets(between_rows(time), INTERVAL_TIME_STEP)

    for _ in range(_SETTLING_STEPS):
        simulation.step(Hold(INTERVAL_TIME_STEP))
    for time in np.arange(table.times[0], interval.begin, INTERVAL_TIME_STEP):
        simulation.step(command(time))
    times = np.arange(interval.begin, interval.end, INTERVAL_TIME_STEP)
    return map(command, cycle([*times[1:], *times[-2::-1]]))


_DIAMOND = Path("scenes") / "diamond.yaml"
_REFINEMENTS = (400, 600, 1600, 4500, 15000)
# The Diamond has no good mesh of 500 dof, because its struts are thin, and its finest mesh has less
# than 50 000 dof. A column of the same material, 30 × 30 × 200 mm, is used for both sizes.
_COLUMN_SIZE = (0.030, 0.030, 0.200)
_COLUMN_CELLS = ((2, 2, 18), (12, 12, 98))
# Heights of the column's cable points, as shares of its length.
_CABLE_HOLDS = (0.25, 0.5, 0.75, 0.9)


class NoDefaultSceneError(SoftRobotTwinError):
    """The Diamond's scene file is not where the package keeps it."""

    def __init__(self, looked: list[Path]):
        super().__init__("the Diamond's scene was not found; give a scene. Looked for "
                         + ", ".join(map(str, looked)))


class Paper(NamedTuple):
    """Published values of a robot (Coevoet 2017, table 1).

    Attributes:
        dof: Unknowns of its mesh.
        step: Time of a step, contact included [s].
        source: Origin of the time, for messages.
        required: Longest allowed step [s]; a share of the published one when None.
    """

    dof: int
    step: float
    source: str = "the paper's"
    required: float | None = None


class BenchCase(NamedTuple):
    """One scene to measure.

    Attributes:
        name: Name in tables.
        scene: The scene.
        family: Sizes of one family differ in the mesh only; growth is fitted over a family.
        has_requirements: The requirements on the step's time apply to this case.
        commands: Commands file whose longest hold is timed; None for a circle of the effectors or
            a sweep.
        interval: Interval of a targets file that is followed instead, or None.
        sweeps: Actuators move over their limits, also where there are effectors.
        paper: Published values of this robot, or None.
    """

    name: str
    scene: Scene
    family: str
    has_requirements: bool = False
    commands: Path | None = None
    paper: Paper | None = None
    interval: FileInterval | None = None
    sweeps: bool = False


def default_scene_path() -> Path:
    """The Diamond's scene file.

    Raises:
        NoDefaultSceneError: It is not there.
    """
    candidates = [folder / "config" / _DIAMOND for folder in shared_folders()]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise NoDefaultSceneError(candidates)


def given_cases(paths: list[Path], commands: Path | None = None) -> list[BenchCase]:
    """Cases of a user's scenes, which form one family.

    Args:
        paths: Scene files; the package's own robots with contact or cavities use their standard
            commands.
        commands: Commands file whose longest hold is timed, or None.
    """
    cases, ours = [], robot_cases() if any(path.is_file() for path in paths) else []
    for path in paths:
        known = [case for case in ours if path.is_file() and case.scene.path.samefile(path)]
        if known and commands is None:
            cases += [case._replace(scene=changed_scene(case.scene, changes_of(path)))
                      for case in known]
            continue
        scene = load_scene(path)
        family = "the given scenes" + (", reduced" if is_reduced(scene) else "")
        cases.append(BenchCase(path.stem, scene, family, _is_default(path), commands))
    return cases


def is_reduced(scene: Scene) -> bool:
    """Whether a body of a scene is reduced to modes.

    Args:
        scene: The scene.
    """
    return any(body.reduced is not None for body in scene.deformables)


def full_size(size: SizeMeasurement, sizes: Sequence[SizeMeasurement]) -> SizeMeasurement | None:
    """The full model of a reduced one among measured sizes; None where there is none.

    Args:
        size: What was measured of a model.
        sizes: All that was measured.
    """
    if not size.is_reduced:
        return None
    own = _bodies(size.case.scene)
    return next((other for other in sizes if not other.is_reduced
                 and _bodies(other.case.scene) == own), None)


def _bodies(scene: Scene) -> list[tuple]:
    """Mesh, element and material of each body, which a reduced model shares with its full one."""
    return [(body.mesh if body.mesh.file is None else
             body.mesh.changed(file=scene.file_path(body.mesh.file).resolve()),
             body.element, body.material) for body in scene.deformables]


def robot_cases() -> list[BenchCase]:
    """The robots of the package that have figures of the paper, or are driven in their own way."""
    folder = default_scene_path().parent

    def case(
        name: str, family: str = "", commands: str = "", path: tuple[str, float, float] | None = None,
        paper: Paper | None = None, sweeps: bool = False,
    ) -> BenchCase:  # fmt: skip
        """The case of a scene: a commands file, or a targets file and an interval of it [s]."""
        return BenchCase(
            name, load_scene(folder / f"{name}.yaml"), family or f"the {name.capitalize()}",
            commands=folder.parent / "commands" / commands if commands else None, paper=paper,
            interval=path and FileInterval(folder.parent / "targets" / path[0], *path[1:]),
            sweeps=sweeps,
        )  # fmt: skip

    # It touches a cylinder in this interval.
    trunk = case("trunk_cylinders", "the Trunk", path=("trunk_path.csv", 5.6, 8.3))
    small = with_mesh_file(trunk.scene, trunk.scene.mesh_path.with_name("trunk_700.vtk"))
    small = small.changed(
        obstacles=small.obstacles[:1], contact={"between": small.contact.between[:1]})
    # Published for the Diamond in the C++ framework: 32 modes and hyper-reduction.
    published = Paper(32, 4.6e-3, "the published reduction's", required=0.3e-3)
    reduced = case("diamond_reduced", "the Diamond, reduced", paper=published)
    best = "its C++ code's best"
    return [
        case("grasper", commands="grasper_lift.csv", paper=Paper(1422, 5.0e-3)),
        case("octoleg", commands="octoleg_curl.csv", paper=Paper(360, 1.7e-3)),
        # The paper's small mesh, with one obstacle.
        trunk._replace(name="trunk_700", scene=small, paper=Paper(2100, 4.5e-3, best)),
        trunk._replace(name="trunk_900", paper=Paper(4995, 29.0e-3)),
        case("springy", sweeps=True, paper=Paper(4596, 19.7e-3, best, required=4.0e-3)),
        # Its tips close and open in this interval.
        case("pneunet_inverse", "the PneuNet", path=("pneunet_tips.csv", 0.5, 11.5),
             paper=Paper(3642, 8.5e-3, best, required=2.0e-3)),
        # With all its nodes, and reduced to two vertebrae, which the paper's step is of.
        case("fetch", "the fetch"),
        case("fetch_reduced", "the fetch_reduced", paper=Paper(12, 7.5e-3, required=0.25e-3)),
        case("cantilever", "the cantilever", sweeps=True),
        case("flexo", path=("flexo_circle.csv", 4.0, 12.0),
             paper=Paper(912, 4.5e-3, required=0.4e-3)),
        case("stifface", paper=Paper(2285, 30.0e-3, required=3.0e-3)),
        reduced._replace(name="diamond_quadratic", family="the Diamond, quadratic", paper=None,
                         scene=reduced.scene.changed(body={"reduced": None})),
        reduced,
    ]  # fmt: skip


def standard_cases() -> list[BenchCase]:
    """Sizes from 500 to 50 000 dof, the smallest first."""
    path = default_scene_path()
    diamond = load_scene(path)
    meshes = diamond.mesh_path.parent
    diamonds = [
        BenchCase(f"diamond_{nodes}", with_mesh_file(diamond, meshes / f"diamond_{nodes}.vtk"),
                  "the Diamond", diamond.mesh_path.name == f"diamond_{nodes}.vtk")
        for nodes in _REFINEMENTS
    ]
    small, large = (_column_case(diamond, cells) for cells in _COLUMN_CELLS)
    return [small, *diamonds, large, *robot_cases()]


def _is_default(path: Path) -> bool:
    try:
        return path.resolve() == default_scene_path().resolve()
    except NoDefaultSceneError:
        return False


def _column_case(diamond: Scene, cells: tuple[int, int, int]) -> BenchCase:
    """A hanging column with four cables inside it, halfway between its axis and its sides."""
    half, length = 0.5 * _COLUMN_SIZE[0], _COLUMN_SIZE[2]
    top = Region(box=BoxRegion(minimum=(-1.1 * half, -1.1 * half, -1e-6),
                               maximum=(1.1 * half, 1.1 * half, 1e-6)))
    out = 0.5 * half
    places = {"north": (0.0, out), "west": (-out, 0.0), "south": (0.0, -out), "east": (out, 0.0)}
    typical = diamond.cables[0]
    cables = tuple(
        Cable(name=side, pull_point=(x, y, 0.02),
              points=tuple((x, y, -share * length) for share in _CABLE_HOLDS),
              shortening=(0.0, 0.012), rate=typical.rate, tension=typical.tension)
        for side, (x, y) in places.items()
    )
    scene = diamond.model_copy(update={
        "name": "column", "markers": (), "cables": cables,
        "body": Body(mesh=Mesh(box=BoxMesh(size=_COLUMN_SIZE, cells=cells),
                               translation=(-half, -half, -length)),
                     element="linear", material=diamond.body.material, fixed=(top,)),
        "effectors": (Effector(name="tip", points=((0.0, 0.0, -length),)),),
    })
    return BenchCase("column_" + "x".join(map(str, cells)), scene, "the columns")


WHOLE_STEP = "whole step"
SUPERLU = "one SuperLU factorization"
OBSERVER = "observer, beside the step"
CONTROL = "control, beside the step"
OUTSIDE = "outside the stages"
"""Time outside the stages: checks of commands, copies of states, reports."""
# SuperLU takes much longer than a step, so it runs only between some of the timed steps.
_SUPERLU_SAMPLES = 20
_SUPERLU_SECONDS = 20.0
_FEWEST_SAMPLES = 3
COUNTED_STEPS = 40
"""Steps whose calls are counted."""
INTERRUPTION = 1.0e-4
"""A step that waited longer than this for the processor was interrupted [s]."""
# Stages of factorization and solves, to be compared with the speed of dense products.
_ALGEBRA = ("factor", "condense", "correct")


@dataclass(frozen=True)
class SizeMeasurement:
    """Measurements of one case.

    Attributes:
        case: The measured case.
        factorization: Name of the factorization.
        thread_count: Threads that factorize.
        node_count: Nodes of the mesh.
        tet_count: Its tetrahedra.
        dof_count: Unknowns.
        mode_count: Modes of reduced bodies, 0 without any.
        point_count: Sampled quadrature points of these.
        row_count: Rows of H, median.
        contact_count: Contacts with force, median.
        stages: Time of each stage [s], of what is outside them, of the whole step, and of an observer
            and of `control` beside it.
        step_count: Steps timed.
        superlu: Time of one SuperLU factorization of the same matrices [s]; NaN for a reduced
            model, whose matrix is dense and small.
        superlu_count: Number of timed SuperLU factorizations.
        superlu_page_faults: Page faults in one SuperLU factorization, median; see `SuperLUReference.factorize`.
        interrupted_share: Share of steps during which another program took the processor.
        flops: Operations of factor and solves; None where they cannot be counted.
        dense_speed: Speed of a dense product in the same run [flop/s].
        factor_bytes: Buffers of the factor; None where a library allocates them.
        resident: Memory of the process before the first call of SuperLU [B].
        statuses: Number of timed steps by status.
        qp_solvers: Number of timed steps by solver of the inverse problem.
        calls: Calls of Python functions in a step, those that are written in C too, in the mean.
        kernel_share: Share of a step's time that kernels take, in the median.
        beside: Time of the twin's tick beside its step, without ROS [s], in the median; NaN where no
            targets lead.
    """

    case: BenchCase
    factorization: str
    thread_count: int
    node_count: int
    tet_count: int
    dof_count: int
    mode_count: int
    point_count: int
    row_count: float
    contact_count: float
    stages: dict[str, Spread]
    step_count: int
    superlu: Spread
    superlu_count: int
    superlu_page_faults: float
    interrupted_share: float
    flops: FlopCount | None
    dense_speed: float
    factor_bytes: int | None
    resident: int | None
    statuses: Counter[str]
    qp_solvers: Counter[str]
    calls: float
    kernel_share: float
    beside: float

    @property
    def is_reduced(self) -> bool:
        """Whether a body is reduced to modes."""
        return self.mode_count > 0

    @property
    def times(self) -> dict[str, Spread]:
        """Those of the stages, and of one SuperLU factorization where it was timed [s]."""
        return self.stages | ({SUPERLU: self.superlu} if self.superlu_count else {})

    @property
    def ratio(self) -> float:
        """The whole step in SuperLU factorizations, medians."""
        return self.stages[WHOLE_STEP].median / self.superlu.median

    @property
    def tail(self) -> float:
        """99th percentile of the whole step over its median."""
        return self.stages[WHOLE_STEP].p99 / self.stages[WHOLE_STEP].median

    @property
    def limit(self) -> float:
        """Time of factor and solves if every operation ran at the speed of a dense product [s]."""
        return float("nan") if self.flops is None else sum(self.flops) / self.dense_speed

    @property
    def share_of_dense_speed(self) -> float:
        """Speed of factor and solves, as a share of that of dense products."""
        return self.limit / sum(self.stages[stage].median for stage in _ALGEBRA)


def measure(case: BenchCase, steps: int) -> SizeMeasurement:
    """Builds a case and times its steps.

    Args:
        case: The case.
        steps: Steps to time.

    Raises:
        SoftRobotTwinError: The scene cannot be built or has nothing to follow.
    """
    simulation = Simulation(case.scene)
    simulation.warm_up()
    commands = _commands_of(simulation, case)
    resident, model = resident_bytes(), simulation.model
    with without_garbage_collection():
        record = _follow(simulation, commands, steps, not is_reduced(case.scene))
        calls = _calls_in_a_step(simulation, commands)
        kernel_share = _share_of_kernels(simulation, commands)
        beside = _time_beside_steps(simulation, commands)
        stages = _stages(record.steps, simulation.stages) | _observed(simulation, commands)
        stages |= _controlled(simulation)
    factorization = without_rows(model.factorization)
    reductions = [body.reduction.reduction for body in model.bodies if body.reduction is not None]
    reports = [step.report for step in record.steps]
    times, faults = np.array(record.superlu).reshape(-1, 2).T
    return SizeMeasurement(
        case, factorization.name, getattr(factorization, "thread_count", 1),
        simulation.node_count, simulation.tet_count, simulation.dof_count, sum(one.mode_count for one in reductions),
        sum(len(one.sampled.cells) for one in reductions),
        spread([step.row_count for step in record.steps]).median,
        spread([report.contact_count for report in reports]).median,
        stages, steps, spread(times), len(times),
        spread(faults).median,
        sum(step.time - step.worked > INTERRUPTION for step in record.steps) / steps,
        flop_count(factorization, model.rows.node_index, model.rows.row_count),
        spread(record.dense).median, _factor_bytes(factorization), resident,
        Counter(step.status.value for step in record.steps),
        Counter(report.qp_solver for report in reports), calls, kernel_share, beside)


def _commands_of(simulation: Simulation, case: BenchCase):
    """Source of the commands while a case is timed."""
    if case.interval is not None:
        return interval_targets(simulation, case.interval)
    if case.commands is not None:
        return held_commands(simulation, case.commands)
    if case.sweeps or not simulation.effector_names:
        return swept_setpoints(simulation)
    return circle_targets(simulation)


class _TimedStep(NamedTuple):
    """A step: elapsed and processor time [s], what it reported, and the number of rows of H."""

    time: float
    worked: float
    report: StepReport
    status: Status
    row_count: int


class _Record(NamedTuple):
    """Timed steps, and between them times of SuperLU [s] with its page faults, and dense speeds."""

    steps: list[_TimedStep]
    superlu: list[tuple[float, int]]
    dense: list[float]


def _stages(steps: Sequence[_TimedStep], names: Sequence[str]) -> dict[str, Spread]:
    """Times of each stage, of what is outside them, and of the whole step [s]."""
    whole = np.array([step.time for step in steps])
    booked = np.array([[step.report.stage_times.get(name, 0.0) for name in names]
                       for step in steps])
    spreads = {name: spread(booked[:, index]) for index, name in enumerate(names)}
    return {**spreads, OUTSIDE: spread(whole - booked.sum(axis=1)), WHOLE_STEP: spread(whole)}


def _follow(simulation: Simulation, commands, steps: int, with_superlu: bool) -> _Record:
    """Times steps, and between them dense products and, where it is asked for, SuperLU."""
    dense, record, yardstick = DenseSpeed(), _Record([], [], []), None
    dense.measure()
    samples = _SUPERLU_SAMPLES
    if with_superlu:
        yardstick = SuperLUReference(without_rows(simulation.model.factorization))
        first, _ = yardstick.factorize()
        samples = int(np.clip(_SUPERLU_SECONDS / first, _FEWEST_SAMPLES, _SUPERLU_SAMPLES))
    interval = max(1, steps // samples)
    for number in range(steps):
        if number % interval == 0:
            if yardstick is not None:
                record.superlu.append(yardstick.factorize())
            record.dense.append(dense.measure())
            # They remove a step's data from the caches, so one more step runs before the next
            # timing.
            simulation.step(next(commands))
        command, worked = next(commands), thread_time()
        start = perf_counter()
        result = simulation.step(command)
        time = perf_counter() - start
        record.steps.append(_TimedStep(time, thread_time() - worked, result.report, result.status,
                                       simulation.model.rows.row_count))
    return record


def _calls_in_a_step(simulation: Simulation, commands) -> float:
    """Calls of Python functions in a step, which no other program changes."""
    profile = cProfile.Profile()
    for _ in range(COUNTED_STEPS):
        command = next(commands)
        with profile:
            simulation.step(command)
    return sum(entry.callcount for entry in profile.getstats()) / COUNTED_STEPS


class _TimeWithin:
    """Adds up the time that is spent within a function [s]."""

    def __init__(self) -> None:
        self.total = 0.0

    def of(self, function: Callable) -> Callable:
        """The function, whose time is added."""

        def timed(*given, **options):
            start = perf_counter()
            try:
                return function(*given, **options)
            finally:
                self.total += perf_counter() - start

        return timed


def _share_of_kernels(simulation: Simulation, commands) -> float:
    """Share of a step's time in the kernels that Python calls; the rest is Python's own."""
    within, shares = _TimeWithin(), []
    CPUDispatcher.__call__ = within.of(CPUDispatcher.__call__)
    try:
        for _ in range(COUNTED_STEPS):
            command, within.total = next(commands), 0.0
            start = perf_counter()
            simulation.step(command)
            shares.append(within.total / (perf_counter() - start))
    finally:
        # What is inherited from numba's compiled base class is used again.
        del CPUDispatcher.__call__
    return float(np.median(shares))


def _time_beside_steps(simulation: Simulation, commands) -> float:
    """Time of a tick beside its step, see `SizeMeasurement.beside`."""
    if not isinstance(next(commands), FollowTargets):
        return float("nan")
    loop, within, beside = TwinLoop(simulation, LoopSettings()), _TimeWithin(), []
    simulation.step = within.of(simulation.step)
    try:
        for number in range(COUNTED_STEPS):
            now = number / loop.settings.rate
            arrival = Arrival("base_link", 0, round(NANOSECONDS * now), now)
            for effector, target in enumerate(next(commands).targets):
                loop.targets.accept_point(effector, target, arrival)
            within.total, start = 0.0, perf_counter()
            loop.tick(now, arrival.ros_time)
            beside.append(perf_counter() - start - within.total)
    finally:
        del simulation.step
    return float(np.median(beside))


def _observed(simulation: Simulation, commands) -> dict[str, Spread]:
    """Time of an observer beside a step, with markers where the model has them; nothing without one."""
    if simulation.scene.observer is None:
        return {}
    observer, times = ForceObserver(simulation), []
    for number in range(1, COUNTED_STEPS + 1):
        simulation.step(next(commands), None, observer.found)
        start = perf_counter()
        observer.look()
        model = observer.moment(simulation.marker_positions(), simulation.effector_positions())
        observer.update(model.markers, model, USUAL_NOISE, number * NANOSECONDS)
        times.append(perf_counter() - start)
    return {OBSERVER: spread(times)}


def _controlled(simulation: Simulation) -> dict[str, Spread]:
    """Time in a tick of what predicts and commands motion; nothing in a scene without `control`."""
    if simulation.scene.control is None:
        return {}
    loop, within, times = TwinLoop(simulation, LoopSettings()), _TimeWithin(), []
    for method in ("measure", "command", "end"):
        setattr(loop.dynamic, method, within.of(getattr(loop.dynamic, method)))
    places = simulation.effector_positions()
    for number in range(COUNTED_STEPS):
        now = number / loop.settings.rate
        arrival = Arrival("base_link", 0, round(NANOSECONDS * now), now)
        for effector, place in enumerate(places):
            loop.targets.accept_point(effector, place, arrival)
        within.total = 0.0
        loop.tick(now, arrival.ros_time)
        times.append(within.total)
    return {CONTROL: spread(times)}


def _factor_bytes(factorization) -> int | None:
    """Size of the panels, updates, triangles and assembled blocks [B]."""
    if not isinstance(factorization, Multifrontal):
        return None
    layout = factorization.layout
    doubles = (layout.panels_size + layout.updates_size + layout.triangles_size
               + factorization.storage.size)
    return 8 * int(doubles)
