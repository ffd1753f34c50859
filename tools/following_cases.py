"""The cases of `following_scoreboard.py`: robots, what they are asked for, and what is measured.

Each family draws its cases from a seed. A case knows a robot by its simulation, its commands and what a
step tells, and nothing of how a step finds its answer: rest is what stands still. So the same cases run on
a package before and after its step is changed.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import compare_inverse
import meshio
import numpy as np
import scipy.sparse as sp
import yaml
from scipy.sparse.linalg import splu

import softrobot_twin as st
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation
from softrobot_twin.solvers.dense_stiffness import without_rows
from softrobot_twin.study.bench_measurement import circle_targets
from superlu_reference import SuperLUReference

ROOT = Path(st.__file__).resolve().parents[1]
"""The checkout of the package that runs: its scenes and meshes are used, too."""
OUTPUT = Path("out") / "scoreboard"
PERIOD, UNLIMITED = 0.02, 1.0e3
"""Duration of a step, and of one that no rate limits [s]."""
MOVED, STILL = 1.0e-6, 1.0e-9
"""Moves of a drive, as shares of its scale: above the first it moves, below the second it stands."""
STILL_STEPS, STILL_STEPS_AWAY = 25, 85
"""Steps that stand still until a case ends: with status `ok`, and with another one."""
LATE = 60
"""A robot is restless where a drive moves within the last steps of those that it is given, so many."""
DECIMALS = 9
"""Targets are rounded to 1e-9 m, so that a file holds them exactly."""


class Case(NamedTuple):
    """One line of the scoreboard.

    Attributes:
        name: Its name, unlike all others.
        family: The family, by which figures are summed up.
        measure: Runs the case; its figures by name. See `following_scoreboard.py`.
    """

    name: str
    family: str
    measure: Callable[[], dict]


class Pursuit(NamedTuple):
    """A robot that follows fixed targets.

    Attributes:
        simulation: The robot.
        step: Makes a step towards the targets; what came of it.
        miss: Weighted distance from the targets, after a step [m].
        targets: The targets, where the robot found them itself; written into the file.
        turn_home: Makes home the target, where the robot shall come home afterwards.
        most_steps: Steps that it is given.
    """

    simulation: Simulation
    step: Callable
    miss: Callable[[], float]
    targets: list | None = None
    turn_home: Callable | None = None
    most_steps: int = 400


# --- measurements --------------------------------------------------------------------------------


def time_superlu() -> float:
    """Shortest processor time of three factorizations of a fixed matrix by SuperLU [s]."""
    size = 9
    line = sp.diags([-1.0, 2.1, -1.0], [-1, 0, 1], shape=(size, size))
    matrix = sp.csc_matrix(sp.kronsum(sp.kronsum(line, line), line))
    times = []
    for _ in range(3):
        begin = time.thread_time()
        splu(matrix)
        times.append(time.thread_time() - begin)
    return min(times)


class _Steps:
    """Steps of one robot: their drives, statuses and times.

    Attributes:
        drives: Drives after each step, as shares of their scales, each of shape (actuator_count,).
        statuses: How many steps ended with each status.
        last: Status of the last step.
        times: Processor time of each step [s], which depends little on other programs.
    """

    def __init__(self, simulation: Simulation):
        self._actuators, self._scale = simulation.actuators, simulation.limits.drive_scale
        self.drives, self.statuses, self.last, self.times = [], Counter(), "", []

    def make(self, step: Callable):
        """Makes a step; what came of it."""
        begin = time.thread_time()
        result = step()
        self.times.append(time.thread_time() - begin)
        self.last = result.status.value
        self.statuses[self.last] += 1
        self.drives.append(self._actuators.drives(result.setpoints) / self._scale)
        return result

    @property
    def moves(self) -> np.ndarray:
        """Largest move of a drive in each step but the first, shape (step_count - 1,)."""
        return np.abs(np.diff(self.drives, axis=0)).max(axis=1)

    def figures(self, first: int = 0) -> dict:
        """Figures that all cases have; times from a first step on."""
        return {"status": self.last, "statuses": dict(self.statuses),
                "ms": 1e3 * float(np.median(self.times[first:])), "unit_ms": 1e3 * time_superlu()}


def rest_of(begin: Callable[[], Pursuit]) -> dict:
    """Lets a robot follow fixed targets until it stands still, and come home where it shall."""
    pursuit = begin()
    figures = _come_to_rest(pursuit, pursuit.most_steps)
    if pursuit.turn_home is not None:
        pursuit.turn_home()
        home = _come_to_rest(pursuit, HOME_STEPS)
        figures["statuses"] = dict(Counter(figures["statuses"]) + Counter(home["statuses"]))
        figures |= {"home_miss": home["miss"], "home_steps": home["steps"]}
    if pursuit.targets is not None:
        figures["targets"] = pursuit.targets
    return figures


HOME_STEPS = 300


def _come_to_rest(pursuit: Pursuit, most_steps: int) -> dict:
    steps, still = _Steps(pursuit.simulation), 0
    for number in range(most_steps):
        result = steps.make(pursuit.step)
        is_still = number > 0 and np.abs(steps.drives[-1] - steps.drives[-2]).max() < STILL
        still = still + 1 if is_still else 0
        most = STILL_STEPS if result.status.value == "ok" else STILL_STEPS_AWAY
        if result.report.is_resting or still >= most:
            break
    moves = steps.moves
    moved, has_time = np.flatnonzero(moves > MOVED), number < most_steps - 1
    is_restless = not has_time and bool(moves[-LATE:].max() > MOVED)
    return {"miss": pursuit.miss(), "steps": int(moved[-1]) + 2 if len(moved) else 1,
            "restless": is_restless, **steps.figures()}  # fmt: skip


def path_of(simulation: Simulation, targets: np.ndarray, first: int) -> dict:
    """Lets a robot follow moving targets.

    Args:
        simulation: The robot.
        targets: Targets of each step [m], shape (step_count, effector_count, 3).
        first: The step from which on figures count.
    """
    steps, errors = _Steps(simulation), []
    for wanted in targets:
        result = steps.make(lambda: simulation.step(FollowTargets(wanted, PERIOD)))
        errors.append(float(np.linalg.norm(np.nan_to_num(result.effector_errors))))
    late = np.array(errors[first:])
    return {"miss": float(late.mean()), "worst": float(late.max()),
            "move": float(steps.moves[first:].max()), **steps.figures(first),
            "p99_ms": 1e3 * float(np.quantile(steps.times[first:], 0.99))}  # fmt: skip


def jumps_of(simulation: Simulation, share: float, rng: np.random.Generator, count: int = 10) -> dict:
    """Commands setpoints at random in one jump from rest, a few times, each until balance."""
    state, low, high = simulation.state, *_drives_within(simulation, share)
    steps, unbalanced, made = _Steps(simulation), 0, []
    for _ in range(count):
        simulation.restore(state)
        drives = low + (high - low) * rng.random(len(low)) * (rng.random(len(low)) < 0.6)
        command = CommandSetpoints(simulation.actuators.setpoints(drives), UNLIMITED)
        for number in range(1, JUMP_STEPS + 1):
            steps.make(lambda: simulation.step(command))
            if steps.last == "ok":
                break
        unbalanced += steps.last != "ok"
        made.append(number)
    return {"steps": sum(made), "unbalanced": unbalanced, **steps.figures()}


JUMP_STEPS = 80


def ratio_of(simulation: Simulation, rounds: int = 40, steps: int = 10) -> dict:
    """Processor time of a step along a circle, in SuperLU factorizations of the same matrix: the median of
    rounds of some steps and a factorization.
    """
    commands, ratios, made = circle_targets(simulation), [], _Steps(simulation)
    superlu = SuperLUReference(without_rows(simulation.model.factorization))
    for _ in range(rounds):
        # It removes the data of a step from the caches, so one more step runs before the others.
        unit = superlu.factorize()
        simulation.step(next(commands))
        for command in islice(commands, steps):
            made.make(lambda: simulation.step(command))
        ratios.append(np.median(made.times[-steps:]) / unit)
    return {"ratio": float(np.median(ratios)), **made.figures()}


def _drives_within(simulation: Simulation, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest drives within their limits and a share of their scales."""
    limits = simulation.limits
    return (np.maximum(limits.drive_min, -share * limits.drive_scale),
            np.minimum(limits.drive_max, share * limits.drive_scale))  # fmt: skip


# --- robots --------------------------------------------------------------------------------------

COARSE = {"diamond": "diamond_400", "trunk": "trunk_700", "trunk_cylinders": "trunk_700"}


def shipped(name: str, change: Callable | None = None, coarse: bool = True) -> Simulation:
    """A shipped scene, on a coarse mesh where there is one, perhaps with something changed."""
    path = ROOT / "config" / "scenes" / f"{name}.yaml"
    scene = yaml.safe_load(path.read_text())
    if coarse and name in COARSE:
        scene["body"]["mesh"]["file"] = f"../../meshes/{COARSE[name]}.vtk"
    if change is not None:
        change(scene)
    # Processor times are those of one thread; the bits are the same for any number.
    scene["solver"] = {**scene.get("solver", {}), "threads": 1}
    return Simulation(scene_from_mapping(scene, path))


def beam_beside_rod(eight: bool, friction: float = 0.0) -> Simulation:
    """A beam of 20 x 20 x 100 mm with four long cables, perhaps four short ones, 5 mm beside a rod."""
    sides = {"east": (0.018, 0.01), "north": (0.01, 0.018), "west": (0.002, 0.01), "south": (0.01, 0.002)}
    cables = []
    for kind, anchors in (("long", 5), ("short", 3))[: 1 + eight]:
        cables += [dict(
            name=f"{name}_{kind}", pull_point=[x, y, 0.0],
            points=[[x, y, z] for z in (0.02, 0.04, 0.06, 0.08, 0.095)[:anchors]],
            shortening=[0.0, 0.02], rate=0.05, tension=[0.0, 40.0],
        ) for name, (x, y) in sides.items()]  # fmt: skip
    rubs = {"friction": friction} if friction else {}
    return st.build(
        name="beam_beside_rod", gravity=[0.0, 0.0, 0.0], cables=cables,
        body=dict(
            name="beam", mesh=dict(box=dict(size=[0.02, 0.02, 0.1], cells=[1, 1, 5])),
            material=dict(young_modulus=3e5, poisson_ratio=0.3, density=1000.0),
            fixed=[dict(box=dict(minimum=[-1.0, -1.0, -1e-6], maximum=[1.0, 1.0, 1e-6]))],
        ),
        obstacles=[dict(name="rod", cylinder=dict(
            ends=[[0.03, -0.05, 0.08], [0.03, 0.07, 0.08]], radius=0.005))],
        contact=dict(between=[dict(pair=["beam", "rod"], **rubs)]),
        effectors=[dict(name="tip", points=[[0.01, 0.01, 0.1]])],
        solver=dict(newton_iterations=3, residual_tolerance=1e-6),
    ).simulation  # fmt: skip


def thick_arm() -> Simulation:
    """A hanging tube, 120 mm long with a wall of 10 mm, with three cables and three chambers in it."""
    radii, turns, heights = np.array([5.0, 8.0, 12.0, 15.0]), 9, np.linspace(0.0, 120.0, 11)
    angles = 2.0 * np.pi * np.arange(turns) / turns
    r, a, z = np.meshgrid(radii, angles, heights, indexing="ij")
    nodes = 1e-3 * np.stack([r * np.cos(a), r * np.sin(a), -z], axis=-1).reshape(-1, 3)

    def corners(i, j, k):
        return [((i + p) * turns + (j + q) % turns) * len(heights) + k + s
                for s in (1, 0) for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))]  # fmt: skip

    chambers = {j: [] for j in (1, 4, 7)}
    cells = []
    for i, j, k in np.ndindex(len(radii) - 1, turns, len(heights) - 1):
        is_gas = i == 1 and j in chambers and 1 <= k < len(heights) - 2
        (chambers[j] if is_gas else cells).append(corners(i, j, k))
    OUTPUT.mkdir(parents=True, exist_ok=True)
    folder = OUTPUT.resolve()
    meshio.write(folder / "arm.vtk", meshio.Mesh(nodes, [("hexahedron", np.array(cells))]))
    quads = np.array([[3, 2, 1, 0], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
    for number, gas in enumerate(chambers.values()):
        faces = np.array(gas)[:, quads].reshape(-1, 4)
        _, first, counts = np.unique(np.sort(faces), axis=0, return_index=True, return_counts=True)
        faces = faces[first[counts == 1]]
        triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
        meshio.write(folder / f"air_{number}.stl", meshio.Mesh(nodes, [("triangle", triangles)]))
    scene = dict(
        name="arm", gravity=[0.0, 0.0, -9.81], solver=dict(newton_iterations=10, threads=1),
        body=dict(
            mesh=dict(file="arm.vtk"), element="hexahedral",
            material=dict(young_modulus=150.0e3, poisson_ratio=0.45, density=1080.0),
            fixed=[dict(box=dict(minimum=[-0.02, -0.02, -0.0005], maximum=[0.02, 0.02, 0.0005]))],
        ),
        cables=[dict(
            name="cable_#", repeat=dict(count=3, about="z"), pull_point=[0.0125, 0.0, 0.0],
            points=[[0.0125, 0.0, -0.04], [0.0125, 0.0, -0.08], [0.0125, 0.0, -0.117]],
            hold_radius=0.003, shortening=[0.0, 0.04], rate=0.1, tension=[0.0, 20.0],
        )],
        cavities=[dict(name=f"air_{number}", walls=[dict(file=f"air_{number}.stl")],
                       pressure=[0.0, 30.0e3], rate=50.0e3) for number in range(3)],
        effectors=[dict(name="tip", points=[
            [0.01, 0.0, -0.12], [-0.005, 0.00866, -0.12], [-0.005, -0.00866, -0.12]])],
    )  # fmt: skip
    return Simulation(scene_from_mapping(scene, folder / "arm.yaml"))


_at_rest: dict[str, tuple] = {}


def at_rest(key: str, build: Callable[[], Simulation]) -> Simulation:
    """A robot at rest under its weight, built once; a key is that of one robot only."""
    if key not in _at_rest:
        forget_robots()
        simulation = build()
        simulation.warm_up()
        for _ in range(20):
            simulation.step(Hold(PERIOD))
        _at_rest[key] = simulation, simulation.state
    simulation, state = _at_rest[key]
    simulation.restore(state)
    return simulation


def forget_robots() -> None:
    """Forgets what was built, such as a robot that was interrupted in a step."""
    _at_rest.clear()


# --- families ------------------------------------------------------------------------------------


def random_cases(seed: int, count: int) -> Iterator[Case]:
    """The robots of compare_inverse.py: the same seed and number draw the same robot."""

    def begin(number):
        robot = compare_inverse.random_robot(np.random.default_rng([seed, number]))
        twin, asked, last = st.build(**robot.scene), st.targets(robot.targets), []

        def step():
            last[:] = [twin.step(asked)]
            return last[0].outcome

        def miss():
            return float(np.linalg.norm(compare_inverse.missed_targets(robot, last[0])))

        return Pursuit(twin.simulation, step, miss)

    for number in range(count):
        yield Case(f"random/{number}", "random", partial(rest_of, partial(begin, number)))


def _scene_case(name: str, family: str, scene: dict, targets: dict, most_steps: int = 400) -> Case:
    """A scene that is written down, and targets of its effectors by name [m]."""

    def begin():
        simulation = st.build(**scene).simulation
        wanted = np.array([targets[name] for name in simulation.effector_names], dtype=float)
        return _pursuit(simulation, wanted, UNLIMITED, most_steps)

    return Case(name, family, lambda: rest_of(begin))


def _pursuit(simulation: Simulation, targets: np.ndarray, time_step: float, most_steps: int) -> Pursuit:
    """Fixed targets of all effectors [m], shape (effector_count, 3)."""
    effectors, command = simulation.model.effectors, FollowTargets(targets, time_step)
    weights = np.sqrt(effectors.row_weights[: effectors.position_row_count])

    def miss():
        rows = effectors.rows_of(simulation.effector_positions() - targets)
        return float(np.linalg.norm(weights * rows))

    return Pursuit(simulation, lambda: simulation.step(command), miss, None, None, most_steps)


def redundant_cases(seed: int, count: int) -> Iterator[Case]:
    """Bars and beams with two to five cables for one to two directions of a near target."""
    for number in range(count):
        kind = ("bar", "beam")[number % 2]
        rng = np.random.default_rng([seed, 1, number])
        length, cables = rng.uniform(0.08, 0.2), int(rng.integers(2, 6))
        directions = (["z"], ["y", "z"], ["x", "z"], ["x"])[rng.integers(0, 4)]
        draw = compare_inverse.draw_bar if kind == "bar" else compare_inverse.draw_beam
        body, point, on, tension = draw(rng, length)
        angles = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(cables) / cables
        tip = point(1.0, None)
        scene = dict(
            name=kind, gravity=[0.0, 0.0, 0.0], **body,
            cables=[dict(name=f"c{i}", pull_point=point(0.0, angle),
                         points=[point(share, angle) for share in (1 / 3, 2 / 3, 1.0)], **on)
                    for i, angle in enumerate(angles)],
            effectors=[dict(name="tip", points=[tip], directions=directions, **on)],
            solver=dict(newton_iterations=3, residual_tolerance=1e-4 * max(float(tension), 1e-2)),
        )  # fmt: skip
        way = length * np.array([-rng.uniform(0.02, 0.3), *(0.25 * rng.normal(size=2))])
        yield _scene_case(f"redundant/{kind}_{number}", "redundant", scene, {"tip": np.add(tip, way)})


def _clamped_bar(length: float, width: float, cells: int, young: float, **scene) -> dict:
    """A scene of a bar of hexahedra along x, without weight."""
    return dict(
        name="bar", gravity=[0.0, 0.0, 0.0], **scene,
        body=dict(
            mesh=dict(box=dict(size=[length, width, width], cells=[cells, 2, 2])), element="hexahedral",
            material=dict(young_modulus=young, poisson_ratio=0.4, density=1000.0),
            fixed=[dict(box=dict(minimum=[-1e-6, -1, -1], maximum=[1e-6, 1, 1]))],
        ),
    )  # fmt: skip


def limit_cases() -> Iterator[Case]:
    """A slack cable at its greatest shortening; two far effectors; a beam that chattered."""
    length, width = 0.1, 0.02
    for limit in (0.002, 0.005, 0.02):
        cables = [
            dict(name=name, pull_point=[0, y * width, 0.9 * width], shortening=[0, most],
                 points=[[s * length, y * width, 0.9 * width] for s in (0.25, 0.5, 0.75, 1.0)])
            for name, y, most in (("long", 0.4, 0.02), ("other", 0.6, limit))]  # fmt: skip
        scene = _clamped_bar(
            length, width, 8, 3e5, cables=cables,
            effectors=[dict(name="tip", points=[[length, width / 2, width / 2]], directions=["z"])],
            solver=dict(newton_iterations=20, residual_tolerance=1e-8),
        )  # fmt: skip
        for place, z in SLACK_TARGETS.items():
            target = [length, width / 2, z]
            yield _scene_case(f"limits/slack_{1e3 * limit:g}_{place}", "limits", scene, {"tip": target})
    length, width = 0.15, 0.03
    middle, far, near = width / 2, 0.9 * width, 0.1 * width
    pulls = [(middle, far), (middle, near), (far, middle), (near, middle), (middle, far), (middle, near)]
    cables = [dict(name=f"c{i}", pull_point=[0, y, z], tension=[0, 30.0],
                   points=[[s * length, y, z] for s in (0.2, 0.4, 0.6, 0.8, 1.0)[: 5 if i < 4 else 3]])
              for i, (y, z) in enumerate(pulls)]  # fmt: skip
    places = dict(tip=[length, middle, middle], mid=[length * 4 / 7, middle, middle])
    scene = _clamped_bar(
        length, width, 7, 2e5, cables=cables,
        effectors=[dict(name=name, points=[place]) for name, place in places.items()],
        solver=dict(newton_iterations=30, residual_tolerance=1e-8),
    )  # fmt: skip
    for number, (tip, mid) in enumerate(TWO_FAR):
        yield _scene_case(f"limits/two_far_{number}", "limits", scene, dict(tip=tip, mid=mid), 300)
    for iterations in (1, 3, 40):
        solver = dict(newton_iterations=iterations, residual_tolerance=1e-4, reach_tolerance=1e-4)
        scene = dict(CHATTERING, solver=solver)
        yield _scene_case(f"limits/chatter_{iterations}", "limits", scene, CHATTER_TARGET, 300)


SLACK_TARGETS = {8: 0.03678921458783416, 14: 0.0529959840892027}
"""Heights of the tip where `long` is 8 and 14 mm shorter, and `other` slack [m]."""
TWO_FAR = (
    ((0.25, 0.015, 0.065), (0.09, 0.015, -0.03)), ((0.3, 0.015, 0.2), (0.086, 0.015, 0.005)),
    ((0.15, 0.015, 0.3), (0.086, 0.015, -0.04)),
)  # fmt: skip
CHATTERING = dict(
    name="s", gravity=[0.0, 0.0, 0.0],
    beams=[dict(
        name="b", curve="smooth", elements=8, fixed=["start"],
        points=[[0, 0, 0], [0.0427790416, 0, -0.00212683758], [0.0855580832, 0, 0.00119903702]],
        section=dict(circle=dict(radius=0.00369822336)),
        material=dict(young_modulus=1768760.53, poisson_ratio=0.4, density=1100.0),
    )],
    cables=[
        dict(name="c0", body="b", shortening=[-0.00641023187, 0.00473355591],
             pull_point=[0.0, -0.00919048434, -0.000198316732],
             points=[[0.0171116166, -0.00919048434, -0.00170337722],
                     [0.0342232333, -0.00919048434, -0.00233600377],
                     [0.0513348499, -0.00919048434, -0.00209619636]]),
        dict(name="c1", body="b", shortening=[-0.0129158631, 0.00872311015],
             pull_point=[0.0, 0.00909380844, -0.00134423956],
             points=[[0.0171116166, 0.00909380844, -0.00284930006],
                     [0.0342232333, 0.00909380844, -0.0034819266],
                     [0.0513348499, 0.00909380844, -0.0032421192]]),
    ],
    effectors=[dict(name="tip", points=[[0.0855580832, 0, 0.00119903702]], directions=["z"], body="b")],
)  # fmt: skip
"""A smooth beam with two cables that jumped by millimetres in each step, near its target."""
CHATTER_TARGET = {"tip": [0.062163071529763594, 0.039327269255571645, -0.05295373274411861]}


class _Place(NamedTuple):
    """A robot whose targets are places where its effectors were.

    Attributes:
        name: Name of the robot.
        build: Builds it.
        goals: Places to be found.
        far: Of these, ways that are doubled.
        time_step: Duration of its steps [s].
        most_steps: Steps that it is given.
        touches: Whether places count only where something touches the robot.
    """

    name: str
    build: Callable[[], Simulation]
    goals: int
    far: int
    time_step: float = UNLIMITED
    most_steps: int = 300
    touches: bool = False


SHIPPED = ("diamond", "trunk", "finger", "springy", "flexo", "emio", "octoleg")


def reach_cases(seed: int, count: int | None, known: dict) -> Iterator[Case]:
    """Seven shipped robots towards places where direct commands led them, and twice as far."""
    for name in SHIPPED:
        place = _Place(name, partial(shipped, name), count or 10, (count or 10) // 2)
        if name == "octoleg":
            place = place._replace(goals=min(place.goals, 4), far=2, time_step=PERIOD, most_steps=150)
        yield from _place_cases(place, "reachable", "too_far", seed, known)


def contact_cases(seed: int, count: int | None, known: dict) -> Iterator[Case]:
    """The same of a beam beside a rod, without friction and with it."""
    for family, friction in (("rod", 0.0), ("friction", 0.5)):
        build = partial(beam_beside_rod, False, friction)
        place = _Place(family, build, count or 10, min(count or 10, 4), touches=True)
        yield from _place_cases(place, family, family, seed, known)


def _place_cases(place: _Place, near: str, far: str, seed: int, known: dict) -> Iterator[Case]:
    goals = cache(lambda: _places(place, np.random.default_rng([seed, 2])))

    def begin(name, number, share):
        if name in known:
            target = np.array(known[name])
        else:
            home, found = goals()
            target = np.round(home + share * (found[number] - home), DECIMALS)
        simulation = at_rest(place.name, place.build)
        pursuit = _pursuit(simulation, target, place.time_step, place.most_steps)
        return pursuit._replace(targets=target.tolist())

    for family, word, share, count in ((near, "in", 1.0, place.goals), (far, "out", 2.0, place.far)):
        for number in range(count):
            name = f"{family}/{place.name}_{word}_{number}"
            yield Case(name, family, partial(rest_of, partial(begin, name, number, share)))


def _places(place: _Place, rng: np.random.Generator) -> tuple[np.ndarray, list[np.ndarray]]:
    """Where the effectors are at rest, and after random direct commands that end in balance [m]."""
    simulation, found, tries = at_rest(place.name, place.build), [], 0
    home, state, start = simulation.effector_positions().copy(), simulation.state, simulation.state.setpoints
    is_moving = place.time_step != UNLIMITED
    while len(found) < place.goals:
        simulation.restore(state)
        # Where direct commands lead to no balance, smaller ones do.
        low, high = _drives_within(simulation, 0.5 * 0.5 ** (tries // 12))
        tries += 1
        shares = rng.random(len(low))
        if (low >= 0.0).all():
            shares *= rng.random(len(low)) < 0.6
        goal = simulation.actuators.setpoints(low + (high - low) * shares)
        for share in np.minimum(1.0, np.arange(1, 61) / 15):
            command = CommandSetpoints(start + share * (goal - start), place.time_step)
            result = simulation.step(command)
            if share == 1.0 and result.status.value == "ok" and not is_moving:
                break
        far = np.linalg.norm(simulation.effector_positions() - home)
        is_far = far > 0.01 * min(simulation.model.nodes.size, 0.3)
        is_touched = result.report.contact_count > 0 or not place.touches
        if (result.status.is_success or is_moving) and is_far and is_touched:
            found.append(simulation.effector_positions().copy())
    return home, found


def edge_cases(seed: int) -> Iterator[Case]:
    """Far ways in random directions, of which nothing is reached, and home again."""

    def trunk(*left_out):
        def change(scene):
            for key in left_out:
                del scene[key]

        return partial(shipped, "trunk_cylinders", change)

    robots = {
        "beam": (partial(beam_beside_rod, True), 0.2, 4), "diamond": (partial(shipped, "diamond"), 0.9, 2),
        "trunk": (trunk("obstacles", "contact", "slides"), 1.9, 2),
        "trunk_slide": (trunk("obstacles", "contact"), 1.9, 1),
        "trunk_cylinders": (trunk("slides"), 1.9, 2),
    }  # fmt: skip
    for name, (build, distance, ways) in robots.items():
        rng = np.random.default_rng([seed, 3])
        for number in range(ways):
            way = rng.standard_normal(3)
            way *= distance / np.linalg.norm(way)
            begin = partial(_there_and_back, f"edge_{name}", build, way)
            yield Case(f"edge/{name}_{number}", "edge", partial(rest_of, begin))


def _there_and_back(key: str, build: Callable[[], Simulation], way: np.ndarray) -> Pursuit:
    simulation = at_rest(key, build)
    home, at = simulation.effector_positions().copy(), []
    at.append(FollowTargets(home + way, PERIOD))
    return Pursuit(
        simulation, lambda: simulation.step(at[-1]),
        lambda: float(np.linalg.norm(simulation.effector_positions() - at[-1].targets)),
        None, lambda: at.append(FollowTargets(home, PERIOD)), 350,
    )  # fmt: skip


def arm_cases() -> Iterator[Case]:
    """The thick arm on a circle of 10 mm at the height of its tip at rest, which it cannot quite reach."""

    def follow():
        simulation = at_rest("arm", thick_arm)
        angles = 2.0 * np.pi * np.arange(ARM_STEPS) / ARM_STEPS
        circle = 0.010 * np.stack([np.cos(angles), np.sin(angles), np.zeros(ARM_STEPS)], axis=1)
        return path_of(simulation, (simulation.effector_positions()[0] + circle)[:, None], 0)

    yield Case("arm/circle", "arm", follow)


ARM_STEPS = 750


def jump_cases(seed: int) -> Iterator[Case]:
    """Direct commands in one jump from rest."""
    robots = {name: partial(shipped, name) for name in ("diamond", "trunk", "finger", "springy")}
    robots["beam"] = partial(beam_beside_rod, True)
    for name, build in robots.items():

        def jump(name=name, build=build):
            # More would exceed the greatest tensions of the Trunk's eight cables.
            share = 0.1 if name == "trunk" else 0.4
            return jumps_of(at_rest(name, build), share, np.random.default_rng([seed, 4]))

        yield Case(f"jumps/{name}", "jumps", jump)


FILES = {
    "diamond_circle": "diamond", "finger_ellipse": "finger", "flexo_circle": "flexo",
    "pneunet_tips": "pneunet_inverse", "springy_path": "springy", "stifface_hold": "stifface",
    "trunk_path": "trunk", "trunk_beyond": "trunk_cylinders",
}  # fmt: skip
CIRCLES = {
    "emio": "emio", "tdcr": "tdcr", "segment": "segment", "strider": "strider", "finger": "finger",
    "fetch": "fetch_reduced",
}  # fmt: skip
"""Robots whose demonstration is a circle, and their scenes."""
MOST_SECONDS, RAMP_SECONDS = 10.0, 2.0
FROM_STEP = 50
"""Figures of a path count from here on: until then a robot goes to its beginning."""


def path_cases() -> Iterator[Case]:
    """Paths of the shipped robots in steps of 20 ms, on the shipped meshes."""

    def along_file(file, scene):
        simulation = at_rest(f"path_{scene}", partial(shipped, scene, coarse=False))
        rows = np.genfromtxt(ROOT / "config" / "targets" / f"{file}.csv", delimiter=",", skip_header=1)
        times = np.arange(rows[0, 0], min(rows[-1, 0], MOST_SECONDS), PERIOD)
        columns = range(1, 1 + 3 * len(simulation.effector_names))
        targets = np.stack([np.interp(times, rows[:, 0], rows[:, k]) for k in columns], axis=1)
        return path_of(simulation, targets.reshape(len(times), -1, 3), FROM_STEP)

    def along_circle(robot, scene):
        simulation = at_rest(f"path_{scene}", partial(shipped, scene, coarse=False))
        home, times = simulation.effector_positions(), np.arange(0.0, MOST_SECONDS, PERIOD)
        told = _demonstration(yaml.safe_load((ROOT / "config" / f"{robot}.yaml").read_text()))
        angles, targets = 2.0 * np.pi * times / told["target_period"], np.tile(home, (len(times), 1, 1))
        circle = np.tile(told["target_center"], (len(times), 1))
        for axis, wave in zip(told["target_plane"], (np.cos(angles), np.sin(angles)), strict=True):
            circle[:, "xyz".index(axis)] += told["target_radius"] * wave
        ramp = np.minimum(1.0, times / RAMP_SECONDS)[:, None]
        place = simulation.effector_names.index(told["target_effector"])
        targets[:, place] += ramp * (circle - home[place])
        return path_of(simulation, targets, FROM_STEP)

    for file, scene in FILES.items():
        yield Case(f"paths/{file}", "paths", partial(along_file, file, scene))
    for robot, scene in CIRCLES.items():
        yield Case(f"paths/{robot}", "paths", partial(along_circle, robot, scene))


def _demonstration(parameters: dict) -> dict:
    """The parameters of the node that sends targets."""
    nodes = [node["ros__parameters"] for node in parameters.values() if "ros__parameters" in node]
    return next(node for node in nodes if "target_center" in node)


def speed_cases() -> Iterator[Case]:
    """Times of a step."""
    for name in ("diamond", "trunk", "finger"):
        build = partial(shipped, name, coarse=False)
        yield Case(f"speed/{name}", "speed", lambda build=build: ratio_of(build()))


FAMILIES = ("random", "redundant", "limits", "reachable", "too_far", "rod", "friction", "edge", "arm",
            "jumps", "paths", "speed")  # fmt: skip


def all_cases(seed: int, count: int | None = None, known: dict | None = None) -> Iterator[Case]:
    """The cases of all families.

    Args:
        seed: Draws robots and targets.
        count: Cases of each family that is drawn, of `reachable` and contact by robot, in place of the
            usual number.
        known: Targets of cases by name, as an earlier run found them; the others are found anew.
    """
    known = known or {}
    yield from random_cases(seed, count or 200)
    yield from redundant_cases(seed, count or 32)
    yield from limit_cases()
    yield from reach_cases(seed, count, known)
    yield from contact_cases(seed, count, known)
    yield from edge_cases(seed)
    yield from arm_cases()
    yield from jump_cases(seed)
    yield from path_cases()
    yield from speed_cases()
