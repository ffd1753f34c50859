"""Reduced models in studies of meshes: of which mesh a file is, and what a training would give.

What a reduced model of a fine mesh would be is told by a trial: one of the coarsest mesh of the
family, with quadratic elements, whose training takes seconds. Motions of the robot have about as
many modes on any mesh, and the time of a reduced step depends on modes and points only; so the trial
is timed in its place. A training takes as many linearizations as the trial, each as long as a step
of the fine mesh.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.harness.sample_workers import core_count
from softrobot_twin.reduction.body_training import (
    FRESH_SEED,
    MARGIN,
    Training,
    begin_training,
    point_count,
    reduce,
    reduction_of,
    train_once,
)
from softrobot_twin.reduction.reduction_states import States, columns_of
from softrobot_twin.reduction.training_options import SNAPSHOTS, TrainingOptions
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.reduced_body import (
    BodyReduction,
    ModelFile,
    ModelFileError,
    read_body_reduction,
    reduction_fingerprints,
    write_body_reduction,
)
from softrobot_twin.study.accuracy_study import (
    POSE_SHARES,
    AccuracyError,
    AccuracyRow,
    Differences,
    MeshLevel,
    ReducedModel,
    Setting,
    dof_count,
    only_body,
    write_scene_copy,
)

SUFFIX = "_reduced.npz"
"""End of the names of files of reduced models, by which they are found beside meshes."""
# Cables of a training for a study are wound in up to this share of their limits; the poses of the
# study, `POSE_SHARES`, lie inside.
_WOUND = max(map(max, POSE_SHARES)) + 0.1
# Gravity of a training for a study points anywhere, since errors are measured without it too [rad].
_ANY_TILT = np.pi
STUDY = TrainingOptions(energy=1.0e-5, tolerance=5.0e-3)
"""Energy and work that modes and points leave out: a tenth of the error of most meshes."""


def own_file(scene: Scene) -> Path | None:
    """File of the reduced model that the scene itself names, if any.

    Args:
        scene: The scene.
    """
    reduced = None if scene.body is None else scene.body.reduced
    return None if reduced is None else scene.file_path(reduced.file)


def beside(*folders: Path) -> list[Path]:
    """Files of reduced models in folders.

    Args:
        *folders: The folders; one that does not exist has no files.
    """
    return [path for folder in folders if folder.is_dir()
            for path in sorted(folder.glob(f"*{SUFFIX}"))]  # fmt: skip


def every_level(levels: Iterable[MeshLevel], hexahedra: Iterable[MeshLevel]) -> list[MeshLevel]:
    """Meshes with all elements, each of which may have a reduced model.

    Args:
        levels: Meshes of linear tetrahedra.
        hexahedra: Meshes of hexahedra.
    """
    levels = list(levels)
    return [*levels, *(level.with_element("quadratic") for level in levels), *hexahedra]


def reduced_models(
    given: Sequence[Path], found: Sequence[Path], levels: Sequence[MeshLevel]
) -> list[ReducedModel]:
    """Reduced models of the meshes of a study.

    Args:
        given: Files that the user names.
        found: Files that were found; those of other bodies are left out.
        levels: Meshes with their elements; see `every_level`.

    Returns:
        One for each file, those that are given first.

    Raises:
        AccuracyError: A given file cannot be read, or is of none of the meshes.
    """
    models: dict[Path, ReducedModel] = {}
    for path in (*given, *found):
        if path.resolve() in models:
            continue
        try:
            model = _model_of(path, levels)
        except ModelFileError as error:
            if path not in given:
                continue
            raise AccuracyError(str(path), error.reason) from None
        if model is not None:
            models[path.resolve()] = model
        elif path in given:
            tried = ", ".join(dict.fromkeys(one.name for one in levels))
            raise AccuracyError(str(path), f"is of none of the meshes {tried} with this material "
                                "and these fixed nodes")  # fmt: skip
    return list(models.values())


def _model_of(path: Path, levels: Sequence[MeshLevel]) -> ReducedModel | None:
    """The reduced model of a file; None where it is of none of the meshes."""
    file = ModelFile(path)
    nodes = len(file.taken("basis", None, 3, None))
    for level in levels:
        # Fingerprints take longer than a look at the number of nodes. To the corners of quadratic
        # elements come nodes at mid-edges.
        corners = level.node_count
        has_more = level.scene.body.element == "quadratic"
        if not (corners < nodes < 10 * corners if has_more else nodes == corners):
            continue
        try:
            reduction = read_body_reduction(file, only_body(level.scene))
        except ModelFileError as error:
            if not error.changed:
                raise
            continue
        return ReducedModel(path, level, reduction.mode_count, len(reduction.sampled.cells))
    return None


def reduced_row(row: AccuracyRow, model: ReducedModel, added: Differences) -> AccuracyRow:
    """What is known of a reduced model: the errors of its full one, and how far it is from it.

    Args:
        row: The row of the full model.
        model: The reduced model.
        added: How far it is from the full one.
    """
    return replace(
        row, **model.columns, dof_count=model.mode_count, error_lengths=row.error_lengths + added.moved,
        error_weightless=row.error_weightless + added.moved,
        error_tensions=row.error_tensions + added.pressed,
    )  # fmt: skip


# --- training ------------------------------------------------------------------------------------


def train_level(original: Path, level: MeshLevel, folder: Path) -> ReducedModel:
    """Train the reduced model of a mesh for a study, and keep it and its scene in a folder.

    The scene has cables held as in the study. A file of an earlier call is used again.

    Args:
        original: The user's scene file.
        level: The mesh with its element.
        folder: Where scene and file are written.

    Raises:
        SoftRobotTwinError: It cannot be trained or written.
    """
    element = level.scene.body.element
    stem = f"{level.name}_{element}"
    scene, file = folder / f"{stem}.yaml", folder / f"{stem}{SUFFIX}"
    if file.is_file() and (found := reduced_models((), (file,), [level])):
        return found[0]
    folder.mkdir(parents=True, exist_ok=True)
    return trained_model(scene, original, level, study_options(level.scene, file))


def trained_model(scene: Path, original: Path, level: MeshLevel, options: TrainingOptions) -> ReducedModel:
    """Write the scene of the full model of a mesh, and train its reduced model.

    Args:
        scene: Scene file to write.
        original: The user's scene file.
        level: The mesh with its element.
        options: Of the training, with the file to write.

    Raises:
        SoftRobotTwinError: It cannot be trained or written.
    """
    write_training_scene(scene, original, level)
    reduce(scene, options)
    return reduced_models((options.output,), (), [level])[0]


def write_training_scene(path: Path, original: Path, level: MeshLevel) -> None:
    """Write the scene of the full model of a mesh, as a study has it.

    Args:
        path: The file that is written.
        original: The scene file of the study.
        level: The mesh, with its scene.
    """
    body = level.scene.body
    setting = Setting(level.name, body.element, body.material.law, 1)
    remark = f"Made from {original.name} for the training of a reduced model"
    write_scene_copy(path, original, level.scene, setting, [remark])


def study_options(scene: Scene, output: Path) -> TrainingOptions:
    """Options of a training that covers what a study asks for.

    Args:
        scene: The scene.
        output: File to write.
    """
    tilt = _ANY_TILT if any(scene.gravity) else 0.0
    return replace(with_ranges(STUDY, scene), output=output, tilt=tilt)


def with_ranges(options: TrainingOptions, scene: Scene) -> TrainingOptions:
    """Options with the range of a study, in which errors of meshes are known too.

    Those that say themselves what is sampled stay as they are.

    Args:
        options: Options of a training.
        scene: The scene.
    """
    if options.ranges or options.targets:
        return options
    driven = {name for motor in scene.motors for name in motor.cables}
    return replace(options, ranges=tuple(
        f"{cable.name}_shortening_m=0:{_WOUND * cable.shortening[1]:.6g}"
        for cable in scene.cables
        if cable.name not in driven and np.isfinite(cable.shortening[1])
        and cable.shortening[0] <= 0.0 < cable.shortening[1]
    ))  # fmt: skip


class Trial(NamedTuple):
    """A reduced model of the coarsest mesh, which tells what one of a finer mesh would be.

    Attributes:
        model: It.
        error: Its error against its own full model at fresh states, as a share.
        linearizations: Of all states of its training, fresh ones included.
        sampling: Time for modes and points [s].
        points: Quadrature points of its mesh.
    """

    model: ReducedModel
    error: float
    linearizations: float
    sampling: float
    points: int

    def training_seconds(self, level: MeshLevel, step: float) -> float:
        """Expected time of a training of another mesh on all cores of this machine [s].

        Args:
            level: The mesh with its element.
            step: Time of a step of its full model [s].
        """
        share = point_count(only_body(level.scene)) / self.points
        return self.linearizations * step / core_count() + share * self.sampling


def make_trial(original: Path, levels: Sequence[MeshLevel], options: TrainingOptions, folder: Path) -> Trial:
    """Train a reduced model of the coarsest of some meshes, in this process.

    Linear tetrahedra lock: a coarse mesh of them does not buckle where a fine one does, and is left
    out where there are others.

    Args:
        original: The user's scene file.
        levels: Meshes, full.
        options: Those of the training that is foreseen.
        folder: Where its files are written.

    Raises:
        SoftRobotTwinError: The scene cannot be trained.
    """
    soft = [level for level in levels if level.scene.body.element != "linear"]
    level = min(soft or levels, key=dof_count)
    folder.mkdir(parents=True, exist_ok=True)
    scene, file = folder / "trial.yaml", folder / f"trial{SUFFIX}"
    write_training_scene(scene, original, level)
    training = begin_training(scene, replace(options, output=file, workers=1))
    try:
        samples = training.samples(options.snapshots or SNAPSHOTS, options.seed, MARGIN)
        judging = training.fresh_samples(max(2, options.states), FRESH_SEED)
        # They are kept, so that the time for modes and points is told apart.
        _, fresh = training.states("trial: states of the full model", samples, judging)
        begin = time.perf_counter()
        trained, states = train_once(training)
        sampling = time.perf_counter() - begin
        reduction = reduction_of(training.body, trained, np.full(2, np.nan), {})
        write_body_reduction(file, reduction, reduction_fingerprints(training.body))
        error = _error(training, reduction, fresh.found())
    finally:
        shutil.rmtree(training.store.path, ignore_errors=True)
    linearizations = float(states.iterations.sum() + fresh.iterations.sum())
    model = reduced_models((file,), (), [level])[0]
    return Trial(model, error, linearizations, sampling, point_count(training.body))


def _error(training: Training, reduction: BodyReduction, truth: States) -> float:
    """Relative error of the effectors against states of the full model.

    It is the root mean square of the effectors' distances by that of their displacements, over all
    states that the reduced model finds.
    """
    held = truth.held(columns_of(training.simulation))
    own = training.solve(reduction, "in_use", held)
    order = np.concatenate(training.tours(held))
    training.simulation.reset()
    motion = truth.effectors[order] - training.simulation.effector_positions()
    apart = (own.effectors - truth.effectors[order])[own.is_found]
    return float(np.linalg.norm(apart) / np.linalg.norm(motion[own.is_found]))
