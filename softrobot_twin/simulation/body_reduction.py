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

from softrobot_twin.mechanics.reduced_elements import SampledPoints
from softrobot_twin.simulation.body_fingerprints import digest, fingerprints_of, saved_prints
from softrobot_twin.simulation.deformable_body import Body

# Version of the file; one of another version is made anew.
FORMAT = 1


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


def read_body_reduction(path: Path) -> BodyReduction:
    """Read a file that `changed_since` found current."""
    with np.load(path) as saved:
        points = (
            SampledPoints(*(saved[f"{name}_{field}"] for field in SampledPoints._fields))
            for name in ("sampled", "spare_sampled")
        )
        return BodyReduction(
            saved["basis"].astype(float), int(saved["mode_count"]), *points, saved["ranges"],
            saved["measured"], json.loads(str(saved["training"])),
        )  # fmt: skip
