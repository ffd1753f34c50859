"""Compares the inverse problem with an optimiser over direct steps, on random robots.

    tools/compare_inverse.py SEED COUNT [--exploration]

Each robot is a bar of hexahedra or a beam with random cables, and one or two effectors with random
directions and weights; some cables are limited. Some effectors ask for an orientation, or on bars
for a stiffness, too. Targets are within reach or far out. With `--exploration` the robots look for
nearer poses by simulation. A robot follows its targets for 300 steps, and on until it has been resting
or `ok` for 60, or has made 3000. Then the weighted distance is minimised over the lengths of the
cables by `scipy.optimize.least_squares` on direct steps: near where the robot is, and from lengths at
random.
Direct steps begin where the robot is; where its body is not in balance, they begin at rest. A pose
counts where direct steps come to balance with all tensions within their limits. A robot is worse
where it is left more than 1 % further away than that, told where its status is not `ok`, and restless
where in the last 60 of the 300 steps, or of all, a command still moves by more than 1e-6 of the size,
or where these end as neither ok, saturated nor unreachable.
"""

from __future__ import annotations

import argparse
import warnings
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import softrobot_twin as st

STEPS, LATE, MOST_STEPS, RESTED = 300, 60, 3000, 1.0e-6
# Direct steps at each commanded pose; starts of the optimiser beside the robot's own pose.
DIRECT_STEPS, STARTS, EVALUATIONS = 6, 2, 25
WORSE = 1.01
RESTING = ("ok", "saturated", "unreachable")
LEAST_RATIO = 1.0e-6
QUARTERS = np.arange(4) * 0.5 * np.pi
DIRECTIONS = (["z"], ["y", "z"], ["x", "z"], ["x", "y", "z"])


class Robot(NamedTuple):
    """A random robot and what it is asked for.

    Attributes:
        scene: The scene, as keywords of `softrobot_twin.build`.
        targets: Targets by the names of `softrobot_twin.targets`.
        weights: Square roots of the weights of the effectors' positions, by effector.
        turns: Square roots of the weights of orientations times the length per radian, by effector.
        stiff: The same of stiffnesses times their length.
        size: Length of the body [m].
        kind: What it is, in a few words.
    """

    scene: dict
    targets: dict
    weights: dict
    turns: dict
    stiff: dict
    size: float
    kind: str


class Finding(NamedTuple):
    """How a robot fared.

    Attributes:
        status: Status after the last step.
        limits: Names of the active limits.
        ours: Weighted distance that the inverse leaves [m].
        best: The least that the optimiser found, or ours [m].
        late_move: Largest move of a command in a late step, by the size.
        late: Statuses of the late steps.
        tolerance: Weighted distance within which targets count as reached [m].
    """

    status: str
    limits: tuple[str, ...]
    ours: float
    best: float
    late_move: float
    late: frozenset
    tolerance: float

    @property
    def is_worse(self) -> bool:
        """Whether a pose that direct steps reach is nearer by more than 1 %."""
        return self.ours > WORSE * self.best and self.ours > self.tolerance

    @property
    def is_told(self) -> bool:
        """Whether the status says that the target is missed."""
        return self.status != "ok"

    @property
    def is_restless(self) -> bool:
        """Whether commands still move, or the status is none of a robot at rest."""
        return self.late_move > RESTED or not self.late <= set(RESTING)


def random_robot(rng: np.random.Generator, exploration: bool = False) -> Robot:
    """Draws a robot, which may look for nearer poses by simulation, and its targets."""
    length, count = rng.uniform(0.08, 0.2), int(rng.integers(2, 6))
    is_beam = bool(rng.random() < 0.5)
    body, point, on, tension = (draw_beam if is_beam else draw_bar)(rng, length)
    first = rng.uniform(0.0, 2.0 * np.pi)
    limit = (None, None, 0.03, 0.1)[int(rng.integers(0, 4))]
    cables = []
    for i in range(count):
        angle = first + 2.0 * np.pi * i / count + rng.normal() * 0.2
        end = 1.0 if i < 2 or rng.random() < 0.6 else rng.uniform(0.4, 0.8)
        cable = dict(
            name=f"c{i}", pull_point=point(0.0, angle),
            points=[point(end * share, angle) for share in (1 / 3, 2 / 3, 1.0)],
            tension=[0.0, float(20.0 * tension)], **on,
        )  # fmt: skip
        if limit is not None:
            cable["shortening"] = [-limit * length, limit * length * rng.uniform(0.2, 1.5)]
        cables.append(cable)
    effectors, targets, weights, words, turns, stiff = [], {}, {}, [], {}, {}
    for name, share in (("tip", 1.0), ("mid", 4 / 7))[: 1 + (rng.random() < 0.4)]:
        place = point(share, None)
        directions = DIRECTIONS[int(rng.integers(0, len(DIRECTIONS)))]
        weight = float(rng.uniform(0.3, 3.0))
        effectors.append(
            dict(name=name, points=[place], directions=directions, weight=weight, **on)
        )
        far = 10 ** rng.uniform(-1.3, 0.3) * length * share
        off = np.array([-abs(rng.normal()) * 0.3, *rng.normal(size=2)]) * far
        targets[name] = (np.array(place) + off).tolist()
        weights[name] = np.sqrt(weight) * np.isin(["x", "y", "z"], directions)
        words.append(f"{name} {''.join(directions)}")
        more = rng.random()
        if more < 0.3:
            # Four points around the axis: their mean is the place, their turn the orientation.
            effectors[-1]["points"] = [point(share, quarter) for quarter in QUARTERS]
            turns[name] = np.sqrt(effectors[-1]["weight"]) * length
            whole = bool(rng.random() < 0.5)
            effectors[-1]["orientation"] = dict(
                weight=effectors[-1]["weight"], length_per_radian=length,
                **({} if whole else dict(pointing=[1.0, 0.0, 0.0])),
            )  # fmt: skip
            turn = Rotation.from_rotvec(rng.normal(size=3) * far / length)
            targets[f"{name}_quaternion"] = turn.as_quat().tolist()
            words[-1] += " turn" if whole else " pointing"
        elif more < 0.5 and not is_beam:
            stiff[name] = np.sqrt(effectors[-1]["weight"]) * 0.1 * length
            effectors[-1]["stiffness"] = dict(
                weight=effectors[-1]["weight"], length=0.1 * length, target=[None] * 3
            )
            # Up to thrice what it has without cables.
            lever = np.linalg.norm(np.subtract(point(share, 0.0), place))
            bare = 3.0 * tension * lever / (share**3 * length**2)
            wanted = [None, None, None]
            wanted[int(rng.integers(1, 3))] = float(bare * 10 ** rng.uniform(-0.1, 0.5))
            targets[f"{name}_stiffness_N_per_m"] = wanted
            words[-1] += " stiffness"
    kind = "beam" if is_beam else "bar"
    scene = dict(
        name=kind, gravity=[0.0, 0.0, 0.0], cables=cables, effectors=effectors,
        solver=dict(
            newton_iterations=5, exploration=exploration,
            residual_tolerance=1e-5 * max(float(tension), 1e-3),
        ),
        **body,
    )  # fmt: skip
    limits = "" if limit is None else f" limited to {limit:g} L"
    words = f"{kind} {count} cables{limits} {words}"
    return Robot(scene, targets, weights, turns, stiff, length, words)


def draw_beam(rng, length: float):
    """A straight beam; its points by share of its length and angle, and its scale of tension."""
    radius, young = rng.uniform(0.002, 0.004), 10 ** rng.uniform(6.0, 7.0)
    beam = dict(
        name="b", points=[[0, 0, 0], [float(length), 0, 0]], elements=8, fixed=["start"],
        section=dict(circle=dict(radius=float(radius))),
        material=dict(young_modulus=float(young), poisson_ratio=0.4, density=1100.0),
    )  # fmt: skip

    def point(share, angle):
        off = 0.0 if angle is None else 2.0 * radius
        angle = angle or 0.0
        return [float(share * length), float(off * np.cos(angle)), float(off * np.sin(angle))]

    tension = young * np.pi * radius**4 / 4.0 / length / (2.0 * radius)
    return dict(beams=[beam]), point, dict(body="b"), tension


def draw_bar(rng, length: float):
    """The same of a bar of hexahedra."""
    width, young = length * rng.uniform(0.14, 0.22), 10 ** rng.uniform(4.9, 5.6)
    body = dict(
        mesh=dict(box=dict(size=[float(length), float(width), float(width)], cells=[7, 2, 2])),
        element="hexahedral",
        material=dict(young_modulus=float(young), poisson_ratio=0.4, density=1000.0),
        fixed=[dict(box=dict(minimum=[-1e-6, -1, -1], maximum=[1e-6, 1, 1]))],
    )  # fmt: skip

    def point(share, angle):
        off = 0.0 if angle is None else 0.42 * width
        angle, centre = angle or 0.0, 0.5 * width
        return [float(share * length), float(centre + off * np.cos(angle)),
                float(centre + off * np.sin(angle))]  # fmt: skip

    return dict(body=body), point, {}, young * width**4 / 12.0 / length / (0.42 * width)


def follow(robot: Robot) -> tuple[st.Robot, Finding]:
    """Lets a robot follow its targets; it is as near to them as the best that is known."""
    twin = st.build(**robot.scene)
    asked, commands, late, count = st.targets(robot.targets), [], [], 0
    moves, words, result = [], set(), None
    rested = 0
    while count < STEPS or (count < MOST_STEPS and rested < LATE):
        result, count = twin.step(asked), count + 1
        commands = [*commands[-LATE:], _setpoints(result, _names(robot))]
        late = [*late[1 - LATE :], result.status.value]
        is_at_rest = result.status.value == "ok" or result.outcome.report.is_resting
        has_moved = max(_moves(commands[-2:]), default=np.inf) > RESTED * robot.size
        rested = rested + 1 if is_at_rest and not has_moved else 0
        if count == STEPS:
            moves, words = _moves(commands), set(late)
    late_move = max(moves + _moves(commands)) / robot.size
    ours = float(np.linalg.norm(missed_targets(robot, result)))
    # All effectors may be as far off as counts as reached, and distances are weighted.
    greatest = np.linalg.norm([weights.max() for weights in robot.weights.values()])
    return twin, Finding(
        result.status.value, result.active_limits, ours, ours, late_move, frozenset(words.union(late)),
        max(greatest, 1.0) * twin.simulation.model.reach_tolerance,
    )  # fmt: skip


def _moves(commands: list[np.ndarray]) -> list[float]:
    return [float(np.abs(after - before).max()) for before, after in zip(commands, commands[1:])]


def compare(robot: Robot, rng: np.random.Generator) -> Finding:
    """Lets a robot follow its targets, and looks for nearer poses by direct steps."""
    twin, found = follow(robot)
    names, limits = _names(robot), twin.simulation.actuators.limits
    least = np.maximum(limits.displacement_min, -0.5 * robot.size)
    most = limits.displacement_max.copy()
    own = _setpoints(twin.step(st.hold()), names)
    if found.status not in RESTING:
        twin.reset()
    state, greatest = twin.state, robot.scene["cables"][0]["tension"][1]

    def at(shortenings):
        twin.state = state
        given = {f"{name}_shortening_m": float(s) for name, s in zip(names, shortenings)}
        for _ in range(DIRECT_STEPS):
            result = twin.step(st.setpoints(given))
            if result.is_at_rest:
                break
        is_pose = result.status.value == "ok"
        if robot.stiff:
            # A step that follows targets tells the stiffness; here all lengths are commanded.
            result = twin.step(st.targets(robot.targets, **given))
        is_pose = is_pose and max(result[f"{name}_tension_N"] for name in names) < greatest
        missed = missed_targets(robot, result)
        return missed if is_pose else np.full(len(missed), 10.0 * robot.size)

    best = found.ours
    if best > found.tolerance:
        starts = [own, *(own + 0.1 * robot.size * rng.normal(size=len(names))
                         for _ in range(STARTS))]  # fmt: skip
        for start in starts:
            inside = np.clip(start, least + 1e-9, most - 1e-9)
            pose = least_squares(
                at, inside, bounds=(least, most), x_scale=0.02 * robot.size, diff_step=1e-4,
                max_nfev=EVALUATIONS,
            )
            best = min(best, float(np.linalg.norm(pose.fun)))
    return found._replace(best=best)


def _names(robot: Robot) -> list[str]:
    return [cable["name"] for cable in robot.scene["cables"]]


def _setpoints(result, names: list[str]) -> np.ndarray:
    return np.array([result[f"{name}_shortening_m"] for name in names])


def missed_targets(robot: Robot, result) -> np.ndarray:
    """Weighted distances of the effectors, one row after the other, after a step [m]."""
    missed = [
        weights * (np.array(result.effectors[name]) - robot.targets[name])
        for name, weights in robot.weights.items()
    ]
    effectors = {one["name"]: one for one in robot.scene["effectors"]}
    for name, weight in robot.turns.items():
        made = Rotation.from_quat(result.orientations[name])
        wanted = Rotation.from_quat(robot.targets[f"{name}_quaternion"])
        axis = effectors[name]["orientation"].get("pointing")
        missed.append(weight * _turn(made, wanted, axis))
    for place, one in enumerate(robot.scene["effectors"]):
        if one["name"] in robot.stiff:
            wanted = robot.targets[f"{one['name']}_stiffness_N_per_m"]
            wanted, told = np.array(wanted, dtype=float), result.outcome.effector_stiffness
            # A step that failed tells none; that is as wrong as what yields backwards.
            ratio = np.zeros(3) if told is None else told[place] / wanted
            ratio = np.fmax(ratio[np.isfinite(wanted)], LEAST_RATIO)
            missed.append(robot.stiff[one["name"]] * np.log(ratio))
    return np.concatenate(missed)


def _turn(made: Rotation, wanted: Rotation, axis) -> np.ndarray:
    """The rotation vector between two orientations, or between where an axis points [rad]."""
    if axis is None:
        return (made * wanted.inv()).as_rotvec()
    pointed, direction = made.apply(axis), wanted.apply(axis)
    across = np.cross(direction, pointed)
    angle = np.arctan2(np.linalg.norm(across), direction @ pointed)
    return across * angle / max(np.linalg.norm(across), 1e-300)


def main() -> None:
    """Compares some robots, and prints those that are worse or restless, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("seed", type=int)
    parser.add_argument("count", type=int)
    parser.add_argument("--exploration", action="store_true")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    worse = untold = restless = 0
    for index in range(given.count):
        rng = np.random.default_rng([given.seed, index])
        robot = random_robot(rng, given.exploration)
        found = compare(robot, rng)
        worse, untold = worse + found.is_worse, untold + (found.is_worse and not found.is_told)
        restless += found.is_restless
        if found.is_worse or found.is_restless:
            print(
                f"{index}: {robot.kind}: {found.status} {found.limits}, "
                f"ours {1e3 * found.ours:.3f} mm, best {1e3 * found.best:.3f} mm, "
                f"late move {found.late_move:.1e} of the size, late {sorted(found.late)}",
                flush=True,
            )
    print(f"{given.count} robots: worse {worse}, of these not told {untold}; restless {restless}")


if __name__ == "__main__":
    main()
