"""Assembles a robot: the equilibrium in which it rests once its parts are bent into place.

The drawn robot is simulated in statics, while its fixed bodies and its actuators move as the scene
says. Its forces know the drawn shape, where nothing is strained; what is measured from rest counts from
the mounted one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.constraints.cable import ROUNDED
from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.kinematics import Nodes
from softrobot_twin.scene import Scene
from softrobot_twin.scene.mounting_entries import MountingStage
from softrobot_twin.simulation.command import LONG, CommandSetpoints
from softrobot_twin.simulation.step.step_part import Steppable

# A mounted state is a rest shape: it is found to round-off, as far as this tolerance can tell [N].
RESIDUAL_TOLERANCE, MOST_LINEARIZATIONS = 1.0e-9, 60
MOST_SETTLING, SETTLED = 5, 1.0e-13
# A step that takes more linearizations is halved, down to a share of the scene's; one that takes few
# lets the next one be twice as long.
MOST_TAKEN, FEW_TAKEN, SHORTEST, WHOLE = 7, 5, 1.0 / 256.0, 1.0 - 1.0e-9
# Longer steps that are tried where a branch ends, as shares of the scene's.
SNAPPED = 2.0 ** np.arange(-7, 0)
# A cable bears its tension if it is short of it by no more than this share.
SHORT_OF = 1.0e-6
# Limits of what moves on the way: none that could be met.
UNLIMITED = 1.0e6
# Angles and shortenings on the way stay within their limits by this margin [rad], [m].
MARGIN = 0.1

# A robot is disturbed so often, with a largest displacement by this share of its size, and should come
# back within another share in a number of steps.
DISTURBANCES, DISTURBED, BACK, STEPS_BACK = 4, 0.03, 0.01, 20


class MountingError(SceneError):
    """A robot cannot be assembled as its scene says.

    Attributes:
        simulation: Where it stands before the step that failed.
    """

    def __init__(self, scene: Scene, key: str, stage: MountingStage, share: float, simulation):
        self.simulation = simulation
        super().__init__(
            scene.path, f"{key}.steps", stage.steps, "",
            f"no equilibrium was found after {100.0 * share:.3g} % of the way, where explain --picture "
            "FILE.png draws it: let other parts move first, or turn or shorten less",
        )  # fmt: skip


class Mounted(NamedTuple):
    """A mounted robot.

    Attributes:
        positions: Node positions [m], shape (node_count, 3).
        efforts: Of all actuators of the scene, in their units, shape (actuator_count,).
        drawn: The nodes of the drawn robot.
    """

    positions: np.ndarray
    efforts: np.ndarray
    drawn: Nodes


def mount(scene: Scene, simulate: Callable, before: Mounted | None = None) -> Mounted:
    """Assemble the robot of a scene that says how.

    Args:
        scene: The scene, with stages of its mounting.
        simulate: Makes a simulation of a scene, as `Simulation` does.
        before: Where a robot of the same structure was mounted: this one goes from there to its own
            equilibrium at once, where it can. None to begin with the drawn robot.

    Raises:
        SceneError: No equilibrium was found; it names the stage.
    """
    own = simulate(drawn_scene(scene), with_warnings=False)
    if before is None or not _settles_from(own, before, scene):
        own.reset()
        supports = _Supports.of(own)
        for index, stage in enumerate(scene.mounting):
            _make(own, supports, stage, f"mounting[{index}]", scene)
            supports = supports.moved(stage, 1.0)
    _settle(own)
    names = [entry.name for entries in scene.actuator_entries.values() for entry in entries]
    for index, stage in enumerate(scene.mounting):
        _check_tensions(own, stage, f"mounting[{index}]", scene)
    found = dict(zip(own.actuator_names, own.state.efforts, strict=True))
    efforts = np.array([found.get(name, 0.0) for name in names])
    return Mounted(own.state.positions.copy(), efforts, own.model.nodes)


def drawn_scene(scene: Scene) -> Scene:
    """The drawn robot, whose fixed bodies and actuators can move as its mounting says.

    Actuators that no stage names do nothing. What only watches is left out.

    Args:
        scene: A scene with a mounting.
    """
    moved = {move.body for stage in scene.mounting for move in stage.bodies}
    most: dict[str, list[float]] = {}
    tensions = dict[str, float]()
    for stage in scene.mounting:
        for move in stage.actuators:
            if move.tension is None:
                most.setdefault(move.actuator, [0.0]).append(move.displacement)
            else:
                most[move.actuator], tensions[move.actuator] = [0.0, UNLIMITED], move.tension

    def guided(body):
        free = dict(motion="guided", speed=UNLIMITED, turn_rate=UNLIMITED)
        return body.changed(**free) if body.name in moved else body

    def wide(key: str, entries: tuple) -> tuple:
        return tuple(
            entry.changed(rate=None, offset=0.0, **{
                key: (min(most[entry.name]) - MARGIN, max(most[entry.name]) + MARGIN)})
            for entry in entries if entry.name in most
        )  # fmt: skip

    cables = tuple(cable.changed(tension=(0.0, tensions.get(cable.name, np.inf)), pulley=None)
                   for cable in wide("shortening", scene.cables))  # fmt: skip
    motors = tuple(motor.changed(torque=(-np.inf, np.inf))
                   for motor in wide("angle", scene.hinge_motors))  # fmt: skip
    drawn = dict.fromkeys(scene.actuator_entries, ()) | dict(cables=cables, hinge_motors=motors)
    return scene.changed(
        mounting=(), integration="quasi_static", time_scheme="backward_euler", spectral_radius=None,
        rigid_bodies=guided, effectors=(), touches=(), markers=(), observer=None, motors=(),
        sensors=(), reactions=(), grips=(), moving_base=None,
        solver=dict(newton_iterations=MOST_LINEARIZATIONS, residual_tolerance=RESIDUAL_TOLERANCE,
                    exploration=False),
        **drawn,
    )  # fmt: skip


def _make(own, here: _Supports, stage: MountingStage, key: str, scene: Scene) -> None:
    """Make the moves of a stage from where the supports are, together and in steps.

    A step after which Newton's method takes many linearizations may end on another branch than a
    shorter one, so it is halved.
    """
    before, share, longest = own.state, 0.0, 1.0 / stage.steps
    length = longest
    while share < 1.0:
        ahead = min(share + length, 1.0)
        ahead = ahead if ahead < WHOLE else 1.0
        result = own.step(here.moved(stage, ahead).command(own))
        count = result.report.iterations
        if own.is_balanced and (count <= MOST_TAKEN or length <= SHORTEST * longest):
            share, before = ahead, own.state
            length = min(longest, 2.0 * length) if count <= FEW_TAKEN else length
            continue
        own.restore(before)
        if length > SHORTEST * longest:
            length *= 0.5
        elif (past := _past_an_end(own, here, stage, share, longest)) is not None:
            share, before = past, own.state
        else:
            raise MountingError(scene, key, stage, share, own)


def _past_an_end(own, here: _Supports, stage: MountingStage, share: float, longest: float) -> float | None:
    """Steps past the end of a branch, where a robot snaps into another shape; None where none is found."""
    before = own.state
    for length in SNAPPED * longest:
        ahead = min(share + length, 1.0)
        own.step(here.moved(stage, ahead).command(own))
        if own.is_balanced:
            return ahead
        own.restore(before)
    return None


def _check_tensions(own, stage: MountingStage, key: str, scene: Scene) -> None:
    """Refuses a stage whose cables are wound up before they bear their tensions [N]."""
    efforts = dict(zip(own.actuator_names, own.state.efforts, strict=True))
    before, now = map(own.actuators.path_lengths, (own.model.nodes.rest_positions, own.state.positions))
    for index, move in enumerate(stage.actuators):
        if move.tension is None:
            continue
        name = move.actuator
        if now[name] < ROUNDED * before[name] or efforts[name] < (1.0 - SHORT_OF) * move.tension:
            raise SceneError(
                scene.path, f"{key}.actuators[{index}].tension", move.tension, "N",
                f"{name} is wound up before it bears that: {1e3 * now[name]:.3g} mm are left "
                f"of {1e3 * before[name]:.3g} mm")  # fmt: skip


def _settle(own) -> None:
    """Steps until round-off alone is left: derivatives are differences of mounted robots."""
    for _ in range(MOST_SETTLING):
        before = own.state.positions
        own.step(CommandSetpoints(own.state.setpoints, LONG))
        if np.abs(own.state.positions - before).max() <= SETTLED * own.model.nodes.size:
            break


def _settles_from(own, before: Mounted, scene: Scene) -> bool:
    """Whether the equilibrium at the end of all stages is found from that of another robot."""
    supports = _Supports.of(own)
    for stage in scene.mounting:
        supports = supports.moved(stage, 1.0)
    own.restore(replace(own.state, positions=own.model.nodes.placed_like(before.drawn, before.positions)))
    # After many linearizations it may be one of another branch.
    result = own.step(supports.command(own))
    return own.is_balanced and result.report.iterations <= MOST_TAKEN


class _Supports(NamedTuple):
    """Where fixed bodies and actuators are.

    Attributes:
        poses: Origin [m] and rotation of each body that moves, by its name.
        displacements: Of the actuators, by their names.
        lengths: At rest, of the cables among them.
    """

    poses: dict[str, tuple[np.ndarray, Rotation]]
    displacements: dict[str, float]
    lengths: dict[str, float]

    @classmethod
    def of(cls, own) -> _Supports:
        """Those of a simulation now."""
        state, poses = own.state, {}
        for name in own.guided_names:
            origin, quaternion = own.model.guides.pose(name, state.positions)
            poses[name] = origin, Rotation.from_quat(quaternion)
        drives = own.actuators.drives(state.setpoints)
        named = (dict(zip(own.actuator_names, values, strict=True)) for values in (drives, own.rest_setpoints))
        return cls(poses, *named)

    def moved(self, stage: MountingStage, share: float) -> _Supports:
        """Those after a share of a stage."""
        poses, displacements = dict(self.poses), dict(self.displacements)
        for move in stage.bodies:
            origin, rotation = self.poses[move.body]
            turn = share * np.array(move.turn)
            poses[move.body] = (origin + share * np.array(move.translation),
                                Rotation.from_rotvec(turn) * rotation)  # fmt: skip
        for move in stage.actuators:
            start, end = self.displacements[move.actuator], move.displacement
            # Wound as if its whole length could be, a cable stops at the tension that it may have at most.
            end = self.lengths[move.actuator] if end is None else end
            displacements[move.actuator] = start + share * (end - start)
        return _Supports(poses, displacements, self.lengths)

    def command(self, own) -> CommandSetpoints:
        """Aims the bodies of a simulation, and commands its actuators."""
        for name, (origin, rotation) in self.poses.items():
            own.model.guides.aim(name, origin, rotation.as_quat())
        drives = np.array([self.displacements[name] for name in own.actuator_names])
        return CommandSetpoints(own.actuators.setpoints(drives), LONG)


def branch_notes(simulation: Steppable) -> Iterator[str]:
    """Tell of a mounted robot that a small disturbance brings into another shape.

    Args:
        simulation: The simulation; at rest afterwards.

    Yields:
        A sentence, where there is something to tell.
    """
    rest, nodes = simulation.state, simulation.model.nodes
    command = CommandSetpoints(rest.setpoints, LONG)
    simulation.step(command)
    compliance, rng = simulation.newton.tangent.static_factorization, np.random.default_rng(0)
    for _ in range(DISTURBANCES if compliance else 0):
        move = compliance.solve(rng.normal(size=(nodes.free_node_count, 3))).copy()
        disturbed = rest.positions.copy()
        nodes.advance(disturbed, move, DISTURBED * nodes.size / nodes.longest(move))
        simulation.restore(replace(rest, positions=disturbed))
        for _ in range(STEPS_BACK):
            result = simulation.step(command)
            if result.status.is_success and simulation.is_balanced:
                break
        apart = float(np.linalg.norm(simulation.state.positions - rest.positions, axis=1).max())
        if apart > BACK * nodes.size:
            yield (f"mounting: a disturbance by {1000.0 * DISTURBED * nodes.size:.2g} mm brings the robot "
                   f"into another shape, {1000.0 * apart:.3g} mm away")  # fmt: skip
            break
    simulation.reset()
