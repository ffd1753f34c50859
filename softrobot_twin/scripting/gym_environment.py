"""A `gymnasium` environment: an effector reaches for targets, with a robot of any scene.

`vector_environment.py` steps many of them at once.

    from softrobot_twin.scripting.gym_environment import ReachingEnvironment
    environment = ReachingEnvironment("config/scenes/finger.yaml")

or, once this module is imported, ``gymnasium.make("softrobot_twin/Reaching-v0", scene=...)``.
gymnasium is an extra: ``pip install gymnasium``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.harness.figure import MissingExtraError
from softrobot_twin.harness.sampled_axes import Axis, driven_by, joint_axes
from softrobot_twin.scene import Scene
from softrobot_twin.scene.scene_parameters import (
    JointParameter,
    Parameter,
    changed_scene,
    parameters,
)
from softrobot_twin.scripting.named_commands import (
    array_of,
    check_given,
    finite_numbers,
    one_number,
    place_of,
    whole_number,
)
from softrobot_twin.scripting.robot import Robot, load
from softrobot_twin.simulation import CommandSetpoints, Simulation, State
from softrobot_twin.study.scene_picture import take_snapshot
from softrobot_twin.study.triangle_drawing import camera_at, image_of

try:
    import gymnasium
except ImportError as error:
    raise MissingExtraError("gymnasium", "learning environments need it") from error

ENVIRONMENT_ID = "softrobot_twin/Reaching-v0"
# Where observed places end, in sizes of the robot: further than any of its points gets.
_FAR = 4.0
# Steps in which a robot comes to rest at random setpoints, and how many of these are tried.
_MOST_STEPS, _MOST_DRAWS = 100, 20
# Rows and columns of a picture, and where its eye is.
_PICTURE, _CAMERA = (480, 640), camera_at(15.0, -70.0)

Draw: TypeAlias = Callable[[np.random.Generator], float]
"""Draws a value of a parameter, in its unit."""
Randomized: TypeAlias = Mapping[str | Parameter | JointParameter, tuple[float, float] | Draw]
"""What is drawn for episodes: parameters by their handles, or by keys that may have ``*``, each
between two values or by a function of a generator."""


class ReachingEnvironment(gymnasium.Env[np.ndarray, np.ndarray]):
    """An effector shall reach a target within an episode.

    - Action: for each drive (an actuator, or a motor with its cables) the speed at which its
      setpoint moves, -1 to 1: as a share of its rate in the scene.
    - Observation: the setpoint of each drive, -1 to 1 between its limits; the effector's place less
      that at the start of the episode; the target less the effector's place. Both places are shares
      of the robot's size, along x, y and z.
      Parts of an action out of range are cut to it, and counted.
    - Reward of a step: less the distance to the target [m].
    - An episode ends (`terminated`) where the target is reached, and is cut (`truncated`) after
      `most_steps`.
    - A step without solution leaves the robot where it is and ends the episode; ``info["status"]``
      says so. Its reward is that of all steps which are left: to fail is never worth it.
    - Targets are reachable: the effector's place at random setpoints, in balance.

    The same seed gives the same episodes.

    Attributes:
        robot: The robot.
        drives: What an action moves, in its order.
        target: Of this episode [m], shape (3,).
        parameters: What was drawn for this episode, by key, each in its unit.
        clipped_count: Parts of actions that were out of range, in all.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        scene: Path | str | Scene | Robot,
        *,
        effector: str | None = None,
        time_step: float = 0.1,
        most_steps: int = 50,
        reached_within: float = 1.0e-3,
        travel: float = 0.6,
        render_mode: str | None = None,
        randomize: Randomized | None = None,
        redraw_every: int = 1,
        states: Sequence[State] = (),
    ):
        """Build the robot.

        Args:
            scene: File of a scene, a scene, or a robot, which the environment then moves.
            effector: Name of the effector; by default the first one.
            time_step: Duration of a step [s].
            most_steps: Steps of an episode.
            reached_within: Distance at which a target counts as reached [m]; 0 for never.
            travel: Share of the range of each drive, around its setpoint at rest, that targets
                are drawn from.
            render_mode: ``rgb_array`` for pictures by `render`, or None.
            randomize: Numbers of the scene that are drawn for episodes, such as
                ``{"body.material.young_modulus": (150e3, 210e3)}``, in their units.
            redraw_every: Episodes between two draws: each builds the robot anew, without compiling.
            states: Where episodes begin, by chance, such as `sample_states` gives; the target is
                the effector's place at another of them. Empty for the robot at rest.

        Raises:
            CommandError: The scene has no such effector or no actuator, an actuator has no limits
                or no rate, a value is out of its range, or a state is of another scene.
            SceneError: The scene cannot be used, or does not take what may be drawn.
        """
        if isinstance(scene, Robot):
            self.robot = scene
        else:
            self.robot = Robot(scene) if isinstance(scene, Scene) else load(scene)
        names = self.robot.effector_names
        if not names:
            raise CommandError(self.robot.name, "has no effector that could reach a target")
        self.effector = names[0 if effector is None else place_of(effector, "effectors:", names)]
        self.time_step = _within("time_step", time_step, 1.0e-6, 1.0e3)
        self.most_steps = whole_number("most_steps", most_steps)
        self.reached_within = _within("reached_within", reached_within, 0.0, math.inf)
        self.travel = _within("travel", travel, 0.0, 1.0)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise CommandError("render_mode", f"{render_mode!r} must be None or rgb_array")
        self.render_mode = render_mode

        self._draws = _draws_of(self.robot.scene, {} if randomize is None else randomize)
        self.redraw_every = whole_number("redraw_every", redraw_every)
        self.parameters = dict[str, float]()
        self._effector_index = names.index(self.effector)
        self._nominal = self.robot.simulation
        self._take()
        check_given("states", states, Iterable, "states of the scene")
        self.states = tuple(states)
        if len(self.states) == 1:
            raise CommandError("states", "has 1 state: an episode needs another one as its target")
        self._places = [self._stand_at(state) and self.place for state in self.states]
        self._size = float(self._simulation.model.nodes.size)
        self._start = self.target = np.full(3, np.nan)
        self._has_begun, self._window = False, np.zeros(4)
        self._step_count = self._episode_count = self.clipped_count = 0
        places = np.full(6, _FAR, np.float32)
        shares = np.ones(len(self.drives), np.float32)
        self.action_space = gymnasium.spaces.Box(-shares, shares, dtype=np.float32)
        self.observation_space = gymnasium.spaces.Box(
            -np.append(shares, places), np.append(shares, places), dtype=np.float32
        )

    def _take(self) -> None:
        """Steps the robot's present simulation from now on."""
        self._simulation = self.robot.simulation
        self.drives = _drives_of(self._simulation)
        self._least, self._most, self._rates = (
            np.array([getattr(drive, field) for drive in self.drives])
            for field in ("least", "most", "rate")
        )
        self._first_of = np.array([drive.places[0] for drive in self.drives])
        self._moved = np.concatenate([drive.places for drive in self.drives])
        self._drive_of = np.repeat(
            np.arange(len(self.drives)), [len(drive.places) for drive in self.drives])

    @property
    def place(self) -> np.ndarray:
        """Position of the effector [m], shape (3,)."""
        return self._simulation.effector_positions()[self._effector_index]

    @property
    def distance(self) -> float:
        """Of the effector from its target [m]."""
        return float(np.linalg.norm(self.target - self.place))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins an episode: the robot at rest, and a target.

        Args:
            seed: Of the random targets from now on; None goes on with them.
            options: ``{"target": [x, y, z]}`` is the target [m] in place of a random one,
                ``{"state": state}`` a state of the scene in which the episode begins.

        Returns:
            The observation and the info, see `step`.

        Raises:
            CommandError: An option is unknown, no place, or no state of the scene.
            SceneError: The robot cannot be built with what was drawn.
        """
        target, state = self.read_options(options)
        super().reset(seed=seed)
        info: dict[str, Any] = {}
        if self._draws:
            self._episode_count = 0 if seed is not None else self._episode_count
            if self._episode_count % self.redraw_every == 0:
                self._redraw()
            self._episode_count += 1
            info["parameters"] = dict(self.parameters)
        if self.states:
            begin, end = self.np_random.choice(len(self.states), 2, replace=False)
            state = self.states[begin] if state is None else state
            self.target = self._places[end]
        elif target is None:
            # Where the effector comes to rest at random setpoints.
            self._random_state(self.np_random)
            self.target = self.place
        self.target = self.target if target is None else target
        self._stand_at(state)
        if self._draws or state is None:
            result = self.robot.settle(time_step=self.time_step, most_steps=_MOST_STEPS)
            info["status"] = result.status.value
        self._start, self._step_count, self._has_begun = self.place, 0, True
        self._window = self._window_around()
        return self._observation(self._start), self._info(self._start) | info

    def read_options(self, options: dict[str, Any] | None) -> tuple[np.ndarray | None, State | None]:
        """The target [m] and the state of options, None for what they do not give.

        Args:
            options: See `reset`.

        Raises:
            CommandError: An option is unknown, no place, or no state of the scene.
        """
        check_given("options", {} if options is None else options, Mapping, "target and state by name")
        given = dict(options or {})
        target, state = given.pop("target", None), given.pop("state", None)
        if given:
            raise CommandError(next(iter(given)), "is no option of reset; there are: target, state")
        if state is not None:
            self._simulation.check_fits(state)
        place = None if target is None else np.array(finite_numbers("target", target))
        if place is not None and place.shape != (3,):
            raise CommandError("target", f"has {len(place)} numbers, not x, y and z [m]")
        return place, state

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Moves the setpoints for one time step.

        Args:
            action: Speed of each drive, -1 to 1, shape (drive_count,).

        Returns:
            Observation, reward [m], terminated, truncated, and info: ``distance`` [m], ``status``
            of the step, ``is_success``, whether the target is reached, ``is_failure``, whether there
            was no solution, and ``clipped``, how many parts of the action were out of range.

        Raises:
            CommandError: `reset` was never called, or the action is not finite or of another shape.
        """
        speeds = array_of("action", action, self._least.shape)
        if not self._has_begun:
            raise CommandError("step", "an episode begins with reset()")
        allowed = np.minimum(np.maximum(speeds, -1.0), 1.0)
        clipped = int(np.count_nonzero(allowed != speeds))
        self.clipped_count += clipped
        moved = self._present() + allowed * self._rates * self.time_step
        outcome = self._simulation.step(self._command(np.minimum(np.maximum(moved, self._least), self._most)))
        self._step_count += 1
        place, fails = self.place, outcome.status.is_failure
        info = self._info(place) | {"status": outcome.status.value, "is_failure": fails, "clipped": clipped}
        reward = -info["distance"]
        if fails:
            reward *= 1 + self.most_steps - self._step_count
        return (self._observation(place), reward, info["is_success"] or fails,
                self._step_count >= self.most_steps, info)

    def prepare(self) -> None:
        """Computes ahead what the next step needs, whatever its action; see `Simulation.prepare`."""
        self._simulation.prepare(self._command(self._present()))

    def sample_states(self, count: int, seed: int = 0) -> tuple[State, ...]:
        """States at random setpoints, in balance: where episodes may begin; see `states`.

        Args:
            count: How many.
            seed: Of their setpoints.

        Raises:
            CommandError: The robot stood nowhere.
        """
        random = np.random.default_rng(seed)
        return tuple(self._random_state(random) for _ in range(whole_number("count", count, 0)))

    def render(self) -> np.ndarray | None:
        """A picture of the robot and its target, where `render_mode` asks for it.

        All pictures of an episode show the same part of space.

        Returns:
            Red, green and blue, 0 to 255, shape (480, 640, 3); None without a mode.

        Raises:
            CommandError: `reset` was never called.
            MissingExtraError: matplotlib is not installed.
        """
        if self.render_mode is None:
            return None
        if not self._has_begun:
            raise CommandError("render", "an episode begins with reset()")
        targets = np.full((len(self.robot.effector_names), 3), np.nan)
        targets[self._effector_index] = self.target
        return image_of(take_snapshot(self._simulation, None, "", targets).solids, _CAMERA, self._window, _PICTURE)

    def _window_around(self) -> np.ndarray:
        """Left, right, bottom and top of the pictures of this episode [m]."""
        places = np.vstack([self.robot.positions, self.place, self.target])
        middle = _CAMERA.project(0.5 * (places.min(axis=0) + places.max(axis=0)))[:2]
        extent = float(np.linalg.norm(np.ptp(places, axis=0)))
        half = 0.7 * extent * np.array([_PICTURE[1] / _PICTURE[0], 1.0])
        (left, bottom), (right, top) = middle - half, middle + half
        return np.array([left, right, bottom, top])

    def _redraw(self) -> None:
        """Gives the scene other numbers."""
        self.parameters = {one.key: float(draw(self.np_random)) for one, draw in self._draws}
        changes = dict[str, float]()
        for one, _ in self._draws:
            changes |= one.changes(self.parameters[one.key])
        try:
            self.robot.change(changes)
        except CommandError as error:
            raise CommandError(", ".join(self.parameters), "cannot be drawn: the robot would have "
                               f"other unknowns ({error}); draw from the full model") from None
        self._take()

    def _stand_at(self, state: State | None) -> bool:
        """Puts the robot to a state of the scene before any draw, or to rest for None."""
        if state is None:
            self.robot.reset()
        elif self._simulation is self._nominal:
            self.robot.state = state
        else:
            self._simulation.take_over(self._nominal, state)
            self.robot.state = self._simulation.state
        return True

    def _random_state(self, random: np.random.Generator) -> State:
        """Brings the robot to rest at random setpoints."""
        rest = np.clip(0.0, self._least, self._most)
        least, most = (rest + self.travel * (end - rest) for end in (self._least, self._most))
        for _ in range(_MOST_DRAWS):
            self.robot.reset()
            wanted = self._command(random.uniform(least, most))
            result = self.robot.settle(wanted, time_step=self.time_step, most_steps=_MOST_STEPS)
            if not result.status.is_failure:
                return self.robot.state
        raise CommandError(
            self.effector, f"the robot stood at none of {_MOST_DRAWS} random setpoints: lower "
            "travel, or narrow the limits of its actuators")

    def _present(self) -> np.ndarray:
        """What each drive is set to: its displacement or effort, shape (drive_count,)."""
        return self._simulation.actuators.drives(self._simulation.state.setpoints)[self._first_of]

    def _command(self, values: np.ndarray) -> CommandSetpoints:
        actuators = self._simulation.actuators
        every = actuators.drives(self._simulation.state.setpoints).copy()
        every[self._moved] = values[self._drive_of]
        return CommandSetpoints(actuators.setpoints(every), self.time_step)

    def _observation(self, place: np.ndarray) -> np.ndarray:
        shares = 2.0 * (self._present() - self._least) / (self._most - self._least) - 1.0
        seen = np.concatenate(
            [shares, (place - self._start) / self._size, (self.target - place) / self._size]
        ).astype(np.float32)
        space = self.observation_space
        return np.minimum(np.maximum(seen, space.low), space.high)  # type: ignore[attr-defined]

    def _info(self, place: np.ndarray) -> dict[str, Any]:
        distance = math.dist(self.target, place)
        return {"distance": distance, "is_success": distance < self.reached_within}


def _draws_of(scene: Scene, randomized: Randomized) -> tuple[tuple[Parameter | JointParameter, Draw], ...]:
    """Each parameter that is drawn, and how; the scene takes both ends of each range."""
    draws, ends = [], (dict[str, float](), dict[str, float]())
    check_given("randomize", randomized, Mapping, "ranges by keys")
    for key, how in randomized.items():
        check_given("randomize", key, str | Parameter | JointParameter, "keys of numbers")
        own = parameters(scene, key) if isinstance(key, str) else (key,)
        if not callable(how):
            name = key if isinstance(key, str) else key.key
            numbers = finite_numbers(name, how)
            if len(numbers) != 2 or numbers[0] > numbers[1]:
                raise CommandError(name, f"is drawn from {how!r}, which must be a least and a greatest "
                                   f"value [{own[0].unit}], or a function of a random generator")
            how = partial(np.random.Generator.uniform, low=numbers[0], high=numbers[1])
            for changes, end in zip(ends, numbers, strict=True):
                for one in own:
                    changes |= one.changes(end)
        draws += [(one, how) for one in own]
    for changes in ends:
        changed_scene(scene, changes)
    return tuple(draws)


def _drives_of(simulation: Simulation) -> tuple[Axis, ...]:
    """What an action moves: motors with their cables, and all other actuators."""
    limits = simulation.limits
    drives = joint_axes(simulation, limits.drive_min, limits.drive_max)
    for drive in drives:
        if not (math.isfinite(drive.least) and math.isfinite(drive.most) and drive.least < drive.most):
            word = driven_by(simulation, drive).word
            raise CommandError(
                drive.name, f"has a {word} from {drive.least:g} to {drive.most:g}; an environment "
                f"needs finite limits: give {word}: [least, most] in the scene")
        if not math.isfinite(drive.rate):
            raise CommandError(drive.name, "has no rate, which an environment needs: give it in the scene")
    if not drives:
        raise CommandError(simulation.scene.name, "has no actuator that could learn")
    return tuple(drives)


def _within(name: str, value: float, least: float, most: float) -> float:
    number = one_number(name, value)
    if not least <= number <= most:
        raise CommandError(name, f"{value} must be from {least:g} to {most:g}")
    return number


gymnasium.register(id=ENVIRONMENT_ID, entry_point=f"{__name__}:ReachingEnvironment")
