"""The orthotropic law: Hooke's law of three axes at right angles, as of printed parts and composites.

It acts between Green's strain and its stress, as the law of St. Venant and Kirchhoff does: for large
rotations with small strains. With the axes as rows of Q,

    e = Q E Qᵀ,    s_i = Σ C_ij e_j for the three stretches,    s_ij = 2 G_ij e_ij for the shears,
    S = Qᵀ s Q,    P = F S,    dP = dF S + F dS,

and C the inverse of the compliances 1/E_i and -ν_ij/E_i.

Arguments of the kernels here are as in `saint_venant_kirchhoff`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import product, product_transposed, transposed_product
from softrobot_twin.kernels.compilation import INLINED, njit
from softrobot_twin.mechanics.laws.saint_venant_kirchhoff import (
    differential,
    energy_density,
    linearize,
    stress,
)
from softrobot_twin.mechanics.point_law import LawConstant, OwnConstants, register_law

# The two axes may be off a right angle by this cosine; the second one is turned.
RIGHT_ANGLE = 0.02


class Orthotropic(NamedTuple):
    """Parameters of the law.

    Attributes:
        stretches: C_11, C_22, C_33, C_12, C_13, C_23 [Pa].
        shears: 2 G_12, 2 G_13, 2 G_23 [Pa].
        axes: Q, row by row.
    """

    stretches: tuple[float, ...]
    shears: tuple[float, ...]
    axes: tuple[float, ...]

    def turned(self, rotation: np.ndarray) -> Orthotropic:
        """The law of a mesh that was turned.

        Args:
            rotation: Shape (3, 3).
        """
        Q = np.reshape(self.axes, (3, 3)) @ rotation.T
        return self._replace(axes=tuple(Q.ravel().tolist()))


@njit(**INLINED)
def hooke_along_axes(law, E):
    """S of a symmetric strain E [Pa].

    Args:
        E: Three rows of three numbers.
    """
    a, C, G = law.axes, law.stretches, law.shears
    Q = ((a[0], a[1], a[2]), (a[3], a[4], a[5]), (a[6], a[7], a[8]))
    e = product_transposed(product(Q, E), Q)
    x, y, z = e[0][0], e[1][1], e[2][2]
    xy, xz, yz = G[0] * e[0][1], G[1] * e[0][2], G[2] * e[1][2]
    s = ((C[0] * x + C[3] * y + C[4] * z, xy, xz), (xy, C[3] * x + C[1] * y + C[5] * z, yz),
         (xz, yz, C[4] * x + C[5] * y + C[2] * z))  # fmt: skip
    return product(transposed_product(Q, s), Q)


def compliances(constants: Mapping[str, tuple]) -> np.ndarray:
    """The compliances of the three stretches [1/Pa], shape (3, 3).

    Args:
        constants: Of the law, by name.

    Raises:
        ValueError: They are not those of a material that resists every strain.
    """
    if any(len(values) != 3 for values in constants.values()):
        raise ValueError("each of them has three numbers")
    E, (xy, xz, yz) = np.array(constants["young_moduli"]), constants["poisson_ratios"]
    if min(E) <= 0.0 or min(constants["shear_moduli"]) <= 0.0:
        raise ValueError("moduli must be above 0 Pa")
    S = -np.array([[-1.0, xy, xz], [0.0, -1.0, yz], [0.0, 0.0, -1.0]]) / E[:, None]
    S = np.triu(S) + np.triu(S, 1).T
    if np.linalg.eigvalsh(S)[0] <= 0.0:
        raise ValueError("Poisson's ratios are too large: some strain would store no energy")
    first, second = np.array(constants["first_axis"]), np.array(constants["second_axis"])
    lengths = np.linalg.norm(first) * np.linalg.norm(second)
    if lengths == 0.0 or abs(first @ second) > RIGHT_ANGLE * lengths:
        raise ValueError("the axes must be at right angles")
    return S


def mean_shear_modulus(constants: Mapping[str, tuple]) -> float:
    """Mean of the shear moduli [Pa]; see `compliances`."""
    compliances(constants)
    return float(np.mean(constants["shear_moduli"]))


def bulk_modulus(constants: Mapping[str, tuple]) -> float:
    """κ of an even pressure [Pa]; see `compliances`."""
    return float(1.0 / compliances(constants).sum())


def of_constants(constants: Mapping[str, tuple], bulk_modulus: float) -> Orthotropic:
    """Parameters of the law; see `compliances`. κ follows from the others."""
    C, shears = np.linalg.inv(compliances(constants)), np.array(constants["shear_moduli"])
    first, second = np.array(constants["first_axis"]), np.array(constants["second_axis"])
    third = np.cross(first, second)
    axes = np.array([first, np.cross(third, first), third])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    stretches = (*C.diagonal(), C[0, 1], C[0, 2], C[1, 2])
    return Orthotropic(*(tuple(map(float, own)) for own in (stretches, 2.0 * shears, axes.ravel())))


register_law(
    "orthotropic", Orthotropic, energy_density, stress, differential, linearize,
    own=OwnConstants(
        tuple(LawConstant(name, unit, True) for name, unit in (
            ("young_moduli", "Pa"), ("shear_moduli", "Pa"), ("poisson_ratios", ""),
            ("first_axis", ""), ("second_axis", ""))),
        mean_shear_modulus, of_constants, bulk_modulus,
    ),
    second_stress=hooke_along_axes,
)  # fmt: skip
