"""Reduced models in studies of meshes: of which mesh a file is, and what is known of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.reduced_body import (
    ModelFile,
    ModelFileError,
    read_body_reduction,
)
from softrobot_twin.study.accuracy_study import (
    AccuracyError,
    AccuracyRow,
    Differences,
    MeshLevel,
    ReducedModel,
    only_body,
)

SUFFIX = "_reduced.npz"
"""End of the names of files of reduced models, by which they are found beside meshes."""


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
