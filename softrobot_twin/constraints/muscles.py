"""Muscles as actuators: fibres that contract, along threads or in a region of a body.

A fibre is a vector r = Σ c_a x_a with the length L₀ at rest and the stretch ℓ = |r|/L₀. A thread has a
fibre between each two of its points; in a region there is one at each quadrature point, r = F a₀ with
the direction a₀ at rest. At the activation λ its tension is λ T f(ℓ), with the isometric force T and
a force-length relation f: constant; a line that reaches 0 at the free contraction c, as of
artificial muscles; or a bell, as of living ones (Thelen 2003):

    f = 1,    f = max(0, 1 - (1 - ℓ)/c),    f = exp(-((ℓ - ℓ_o)/w)²).

The displacement is the work by the activation, over all fibres of a muscle,

    δ = Σ T L₀ (G(1) - G(ℓ)) [J],    G' = f,    H = -Σ T f ∂|r|/∂q,

and with d = r/|r| a fibre has the stiffness c_a c_b K,

    K = λ T (f (1 - d dᵀ)/|r| + f'/L₀ d dᵀ).

Arguments of the kernels here:
    activations: λ of each muscle, shape (muscle_count,).
    coefficients: c of the nodes of each fibre, shape (fibre_count, width).
    laws: T [N], L₀ [m], and of f the slope 1/c, ℓ_o and w, 0 for none, shape (fibre_count, 5).
    muscle: Muscle of each fibre, shape (fibre_count,).
    nodes: Nodes of each fibre, -1 where there is none, shape (fibre_count, width).
    x: Node positions [m], shape (node_count, 3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.segment_term import SegmentTerm
from softrobot_twin.geometry.matrix3 import IDENTITY, add_outer, scaled_matrix, set_rows
from softrobot_twin.geometry.vector3 import norm, scaled, set_row
from softrobot_twin.kernels.compilation import INNER, KERNEL, njit
from softrobot_twin.mechanics.kinematics import CarriedPoints
from softrobot_twin.mechanics.springs import segment_vector
from softrobot_twin.mechanics.stencil import add_weighted_matrices, stacked

# A fibre that is shorter than this share of its length at rest has no direction.
NO_STRETCH = 1.0e-6
_ZERO = np.zeros(3)


class Fibres(NamedTuple):
    """Fibres of one muscle, of one width.

    Attributes:
        nodes: Nodes of each fibre, -1 where there is none, shape (fibre_count, width).
        coefficients: c of these nodes, same shape.
        lengths: L₀ [m]; 1 in a region, where r = F a₀, shape (fibre_count,).
        forces: T [N]; in a region its stress times a volume, shape (fibre_count,).
        law: Of f the slope 1/c, ℓ_o and w; zeros for a constant one.
    """

    nodes: np.ndarray
    coefficients: np.ndarray
    lengths: np.ndarray
    forces: np.ndarray
    law: tuple[float, float, float]


@njit(**INNER)
def force_length(stretch, law):
    """G(ℓ) - G(1), f and f' of a fibre.

    Args:
        stretch: ℓ.
        law: A row of `laws`.
    """
    slope, optimum, width = law[2], law[3], law[4]
    if width > 0.0:
        s, one = (stretch - optimum) / width, (1.0 - optimum) / width
        f = math.exp(-s * s)
        work = 0.5 * math.sqrt(math.pi) * width * (math.erf(s) - math.erf(one))
        return work, f, -2.0 * s / width * f
    if slope > 0.0 and stretch <= 1.0 - 1.0 / slope:
        return -0.5 / slope, 0.0, 0.0
    change = stretch - 1.0
    return change + 0.5 * slope * change * change, 1.0 + slope * change, slope


@njit(**KERNEL)
def write_muscle_rows(x, nodes, coefficients, laws, muscle, entry, blocks, values):
    """Write H and the works δ [J].

    Args:
        entry: Entry of H of each node, -1 where fixed, shape (fibre_count, width).
        blocks: Takes the entries of H [N], shape (entry_count, 3).
        values: Takes δ [J], shape (muscle_count,).
    """
    values[:] = 0.0
    for s in range(len(nodes)):
        r = segment_vector(x, nodes[s], coefficients[s], _ZERO)
        length, rest = norm(r), laws[s, 1]
        work, f, _ = force_length(length / rest, laws[s])
        values[muscle[s]] -= laws[s, 0] * rest * work
        pull = laws[s, 0] * f / length if length > NO_STRETCH * rest else 0.0
        for a in range(nodes.shape[1]):
            if entry[s, a] >= 0:
                set_row(blocks, entry[s, a], scaled(r, -coefficients[s, a] * pull))


@njit(**KERNEL)
def write_muscle_matrices(x, nodes, coefficients, laws, muscle, activations, projected, matrices):
    """Write K of every fibre.

    Args:
        projected: True for a part of it that is never negative.
        matrices: Takes K [N/m], shape (fibre_count, 3, 3).
    """
    for s in range(len(nodes)):
        r, rest = segment_vector(x, nodes[s], coefficients[s], _ZERO), laws[s, 1]
        length, pull = norm(r), activations[muscle[s]] * laws[s, 0]
        if pull == 0.0 or length <= NO_STRETCH * rest:
            matrices[s] = 0.0
            continue
        _, f, slope = force_length(length / rest, laws[s])
        across, along = pull * f / length, pull * slope / rest
        if projected:
            across, along = max(across, 0.0), max(along, 0.0)
        d = scaled(r, 1.0 / length)
        matrix = add_outer(scaled_matrix(IDENTITY, across), scaled(d, along - across), d)
        set_rows(matrices[s], matrix)


class Muscles(SegmentTerm):
    """Constraint term of all muscles of a scene."""

    name = "muscles"
    is_traceable = True

    def __init__(
        self, muscles: Sequence[Sequence[Fibres]], free_index: np.ndarray,
        points: CarriedPoints | None = None,
    ):  # fmt: skip
        """Lay out the rows.

        Args:
            muscles: The fibres of each muscle.
            free_index: Unknown or carried point of each node, -1 where fixed, shape (node_count,).
            points: The carried points of the scene; None without any.
        """
        parts = [own for muscle in muscles for own in muscle]
        self.row_count = len(muscles)
        counts = [sum(len(own.nodes) for own in muscle) for muscle in muscles]
        self._muscle = np.repeat(np.arange(len(muscles)), counts)
        self._laws = np.concatenate([
            np.column_stack([own.forces, own.lengths, np.tile(own.law, (len(own.nodes), 1))])
            for own in parts
        ])  # fmt: skip
        work = self._laws[:, 0] * self._laws[:, 1]
        self.scales = np.bincount(self._muscle, work, len(muscles))
        self._take_segments(self._muscle, stacked([own.nodes for own in parts]),
                            stacked([own.coefficients for own in parts], 0.0), free_index, points)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H [N] and the works δ [J]; see `ConstraintTerm.evaluate`."""
        write_muscle_rows(
            positions, self._nodes, self._coefficients, self._laws, self._muscle, self._entry,
            blocks, values,
        )  # fmt: skip

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the stiffness of active fibres; see `ConstraintTerm.add_stiffness`."""
        write_muscle_matrices(
            positions, self._nodes, self._coefficients, self._laws, self._muscle, multipliers,
            projected, self._matrices,
        )  # fmt: skip
        if self._folded is None:
            add_weighted_matrices(
                self._matrices, self._coefficients, self._bound.offsets, self._bound.strides, storage
            )
        else:
            self._fold_matrices(positions, self.entry_rows, multipliers, projected, storage)
