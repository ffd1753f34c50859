"""States of a full model that a reduction is trained and judged on.

A state is an equilibrium: of actuators within their bounds, or of those that bring the effectors
near targets; perhaps under a load at a point, and under a tilted gravity. States are visited on
tours, each near the one before it, which takes few linearizations. A tour is cut into chains. Each
chain begins at rest, so that its states do not depend on any other chain, on the number of workers,
or on whether the run was interrupted.

Along a path of targets the scene keeps its contact: what presses on the body is sampled as it will
be met. There a chain is a pass of the whole path, since between obstacles the way matters.

The file contains, in this order: what is sampled, the tours, how a chain is computed, what a
stopped run leaves behind.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SceneError, SoftRobotTwinError
from softrobot_twin.harness.equilibrium import ANY_TIME
from softrobot_twin.harness.output_file import BROKEN_OFF, output_file, writing
from softrobot_twin.harness.sample_workers import (
    LOST,
    Job,
    SampleOutcome,
    SampleWorkers,
    check_fingerprint,
    check_run,
    run_samples,
)
from softrobot_twin.harness.sampled_axes import Axis, setpoints_between, shifted_sobol
from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.reduced_points import Platform
from softrobot_twin.reduction.training_options import TargetBox
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.body_entries import PATCHES_NOT_REDUCED
from softrobot_twin.scene.scene_changes import full_scene, without_reductions
from softrobot_twin.scene.schema import Touch
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation
from softrobot_twin.simulation.building.deformable_body import Body, of_kind
from softrobot_twin.simulation.building.reduced_body import (
    ReducedBody,
    ModelFile,
    ModelFileError,
    rides_on_a_slide,
)
from softrobot_twin.simulation.effects.touches import Touched
from softrobot_twin.tables.input_tables import between_rows

# Linearizations of a step, and most steps to an equilibrium.
ITERATIONS, MOST_STEPS = 4, 15
# Parts of the way to the first state of a chain, and to one that a whole step did not reach.
FIRST_WAY, FINE_WAY = 4, 12
# Most steps towards targets on the way, and the distance from targets that ends them, as a share of
# the robot's size; the same at the end of the way. A state that is further away missed its target.
MOST_FOLLOWS, NEAR = 4, 0.01
LAST_FOLLOWS, CLOSE = 12, 0.001
# A step that leaves more than this share of the distance brings effectors no nearer.
STALLED = 0.98
# States of a chain: what a lost worker costs.
CHAIN_LENGTH = 12
# Most corners of the actuators' box, as a share of the samples of a training.
MOST_CORNERS = 0.25
# States of a pass of a whole path.
PASS_LENGTH = 40


class TrainingError(SoftRobotTwinError):
    """A body cannot be reduced as it is asked for."""


# --- what is sampled -----------------------------------------------------------------------------


class Sampling(NamedTuple):
    """What is sampled, beside the box of the actuators.

    Attributes:
        body: Name of the body that is reduced.
        load: Greatest force at a point [N]; zero for none.
        load_points: Points that are loaded, each the mean of some points at rest [m].
        tilt: Greatest angle of gravity from its direction in the scene [rad].
        in_contact: Whether the scene keeps its contact.
    """

    body: str
    load: float = 0.0
    load_points: tuple[tuple[tuple[float, float, float], ...], ...] = ()
    tilt: float = 0.0
    in_contact: bool = False


class TargetWay(NamedTuple):
    """A path of targets, around which states are sampled.

    Attributes:
        times: Of its targets, increasing [s], shape (row_count,).
        targets: Targets of all effectors [m], NaN for those without, shape
            (row_count, effector_count, 3).
        radius: Greatest shift of a pass along each axis [m].
    """

    times: np.ndarray
    targets: np.ndarray
    radius: float

    def at(self, shares: np.ndarray) -> np.ndarray:
        """Targets at shares of its duration, (count,) [m], shape (count, effector_count, 3).

        Args:
            shares: Shares of the duration, 0 to 1, shape (count,).
        """
        times = self.times[0] + shares * (self.times[-1] - self.times[0])
        found = between_rows(times, self.times, self.targets.reshape(len(self.times), -1))
        return found.reshape(len(shares), *self.targets.shape[1:])


class Columns(NamedTuple):
    """Places of a sample's values: setpoints, targets, forces, gravity.

    Attributes:
        actuator_count: Number of setpoints.
        effector_count: Number of targets; NaN where the setpoints hold.
        load_count: Number of forces.
    """

    actuator_count: int
    effector_count: int
    load_count: int

    @property
    def width(self) -> int:
        """Number of values of a sample."""
        return self.actuator_count + 3 * (self.effector_count + self.load_count + 1)

    def split(self, sample: np.ndarray) -> tuple[np.ndarray, ...]:
        """Setpoints, targets (effector_count, 3), forces (load_count, 3) and gravity (3,).

        They are views; several samples have their axis first.

        Args:
            sample: A sample, shape (width,), or several, shape (..., width).
        """
        ends = np.cumsum([self.actuator_count, 3 * self.effector_count, 3 * self.load_count])
        setpoints, targets, forces, gravity = np.split(sample, ends, axis=-1)
        points = (*sample.shape[:-1], -1, 3)
        return setpoints, targets.reshape(points), forces.reshape(points), gravity


def columns_of(simulation: Simulation) -> Columns:
    """Columns of the samples of a training scene.

    Args:
        simulation: The simulation of a training scene.
    """
    return Columns(
        len(simulation.actuator_names), len(simulation.effector_names), len(simulation.touch_names)
    )


def training_scene(scene: Scene, sampling: Sampling) -> Scene:
    """The scene in statics without rates, with the loaded points as its touches.

    It has contact only where the sampling says so.

    Args:
        scene: The scene.
        sampling: What is sampled.
    """
    touches = tuple(
        Touch(name=f"load_{index}", body=sampling.body, points=points,
              while_touched="follow_targets")
        for index, points in enumerate(sampling.load_points)
    )  # fmt: skip
    touching = (dict(contact=scene.contact, obstacles=scene.obstacles) if sampling.in_contact else {})
    return full_scene(scene).changed(
        touches=touches, **touching,
        solver=dict(newton_iterations=ITERATIONS,
                    residual_tolerance=1.0e-3 * scene.solver.residual_tolerance),
    )  # fmt: skip


def spread_points(body: Body, count: int) -> np.ndarray:
    """Points of a body's surface far from each other, none of them fixed [m], shape (count, 3).

    Each is the one furthest from those before it; the first is furthest from the fixed nodes.

    Args:
        body: The body.
        count: Number of points; fewer are given where the surface has fewer free nodes.
    """
    nodes = np.unique(body.mesh.surface_triangles)
    places = body.mesh.node_positions
    free = places[nodes[~body.fixed[nodes]]]
    known = places[body.fixed] if body.fixed.any() else places.mean(axis=0)[None]
    distance = np.min([np.linalg.norm(free - point, axis=1) for point in known], axis=0)
    chosen = []
    for _ in range(min(count, len(free))):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(free - free[chosen[-1]], axis=1))
    return free[chosen]


def samples_of(
    simulation: Simulation, axes: Sequence[Axis], sampling: Sampling,
    boxes: Sequence[TargetBox], count: int, seed: int, with_corners: bool = False,
) -> np.ndarray:  # fmt: skip
    """Samples on a shifted Sobol sequence, that at rest first; more begin with the same ones.

    In a training the corners of the actuators' box come next, in place of the first ones: without
    them poses within the box left the range of what was seen, by up to 1.9 times.

    Every second one is without a load.

    Args:
        simulation: The training scene.
        axes: Box of the actuators; used where there are no boxes of targets.
        sampling: Loads and tilts.
        boxes: Boxes of targets, in which targets are sampled in place of setpoints.
        count: Number of samples.
        seed: Seed of the shift.
        with_corners: Whether the corners of the box of the actuators are among them, where they are
            at most a share of all (`MOST_CORNERS`).

    Returns:
        See `Columns`, shape (count, width).
    """
    own = 3 * len(boxes) if boxes else len(axes)
    points = shifted_sobol(own + 5, count - 1, seed)
    samples, (setpoints, targets, forces, gravity) = _samples_at_rest(simulation, count)
    if boxes:
        names = simulation.effector_names
        for place, box in enumerate(boxes):
            shares = points[:, 3 * place : 3 * place + 3]
            low, high = np.array(box.low), np.array(box.high)
            targets[1:, names.index(box.effector)] = low + shares * (high - low)
    else:
        if with_corners and 2 ** len(axes) <= MOST_CORNERS * (count - 1):
            corners = np.array(list(np.ndindex((2,) * len(axes))), float)
            points[: len(corners), :own] = corners
        setpoints[1:] = setpoints_between(simulation, axes, points[:, :own])
    if sampling.load:
        loaded = np.arange(2, count, 2)
        which = (loaded // 2) % forces.shape[1]
        vectors = _directions(points[loaded - 1, own : own + 2])
        sizes = sampling.load * points[loaded - 1, own + 2]
        forces[loaded, which] = sizes[:, None] * vectors
    if sampling.tilt:
        gravity[1:] = _tilted(gravity[0], sampling.tilt, points[:, own + 3 : own + 5])
    return samples


def _samples_at_rest(simulation: Simulation, count: int) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Samples of the rest shape, and the parts of them that `Columns.split` gives."""
    columns = columns_of(simulation)
    samples = np.zeros((count, columns.width))
    setpoints, targets, _, gravity = parts = columns.split(samples)
    setpoints[:], targets[:] = simulation.rest_setpoints, np.nan
    gravity[:] = simulation.scene.gravity
    return samples, parts


def passes(count: int) -> list[np.ndarray]:
    """Samples of each pass of a path; that at rest begins the first one.

    Args:
        count: Number of samples, that at rest included.

    Returns:
        Indices of the samples of each pass.
    """
    most = max(1, -(-(count - 1) // PASS_LENGTH))
    return np.split(np.arange(count), 1 + np.cumsum(
        [len(part) for part in np.array_split(np.arange(count - 1), most)])[:-1])  # fmt: skip


def samples_along(simulation: Simulation, way: TargetWay, count: int, seed: int) -> np.ndarray:
    """Samples of passes of a path, each shifted as a whole, that at rest first.

    Args:
        simulation: The training scene.
        way: The path.
        count: Number of samples.
        seed: Seed of the shifts.

    Returns:
        See `Columns`, shape (count, width).
    """
    samples, (_, targets, _, _) = _samples_at_rest(simulation, count)
    tours = passes(count)
    shifts = shifted_sobol(4, len(tours), seed)
    for tour, shift in zip(tours, shifts, strict=True):
        own = tour[tour > 0]
        shares = (np.arange(len(own)) + shift[3]) / max(len(own), 1)
        targets[own] = way.at(shares) + way.radius * (2.0 * shift[:3] - 1.0)
    return samples


def _directions(shares: np.ndarray) -> np.ndarray:
    """Directions, uniform over the sphere, of points of the unit square, shape (count, 3)."""
    height, turn = 2.0 * shares[:, 0] - 1.0, 2.0 * np.pi * shares[:, 1]
    flat = np.sqrt(1.0 - height**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])


def _tilted(gravity: np.ndarray, tilt: float, shares: np.ndarray) -> np.ndarray:
    """Gravity tilted by angles up to `tilt`, uniform over that cap, shape (count, 3)."""
    size = np.linalg.norm(gravity)
    axis = gravity / size
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    along = 1.0 - shares[:, 0] * (1.0 - math.cos(tilt))
    across, turn = np.sqrt(1.0 - along**2), 2.0 * np.pi * shares[:, 1]
    return size * (
        along[:, None] * axis + (across * np.cos(turn))[:, None] * side
        + (across * np.sin(turn))[:, None] * other
    )  # fmt: skip


# --- tours ---------------------------------------------------------------------------------------


def chains(samples: np.ndarray, scales: np.ndarray, length: int = CHAIN_LENGTH) -> list[np.ndarray]:
    """Samples in chains, each near the one before it.

    Args:
        samples: That at rest first, shape (count, width).
        scales: What a value of each column is divided by in distances, shape (width,).
        length: Most samples of a chain.

    Returns:
        Indices of the samples of each chain.
    """
    places = np.nan_to_num(samples) / scales
    left, order = np.arange(1, len(samples)), [0]
    while len(left):
        squares = ((places[left] - places[order[-1]]) ** 2).sum(axis=1)
        nearest = int(np.argmin(squares))
        order.append(int(left[nearest]))
        left = np.delete(left, nearest)
    count = -(-len(order) // length)
    return np.array_split(np.array(order), count)


def spread_of(samples: np.ndarray) -> np.ndarray:
    """Width of each column; one where all values are the same, shape (width,).

    Args:
        samples: The samples, shape (count, width); NaN where a value is not given.
    """
    wide = np.ptp(np.nan_to_num(samples[1:] if len(samples) > 1 else samples), axis=0)
    return np.where(wide > 0.0, wide, 1.0)


# --- a chain -------------------------------------------------------------------------------------


class States(NamedTuple):
    """States of some samples.

    Attributes:
        samples: What was asked, see `Columns`, shape (count, width).
        is_found: Whether there is an equilibrium, shape (count,); the rest is NaN where not.
        displacements: Of the body's nodes from rest [m], in the world, single precision,
            shape (count, node_count, 3).
        setpoints: Of the actuators, shape (count, actuator_count).
        efforts: Of the actuators, same shape.
        effectors: Positions of the effectors [m], shape (count, effector_count, 3).
        missed: Largest distance of an effector from its target, along the directions that it is
            controlled in [m]; NaN without targets, shape (count,).
        iterations: Linearizations that each took, shape (count,).
    """

    samples: np.ndarray
    is_found: np.ndarray
    displacements: np.ndarray
    setpoints: np.ndarray
    efforts: np.ndarray
    effectors: np.ndarray
    missed: np.ndarray
    iterations: np.ndarray

    def found(self) -> States:
        """Those with an equilibrium."""
        return States(*(field[self.is_found] for field in self))

    def has_missed(self, size: float) -> np.ndarray:
        """Which states are further from their targets than `CLOSE` of a robot's size [m].

        Args:
            size: Size of the robot [m].
        """
        return self.missed > CLOSE * size

    def held(self, columns: Columns) -> np.ndarray:
        """Samples that hold the actuators where they are in these states, without targets.

        Args:
            columns: Columns of the samples.
        """
        samples = self.samples.copy()
        setpoints, targets, _, _ = columns.split(samples)
        setpoints[:], targets[:] = self.setpoints, np.nan
        return samples


def joined(parts: Sequence[States]) -> States:
    """States of several chains, one after the other.

    Args:
        parts: States of each chain.
    """
    return States(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


class StateFinder:
    """Finds the states of chains by one simulation, which each chain begins at rest."""

    def __init__(self, scene: Scene, body: str):
        """Build the scene.

        Args:
            scene: A training scene.
            body: Name of the body of which displacements are told; empty for none.
        """
        self.simulation = Simulation(scene, with_warnings=False)
        model = self.simulation.model
        self._columns = columns_of(self.simulation)
        self._directions = np.array([
            [axis in effector.directions for axis in "xyz"] for effector in scene.effectors
        ], bool).reshape(-1, 3)  # fmt: skip
        self._nodes, self._platform = slice(0, 0), None
        for own in model.bodies:
            if own.name == body:
                self._nodes = slice(own.first_node, own.first_node + own.mesh.node_count)
                self._platform = _platform_of(own, model.rigid)
        self._weight = model.force_term(Gravity)
        self._gravity = np.array(scene.gravity, float)
        if self._weight is not None:
            self._unit_weights = _unit_weights(self.simulation, self._weight.weights)
        self._iterations = 0

    def __call__(self, chain: np.ndarray) -> States:
        """States of the samples of a chain, shape (count, width)."""
        simulation, rest = self.simulation, self.simulation.model.nodes.rest_positions
        self._begin()
        found, rows, way = [], [], FIRST_WAY
        for sample in chain:
            self._iterations = 0
            is_found, missed = self._nearest(sample, way)
            state = simulation.state
            shift = state.positions[self._nodes] - rest[self._nodes]
            if self._platform is not None:
                shift -= self._platform.displacement(state.positions)
            row = [
                shift.astype(np.float32), state.setpoints, state.efforts,
                simulation.effector_positions(), missed,
            ]  # fmt: skip
            found.append(is_found)
            rows.append([np.where(is_found, value, np.nan).astype(np.asarray(value).dtype)
                         for value in row])  # fmt: skip
            rows[-1].append(self._iterations)
            if not is_found:
                self._begin()
            way = 1 if is_found else FIRST_WAY
        return States(chain.copy(), np.array(found), *map(np.array, zip(*rows, strict=True)))

    def _begin(self) -> None:
        """Go back to rest, under the gravity of the scene."""
        self.simulation.reset()
        self._load(np.zeros((0, 3)), np.array(self.simulation.scene.gravity, float))

    def _nearest(self, sample: np.ndarray, way: int) -> tuple[bool, float]:
        """Go to a sample, or to the nearest equilibrium that is found to its targets.

        Where the first try misses the targets, they are sought from the same state in smaller
        steps, then from rest; in contact a way from rest may end on another side of an obstacle,
        so it is tried only where there is no equilibrium else.

        Args:
            sample: The sample.
            way: Parts of the first way.

        Returns:
            Whether an equilibrium was found, and how far it is from the targets [m]; NaN without.
        """
        simulation, columns = self.simulation, self._columns
        targets, forces, gravity = columns.split(sample)[1:]
        has_targets = np.isfinite(targets).any()
        before, gravity_before = simulation.state, self._gravity
        loads = self._forces_or(forces)
        best, missed = None, np.nan
        tries = [(way, before), *([(FINE_WAY, before)] if has_targets else []), (FINE_WAY, None)]
        for parts, start in tries:
            if start is not None:
                simulation.restore(start)
                self._load(loads, gravity_before)
            elif best is not None and simulation.model.contacts is not None:
                break
            else:
                self._begin()
            if self._find(sample, parts):
                own = self._missed(targets)
                if best is None or own < missed:
                    best, missed = simulation.state, own
                if not missed > CLOSE * simulation.model.nodes.size:
                    break
        if best is None:
            return False, np.nan
        simulation.restore(best)
        self._load(forces, gravity)
        return True, missed

    def _missed(self, targets: np.ndarray) -> float:
        """Largest distance of an effector from its target [m]; NaN without targets."""
        shifts = np.where(self._directions, self.simulation.effector_positions() - targets, 0.0)
        distances = np.linalg.norm(shifts, axis=1)
        known = distances[np.isfinite(distances)]
        return float(known.max()) if len(known) else np.nan

    def _forces_or(self, others: np.ndarray) -> np.ndarray:
        """Forces of the touches now [N]; other ones in a scene without touches."""
        touches = self.simulation.touches
        return others if touches is None else touches.forces

    def _find(self, sample: np.ndarray, way: int) -> bool:
        """Go to a sample in so many parts; whether the equilibrium is reached."""
        setpoints, targets, forces, gravity = self._columns.split(sample)
        begin = self.simulation.state
        loads = self._forces_or(forces)
        weight, start = self._gravity.copy(), self.simulation.effector_positions()
        for share in np.arange(1, way + 1) / way:
            self._load(loads + share * (forces - loads), weight + share * (gravity - weight))
            wanted = begin.setpoints + share * (setpoints - begin.setpoints)
            if np.isfinite(targets).any():
                wanted = self.follow(start + share * (targets - start), share == 1.0)
            if wanted is None or not self._balance(wanted, share == 1.0):
                return False
        return True

    def _load(self, forces: np.ndarray, gravity: np.ndarray) -> None:
        self._touched = Touched(forces, np.full_like(forces, np.nan)) if len(forces) else None
        if self._weight is not None:
            self._gravity = gravity
            self._weight.weights[:] = np.tensordot(gravity, self._unit_weights, 1)

    def _step(self, command):
        result = self.simulation.step(command, measured=self._touched)
        self._iterations += result.report.iterations
        return result

    def follow(self, wanted: np.ndarray, is_last: bool) -> np.ndarray | None:
        """Setpoints that bring the effectors near targets, or some of the way.

        Args:
            wanted: Targets [m], shape (effector_count, 3); NaN for free ones.
            is_last: Whether they are those of the chain's end.
        """
        simulation = self.simulation
        most, share = (LAST_FOLLOWS, CLOSE) if is_last else (MOST_FOLLOWS, NEAR)
        missed = np.inf
        for _ in range(most):
            result = self._step(FollowTargets(wanted, ANY_TIME))
            if result.status.is_failure:
                return None
            before, missed = missed, self._missed(wanted)
            if missed <= share * simulation.model.nodes.size or missed > STALLED * before:
                break
        return simulation.state.setpoints.copy()

    def _balance(self, setpoints: np.ndarray, is_last: bool) -> bool:
        """Whether the actuators are held in an equilibrium; on the way one step is enough."""
        tolerance = self.simulation.scene.solver.residual_tolerance
        for _ in range(MOST_STEPS):
            result = self._step(CommandSetpoints(setpoints, ANY_TIME))
            if result.status.is_failure:
                return False
            if not is_last or (result.report.residual <= tolerance and not result.report.inverted_count):
                return True
        return False


def _platform_of(body: Body, parts: Sequence) -> Platform | None:
    """What a full body rides on; None where it stands still."""
    for part in parts:
        if part.name in body.riding:
            return Platform(part.first_node, part.origin)
    return None


def _unit_weights(simulation: Simulation, weights: np.ndarray) -> np.ndarray:
    """Weights under a gravity of one along each axis, shape (3, free_node_count, 3).

    Args:
        simulation: The scene.
        weights: Those under its gravity [N], shape (free_node_count, 3).
    """
    gravity, nodes = np.array(simulation.scene.gravity, float), simulation.model.nodes
    masses = weights @ gravity / (gravity @ gravity)
    units = masses[None, :, None] * np.eye(3)[:, None, :]
    for body in of_kind(simulation.model.bodies, ReducedBody):
        own = nodes.free_index[body.coordinate_nodes]
        for unit, axis in zip(units, np.eye(3), strict=True):
            unit[own] = body.weights(axis)
    return units


class FinderMaker(NamedTuple):
    """Makes the `StateFinder` of a scene file in a worker.

    Attributes:
        sampling: What is sampled.
    """

    sampling: Sampling

    def __call__(self, scene: Path, content: str) -> StateFinder:
        """Build the scene; see `Job`.

        Raises:
            RunError: It is not that of the fingerprint.
        """
        read = without_reductions(load_scene(scene))
        check_fingerprint(read, content)
        return StateFinder(training_scene(read, self.sampling), self.sampling.body)


# --- what a stopped run leaves behind ------------------------------------------------------------

_RUN = "run.json"


class StateStore:
    """States of a run on disk, a file for each chain, in a folder beside the file it will write.

    A chain's file is named by a digest of its samples: another command on the same scene finds the
    chains that it has in common with this one.

    Attributes:
        path: The folder.
    """

    def __init__(self, output: Path, run: dict[str, object]):
        """Take the folder that an earlier call of the same run left, or make it.

        Args:
            output: File that the run will write.
            run: What identifies it, by name.

        Raises:
            RunError: The folder is of another run.
            OutputError: It cannot be read or written.
        """
        self.path = output.with_name(output.name + BROKEN_OFF)
        with writing(self.path, UnicodeDecodeError):
            if (self.path / _RUN).is_file():
                check_run(self.path, (self.path / _RUN).read_text(encoding="utf-8"), run)
                return
            self.path.mkdir(parents=True, exist_ok=True)
            with output_file(self.path / _RUN) as partial:
                partial.write_text(json.dumps(run), encoding="utf-8")

    def _file(self, chain: np.ndarray) -> Path:
        return self.path / f"{hashlib.sha256(chain.tobytes()).hexdigest()[:24]}.npz"

    def find(self, chain: np.ndarray) -> States | None:
        """The states of a chain; None where they are not there, or cannot be read.

        Args:
            chain: Samples of the chain, shape (count, width).
        """
        try:
            return _saved_states(ModelFile(self._file(chain)), chain)
        except ModelFileError:
            return None

    def add(self, chain: np.ndarray, states: States) -> None:
        """Save the states of a chain; its file is there whole or not at all.

        Args:
            chain: Samples of the chain, shape (count, width).
            states: Their states.
        """
        with output_file(self._file(chain)) as partial, open(partial, "wb") as stream:
            np.savez(stream, **states._asdict())

    def count(self) -> int:
        """Number of chains that are saved."""
        return len(list(self.path.glob("[!.]*.npz")))

    def remove(self) -> None:
        """Remove the folder: the run is done."""
        shutil.rmtree(self.path, ignore_errors=True)


def _saved_states(file: ModelFile, chain: np.ndarray) -> States:
    """The states of a chain; refuses a file of other samples, or with NaN in states that are found.
    """
    count = len(chain)
    is_found = file.taken("is_found", count, kind="b")

    def values(name: str, *shape: int | None, dtype=float) -> np.ndarray:
        found = file.taken(name, count, *shape, may_be_nan=True).astype(dtype)
        if not np.isfinite(found[is_found]).all():
            raise file.damaged(f"{name} of found states are not finite")
        return found

    samples = file.taken("samples", *chain.shape, may_be_nan=True)
    if not np.array_equal(samples, chain, equal_nan=True):
        raise file.damaged("samples are others")
    return States(
        samples, is_found, values("displacements", None, 3, dtype=np.float32),
        values("setpoints", None), values("efforts", None), values("effectors", None, 3),
        file.taken("missed", count, least=0.0, may_be_nan=True),
        file.taken("iterations", count, kind="i"),
    )  # fmt: skip


def find_states(
    title: str, crew: SampleWorkers, job: Job, asked: Sequence[np.ndarray], store: StateStore
) -> tuple[list[States | None], list[str]]:
    """States of chains: those of the store, the others computed and saved.

    Args:
        title: What the progress is called.
        crew: Computes them.
        job: What all chains share.
        asked: Samples of each chain, shape (count, width).
        store: Keeps them.

    Returns:
        The states of all chains in their order, None of those that were lost; and why these were.
    """
    known = [store.find(chain) for chain in asked]
    causes: list[str] = []

    def keep(outcome: SampleOutcome) -> list[str]:
        index, states, cause = outcome
        if states is None:
            causes.append(f"{len(asked[index])} states are lost: {cause}")
            return [LOST] * len(asked[index])
        known[index] = states
        store.add(asked[index], states)
        return ["ok" if found else "not_converged" for found in states.is_found]

    done = {index for index, states in enumerate(known) if states is not None}
    run_samples(title, crew, job, asked, done, keep)
    return known, causes


def refuse_unreducible(scene: Scene, body: Body) -> None:
    """Refuse a body that cannot be reduced.

    Args:
        scene: The scene.
        body: The body.

    Raises:
        SceneError: It names why.
    """

    def refuse(key: str, value: object, reason: str):
        raise SceneError(scene.path, f"{body.key}.{key}", value, "", reason)

    if body.entry.vertebrae:
        refuse("vertebrae", body.name, "is reduced to vertebrae: it has no basis of modes")
    if body.entry.has_patches:
        refuse("volume", "patches", PATCHES_NOT_REDUCED)
    if body.riding and not rides_on_a_slide(body, scene):
        refuse("attached", ", ".join(sorted(body.riding)),
               "nodes attached to rigid bodies are not built for a reduced body, but for one "
               "platform that a slide moves")
    if (body.held != body.fixed[:, None]).any():
        refuse("fixed.axes", body.name, "is held along some axes only, which is not built for a reduced body")
    for part in body.materials:
        key = part.key.removeprefix(f"{body.key}.")
        if part.viscosity:
            refuse(f"{key}.viscosity", body.name, "is not built for a reduced body")
        if part.softening:
            refuse(f"{key}.softening", body.name, "is not built for a reduced body")
