"""How far a reduced body can be believed at a state: the sampled range, and the fit's error there.

The range is known in every step. The error is computed when somebody reads it, in less than a
millisecond. Each sample of a superelement knows what its forces are wrong by. The root mean squares
over the nearest samples, weighted by inverse squared distance, are taken as standard deviations of
the forces here, independent of each other, and the compliance of the last linearization turns them
into displacements of the vertebrae. Outside of the range they grow with the power of distance that
the polynomial's first omitted term has.

This is the error of the fit alone. What vertebrae that bend add is not in it; the comparison with
the full model, which the command makes and saves with the superelements, has all of it. Where the
vertebrae are no stiffer than what is between them, as on the Trunk, that is nearly all of the error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.superelements import DEFORMATIONS
from softrobot_twin.simulation.building.model import Model

# Samples that the estimate is a mean of.
NEIGHBOURS = 8
# An error is large above this share of the displacement and this one of the robot's size.
LARGE_SHARE, LARGE_BY_SIZE = 0.05, 0.001


class ReductionState(NamedTuple):
    """How far a reduced body can be believed.

    Attributes:
        range: Share of the range in which it was sampled; above 1 the state is outside of it. The
            largest over all superelements; of a body in the coordinates of a basis see
            `reduction_error.py`.
        error: Estimate of how far off the worst vertebra is by the fit's error, or the worst
            effector by modes that are not in use [m]; NaN without effectors or spare modes.
        measured_median: Error against the full model by the displacement, as the command found it
            over the whole range; NaN where it was not compared.
        measured_worst: The largest of these.
        share: The error by the displacement of the effector; NaN of vertebrae.
        negligible: An error that is too small to be told [m].
    """

    range: float
    error: float
    measured_median: float
    measured_worst: float
    share: float = float("nan")
    negligible: float = 0.0

    @property
    def doubt(self) -> str:
        """Why the body should not be believed here, in words; empty where nothing speaks against it.

        Range and error judge together: each sees poses that the other misses.
        """
        is_measured = self.measured_worst == self.measured_worst
        most = self.measured_worst if is_measured else LARGE_SHARE
        reasons = ["outside of the range of its reduction"] if self.range > 1.0 else []
        if self.share > most and self.error > self.negligible:
            known = f" ({100.0 * most:.2g} % at the worst fresh state)" if is_measured else ""
            reasons.append(f"{100.0 * self.share:.2g} % of the displacement off by its spare modes"
                           + known)  # fmt: skip
        return " and ".join(reasons)


def reduction_state(model: Model, name: str, positions: np.ndarray) -> ReductionState:
    """See the module.

    Args:
        model: The scene; its factorization holds the last linearization.
        name: A body that is reduced to vertebrae.
        positions: Node positions [m], shape (node_count, 3).
    """
    superelements = model.superelements[name]
    body = next(body for body in model.bodies if body.name == name)
    reduction = body.vertebrae.reduction
    superelements.evaluate(positions)
    blocks = _unknowns_of(model, name)
    compliance = _compliance(model, blocks)
    place = np.full(model.nodes.free_node_count, -1)
    place[blocks] = np.arange(len(blocks))
    variances = np.zeros(3 * len(blocks))
    for s, samples in enumerate(reduction.samples):
        z = superelements.scaled_variables(s)[: samples.shape[1]]
        forces = _expected_residual(z, samples, reduction.residuals[s], reduction.degree)
        loads = np.zeros((DEFORMATIONS, len(blocks), 3))
        superelements.write_deformation_slopes(s, place, loads)
        moves = loads.reshape(DEFORMATIONS, -1) @ compliance * forces[:, None]
        variances += (moves**2).sum(axis=0)
    # Every second unknown is a rotation.
    translations = variances.reshape(-1, 3)[::2].sum(axis=1)
    return ReductionState(
        float(superelements.ranges.max(initial=0.0)), float(np.sqrt(translations.max())),
        *map(float, reduction.measured),
    )  # fmt: skip


def _unknowns_of(model: Model, name: str) -> np.ndarray:
    """Translation and rotation of each free vertebra of a body, shape (2 free_count,)."""
    body = next(body for body in model.bodies if body.name == name)
    first = model.nodes.kinds[0].unknowns_of(body.vertebrae.frame_nodes)
    first = first[first >= 0]
    return np.column_stack([first, first + 1]).ravel()


def _compliance(model: Model, blocks: np.ndarray) -> np.ndarray:
    """Displacement of some unknowns by forces on them, by the last linearization.

    Args:
        model: The scene.
        blocks: The unknowns, shape (count,).

    Returns:
        Symmetric, shape (3 count, 3 count).
    """
    compliance = np.empty((len(blocks), 3, 3 * len(blocks)))
    for column in range(3 * len(blocks)):
        load = np.zeros((model.nodes.free_node_count, 3))
        load[blocks[column // 3], column % 3] = 1.0
        compliance[:, :, column] = model.factorization.solve(load)[blocks]
    return compliance.reshape(3 * len(blocks), -1)


def _expected_residual(
    z: np.ndarray, samples: np.ndarray, residuals: np.ndarray, degree: int
) -> np.ndarray:
    """What the forces of a superelement are wrong by at z [N] and [N m], shape (6,)."""
    squares = ((samples - z) ** 2).sum(axis=1)
    nearest = np.argsort(squares)[:NEIGHBOURS]
    weights = 1.0 / np.maximum(squares[nearest], np.finfo(np.float32).tiny)
    mean = weights @ residuals[nearest].astype(float) ** 2 / weights.sum()
    beyond = max(1.0, float(np.abs(z).max())) ** (degree + 1)
    return np.sqrt(mean) * beyond
