"""Many robots at once for reinforcement learning: a `gymnasium` vector environment.

    environments = st.vector_env("config/scenes/diamond.yaml", 32, workers=2)
    observations, infos = environments.reset(seed=0)
    observations, rewards, terminations, truncations, infos = environments.step(actions)

Each worker owns some of the robots: a process of this machine, or of a Dask cluster. What a robot
does depends on its seed and its actions alone, not on the number of workers.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.errors import CommandError, one_line
from softrobot_twin.harness.sample_workers import core_count
from softrobot_twin.harness.worker_process import WorkerError, WorkerProcess
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.loading import changes_of
from softrobot_twin.scripting.gym_environment import (  # type: ignore[attr-defined]
    ReachingEnvironment,
    gymnasium,
)
from softrobot_twin.scripting.named_commands import array_of, whole_number
from softrobot_twin.scripting.robot import Robot, SceneWarning
from softrobot_twin.simulation import State


class VectorEnvironment(gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Robots of one scene, each a `ReachingEnvironment`, that are stepped together.

    An array of all robots has one row for each: actions of shape (count, drive_count), rewards and
    ends of shape (count,). A robot whose episode has ended begins another one by itself, as
    ``metadata["autoreset_mode"]`` says: by default in its next step, whose action is not used.

    Where a worker fails or is lost, the error names it with its robots, and all workers end.

    Attributes:
        scene: The scene that is stepped.
        model: Which model that is, in words.
        states: Where episodes begin; empty for the robot at rest.
    """

    def __init__(
        self,
        scene: Path | str | Scene | Robot,
        count: int,
        workers: Any = None,
        *,
        reduced: bool = True,
        states: int | Sequence[State] = 0,
        autoreset_mode: str | None = None,
        **of_each: Any,
    ):
        """Start the workers, and build their robots.

        Args:
            scene: File of a scene, a scene, or a robot whose scene is taken.
            count: Number of robots.
            workers: Number of processes, 1 for this one alone; or a `dask.distributed.Client`, each
                of whose workers is one. None for a process on each core.
            reduced: Whether a file with ``_reduced`` in its name, beside that of the scene, is
                taken in its place; a warning says so.
            states: Where episodes begin, and the targets: see `ReachingEnvironment`. A number for
                as many random ones, the same each time; 0 for the robot at rest.
            autoreset_mode: As `gymnasium.vector.SyncVectorEnv` takes it; None for its default.
            **of_each: Further arguments of each `ReachingEnvironment`.

        Raises:
            CommandError: See `ReachingEnvironment`; or a number is out of its range.
            SceneError: See `ReachingEnvironment`.
            WorkerError: A worker ends before its robots are built.
        """
        self._workers: list[_Here | _OnCluster | WorkerProcess] = []
        self.num_envs = whole_number("count", count)
        self.scene, beside = _scene_of(scene, reduced)
        # What is wrong is refused here, by its own error, before any process starts.
        given = () if isinstance(states, int) else tuple(states)
        self._first = first = ReachingEnvironment(self.scene, states=given, **of_each)
        self.states = first.sample_states(states) if isinstance(states, int) else given
        first.reset(seed=0)
        simulation = first.robot.simulation
        kind = "reduced" if simulation.has_reduced_bodies else "full"
        self.model = f"{kind} model of {simulation.dof_count} unknowns, {self.scene.path}{beside}"
        modes: dict[str, Any] = {} if autoreset_mode is None else {"autoreset_mode": autoreset_mode}
        one = gymnasium.vector.SyncVectorEnv([lambda: first], **modes)
        self.metadata, self.render_mode = one.metadata, one.render_mode
        self.single_action_space = first.action_space
        self.single_observation_space = first.observation_space
        self.action_space, self.observation_space = (
            gymnasium.vector.utils.batch_space(space, self.num_envs)
            for space in (first.action_space, first.observation_space))
        starts = _starts_of(workers)
        shares = np.array_split(np.arange(self.num_envs), min(len(starts), self.num_envs))
        self._shares = [slice(own[0], own[-1] + 1) for own in shares]
        for start, own in zip(starts, shares, strict=False):
            self._workers.append(start(self.scene, len(own), modes, {"states": self.states, **of_each}))
        self._ask("build")

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:  # fmt: skip
        """Begins an episode of each robot.

        Args:
            seed: Of the first robot, the others have the next ones; or one for each robot.
            options: See `ReachingEnvironment.reset`; and ``reset_mask``, the robots that begin an
                episode, booleans of shape (count,).

        Returns:
            Observations and infos, each info with a row for each robot.

        Raises:
            CommandError: The seeds are not one for each robot, the mask is none, or an option cannot
                be used; no episode has begun then.
            WorkerError: A worker failed or was lost.
        """
        given_seeds = seed if isinstance(seed, Sequence | np.ndarray) else [
            None if seed is None else whole_number("seed", seed, 0, 2**63) + i for i in range(self.num_envs)]
        if len(given_seeds) != self.num_envs:
            raise CommandError("seed", f"has {len(given_seeds)} numbers for {self.num_envs} robots")
        seeds = [None if one is None else whole_number("seed", one, 0, 2**63) for one in given_seeds]
        given = dict(options or {})
        mask = np.asarray(given.pop("reset_mask", True))
        if mask.dtype != bool or mask.shape not in ((), (self.num_envs,)) or not mask.any():
            raise CommandError("reset_mask", f"must be {self.num_envs} booleans, some of them true")
        self._first.read_options(given)
        each = [given | {"reset_mask": mask[own]} if mask.ndim else given for own in self._shares]
        super().reset(seed=None if given_seeds is seed else seeds[0])
        found = self._ask("reset", *([seeds[own] for own in self._shares], each))
        return np.concatenate([one[0] for one in found]), self._joined([one[1] for one in found])

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Moves the setpoints of all robots for one time step.

        Args:
            actions: Of each robot, see `ReachingEnvironment.step`, shape (count, drive_count).

        Returns:
            Observations, rewards [m], terminations, truncations and infos.

        Raises:
            CommandError: The actions are not finite or of another shape.
            WorkerError: A worker failed or was lost.
        """
        speeds = array_of("actions", actions, (self.num_envs, len(self._first.drives)))
        *arrays, infos = zip(*self._ask("step", [speeds[own] for own in self._shares]), strict=True)
        observations, rewards, terminations, truncations = map(np.concatenate, arrays)
        return observations, rewards, terminations, truncations, self._joined(infos)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of each robot, where ``render_mode`` asks for it; see `ReachingEnvironment`."""
        if self.render_mode is None:
            return None
        return tuple(picture for own in self._ask("render") for picture in own)

    @property
    def clipped_count(self) -> int:
        """Parts of actions of all robots that were out of range, since they were built."""
        return sum(self._ask("clipped_count"))

    def close_extras(self) -> None:
        """Ends the workers."""
        for worker in self._workers:
            worker.close()

    def __repr__(self) -> str:
        return (f"<VectorEnvironment {self.scene.name}: {self.num_envs} robots; workers: "
                f"{len(self._workers)}; {self.model}>")

    def _ask(self, what: str, *arguments: Sequence[Any]) -> list[Any]:
        """Answers of all workers; each takes its own of each of the arguments."""
        if self.closed:
            raise CommandError(self.scene.name, "its robots are closed")
        index = 0
        try:
            asked = []
            for index, worker in enumerate(self._workers):
                asked.append(worker.ask(what, *(one[index] for one in arguments)))
            answers = []
            for index, one in enumerate(asked):
                answers.append(one.result())
            return answers
        except BaseException as error:
            self.close()  # Answers that are left would be taken for those of the next question.
            if not isinstance(error, Exception):
                raise
            own, kind = self._shares[index], "" if isinstance(error, WorkerError) else f"{type(error).__name__}: "
            raise WorkerError(
                f"{self.scene.path or self.scene.name}: worker {index + 1} of "
                f"{len(self._workers)}, robots {own.start} to {own.stop - 1}: "
                f"{kind}{one_line(error)}; all workers are closed") from error

    def _joined(self, infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
        """Infos of the workers as one, with rows of zeros for robots without an entry."""
        joined = dict[str, Any]()
        for key in dict.fromkeys(key for own in infos for key in own):
            each = [own.get(key) for own in infos]
            known = next(one for one in each if one is not None)
            if isinstance(known, dict):
                joined[key] = self._joined([one or {} for one in each])
                continue
            nothing = None if known.dtype == object else 0
            joined[key] = np.concatenate([
                np.full((own.stop - own.start, *known.shape[1:]), nothing, known.dtype)
                if one is None else one for one, own in zip(each, self._shares, strict=True)])
        return joined


# --- the workers ----------------------------------------------------------------------------------


class _Robots:
    """The robots of one worker."""

    def __init__(self, scene: Scene, count: int, modes: dict[str, Any], of_each: dict[str, Any]):
        self._each = [partial(ReachingEnvironment, scene, **of_each)] * count
        self._modes, self._seen = modes, np.empty(0)
        self._unprepared: list[Any] = []

    def build(self) -> None:
        """Builds them."""
        self.each = gymnasium.vector.SyncVectorEnv(self._each, **self._modes)

    def reset(self, seeds: list[int | None], options: dict[str, Any]) -> tuple[Any, ...]:
        """See `VectorEnvironment.reset`."""
        if "reset_mask" in options and not options["reset_mask"].any():
            return self._seen, {}
        self._seen, infos = self.each.reset(seed=seeds, options=options)
        self._unprepared = list(self.each.envs)
        return self._seen, infos

    def step(self, actions: np.ndarray) -> tuple[Any, ...]:
        """See `VectorEnvironment.step`."""
        found = self.each.step(actions)
        self._seen = found[0]
        # Of the others the next step is another episode.
        goes_on = ~(found[2] | found[3])
        self._unprepared = [one for one, own in zip(self.each.envs, goes_on, strict=True) if own]
        return found

    def prepare(self, is_asked: Callable[[], bool]) -> None:
        """Prepares the next steps of the robots, one by one, until something is asked."""
        while self._unprepared and not is_asked():
            self._unprepared.pop(0).prepare()

    def render(self) -> Any:
        """See `VectorEnvironment.render`."""
        return self.each.render()

    def clipped_count(self) -> int:
        """See `VectorEnvironment.clipped_count`."""
        return sum(self.each.get_attr("clipped_count"))

    def answer(self, what: str, *arguments: Any) -> Any:
        """What is asked for, by its name."""
        return getattr(self, what)(*arguments)

    __call__ = answer


class _Here:
    """A worker in this process."""

    def __init__(self, *robots: Any):
        self._robots = _Robots(*robots)

    def ask(self, what: str, *arguments: Any) -> Future:
        answer: Future = Future()
        answer.set_result(self._robots.answer(what, *arguments))
        return answer

    def close(self) -> None:
        pass


class _OnCluster:
    """A worker of a Dask cluster."""

    def __init__(self, client: Any, address: str, *robots: Any):
        self._robots = client.submit(
            _Robots, *robots, actor=True, pure=False, workers=[address], allow_other_workers=False)

    def ask(self, what: str, *arguments: Any) -> Any:
        return self._robots.result().answer(what, *arguments)

    def close(self) -> None:
        self._robots.cancel()


def _starts_of(workers: Any) -> list[Any]:
    """What starts each worker, when it is given its robots."""
    if hasattr(workers, "nthreads"):
        return [partial(_OnCluster, workers, address) for address in workers.nthreads()]
    count = core_count() if workers is None else whole_number("workers", workers, more=", or a client of Dask")
    return [_Here] if count == 1 else [partial(WorkerProcess, _Robots)] * count


def _scene_of(scene: Path | str | Scene | Robot, reduced: bool) -> tuple[Scene, str]:
    """The scene that is stepped, and what to say of a reduced model that is not there."""
    if isinstance(scene, Scene | Robot):
        return (scene.scene if isinstance(scene, Robot) else scene), ""
    full = load_scene(scene)
    path = Path(full.path or "")
    if not reduced or path.stem.endswith("_reduced"):
        return full, ""
    beside = path.with_name(f"{path.stem}_reduced{path.suffix}")
    if not beside.is_file():
        return full, f"; there is no {beside.name} beside it"
    warnings.warn(f"{path.name}: the reduced model {beside.name} beside it is stepped; reduced=False "
                  "takes the full one", SceneWarning, stacklevel=4)
    return load_scene(beside, changes_of(scene)), ""
