"""``python -m softrobot_twin reduce``: makes the reduced model of a body of a scene.

1. The full model is brought to states of the actuators' box, or near targets, perhaps under loads
   and tilted gravity, or along a path of targets in contact (`reduction_states.py`).
2. Modes follow from the displacements, and few weighted quadrature points from the forces along
   these modes (`reduction_basis.py`).
3. The reduced model is compared with the full one at fresh states, which served for neither, begun
   at the pose before as in a live run.

With a wanted error the training grows by need. In each round many candidates are solved by the
reduced model, with the modes in use and with the spare ones too; where the two differ most, the
full model is solved and the states are added (greedy sampling; Paul-Dubois-Taine and Amsallem
2015). Some fresh states judge each round before they are added in turn.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.cell_mesh import points_of
from softrobot_twin.harness.output_file import output_file
from softrobot_twin.harness.sample_workers import (
    Job,
    SampleWorkers,
    scene_fingerprint,
    workers_of,
)
from softrobot_twin.harness.sampled_axes import Axis, sampled_axes
from softrobot_twin.harness.terminal import console, table, terminal_status, warn
from softrobot_twin.mechanics.reduced_elements import SampledPoints
from softrobot_twin.reduction.reduction_basis import (
    Modes,
    blocks_of,
    leading,
    mode_count_of,
    proper_modes,
    rest_stiffness,
    sampled_points,
    shaken,
    vibration_modes,
    with_vibrations,
)
from softrobot_twin.reduction.reduction_states import (
    CLOSE,
    FinderMaker,
    Sampling,
    StateFinder,
    States,
    StateStore,
    TargetWay,
    TrainingError,
    chains,
    columns_of,
    find_states,
    joined,
    passes,
    refuse_unreducible,
    samples_along,
    samples_of,
    spread_of,
    spread_points,
    training_scene,
)
from softrobot_twin.reduction.training_options import (
    FIRST_SNAPSHOTS,
    SNAPSHOTS,
    VIBRATIONS,
    TrainingOptions,
)
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.scene_changes import reduced_scene, without_reductions
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.simulation.building.reduced_body import (
    BodyReduction,
    reduction_fingerprints,
    write_body_reduction,
)
from softrobot_twin.tables.input_tables import read_targets

# Most modes by energy: more make a step slower than many a full model.
MOST_MODES = 96
# Error of the virtual work of the points with the spare modes, as a share of that of the others.
# What these modes add is small: points as coarse as the others gave errors of 0.7 to 4.7 of the
# true ones at twice the training range.
SPARE_SHARE = 1.0 / 3.0
# Fresh states have seeds of their own: those of the last judgement, as many between reached targets,
# and of the rounds.
FRESH_SEED, BETWEEN_SEED, ROUND_SEED = 1000, 1500, 2000
# Boxes of targets are this share of their width wider at each side in the training: at the border
# of what was seen a reduced model is least accurate.
MARGIN = 0.08
# With a wanted error: candidates of a round, how many of the worst are added, fresh ones that judge
# it, and most rounds.
CANDIDATES, ADDED, JUDGES, MOST_ROUNDS = 192, 48, 40, 8
# Where the spare modes take this share of the error away, a round adds so many modes in use.
MODES_HELP, MORE_MODES = 0.4, 6
# Else it lowers the tolerance of the sampling by this factor.
FINER_SAMPLING = 0.6
# Least displacement that an error is a share of, by the effector's largest one.
LEAST_DISPLACEMENT = 0.1
# Of all states but few: this quantile.
ALL_BUT_FEW = 0.97


class Judgement(NamedTuple):
    """The reduced model against the full one at states.

    Attributes:
        errors: Largest distance of an effector from where it should be at each state [m]; NaN where
            the reduced model found no equilibrium, shape (count,).
        shares: The same as a share of its displacement; see `Training.displacements`.
    """

    errors: np.ndarray
    shares: np.ndarray

    @property
    def measured(self) -> np.ndarray:
        """Median and largest, where there is an equilibrium; NaN without any, shape (2,)."""
        good = self.shares[np.isfinite(self.shares)]
        return np.array([np.median(good), good.max()]) if len(good) else np.full(2, np.nan)

    @property
    def lost(self) -> int:
        """States at which the reduced model found no equilibrium."""
        return int(np.count_nonzero(~np.isfinite(self.shares)))


class Trained(NamedTuple):
    """A reduced model in the making.

    Attributes:
        modes: All modes, in the axes of the world.
        mode_count: How many are in use.
        sampled: Points with the modes in use, and the error that they leave.
        spare_sampled: The same with the spare modes.
        coordinates: Of the states of the training, and of vibrations [m], shape (count, all modes).
    """

    modes: Modes
    mode_count: int
    sampled: tuple[SampledPoints, float]
    spare_sampled: tuple[SampledPoints, float]
    coordinates: np.ndarray


# --- one reduced model ---------------------------------------------------------------------------


def train(
    body: Body, K, states: States, mode_count: int | None, options: TrainingOptions,
    tolerance: float, vibrations: np.ndarray | None = None,
) -> Trained:  # fmt: skip
    """Make a reduced model of the states of a full one.

    Args:
        body: The full body.
        K: Its stiffness at rest; see `rest_stiffness`.
        states: The states; all are used that were found.
        mode_count: Modes in use; None to follow from the energy.
        options: Says the energy, and the number of spare modes.
        tolerance: Error of the virtual work that sampled points leave.
        vibrations: Vibrations among the modes in use, see `vibration_modes`; None for none.

    Raises:
        TrainingError: There are too few states for as many modes.
    """
    displacements, most = states.found().displacements, MOST_MODES + options.spare
    count_of_vibrations = 0 if vibrations is None else len(vibrations)
    if vibrations is None:
        modes = proper_modes(displacements, K, most)
    else:
        modes = with_vibrations(vibrations, displacements, K, most)
    available = 3 * (modes.basis.shape[2] // 3)
    count = mode_count or min(mode_count_of(modes.shares, options.energy), MOST_MODES)
    count = min(3 * -(-count // 3), available)
    if count < 3:
        raise TrainingError(
            f"{len(displacements)} states have {modes.basis.shape[2]} modes: at least 3 are needed"
        )
    if count < count_of_vibrations:
        raise TrainingError(f"{count} modes are fewer than the {count_of_vibrations} vibrations among them: "
                            "see --vibration-modes")  # fmt: skip
    total = min(count + 3 * -(-options.spare // 3), available)
    modes = leading(modes, total)
    coordinates = modes.coordinates(K, displacements)
    rng = np.random.default_rng(options.seed)
    used = leading(modes, count)
    sampled = sampled_points(body, used, coordinates[:, :count], tolerance, rng, count_of_vibrations)
    # The estimate begins where the spare coordinates are zero.
    without = coordinates * (np.arange(total) < count)
    both = np.concatenate([coordinates[::2], without[1::2]])
    spare_sampled = sampled_points(body, modes, both, SPARE_SHARE * tolerance, rng, count_of_vibrations)
    coordinates = np.concatenate([coordinates, shaken(body, modes, count_of_vibrations)])
    return Trained(modes, count, sampled, spare_sampled, coordinates)


def reduction_of(body: Body, trained: Trained, measured: np.ndarray, training: dict) -> BodyReduction:
    """The reduced model as it is saved, in mesh coordinates.

    Args:
        body: The body.
        trained: Modes and sampled points.
        measured: Errors that were measured.
        training: How it was made, for the file.
    """
    turn = Rotation.from_euler("xyz", body.entry.mesh.rotation).as_matrix()
    basis = np.einsum("ji,njm->nim", turn, trained.modes.basis)
    basis[body.fixed] = 0.0
    return BodyReduction(
        basis, trained.mode_count, trained.sampled[0], trained.spare_sampled[0],
        np.abs(trained.coordinates).max(axis=0), measured, training,
    )  # fmt: skip


# --- a run ---------------------------------------------------------------------------------------


@dataclass
class Training:
    """A run of the command: what it samples, and what it has found.

    Attributes:
        scene: The full scene.
        options: What is asked.
        sampling: Loads and tilts.
        simulation: The training scene; its state is not used.
        body: The full body.
        axes: Box of the actuators.
        crew: Computes states.
        job: What these share.
        store: Keeps them.
        causes: Why states were lost.
        way: The path of targets along which states are sampled; None without.
        vibrations: See `train`.
    """

    scene: Scene
    options: TrainingOptions
    sampling: Sampling
    simulation: Simulation
    body: Body
    axes: tuple[Axis, ...]
    crew: SampleWorkers
    job: Job
    store: StateStore
    causes: list[str] = field(default_factory=list)
    way: TargetWay | None = None
    vibrations: np.ndarray | None = None

    def training_samples(self, count: int) -> np.ndarray:
        """Samples of a training: with the corners of the box, or from wider boxes of targets.

        Args:
            count: Number of samples.
        """
        return self.samples(count, self.options.seed, MARGIN, with_corners=True)

    def samples(self, count: int, seed: int, margin: float = 0.0, with_corners: bool = False) -> np.ndarray:
        """Samples, that at rest first; see `samples_of` and `samples_along`.

        Args:
            count: Their number.
            seed: Their seed.
            margin: Share of its width by which a box of targets is wider at each side.
            with_corners: Whether the corners of the actuators' box are among them.
        """
        if self.way is not None:
            return samples_along(self.simulation, self.way, count, seed)
        boxes = [box.widened(margin) for box in self.options.targets]
        return samples_of(self.simulation, self.axes, self.sampling, boxes, count, seed, with_corners)

    def fresh_samples(self, count: int, seed: int) -> np.ndarray:
        """Samples to judge by, without that at rest, which every training has seen.

        Args:
            count: Their number.
            seed: Their seed, beside that of the options.
        """
        if self.way is not None:  # a pass of a path begins at rest
            return self.samples(count, self.options.seed + seed)
        return self.samples(count + 1, self.options.seed + seed)[1:]

    def samples_between(self, states: States, count: int, seed: int) -> np.ndarray:
        """Samples to judge by that are drawn otherwise than those of a training by targets.

        Each holds the actuators at a place between those of two states that reached their targets,
        where no target is followed and none can be missed.

        Args:
            states: States of the training.
            count: Number of samples.
            seed: Their seed, beside that of the options.
        """
        known = states.found()
        reached = np.flatnonzero(~known.has_missed(self.simulation.model.nodes.size))
        rng = np.random.default_rng(self.options.seed + seed)
        pairs = rng.choice(reached, (count, 2))
        ends, shares = known.held(columns_of(self.simulation))[pairs], rng.random((count, 1))
        samples, columns = ends[:, 0].copy(), columns_of(self.simulation)
        setpoints, (first, last) = columns.split(samples)[0], (
            columns.split(ends[:, end])[0] for end in range(2))
        setpoints[:] = first + shares * (last - first)
        return samples

    def tours(self, samples: np.ndarray) -> list[np.ndarray]:
        """Indices of the samples of each chain, shape (count, width): passes along a path.

        Args:
            samples: The samples, shape (count, width).
        """
        if self.way is not None:
            return passes(len(samples))
        return chains(samples, spread_of(samples))

    def states(self, title: str, *groups: np.ndarray) -> list[States]:
        """States of the full model, of all groups of samples in one run of the workers.

        Args:
            title: What the progress is called.
            groups: Samples, shape (count, width).

        Raises:
            TrainingError: A group has no state at all.
        """
        asked = [[samples[tour] for tour in self.tours(samples)] for samples in groups]
        found, causes = find_states(
            title, self.crew, self.job, [chain for own in asked for chain in own], self.store
        )
        self.causes += causes
        made, rest = [], iter(found)
        for own in asked:
            parts = [states for states in [next(rest) for _ in own] if states is not None]
            if not any(part.is_found.any() for part in parts):
                raise TrainingError(f"{self.scene.path}: no state of the full model was found")
            made.append(joined(parts))
        return made

    def finder(self, reduction: BodyReduction, name: str) -> StateFinder:
        """Finds states of a reduced model, which is saved beside those of the full one.

        Args:
            reduction: The reduced model.
            name: Name of its file, without an ending.
        """
        file = self.store.path / f"{name}.reduced"
        with open(file, "wb") as stream:
            write_body_reduction(stream, reduction, reduction_fingerprints(self.body))
        scene = reduced_scene(self.scene, self.body.name, file)
        return StateFinder(training_scene(scene, self.sampling), "")

    def solve(self, reduction: BodyReduction, name: str, samples: np.ndarray) -> States:
        """States of a reduced model, each begun at the one before it.

        Args:
            reduction: The reduced model.
            name: Name of its file, without an ending.
            samples: The samples, shape (count, width).
        """
        finder = self.finder(reduction, name)
        return joined([finder(samples[tour]) for tour in self.tours(samples)])

    def judge(self, reduction: BodyReduction, name: str, truth: States) -> Judgement:
        """A reduced model against states of the full one, at the same setpoints and loads.

        Args:
            reduction: The reduced model.
            name: Name of its file, without an ending.
            truth: States of the full model.
        """
        truth = truth.found() if self.way is None else truth  # a pass keeps its states apart
        held, finder = truth.held(columns_of(self.simulation)), self.finder(reduction, name)
        tours = [tour[truth.is_found[tour]] for tour in self.tours(held)]
        tours = [tour for tour in tours if len(tour)]
        own = joined([finder(held[tour]) for tour in tours])
        return self.compared(own.effectors, truth.effectors[np.concatenate(tours)])

    def compared(self, effectors: np.ndarray, truth: np.ndarray) -> Judgement:
        """Effectors against where they should be.

        Args:
            effectors: Positions [m], shape (count, effector_count, 3).
            truth: Where they should be [m], same shape.
        """
        errors = np.linalg.norm(effectors - truth, axis=2)
        return Judgement(errors.max(axis=1), (errors / self.displacements(truth)).max(axis=1))

    def displacements(self, effectors: np.ndarray) -> np.ndarray:
        """Displacement of effectors from the rest shape, by which errors are judged [m].

        Where an effector passes its place at rest, actuators balance each other and the body is
        deformed all the same: at least a share of its largest displacement counts.

        Args:
            effectors: Positions [m], shape (count, effector_count, 3).
        """
        self.simulation.reset()
        moved = np.linalg.norm(effectors - self.simulation.effector_positions(), axis=2)
        largest = np.nanmax(moved, axis=0, initial=0.0)
        return np.maximum(moved, LEAST_DISPLACEMENT * largest)


def begin_training(path: Path, options: TrainingOptions) -> Training:
    """Read a scene, refuse what cannot be reduced, and take up an interrupted run.

    Args:
        path: Scene file.
        options: What is asked.
    """
    scene = without_reductions(load_scene(path))
    if options.vibrations is None:
        options = replace(options, vibrations=VIBRATIONS if scene.integration == "dynamic" else 0)
    names = [body.name for body in scene.deformables]
    name = options.body or (names[0] if len(names) == 1 else None)
    if name not in names:
        raise TrainingError(
            f"{path}: --body names one of {', '.join(names)}" if names
            else f"{path}: there is no deformable body"
        )  # fmt: skip
    if not scene.effectors:
        raise TrainingError(f"{path}: there are no effectors, whose error could be told")
    with terminal_status("building the scene"):
        plain = Simulation(training_scene(scene, Sampling(name)), with_warnings=False)
        body = next(own for own in plain.model.bodies if own.name == name)
        refuse_unreducible(scene, body)
        sampling = _sampling(scene, body, options)
        way = None if options.along is None else _way(plain, options)
        simulation = plain
        if sampling.load_points or sampling.in_contact:
            simulation = Simulation(training_scene(scene, sampling), with_warnings=False)
    for box in options.targets:
        if box.effector not in simulation.effector_names:
            raise TrainingError(f"--targets: {path} has no effector {box.effector}")
        if sum(box.effector == other.effector for other in options.targets) > 1:
            raise TrainingError(f"--targets: {box.effector} is given twice")
    by_targets = options.targets or way is not None
    axes = () if by_targets else sampled_axes(simulation, options.ranges)
    content = scene_fingerprint(scene)
    run = {"scene": content, "body": name, "loaded points": sampling.load_points,
           "contact": sampling.in_contact}  # fmt: skip
    crew = workers_of(options.workers, options.scheduler)
    job = Job(FinderMaker(sampling), path.resolve(), content)
    store = StateStore(output_path(scene, body, options), run)
    vibrations = vibration_modes(plain, body, options.vibrations) if options.vibrations else None
    return Training(scene, options, sampling, simulation, body, axes, crew, job, store, way=way,
                    vibrations=vibrations)  # fmt: skip


def _way(simulation: Simulation, options: TrainingOptions) -> TargetWay:
    """The path of targets of a file."""
    table = read_targets(options.along, simulation)
    if table.kind != "targets":
        raise TrainingError(f"--along: {options.along} has no targets of effectors, but {table.kind}")
    return TargetWay(table.times, table.values, options.around)


def _sampling(scene: Scene, body: Body, options: TrainingOptions) -> Sampling:
    points: list = []
    if options.load:
        places = [*options.load_points, *spread_points(body, options.spread_loads)]
        points = [(tuple(map(float, place)),) for place in places] or [
            effector.points for effector in scene.effectors if effector.body in (None, body.name)]
        if not points:
            raise TrainingError(f"--load: no effector is on {body.name}; name points by --load-points")
    if options.tilt and not any(scene.gravity):
        raise TrainingError("--tilts: the scene has no gravity that could be tilted")
    if options.tilt and any(cavity.liquid_density for cavity in scene.cavities):
        raise TrainingError("--tilts: of liquids in cavities is not built")
    in_contact = options.along is not None and scene.contact is not None
    return Sampling(body.name, options.load, tuple(points), options.tilt, in_contact)


def output_path(scene: Scene, body: Body, options: TrainingOptions) -> Path:
    """The file that is written: beside the mesh, by the name of the scene and, of several, the
    body.

    Args:
        scene: The scene.
        body: The body that is reduced.
        options: Options of the training; its `output` comes first.
    """
    if options.output is not None:
        return options.output
    name = scene.name if len(scene.deformables) == 1 else f"{scene.name}_{body.name}"
    return scene.mesh_folder(body.entry) / f"{name}_reduced.npz"


class Round(NamedTuple):
    """A round of a training with a wanted error.

    Attributes:
        states: Number of states it was trained with.
        modes: Modes in use.
        points: Sampled points.
        judgement: At fresh states.
        estimate: Estimated error of all candidates but few, as a share.
    """

    states: int
    modes: int
    points: int
    judgement: Judgement
    estimate: float


def _train_by_need(training: Training) -> tuple[Trained, States, list[Round], bool]:
    """Add states, modes and points until the wanted error is met at fresh states.

    Returns:
        The reduced model, the states of its training, the rounds, and whether the error is met.
    """
    options, body = training.options, training.body
    K, tolerance, mode_count = rest_stiffness(body), options.tolerance, options.modes
    first = training.training_samples(options.snapshots or FIRST_SNAPSHOTS)
    seed, rounds = ROUND_SEED, []
    states, fresh = training.states("first states", first, training.fresh_samples(JUDGES, seed))
    for number in range(1, MOST_ROUNDS + 1):
        with terminal_status(f"round {number}: modes, points, and the error at candidates"):
            trained = train(body, K, states, mode_count, options, tolerance, training.vibrations)
            reduction = reduction_of(body, trained, np.full(2, np.nan), {})
            judged = training.judge(reduction, "in_use", fresh)
            candidates = training.samples(CANDIDATES, options.seed + seed + 1, MARGIN)
            asked, estimates = _estimates(training, reduction, candidates)
        rounds.append(Round(
            int(states.is_found.sum()), trained.mode_count, len(trained.sampled[0].cells), judged,
            _typical(estimates),
        ))  # fmt: skip
        _tell_round(number, rounds[-1])
        worst_seen = max(judged.measured[1], rounds[-1].estimate)
        if not judged.lost and worst_seen <= options.error:
            return trained, states, rounds, True
        if number == MOST_ROUNDS:
            break
        better = training.judge(reduction.with_spare_modes(), "all", fresh)
        if _typical(better.shares) <= (1.0 - MODES_HELP) * _typical(judged.shares):
            mode_count = min(trained.mode_count + MORE_MODES, MOST_MODES)
        else:
            mode_count, tolerance = trained.mode_count, FINER_SAMPLING * tolerance
        seed += 2
        more, next_fresh = training.states(
            f"round {number + 1}: states where the estimate is worst, and fresh ones",
            _worst(asked, estimates), training.fresh_samples(JUDGES, seed),
        )  # fmt: skip
        states, fresh = joined([states, fresh, more]), next_fresh
    return trained, states, rounds, False


def _worst(asked: np.ndarray, estimates: np.ndarray) -> np.ndarray:
    """The samples of the largest estimates, those that are unknown first; that at rest before all.
    """
    order = np.argsort(-np.nan_to_num(estimates, nan=np.inf, posinf=np.inf), kind="stable")
    worst = order[order > 0][:ADDED]
    return np.concatenate([asked[:1], asked[np.sort(worst)]])


def _typical(shares: np.ndarray) -> float:
    """Error of all states but few, as a share; infinite without any."""
    good = shares[np.isfinite(shares)]
    return float(np.quantile(good, ALL_BUT_FEW)) if len(good) else np.inf


def _estimates(
    training: Training, reduction: BodyReduction, candidates: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Samples that hold the actuators where the reduced model has them, and its estimated errors.

    Returns:
        Samples, that at rest first, and the difference that the spare modes make, as a share; NaN
        where one of the two has no equilibrium.
    """
    found = training.solve(reduction, "in_use", candidates)
    held = found.held(columns_of(training.simulation))
    # Where the reduced model is lost, the full one is asked for the sample itself.
    held = np.where(found.is_found[:, None], held, found.samples)
    finder = training.finder(reduction.with_spare_modes(), "all")
    all_modes = finder(held)
    return held, training.compared(found.effectors, all_modes.effectors).shares


def _tell_round(number: int, done: Round) -> None:
    median, largest = 100.0 * done.judgement.measured
    lost = f", {done.judgement.lost} lost" if done.judgement.lost else ""
    console().print(
        f"round {number}: {done.states} states, {done.modes} modes, {done.points} points: error at "
        f"fresh states {median:.3f} % (median), {largest:.3f} % (largest){lost}; estimated at "
        f"most candidates up to {100.0 * done.estimate:.3f} %"
    )


def reduce(path: Path, options: TrainingOptions) -> int:
    """Make the reduced model of a body, and judge it.

    Args:
        path: Scene file.
        options: What is asked.

    Returns:
        Exit code: 1 where states were lost, or a wanted error is not met.

    Raises:
        SoftRobotTwinError: The scene, an option or a file cannot be used.
    """
    begin = time.perf_counter()
    training = begin_training(path, options)
    output = output_path(training.scene, training.body, options)
    try:
        rounds, is_met = [], True
        if options.error is not None:
            trained, states, rounds, is_met = _train_by_need(training)
        else:
            # Fresh ones in the same run of the workers.
            others = [training.fresh_samples(options.states, FRESH_SEED)] if options.states else []
            states = training.states(f"{training.scene.name}: states of the full model",
                                     training.training_samples(options.snapshots or SNAPSHOTS), *others)[0]  # fmt: skip
            with terminal_status("modes and sampled points"):
                trained = train(training.body, rest_stiffness(training.body), states, options.modes, options,
                                options.tolerance, training.vibrations)  # fmt: skip
        training_time = time.perf_counter() - begin
        made = _said(path, training.options, trained, states, training_time) | _targets_said(training, states)
        reduction = reduction_of(training.body, trained, np.full(2, np.nan), made)
        judgement = None
        if options.states:
            groups = [training.fresh_samples(options.states, FRESH_SEED)]
            if options.targets:
                groups.append(training.samples_between(states, options.states, BETWEEN_SEED))
            fresh = joined(training.states("fresh states", *groups))
            with terminal_status("error at fresh states"):
                judgement = training.judge(reduction, "in_use", fresh)
            reduction = reduction._replace(measured=judgement.measured)
    except KeyboardInterrupt:
        warn(f"{training.store.count()} chains of states are in {training.store.path}; the same "
             "command goes on from there")  # fmt: skip
        raise
    _save(output, reduction, training.body)
    training.store.remove()
    for cause in training.causes:
        warn(cause)
    _print_result(training, trained, states, judgement, training_time)
    if (told := _targets_said(training, states))["missed targets"]:
        warn(f"{_reached(told)}: what they should have shown, the reduced model has not seen")
    seconds = time.perf_counter() - begin
    size = 1e-6 * output.stat().st_size
    console().print(f"saved in {output}, {size:.1f} MB, {seconds:.0f} s in all")
    is_met = tell_whether_met(options, rounds, is_met, judgement)
    lost = bool(training.causes) or (judgement is not None and judgement.lost > 0)
    return 0 if is_met and not lost else 1


def tell_whether_met(
    options: TrainingOptions, rounds: list[Round], is_met: bool, judgement: Judgement | None
) -> bool:
    """Say where a wanted error is not met; gives whether it is.

    Args:
        options: Options of the training.
        rounds: The rounds that were made.
        is_met: Whether the last round is good enough.
        judgement: The final judgement by fresh states; None for none.
    """
    if options.error is None:
        return True
    wanted = f"the wanted error of {100.0 * options.error:g} %"
    if not is_met:
        warn(f"{wanted} is not met after {len(rounds)} rounds")
        return False
    if judgement is not None and judgement.measured[1] > options.error:
        above = int(np.count_nonzero(judgement.shares > options.error))
        warn(f"{wanted} was met in the last round, and is exceeded at {above} of the "
             f"{len(judgement.shares)} fresh states after it")  # fmt: skip
        return False
    return True


def _save(output: Path, reduction: BodyReduction, body: Body) -> None:
    with output_file(output) as partial, open(partial, "wb") as stream:
        write_body_reduction(stream, reduction, reduction_fingerprints(body))


def _said(path: Path, options: TrainingOptions, trained: Trained, states: States, seconds: float) -> dict:
    """How a reduced model was made, for its file."""
    return {
        "scene": Path(path).name, "seed": options.seed, "states": int(states.is_found.sum()),
        "states not found": int((~states.is_found).sum()), "modes": trained.mode_count,
        "energy left out": float(trained.modes.shares[trained.mode_count]),
        "points": len(trained.sampled[0].cells), "sampling error": trained.sampled[1],
        "points with spare modes": len(trained.spare_sampled[0].cells),
        "sampling error with spare modes": trained.spare_sampled[1],
        "load [N]": options.load, "tilt [rad]": options.tilt,
        "targets": [list(box) for box in options.targets], "ranges": list(options.ranges),
        "along": None if options.along is None else options.along.name,
        "around [m]": options.around,
        "vibration modes": options.vibrations, "wanted error": options.error, "time [s]": seconds,
    }  # fmt: skip


def _targets_said(training: Training, states: States) -> dict:
    """How many targets of a training were reached, and by how much others were missed."""
    found = states.found()
    size = training.simulation.model.nodes.size
    has_missed = found.has_missed(size)
    return {
        "targets sought": int(np.isfinite(found.missed).sum()), "missed targets": int(has_missed.sum()),
        "reached within [m]": CLOSE * size,
        "largest miss [m]": float(np.nanmax(found.missed, initial=0.0)),
    }  # fmt: skip


def _reached(told: dict) -> str:
    """How many targets were reached, and how far the others were missed, in words."""
    sought, missed = told["targets sought"], told["missed targets"]
    beyond = f", the others missed by up to {1e3 * told['largest miss [m]']:.2g} mm" if missed else ""
    return f"{sought - missed} of {sought} targets were reached{beyond}"


def _print_result(
    training: Training, trained: Trained, states: States, judgement: Judgement | None,
    seconds: float,
) -> None:  # fmt: skip
    body, out = training.body, console()
    rows = table(f"{body.name} of {training.scene.name}, reduced", "", "full model", "reduced")
    found, told = int(states.is_found.sum()), _targets_said(training, states)
    freedoms = 3 * int(np.count_nonzero(~body.fixed))
    rows.add_row("states of the training", f"{found} of {len(states.is_found)}", "")
    if told["targets sought"]:
        rows.add_row(f"targets, reached within {1e3 * told['reached within [m]']:.2g} mm", _reached(told), "")
    rows.add_row("linearizations for a state", f"{states.iterations.mean():.1f}", "")
    rows.add_row("time of the training", f"{seconds:.0f} s", "")
    rows.add_row("unknowns", f"{freedoms}", f"{trained.mode_count}")
    rows.add_row("quadrature points", f"{point_count(body)}", f"{len(trained.sampled[0].cells)}")
    rows.add_row("energy that the modes leave out", "", f"{trained.modes.shares[trained.mode_count]:.1e}")
    rows.add_row("virtual work that the points leave out", "", f"{100 * trained.sampled[1]:.2f} %")
    rows.add_row("spare modes, points with them", "",
                 f"{trained.modes.basis.shape[2] - trained.mode_count}, "
                 f"{len(trained.spare_sampled[0].cells)}")
    if judgement is not None:
        median, largest = 100.0 * judgement.measured
        rows.add_row(f"error of the effectors at {len(judgement.shares)} fresh states", "",
                     f"{median:.3f} % (median), {largest:.3f} % (largest), "
                     f"{1e3 * np.nanmax(judgement.errors, initial=0.0):.3f} mm (largest)"
                     + (f", {judgement.lost} not found" if judgement.lost else ""))
    out.print(rows)


def point_count(body: Body) -> int:
    """Number of quadrature points of a body.

    Args:
        body: The body.
    """
    return sum(points_of(block.mesh).weights.size for block, _ in blocks_of(body))
