"""A `gymnasium` environment: an effector reaches for targets, with a robot of any scene.

    from softrobot_twin.scripting.gym_environment import ReachingEnvironment
    environment = ReachingEnvironment("config/scenes/finger.yaml")

or, once this module is imported, ``gymnasium.make("softrobot_twin/Reaching-v0", scene=...)``.
gymnasium is an extra: ``pip install gymnasium``.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.scene import Scene
from softrobot_twin.scripting.named_commands import finite_numbers, unknown
from softrobot_twin.scripting.robot import Robot, load
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.study.figure import MissingExtraError
from softrobot_twin.study.rasterization import Triangles, camera_at, rasterize
from softrobot_twin.study.scene_picture import layers_of, take_snapshot
from softrobot_twin.study.workspace import Axis, driven_by, joint_axes

try:
    import gymnasium
except ImportError as error:
    raise MissingExtraError("gymnasium", "learning environments need it") from error

ENVIRONMENT_ID = "softrobot_twin/Reaching-v0"
# Where observed places end, in sizes of the robot: further than any of its points gets.
_FAR = 4.0
# Steps in which a robot comes to rest at random setpoints, and how many of these are tried.
_MOST_STEPS, _MOST_DRAWS = 100, 20
# Rows and columns of a picture, where its eye is, and the colours of cables and cavities.
_PICTURE, _CAMERA = (480, 640), camera_at(15.0, -70.0)
_COLOURS = {"cable": np.array([0.60, 0.15, 0.40]), "cavity": np.array([0.80, 0.30, 0.25])}


class ReachingEnvironment(gymnasium.Env[np.ndarray, np.ndarray]):
    """An effector shall reach a target within an episode.

    - Action: for each drive (an actuator, or a motor with its cables) the speed at which its
      setpoint moves, -1 to 1: as a share of its rate in the scene.
    - Observation: the setpoint of each drive, -1 to 1 between its limits; the effector's place less
      that at the start of the episode; the target less the effector's place. Both places are shares
      of the robot's size, along x, y and z.
    - Reward of a step: less the distance to the target [m].
    - An episode ends (`terminated`) where the target is reached, and is cut (`truncated`) after
      `most_steps`.
    - Targets are reachable: the effector's place at random setpoints, in balance.

    A step without solution leaves the robot where it is; ``info["status"]`` says so. The same seed
    gives the same episodes.

    Attributes:
        robot: The robot.
        drives: What an action moves, in its order.
        target: Of this episode [m], shape (3,).
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

        Raises:
            CommandError: The scene has no such effector or no actuator, an actuator has no limits
                or no rate, or a value is out of its range.
            SceneError: The scene cannot be used.
        """
        if isinstance(scene, Robot):
            self.robot = scene
        else:
            self.robot = Robot(scene) if isinstance(scene, Scene) else load(scene)
        names = self.robot.effector_names
        if not names:
            raise CommandError(self.robot.name, "has no effector that could reach a target")
        if effector not in (None, *names):
            raise unknown(str(effector), "effectors:", names)
        self.effector = effector or names[0]
        self.time_step = _within("time_step", time_step, 1.0e-6, 1.0e3)
        self.most_steps = int(_within("most_steps", most_steps, 1, 10**9))
        self.reached_within = _within("reached_within", reached_within, 0.0, math.inf)
        self.travel = _within("travel", travel, 0.0, 1.0)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise CommandError("render_mode", f"{render_mode!r} must be None or rgb_array")
        self.render_mode = render_mode

        self._simulation = self.robot.simulation
        self.drives = _drives_of(self._simulation)
        self._least, self._most, self._rates = (
            np.array([getattr(drive, field) for drive in self.drives])
            for field in ("least", "most", "rate")
        )
        self._size = float(self._simulation.model.nodes.size)
        self._start = self.target = np.full(3, np.nan)
        self._step_count, self._window = 0, np.zeros(4)
        places = np.full(6, _FAR, np.float32)
        shares = np.ones(len(self.drives), np.float32)
        self.action_space = gymnasium.spaces.Box(-shares, shares, dtype=np.float32)
        self.observation_space = gymnasium.spaces.Box(
            -np.append(shares, places), np.append(shares, places), dtype=np.float32
        )

    @property
    def place(self) -> np.ndarray:
        """Position of the effector [m], shape (3,)."""
        return self.robot.effectors[self.effector]

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
            options: ``{"target": [x, y, z]}`` is the target [m] in place of a random one.

        Returns:
            The observation and the info, see `step`.

        Raises:
            CommandError: An option is unknown or no place.
        """
        super().reset(seed=seed)
        given = dict(options or {})
        target = given.pop("target", None)
        if given:
            raise CommandError(next(iter(given)), "is no option of reset; there is: target")
        self.target = self._random_target() if target is None else _place_of(target)
        self.robot.reset()
        self.robot.settle(time_step=self.time_step, most_steps=_MOST_STEPS)
        self._start, self._step_count = self.place, 0
        self._window = self._window_around()
        return self._observation(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Moves the setpoints for one time step.

        Args:
            action: Speed of each drive, -1 to 1, shape (drive_count,).

        Returns:
            Observation, reward [m], terminated, truncated, and info: ``distance`` [m], ``status`` of
            the step and ``is_success``, whether the target is reached.

        Raises:
            CommandError: `reset` was never called, or the action is not finite or of another shape.
        """
        speeds = np.asarray(action, dtype=float)
        if speeds.shape != self._least.shape or not np.isfinite(speeds).all():
            raise CommandError("action", f"{action!r} must be {len(self.drives)} finite numbers")
        if not np.isfinite(self.target).all():
            raise CommandError("step", "an episode begins with reset()")
        moved = self._present() + np.clip(speeds, -1.0, 1.0) * self._rates * self.time_step
        outcome = self._simulation.step(self._command(np.clip(moved, self._least, self._most)))
        self._step_count += 1
        info = self._info() | {"status": outcome.status.value}
        truncated = self._step_count >= self.most_steps
        return self._observation(), -info["distance"], info["is_success"], truncated, info

    def render(self) -> np.ndarray | None:
        """A picture of the robot and its target, where `render_mode` asks for it.

        All pictures of an episode show the same part of space.

        Returns:
            Red, green and blue, 0 to 255, shape (480, 640, 3); None without a mode.

        Raises:
            CommandError: `reset` was never called.
        """
        if self.render_mode is None:
            return None
        if not np.isfinite(self.target).all():
            raise CommandError("render", "an episode begins with reset()")
        targets = np.full((len(self.robot.effector_names), 3), np.nan)
        targets[self.robot.effector_names.index(self.effector)] = self.target
        image = rasterize(_layers(self._simulation, targets), self._window, _PICTURE)
        return np.rint(255.0 * (1.0 - image[..., 3:] * (1.0 - image[..., :3]))).astype(np.uint8)

    def _window_around(self) -> np.ndarray:
        """Left, right, bottom and top of the pictures of this episode [m]."""
        places = np.vstack([self.robot.positions, self.place, self.target])
        middle = _CAMERA.project(0.5 * (places.min(axis=0) + places.max(axis=0)))[:2]
        extent = float(np.linalg.norm(np.ptp(places, axis=0)))
        half = 0.7 * extent * np.array([_PICTURE[1] / _PICTURE[0], 1.0])
        (left, bottom), (right, top) = middle - half, middle + half
        return np.array([left, right, bottom, top])

    def _random_target(self) -> np.ndarray:
        """Where the effector comes to rest at random setpoints [m], shape (3,)."""
        rest = np.clip(0.0, self._least, self._most)
        least, most = (rest + self.travel * (end - rest) for end in (self._least, self._most))
        for _ in range(_MOST_DRAWS):
            self.robot.reset()
            wanted = self._command(self.np_random.uniform(least, most))
            result = self.robot.settle(wanted, time_step=self.time_step, most_steps=_MOST_STEPS)
            if not result.status.is_failure:
                return self.place
        raise CommandError(
            self.effector, f"the robot stood at none of {_MOST_DRAWS} random setpoints: lower "
            "travel, or narrow the limits of its actuators")

    def _present(self) -> np.ndarray:
        """What each drive is set to: its displacement or effort, shape (drive_count,)."""
        all_drives = self._simulation.actuators.drives(self._simulation.state.setpoints)
        return np.array([all_drives[drive.places[0]] for drive in self.drives])

    def _command(self, values: np.ndarray) -> CommandSetpoints:
        actuators = self._simulation.actuators
        every = actuators.drives(self._simulation.state.setpoints).copy()
        for drive, value in zip(self.drives, values, strict=True):
            every[list(drive.places)] = value
        return CommandSetpoints(actuators.setpoints(every), self.time_step)

    def _observation(self) -> np.ndarray:
        place = self.place
        shares = 2.0 * (self._present() - self._least) / (self._most - self._least) - 1.0
        seen = np.concatenate(
            [shares, (place - self._start) / self._size, (self.target - place) / self._size]
        ).astype(np.float32)
        space = self.observation_space
        return np.clip(seen, space.low, space.high)  # type: ignore[attr-defined]

    def _info(self) -> dict[str, Any]:
        distance = self.distance
        return {"distance": distance, "is_success": bool(distance < self.reached_within)}


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
            raise CommandError(drive.name,
                               "has no rate, which an environment needs: give it in the scene")
    if not drives:
        raise CommandError(simulation.scene.name, "has no actuator that could learn")
    return tuple(drives)


def _layers(simulation: Simulation, targets: np.ndarray) -> dict[str, Triangles]:
    """What is drawn of a state: bodies, obstacles, cables, cavities, effectors and targets [m]."""
    shown = take_snapshot(simulation, None, "", targets)
    solids = [solid._replace(colour=_COLOURS.get(solid.kind, solid.colour))
              for solid in shown.solids]
    direction = _CAMERA.eye - 0.4 * _CAMERA.right + 0.5 * _CAMERA.up
    direction /= np.linalg.norm(direction)
    return layers_of(solids, _CAMERA, lambda normals, _: (
        0.65 + 0.4 * np.clip(normals @ direction, 0.0, None)))


def _within(name: str, value: float, least: float, most: float) -> float:
    number = finite_numbers(name, value)[0]
    if not least <= number <= most:
        raise CommandError(name, f"{value} must be from {least:g} to {most:g}")
    return number


def _place_of(target: Any) -> np.ndarray:
    numbers = finite_numbers("target", target)
    if len(numbers) != 3:
        raise CommandError("target", f"has {len(numbers)} numbers, not x, y and z [m]")
    return np.array(numbers)


gymnasium.register(
    id=ENVIRONMENT_ID,
    entry_point=f"{__name__}:ReachingEnvironment",
)
