"""A body reduced to the coordinates of a basis, as ``python -m softrobot_twin reduce`` saves it.

The displacement of every node is u = Φ q: a mode is a displacement of all nodes, and q are its
coordinates (proper orthogonal decomposition of states of the full model). Elastic forces are sums
over few quadrature points with weights of their own, so that they do nearly the same work along the
basis as all points together (energy-conserving sampling; Farhat et al., Int. J. Numer. Meth. Engng
98, 2014; points in place of elements: Hernández et al., Comput. Methods Appl. Mech. Engng 313, 2017).

Further modes, the spare ones, and points of their own tell the error: see `reduction_error.py`.

A file holds fingerprints of what it was made from; one of another body is refused.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.cell_mesh import points_of
from softrobot_twin.mechanics.reduced_elements import SampledPoints, point_gradients
from softrobot_twin.simulation.building.body_fingerprints import digest, fingerprints_of
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.simulation.building.model_file import LEAST, MOST, ModelFile, saved_prints

# Version of the file; one of another version is made anew.
FORMAT = 1
# Greatest displacement of a fixed node by a mode, whose largest is one: rounding of long sums.
FIXED = 1.0e-6
# Least eigenvalue of the stiffness at rest of modes that are scaled to unit stiffness: rounding.
LEAST_STIFFNESS = 1.0e-10


class BodyReduction(NamedTuple):
    """What a body is reduced to.

    Attributes:
        basis: Φ: displacement of each node by each coordinate, in mesh coordinates; the largest
            displacement of a node by a coordinate is one, so coordinates are in metres. Zero at
            fixed nodes. The modes in use come first, then the spare ones,
            shape (node_count, 3, mode_count + spare_count).
        mode_count: Number of modes in use, a multiple of three.
        sampled: The quadrature points that stand for all, with the modes in use.
        spare_sampled: Those that stand for all with the spare modes too.
        ranges: Largest magnitude of each coordinate in the training, spare ones included [m],
            shape (mode_count + spare_count,).
        measured: Median and largest error against the full model at fresh states, as a share of
            the effectors' displacement, or of a tenth of the largest one where that is more; NaN
            before, shape (2,).
        training: How it was made: command, seed, numbers of states, errors, times.
    """

    basis: np.ndarray
    mode_count: int
    sampled: SampledPoints
    spare_sampled: SampledPoints
    ranges: np.ndarray
    measured: np.ndarray
    training: dict

    @property
    def spare_count(self) -> int:
        """Number of spare modes."""
        return self.basis.shape[2] - self.mode_count

    def with_spare_modes(self) -> BodyReduction:
        """The same with the spare modes in use, and none spare."""
        return self._replace(mode_count=self.basis.shape[2], sampled=self.spare_sampled)


def reduction_fingerprints(body: Body) -> dict[str, str]:
    """Digests of what a reduction is made from: mesh, material and fixed nodes of a body."""
    return {
        "format": str(FORMAT), **fingerprints_of(body),
        "fixed nodes": digest(np.flatnonzero(body.fixed).astype(np.int64)),
    }  # fmt: skip


def write_body_reduction(path: Path, reduction: BodyReduction, prints: dict[str, str]) -> None:
    """Save a reduction and the fingerprints of what it was made from.

    The basis is saved in single precision: rounded modes are modes as good as the exact ones.

    Args:
        path: The file.
        reduction: What is saved.
        prints: See `reduction_fingerprints`.
    """
    arrays = {
        "basis": reduction.basis.astype(np.float32), "mode_count": reduction.mode_count,
        "ranges": reduction.ranges, "measured": reduction.measured,
        "training": json.dumps(reduction.training), "prints": saved_prints(prints),
    }  # fmt: skip
    for name in ("sampled", "spare_sampled"):
        for field, values in getattr(reduction, name)._asdict().items():
            arrays[f"{name}_{field}"] = values
    np.savez(path, **arrays)


def read_body_reduction(file: ModelFile | Path, body: Body | None = None) -> BodyReduction:
    """Read a reduction.

    Args:
        file: The file.
        body: The body that it is for; None to read it alone.

    Raises:
        ModelFileError: It was made of another body, or is damaged.
    """
    if not isinstance(file, ModelFile):
        file = ModelFile(file)
    if body is not None:
        file.check_prints(reduction_fingerprints(body))
    basis = file.taken("basis", None if body is None else body.mesh.node_count, 3, None)
    total = basis.shape[2]
    count = int(file.taken("mode_count", kind="i", least=3, most=total))
    if count % 3 or total % 3:
        raise file.damaged(f"{count} modes of {total}: multiples of three are needed")
    sampled, spare_sampled = (
        _sampled_points(file, name, body) for name in ("sampled", "spare_sampled")
    )
    try:
        training = json.loads(str(file.taken("training", kind="U")))
    except ValueError as error:
        raise file.damaged(f"training is no JSON: {error}") from None
    reduction = BodyReduction(
        basis, count, sampled, spare_sampled, file.taken("ranges", total, least=0.0),
        file.taken("measured", 2, least=0.0, may_be_nan=True), training,
    )  # fmt: skip
    if body is not None:
        _check_on_body(file, reduction, body)
    return reduction


def _sampled_points(file: ModelFile, name: str, body: Body | None) -> SampledPoints:
    most = MOST if body is None else max(block.numbers.max() for block in body.mesh.strained_blocks())
    cells = file.taken(f"{name}_cells", None, kind="i", least=0, most=most)
    points = file.taken(f"{name}_points", len(cells), kind="i", least=0)
    weights = file.taken(f"{name}_weights", len(cells), least=LEAST)
    if len(np.unique(np.stack([cells, points]), axis=1).T) < max(len(cells), 1):
        raise file.damaged(f"{name} has no points, or the same twice")
    return SampledPoints(cells, points, weights)


def _check_on_body(file: ModelFile, reduction: BodyReduction, body: Body) -> None:
    """Refuse modes that move fixed nodes, and points that do not hold the modes.

    Raises:
        ModelFileError: It says which.
    """
    if np.abs(reduction.basis[body.fixed]).max(initial=0.0) > FIXED:
        raise file.damaged("its modes move fixed nodes")
    for name, model in (("sampled", reduction), ("spare_sampled", reduction.with_spare_modes())):
        stiffness = np.zeros((model.mode_count, model.mode_count))
        for part in body.materials:
            lame_lambda, shear_modulus = part.lame_parameters
            for block in body.mesh.strained_blocks(part.cells):
                inside = np.isin(model.sampled.cells, block.numbers)
                if model.sampled.points[inside].max(initial=0) >= points_of(
                        block.mesh).weights.shape[1]:  # fmt: skip
                    raise file.damaged(f"{name}_points has points that its cells do not have")
                found = point_gradients(block, model.sampled, model.basis[:, :, :model.mode_count])
                weighted = found.weights[:, None, None] * found.gradients
                turned = found.gradients.reshape(len(weighted), 3, 3, -1).transpose(0, 2, 1, 3)
                traces = found.gradients[:, ::4].sum(axis=1)
                both = found.gradients + turned.reshape(found.gradients.shape)
                stiffness += shear_modulus * np.tensordot(weighted, both, ((0, 1), (0, 1)))
                stiffness += lame_lambda * (found.weights * traces.T) @ traces
        size = np.sqrt(np.diag(stiffness))
        if not (size > 0.0).all() or not np.linalg.eigvalsh(
                stiffness / np.outer(size, size))[0] > LEAST_STIFFNESS:  # fmt: skip
            raise file.damaged(f"at the points {name} the stiffness at rest is not positive "
                               "definite: too few points, or modes that depend on each other")
