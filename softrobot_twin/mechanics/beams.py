"""Shear-flexible beams in three dimensions, with large displacements and rotations.

An element lies between two ends A and B, each with a place x and axes R whose first one is the
tangent. Its deformation is the logarithm of the relative pose,

    ψ = log(R_AᵀR_B),    t = J⁻¹(ψ) R_Aᵀ(x_B - x_A),

with J⁻¹ the inverse of the left Jacobian of rotations. ψ and t are the curvature and the strain, each
times the length, of the helix that leads from A to B. So they are the same for an element that was
moved as a rigid body, and they do not depend on the path to a pose. Between the ends the axis leaves
the helix: a lateral force bends it to an S that leaves the ends by the angle φ of t to their mean, and whose length is

    ℓ = t₁ + w (|t| - t₁),    w = 6/5 min(1, r/0.9), and 0.9 at least,

with r the share of bending, not shear, in t₂ or t₃. With c = t₁/|t| = cos φ, v = (1 + c)/2 and

    s = (ℓ, h t₂, h t₃),    h = 1/√v - (1 - v)/2,

the energy is

    U = ½ (s - s₀)·K_t (s - s₀) + ½ (ψ - ψ₀)·K_r (ψ - ψ₀).

h is one but for the fourth power of φ; with it the energy grows up to half a turn of φ, so that no
element rests with its ends pointing back along its chord.
s₀ and ψ₀ belong to the rest shape, which may be curved. With

    K_t = 1/(L/EA),  1/(L/κ_y GA + L³/12 EI_z),  1/(L/κ_z GA + L³/12 EI_y),    K_r = (GJ, EI_y, EI_z)/L

an element is exact in two limits: for small displacements it is Timoshenko's beam, because L³/12 EI
is the bend that a constant shear force causes beside the mean curvature; and where curvature and
strain are constant (a ring, a helix, any pure bend) U has no error at any rotation below half a turn
in one element. It is therefore a geometrically exact beam with the helix between its nodes and the
residual bending flexibility of MacNeal 1978, and equally a corotational beam whose local frame is
the mean of the rotations of its ends. Error against the elastica and the 45° bend: `test_beams.py`.

An axial force N acts on the length of the axis. So N adds 6 N/5 L to the lateral stiffness of an
element, and together with the helix it does what it does on Hermite's cubic: for an angle of one the S
stores half of N L/5, the bow half of N L/12. A beam-column has N/(L (1 - tanh(k/2)/(k/2))) with
k² = N L²/EI, and 12 EI/L³ + 6 N/5 L differs from it by k⁴/8400 of 12 EI/L³. Where ℓ is not less than
the chord, r > 3/4, a thread without bending stiffness stretches by N/EA at every tension, however its nodes
are turned. With t₁ in place of ℓ, elements would fold sideways where N > 12 EI/L². In compression
an element bows by itself at N = -10 EI/L²; U has no pole there, and a bowed element has its energy.
An element that is shorter than it is thick, r near 0, does not shear aside in tension if
N (1 - w) < (1 - r) κGA (1 + N/EA): with w ≥ 0.9 sections that are not hollow reach 13 EA at least.
With w = 0 elements shear aside by turns at 0.4 to 0.7 EA, which a solid never does.

An end is a constant pose in a frame: that of the beam's own node, or of a rigid body to which it is
joined. Forces and stiffness are those of the ends,

    f_B = -f_A,    m_A = -m_B - (x_B - x_A) × f_B,

moved to the origin of the frame by the lever ρ between them: torque m + ρ × f.

A slender element is much stiffer along than across. Where it turns by θ in a move of Newton's method,
it is stretched by θ²/2, and this force, which the next move takes away again, would spoil the geometric
stiffness: the tangent becomes far too stiff, or indefinite. The geometric stiffness is therefore taken
at the strain that the last linearization predicted, s + ds and ψ + dψ, as for a beam whose stresses are
unknowns too (Magisano, Leonetti and Garcea 2017). Forces are always those of the state. The first
linearization of a step has the tangent of the state, unless the last step ended out of balance.

Damping in proportion to stiffness adds β K times the rates of s and ψ, by backward Euler.

Arguments of the kernels here; those of one element have no first axis:
    A, K: A matrix, three rows of three numbers; in `project` an array of shape (12, 12).
    axes: Axes of each end in its frame, as columns, shape (element_count, 2, 3, 3).
    before, after, x: Node positions [m], shape (node_count, 3).
    block: A matrix, three rows of three numbers.
    forces: On the unknowns [N] and [N m], shape (free_node_count, 3); added to.
    gradient, lever, psi, t: Vectors, three numbers.
    h, root: h and 1/√v.
    has_lever: Whether each end lies off the origin of its frame, shape (element_count, 2).
    k, pulls: Stiffnesses [N/m] and [N m], and k times s₀ and ψ₀, shape (element_count, 6).
    order, offsets, strides: See `BoundStencils`, shape (element_count, 4) and (element_count, 10).
    origins, unknowns: Node and unknown of the frame of each end, shape (element_count, 2).
    out: t and ψ, or s and ψ, shape (element_count, 6); or the stiffness of one element, shape (12, 12).
    points: Place of each end in its frame [m], shape (element_count, 2, 3).
    predicted: s and ψ, shape (element_count, 6), or (0, 6) where there are none.
    strain, stress, turn, u: s, K_t (s - s₀), ∂c/∂t and t/|t|; vectors, three numbers.
    square: φ² [rad²].
    vector: Three numbers, shape (3,).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    IDENTITY,
    add_outer,
    add_scaled_matrix,
    cross_matrix,
    plus_identity,
    product,
    product_transposed,
    rows,
    scaled_matrix,
    symmetric,
    transform,
    transposed,
    transposed_product,
)
from softrobot_twin.geometry.vector3 import (
    add,
    add_scaled,
    cross,
    dot,
    negated,
    norm,
    row,
    scaled,
    set_row,
    subtract,
)
from softrobot_twin.geometry.vector_arrays import are_same, copy_vectors
from softrobot_twin.kernels.compilation import INLINED, INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.rigid_bodies import rotation_at
from softrobot_twin.mechanics.rotation import logarithm, skew_polynomial, turn_between
from softrobot_twin.mechanics.stencil import add_stencil_matrix, of_frames

# An element whose ends are turned by more than this against each other counts as folded, and no
# step makes one [rad]: at π the logarithm has a jump.
GREATEST_TURN = 0.9 * np.pi
# Share of bending from which on an element counts as slender; below, shear takes part in an S. Least w.
_SLENDER, _LEAST_WEIGHT = 0.9, 0.9
# A length of zero [m], and v of an element whose ends point back along its chord.
_SHORTEST, _REVERSED = 1.0e-30, 1.0e-6
# Squared angle [rad²] up to which the series is used: its terms left out are below round-off.
_SERIES_BELOW = 1.0
# |B_2k|/(2k)! for k = 1, 2, ...: the series of (1 - φ/2 cot φ/2)/φ² by powers of φ².
_SERIES = (
    1.0 / 12.0, 1.0 / 720.0, 1.0 / 30240.0, 1.0 / 1209600.0, 1.0 / 47900160.0,
    691.0 / 1307674368000.0, 1.0 / 74724249600.0, 3617.0 / 10670622842880000.0,
    43867.0 / 5109094217170944000.0, 174611.0 / 802857662698291200000.0,
)  # fmt: skip


class BeamElements(NamedTuple):
    """Elements of beams.

    Attributes:
        origins: Origin node of the frame of each end, shape (element_count, 2).
        unknowns: Translation of that frame, its rotation comes next; -1 where it does not move by
            itself, shape (element_count, 2).
        end_points: Place of each end in its frame [m], shape (element_count, 2, 3).
        end_axes: Axes of each end in its frame, as columns, shape (element_count, 2, 3, 3).
        rest: t₀ [m] and ψ₀ [rad], shape (element_count, 6).
        stiffness: Diagonals of K_t [N/m] and K_r [N m], shape (element_count, 6).
        damping: β [s], shape (element_count,).
    """

    origins: np.ndarray
    unknowns: np.ndarray
    end_points: np.ndarray
    end_axes: np.ndarray
    rest: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray


def element_stiffness(lengths, section, young_modulus: float, poisson_ratio: float) -> np.ndarray:
    """Diagonals of K_t and K_r.

    Args:
        lengths: L at rest [m], shape (element_count,).
        section: A `BeamSection`.
        young_modulus: E [Pa].
        poisson_ratio: ν.

    Returns:
        [N/m] and [N m], shape (element_count, 6).
    """
    L = np.asarray(lengths, float)
    E, G = young_modulus, young_modulus / (2.0 + 2.0 * poisson_ratio)
    s = section
    return np.column_stack([
        E * s.area / L,
        1.0 / (L / (G * s.shear_area_y) + L**3 / (12.0 * E * s.inertia_z)),
        1.0 / (L / (G * s.shear_area_z) + L**3 / (12.0 * E * s.inertia_y)),
        G * s.torsion / L, E * s.inertia_y / L, E * s.inertia_z / L,
    ])  # fmt: skip


def axis_weights(rest, stiffness) -> np.ndarray:
    """w of each element; r of the plane in which it is the more slender.

    Args:
        rest: t₀ [m] and ψ₀ [rad], shape (element_count, 6).
        stiffness: Diagonals of K_t [N/m] and K_r [N m], shape (element_count, 6).

    Returns:
        Shape (element_count,).
    """
    shares = stiffness[:, 1:3] * rest[:, :1] ** 2 / (12.0 * stiffness[:, [5, 4]])
    return np.clip(1.2 / _SLENDER * shares.max(axis=1, initial=0.0), _LEAST_WEIGHT, 1.2)


@njit(**KERNEL, forceinline=True)
def curvature_factors(square):
    """c = (1 - φ/2 cot φ/2)/φ² at φ², and its derivatives 2 dc/d(φ²) and 4 d²c/d(φ²)²."""
    if square < _SERIES_BELOW:
        c, slope, bend = 0.0, 0.0, 0.0
        for k in range(len(_SERIES) - 1, -1, -1):
            bend = bend * square + 2.0 * slope
            slope = slope * square + c
            c = c * square + _SERIES[k]
        return c, 2.0 * slope, 4.0 * bend
    half = 0.5 * np.sqrt(square)
    sine, cosine = np.sin(half), np.cos(half)
    cotangent, per_square = cosine / sine, 1.0 / (sine * sine)
    g = half * cotangent
    slope_g = (cotangent / half - per_square) / 8.0
    bend_g = (
        2.0 * cosine * per_square / sine - per_square / half - cotangent / (half * half)
    ) / (64.0 * half)
    c = (1.0 - g) / square
    slope = (-slope_g - c) / square
    bend = (-bend_g - 2.0 * slope) / square
    return c, 2.0 * slope, 4.0 * bend


@njit(**INLINED)
def _symmetric_slope(psi, y, c, c_1):
    """∂(c [ψ]×² y)/∂ψ: c ((ψ·y) 1 + ψ yᵀ - 2 y ψᵀ) + c₁ (ψ (ψ·y) - ψ² y) ψᵀ."""
    along, square = dot(psi, y), dot(psi, psi)
    second = scaled_matrix(IDENTITY, c * along)
    second = add_outer(second, scaled(psi, c), y)
    by_psi = add_scaled(scaled(psi, c_1 * along), y, -2.0 * c - c_1 * square)
    return add_outer(second, by_psi, psi)


@njit(**INLINED)
def _slope_of_chord(psi, y, c, c_1):
    """S = ∂(J⁻¹(ψ) y)/∂ψ."""
    return add_scaled_matrix(_symmetric_slope(psi, y, c, c_1), cross_matrix(y), 0.5)


@njit(**INLINED)
def _slope_of_moment(psi, m, c, c_1):
    """∂(J⁻ᵀ(ψ) m)/∂ψ."""
    return add_scaled_matrix(_symmetric_slope(psi, m, c, c_1), cross_matrix(m), -0.5)


@njit(**INLINED)
def _end_lever(x, origin, point):
    """ρ: from the origin of a frame to an end."""
    return transform(rotation_at(x, origin), _row_of(point))


@njit(**INLINED)
def _row_of(vector):
    """An array of three numbers as a vector."""
    return (vector[0], vector[1], vector[2])


@njit(**INLINED)
def _relative_pose(x, origins, points, axes):
    """R of end A, the chord x_B - x_A in the world, and ψ of one element."""
    R_a, R_b = rotation_at(x, origins[0]), rotation_at(x, origins[1])
    place_a = add(row(x, origins[0]), transform(R_a, row(points, 0)))
    place_b = add(row(x, origins[1]), transform(R_b, row(points, 1)))
    turned_a, turned_b = product(R_a, rows(axes[0])), product(R_b, rows(axes[1]))
    return turned_a, subtract(place_b, place_a), logarithm(transposed_product(turned_a, turned_b))


@njit(**INLINED)
def _chord_in_helix(psi, y, c):
    """t = J⁻¹(ψ) y."""
    return transform(skew_polynomial(psi, -0.5, c), y)


@njit(**INLINED)
def _strain(t, w):
    """s, |t|, the unit vector along t, h, ∂c/∂t and 1/√v; see the top."""
    length = np.sqrt(dot(t, t))
    share = 1.0 / max(length, _SHORTEST)
    u = scaled(t, share)
    v = max(0.5 + 0.5 * u[0], _REVERSED)
    root = 1.0 / np.sqrt(v)
    h = root + 0.5 * v - 0.5
    turn = (share - share * u[0] * u[0], -share * u[0] * u[1], -share * u[0] * u[2])
    strain = (t[0] + w * (length - t[0]), h * t[1], h * t[2])
    return strain, length, u, h, turn, root


@njit(**ONCE)
def _helix_and_bend(x, origins, points, axes):
    """t and ψ of one element."""
    R, chord, psi = _relative_pose(x, origins, points, axes)
    c, _, _ = curvature_factors(dot(psi, psi))
    return _chord_in_helix(psi, transform(transposed(R), chord), c), psi


@njit(**KERNEL)
def write_deformations(x, origins, points, axes, out):
    """t and ψ of every element."""
    for e in range(len(origins)):
        t, psi = _helix_and_bend(x, origins[e], points[e], axes[e])
        for i in range(3):
            out[e, i], out[e, 3 + i] = t[i], psi[i]


@njit(**KERNEL)
def _measure_axes(deformations, w):
    """Put s in the place of t, of t and ψ of every element."""
    for e in range(len(deformations)):
        strain, _, _, _, _, _ = _strain(_row_of(deformations[e]), w[e])
        for i in range(3):
            deformations[e, i] = strain[i]


@njit(**INLINED)
def _stresses(psi, strain, k, pulls, e):
    """K_t (s - s₀) and m = K_r (ψ - ψ₀), as k ε - pulls."""
    stress = (
        k[e, 0] * strain[0] - pulls[e, 0], k[e, 1] * strain[1] - pulls[e, 1],
        k[e, 2] * strain[2] - pulls[e, 2],
    )  # fmt: skip
    m = (
        k[e, 3] * psi[0] - pulls[e, 3], k[e, 4] * psi[1] - pulls[e, 4],
        k[e, 5] * psi[2] - pulls[e, 5],
    )  # fmt: skip
    return stress, m


@njit(**INLINED)
def _slope_of_lean(root):
    """dh/dc = (1 - v^-1.5)/4."""
    return 0.25 - 0.25 * root * root * root


@njit(**INLINED)
def _slope_of_length(u, w):
    """∂ℓ/∂t."""
    return (1.0 + w * (u[0] - 1.0), w * u[1], w * u[2])


@njit(**INLINED)
def _force_on_helix(t, stress, u, w, h, turn, root):
    """n = ∂U/∂t."""
    by_turn = (stress[1] * t[1] + stress[2] * t[2]) * _slope_of_lean(root)
    n = add_scaled(scaled(_slope_of_length(u, w), stress[0]), turn, by_turn)
    return add(n, (0.0, h * stress[1], h * stress[2]))


@njit(**ONCE)
def _helix_stiffness(t, stress, length, u, w, h, turn, root, k, e):
    """∂²U/∂t²: that of constant stress, and Σ k ∂s ∂sᵀ.

    With u along t, ∂²|t| = (1 - u uᵀ)/|t| and ∂²c = -(∂c uᵀ + u ∂cᵀ + c ∂²|t|)/|t|.
    """
    share = 1.0 / max(length, _SHORTEST)
    across, h_1 = stress[1] * t[1] + stress[2] * t[2], _slope_of_lean(root)
    by_turn = share * across * h_1
    taut = share * (w * stress[0] - by_turn * u[0])
    own = add_outer(scaled_matrix(IDENTITY, taut), scaled(u, -taut), u)
    along = _slope_of_length(u, w)
    own = add_outer(own, scaled(along, k[e, 0]), along)
    mixed = add_scaled((0.0, h_1 * stress[1], h_1 * stress[2]), u, -by_turn)
    mixed = add_scaled(mixed, turn, 0.09375 * across * root**5)
    own = add_outer(add_outer(own, mixed, turn), turn, mixed)
    y, z = scaled(turn, h_1 * t[1]), scaled(turn, h_1 * t[2])
    y, z = (y[0], y[1] + h, y[2]), (z[0], z[1], z[2] + h)
    return add_outer(add_outer(own, scaled(y, k[e, 1]), y), scaled(z, k[e, 2]), z)


@njit(**ONCE)
def _bend_gradient(psi, y, n, m, c, c_1):
    """p = ∂U/∂ψ at constant chord: m + Sᵀ n."""
    return add(m, transform(transposed(_slope_of_chord(psi, y, c, c_1)), n))


@njit(**INLINED)
def _loads_of_ends(R, psi, y, n, m, c, c_1):
    """∂U/∂x_B and the moment ∂U/∂φ of the turn between the ends, in the world."""
    to_chord = skew_polynomial(psi, 0.5, c)
    moment = transform(to_chord, _bend_gradient(psi, y, n, m, c, c_1))
    return transform(R, transform(to_chord, n)), transform(R, moment)


@njit(**INLINED)
def _add_end_forces(x, origins, unknowns, points, chord, f, moment, forces):
    """Add the forces f and -f of one element at its ends, and their torques."""
    if unknowns[0] >= 0:
        torque = add(moment, cross(chord, f))
        torque = add(torque, cross(_end_lever(x, origins[0], points[0]), f))
        set_row(forces, unknowns[0], add(row(forces, unknowns[0]), f))
        set_row(forces, unknowns[0] + 1, add(row(forces, unknowns[0] + 1), torque))
    if unknowns[1] >= 0:
        torque = add(moment, cross(_end_lever(x, origins[1], points[1]), f))
        set_row(forces, unknowns[1], subtract(row(forces, unknowns[1]), f))
        set_row(forces, unknowns[1] + 1, subtract(row(forces, unknowns[1] + 1), torque))


@njit(**KERNEL)
def _add_beam_forces(x, origins, unknowns, points, axes, w, k, pulls, forces):
    """Add the forces and torques of every element on the frames of its ends; see `add_forces`."""
    folded = 0
    for e in range(len(origins)):
        R, chord, psi = _relative_pose(x, origins[e], points[e], axes[e])
        c, c_1, _ = curvature_factors(dot(psi, psi))
        y = transform(transposed(R), chord)
        t = _chord_in_helix(psi, y, c)
        strain, length, u, h, turn, root = _strain(t, w[e])
        stress, m = _stresses(psi, strain, k, pulls, e)
        n = _force_on_helix(t, stress, u, w[e], h, turn, root)
        f, moment = _loads_of_ends(R, psi, y, n, m, c, c_1)
        _add_end_forces(x, origins[e], unknowns[e], points[e], chord, f, moment, forces)
        if dot(psi, psi) > GREATEST_TURN * GREATEST_TURN:
            folded += 1
    return folded


@njit(**ONCE)
def _chord_stiffness(psi, y, n, m, K_t, k, c, c_1, c_2):
    """∂²U by the chord y and the turn φ, X ← exp([φ]×) X: blocks yy, yφ and the symmetric φφ."""
    to_helix = skew_polynomial(psi, -0.5, c)
    to_chord = transposed(to_helix)
    S = _slope_of_chord(psi, y, c, c_1)
    S_turn = product(S, to_helix)
    by_turn = product(K_t, S_turn)
    along_t = product(to_chord, product(K_t, to_helix))
    mixed = product(to_chord, by_turn)
    bent = (scaled(to_helix[0], k[3]), scaled(to_helix[1], k[4]), scaled(to_helix[2], k[5]))
    bending = transposed_product(S_turn, by_turn)
    bending = add_scaled_matrix(bending, product(to_chord, bent), 1.0)
    mixed = add_scaled_matrix(mixed, product(_slope_of_moment(psi, n, c, c_1), to_helix), 1.0)
    p = add(m, transform(transposed(S), n))
    by_psi = product(to_chord, _curvature_of_chord(psi, y, n, c, c_1, c_2))
    by_psi = add_scaled_matrix(by_psi, _slope_of_moment(psi, p, c, c_1), 1.0)
    return along_t, mixed, add_scaled_matrix(bending, symmetric(product(by_psi, to_helix)), 1.0)


@njit(**ONCE)
def _curvature_of_chord(psi, y, n, c, c_1, c_2):
    """∂(Sᵀ n)/∂ψ at constant n, the second derivative of n·J⁻¹(ψ) y."""
    across = dot(n, y)
    a = add_scaled(
        add_scaled(scaled(n, dot(psi, y)), y, dot(psi, n)), psi, -2.0 * across
    )
    whole = dot(psi, n) * dot(psi, y) - dot(psi, psi) * across
    out = scaled_matrix(IDENTITY, -2.0 * c * across + c_1 * whole)
    out = add_outer(add_outer(out, scaled(n, c), y), scaled(y, c), n)
    out = add_outer(add_outer(out, scaled(a, c_1), psi), scaled(psi, c_1), a)
    return add_outer(out, scaled(psi, c_2 * whole), psi)


@njit(**INLINED)
def _turned_block(R, A):
    """R A Rᵀ."""
    return product_transposed(product(R, A), R)


@njit(**INLINED)
def _put_block(out, first, second, block):
    """Write a block at two vectors of an element, and its transpose at the same two exchanged."""
    for i in range(3):
        for j in range(3):
            out[3 * first + i, 3 * second + j] = block[i][j]
            out[3 * second + j, 3 * first + i] = block[i][j]


@njit(**ONCE)
def _write_end_stiffness(chord, f, moment, K_yy, K_yt, K_tt, out):
    """Stiffness of the moves (u_A, θ_A, u_B, θ_B) of the ends, from that of chord and turn.

    The chord changes by u_B - u_A + chord × θ_A and the turn by θ_B - θ_A. f and the moment turn
    with A.
    """
    X = cross_matrix(chord)
    K_yX = product(K_yy, X)
    K_ty = transposed(K_yt)
    by_turn_a = add_scaled_matrix(K_yX, K_yt, -1.0)
    bend_a = add_scaled_matrix(product(K_ty, X), K_tt, -1.0)
    own_a = add_scaled_matrix(
        add_scaled_matrix(K_tt, product(X, by_turn_a), -1.0), product(K_ty, X), -1.0
    )
    by_turn_a = add_scaled_matrix(by_turn_a, cross_matrix(f), -1.0)
    bend_a = add_scaled_matrix(bend_a, cross_matrix(moment), -0.5)
    own_a = plus_identity(own_a, -dot(chord, f))
    own_a = add_outer(add_outer(own_a, scaled(f, 0.5), chord), scaled(chord, 0.5), f)
    _put_block(out, 0, 0, K_yy)
    _put_block(out, 2, 2, K_yy)
    _put_block(out, 2, 0, scaled_matrix(K_yy, -1.0))
    _put_block(out, 3, 3, K_tt)
    _put_block(out, 3, 2, K_ty)
    _put_block(out, 3, 0, scaled_matrix(K_ty, -1.0))
    _put_block(out, 2, 1, by_turn_a)
    _put_block(out, 0, 1, scaled_matrix(by_turn_a, -1.0))
    _put_block(out, 3, 1, bend_a)
    _put_block(out, 1, 1, symmetric(own_a))


@njit(**INNER)
def _move_to_frame(end, lever, gradient, out):
    """Refer the rows and columns of an end to the origin of its frame, ρ = `lever` away.

    The end moves by u + θ × ρ. The gradient ∂U/∂x of the end changes its torque as it turns.
    """
    u, t = 6 * end, 6 * end + 3
    for column in range(12):
        moved = cross(lever, (out[u, column], out[u + 1, column], out[u + 2, column]))
        for i in range(3):
            out[t + i, column] += moved[i]
    for line in range(12):
        moved = cross(lever, (out[line, u], out[line, u + 1], out[line, u + 2]))
        for i in range(3):
            out[line, t + i] += moved[i]
    along = dot(gradient, lever)
    for i in range(3):
        out[t + i, t + i] -= along
        for j in range(3):
            out[t + i, t + j] += 0.5 * (gradient[i] * lever[j] + lever[i] * gradient[j])


@njit(**INNER)
def project(K):
    """A symmetric matrix with the magnitudes of its eigenvalues; in place.

    With zeros in place of negative ones, what only this element holds would be free.
    """
    if not np.isfinite(K).all():
        return
    values, vectors = np.linalg.eigh(K)
    if values[0] >= 0.0:
        return
    for k in range(len(K)):
        if values[k] < 0.0:
            for i in range(len(K)):
                for j in range(len(K)):
                    K[i, j] -= 2.0 * values[k] * vectors[i, k] * vectors[j, k]


@njit(**INNER)
def _end_move(before, after, origin, point):
    """Move of an end to first order, and the turn of its frame, from one state to another."""
    R = rotation_at(before, origin)
    turn = turn_between(R, rotation_at(after, origin))
    lever = transform(R, _row_of(point))
    return add(subtract(row(after, origin), row(before, origin)), cross(turn, lever)), turn


@njit(**KERNEL)
def _predict_deformations(before, after, origins, points, axes, w, out):
    """s + ds and ψ + dψ of every element, linearized at a state, for the moves to another one."""
    for e in range(len(origins)):
        R, chord, psi = _relative_pose(before, origins[e], points[e], axes[e])
        c, c_1, _ = curvature_factors(dot(psi, psi))
        y = transform(transposed(R), chord)
        u_a, turn_a = _end_move(before, after, origins[e, 0], points[e, 0])
        u_b, turn_b = _end_move(before, after, origins[e, 1], points[e, 1])
        moved = add(subtract(u_b, u_a), cross(chord, turn_a))
        to_helix = skew_polynomial(psi, -0.5, c)
        d_psi = transform(to_helix, transform(transposed(R), subtract(turn_b, turn_a)))
        t = transform(to_helix, y)
        strain, length, u, h, turn, root = _strain(t, w[e])
        dt = transform(to_helix, transform(transposed(R), moved))
        dt = add(dt, transform(_slope_of_chord(psi, y, c, c_1), d_psi))
        out[e, 0], along = strain[0] + dot(_slope_of_length(u, w[e]), dt), _slope_of_lean(root) * dot(turn, dt)
        for i in range(3):
            out[e, 3 + i] = psi[i] + d_psi[i]
            if i > 0:
                out[e, i] = strain[i] + h * dt[i] + t[i] * along


@njit(**KERNEL)
def _add_beam_stiffness(
    x, origins, unknowns, points, axes, has_lever, w, k, pulls, predicted, projected, order, offsets,
    strides, forces, storage,
):  # fmt: skip
    """Add the forces and the stiffness of every element.

    The geometric stiffness is that of the predicted s and ψ; of the state, where there are none.
    """
    whole = np.empty((12, 12))
    for e in range(len(origins)):
        R, chord, psi = _relative_pose(x, origins[e], points[e], axes[e])
        c, c_1, c_2 = curvature_factors(dot(psi, psi))
        y = transform(transposed(R), chord)
        t = _chord_in_helix(psi, y, c)
        strain, length, u, h, turn, root = _strain(t, w[e])
        stress, m = _stresses(psi, strain, k, pulls, e)
        n = _force_on_helix(t, stress, u, w[e], h, turn, root)
        f, moment = _loads_of_ends(R, psi, y, n, m, c, c_1)
        _add_end_forces(x, origins[e], unknowns[e], points[e], chord, f, moment, forces)
        if len(predicted) > 0:
            stress, m = _stresses(
                _row_of(predicted[e, 3:]), _row_of(predicted[e]), k, pulls, e
            )
            n = _force_on_helix(t, stress, u, w[e], h, turn, root)
            f, moment = _loads_of_ends(R, psi, y, n, m, c, c_1)
        K_t = _helix_stiffness(t, stress, length, u, w[e], h, turn, root, k, e)
        K_yy, K_yt, K_tt = _chord_stiffness(psi, y, n, m, K_t, k[e], c, c_1, c_2)
        _write_end_stiffness(
            chord, f, moment, _turned_block(R, K_yy), _turned_block(R, K_yt),
            _turned_block(R, K_tt), whole,
        )  # fmt: skip
        if has_lever[e, 0]:
            lever = _end_lever(x, origins[e, 0], points[e, 0])
            _move_to_frame(0, lever, negated(f), whole)
        if has_lever[e, 1]:
            _move_to_frame(1, _end_lever(x, origins[e, 1], points[e, 1]), f, whole)
        if projected:
            project(whole)
        add_stencil_matrix(order[e], offsets[e], strides[e], whole, storage)


@njit(**KERNEL)
def _share_below_half_turn(before, after, origins, points, axes, greatest):
    """Share of a move in which the ends of no element turn by more than `greatest` against each
    other.
    """
    share = 1.0
    for e in range(len(origins)):
        _, _, psi = _relative_pose(before, origins[e], points[e], axes[e])
        _, _, then = _relative_pose(after, origins[e], points[e], axes[e])
        turn, start = norm(subtract(then, psi)), norm(psi)
        if start + share * turn > greatest and norm(then) > start:
            # Near the limit a step goes half of what is left: shares of it would take all moves.
            share = min(share, max(greatest - start, 0.5 * (np.pi - start)) / turn)
    return share


class Beams(ForceTerm):
    """Force term of all beams of a scene.

    Attributes:
        element_count: Number of elements.
        elements: What they are made of.
    """

    name = "beams"
    is_slender = True
    is_traceable = True
    remembers_start = True

    def __init__(self, elements: BeamElements):
        """Lay out the elements.

        Args:
            elements: The elements.
        """
        self.elements = e = elements
        self.element_count = len(e.origins)
        self._is_damped = bool(e.damping.any())
        self._stencils = of_frames(e.unknowns)
        self._has_lever = np.abs(e.end_points).max(axis=2) > 0.0
        self._w, self._rest = axis_weights(e.rest, e.stiffness), np.array(e.rest, float)
        _measure_axes(self._rest, self._w)
        # With damping, K grows by β K/h in a step, and what is subtracted from K ε changes.
        self._k, self._pulls = e.stiffness.copy(), e.stiffness * self._rest
        self._start = np.empty((self.element_count, 6))
        # Node positions of the last linearization of a step, and of the one before; NaN without any.
        self._linearized_at = self._linearized_before = np.empty((0, 3))
        self._predicted, self._nothing = np.empty((self.element_count, 6)), np.empty((0, 6))

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Forget the last linearization; with damping, remember s and ψ where a step of h [s] begins.
        """
        self._linearized_at.fill(np.nan)
        if not self._is_damped:
            return
        e = self.elements
        write_deformations(positions, e.origins, e.end_points, e.end_axes, self._start)
        _measure_axes(self._start, self._w)
        rate = (e.damping / time_step)[:, None]
        np.multiply(e.stiffness, 1.0 + rate, out=self._k)
        np.multiply(e.stiffness, self._rest + rate * self._start, out=self._pulls)

    def follow_move(self, start: np.ndarray) -> None:
        """Predict s and ψ in the first linearization of a step too; see `ForceTerm.follow_move`."""
        self._make_room(start)
        self._linearized_at[:] = start

    def deformations(self, positions: np.ndarray) -> np.ndarray:
        """t [m] and ψ [rad] of every element, in the axes of its first end.

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Shape (element_count, 6).
        """
        e, out = self.elements, np.empty((self.element_count, 6))
        write_deformations(positions, e.origins, e.end_points, e.end_axes, out)
        return out

    def strains(self, positions: np.ndarray) -> np.ndarray:
        """s [m] and ψ [rad] of every element, shape (element_count, 6).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        strains = self.deformations(positions)
        _measure_axes(strains, self._w)
        return strains

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy [J]."""
        return 0.5 * float(np.sum(self.elements.stiffness * (self.strains(positions) - self._rest) ** 2))

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces [N] and torques [N m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: On the unknowns, shape (free_node_count, 3); added to.

        Returns:
            Number of elements that are bent by nearly half a turn.
        """
        e = self.elements
        return _add_beam_forces(
            positions, e.origins, e.unknowns, e.end_points, e.end_axes, self._w, self._k,
            self._pulls, forces,
        )  # fmt: skip

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add forces, and stiffness to the system matrix; see `ForceTerm.add`."""
        e, bound, x = self.elements, self._bound, positions
        self._make_room(x)
        # Another tangent of the same state is predicted from the same one before.
        if not are_same(self._linearized_at, x):
            copy_vectors(self._linearized_at, self._linearized_before)
            copy_vectors(x, self._linearized_at)
        predicted = self._nothing
        if are_same(self._linearized_before, self._linearized_before):
            predicted = self._predicted
            _predict_deformations(
                self._linearized_before, x, e.origins, e.end_points, e.end_axes, self._w, predicted
            )
        _add_beam_stiffness(
            x, e.origins, e.unknowns, e.end_points, e.end_axes, self._has_lever, self._w, self._k,
            self._pulls, predicted, projected, bound.order, bound.offsets, bound.strides, forces,
            storage,
        )  # fmt: skip

    def _make_room(self, positions: np.ndarray) -> None:
        if len(self._linearized_at) != len(positions):
            self._linearized_at, self._linearized_before = np.full((2, *positions.shape), np.nan)

    def largest_share(self, before: np.ndarray, after: np.ndarray) -> float:
        """Share of a move in which no element is bent by half a turn; see `ForceTerm`."""
        e = self.elements
        return _share_below_half_turn(
            before, after, e.origins, e.end_points, e.end_axes, GREATEST_TURN
        )
