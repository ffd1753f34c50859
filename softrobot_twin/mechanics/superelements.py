"""Superelements: soft parts between two rigid vertebrae, condensed onto the frames of these.

A part between the vertebrae A and B has inner nodes that are in equilibrium at every pose of A and
B and at every pressure p of its cavities. What it stores then is the enthalpy

    Π(e, p) = min over inner nodes of  (elastic energy - Σ p_c (V_c - V_c,rest)),

and all else are derivatives of this one function: forces -∂Π/∂e, growths of cavities -∂Π/∂p,
stiffness ∂²Π/∂e², rows of H -∂²Π/∂e∂p, and -∂²Π/∂p², the compliance of the walls themselves. They
are consistent with each other, and the stiffness is symmetric, whatever the accuracy of Π.

The six deformations e are

    d = ½ (R_A + R_B)ᵀ (x_B - x_A) - d_rest,      ω = the axial vector of ½ (R_AᵀR_B - R_BᵀR_A),

with x_A and x_B the middle of the faces where the part meets A and B: how much it is stretched and
sheared, in axes between those of its ends, and the sine of the angle between these times its axis.
Both contain only scalar products of axes of the two frames and of the chord x_B - x_A. Therefore a
rigid motion of both frames changes no e, stores no energy, and turns the forces with it: the
superelement is corotational by its coordinates. Each e is a product of two vectors that are linear
in the points of the frames, so that its second derivatives are exact and cheap. Bends by 90° and more are outside of what e
can tell apart; what was sampled ends far below.

The weight of the inner nodes displaces them a little. To first order it adds their potential at the
equilibrium without weight,

    Π ← Π - m g · (x_A + R_A c(e, p) - x_shared),

with c their centre of mass, a polynomial of second degree too. x_shared is the centre that results
where the vertebrae carry shares of their mass; its weight acts on the vertebrae already, like all
their mass. On the Fetch, whose accordions weigh a third of its plates, the shares alone are wrong by
0.6 % of the tip's displacement.

Π is a polynomial of z, the scaled deformations and pressures: it holds where |z_k| ≤ 1, the range
that was sampled. `study/vertebrae_reduction.py` fits it.

Arguments of the kernels here; those of one superelement have no first axis:
    a, b: Vectors, three numbers.
    axes: Axes of A as sums of its frame nodes, shape (3, 8).
    block: A matrix, three rows of three numbers.
    blocks: Entries of H [m²], shape (entry_count, 3); added to.
    by_unknowns: ∂e by the four unknowns, shape (count, 6, 4, 3).
    cavities: Its cavities, -1 behind the last one, shape (count, most cavities).
    centre_values, centre_gradients, centre_curvatures: Coefficients of c and of its derivatives, by
        superelement, axis and monomial or variable, shape (count, 3, …).
    centres: c [m], shape (count, 3).
    centre: That of one superelement, shape (3,).
    centre_slopes: ∂c/∂(e, p), shape (count, 3, n).
    chords, chord: x_B - x_A as a sum of the frame nodes, shape (count, 8).
    compliance: Growth by pressure [m³/Pa], shape (all_cavities, same); added to.
    curvature: ∂²Π/∂(e, p)², shape (count, n, n).
    deformations: Number of entries of e.
    drawn: What turns the weight along the axes of A, shape (count, 3, 3).
    e, rests, rest: Deformations, and those at rest, shape (count, 6).
    ends: Middles of the faces on A and B [m], shape (count, 2, 3).
    entry: Entry of H of each cavity and unknown, -1 for none, shape (count, most cavities, 4).
    first, second: Numbers of two of the four unknowns.
    forces: On the unknowns [N] and [N m], shape (free_node_count, 3); added to.
    gradient: ∂Π/∂(e, p), shape (count, n).
    gradients, curvatures: Coefficients of the derivatives of Π by monomial, shape (count,
        monomial_count, n) and (count, monomial_count, n²).
    levers: Of its frame nodes [m], shape (count, 8, 3).
    middle: Of the sampled range, shape (count, n).
    monomials, parents, factors: Of each monomial of lower degree, shape (monomial_count,).
    nodes: Frame nodes of A and B, shape (count, 8).
    offset, slope, z: Memory, shape (n,).
    order, offsets, strides: See `BoundStencils`, shape (count, 4) and (count, 10).
    out: Stiffness by the four unknowns, shape (12, 12).
    own_shares, shares: Mass of each frame node, shape (8,) and (count, 8).
    points: Frame nodes at the state known last [m], shape (count, 8, 3).
    pressures, told, values: Of all cavities [Pa] and [m³], shape (all_cavities,).
    pulls: The weight along the axes of A [N], shape (3,).
    ranges: Largest |z|, shape (count,).
    scaling: z by (e, p), shape (count, n, n); `by_z` and `by_variables` are of one superelement.
    by_z, by_variables: Second derivatives, shape (n²,) and (n, n).
    share: Factor of the block.
    slopes: ∂e/∂x of the frame nodes, shape (count, 6, 8, 3).
    unknowns: Translation and rotation of A and B, -1 where none, shape (count, 4).
    weight: m g of one superelement [N], three numbers.
    weights: Weight [N], shape (count, 3).
    work, bend: Memory, shape (n, n) and (n²,); in `_write_stiffness` shape (12,).
    x: Node positions [m], shape (node_count, 3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import cross_matrix
from softrobot_twin.geometry.vector3 import (
    add,
    add_scaled,
    cross,
    dot,
    row,
    scaled,
    set_row,
    subtract,
)
from softrobot_twin.kernels.compilation import INLINED, INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.polynomials import Monomials, write_monomials
from softrobot_twin.mechanics.stencil import add_lever_turning, add_stencil_matrix, of_frames

# Points of a superelement: the four frame nodes of each of its two vertebrae.
POINTS = 8
# Number of deformations.
DEFORMATIONS = 6
# Degree of the centre of mass.
CENTRE_DEGREE = 2


class SuperelementFit(NamedTuple):
    """Π of one superelement.

    Attributes:
        ends: Vertebrae A and B, by their order in the body, shape (2,).
        end_points: Middles of its faces on A and B, in their frames [m], shape (2, 3).
        rest: d and ω at rest, zero for ω [m] and [1], shape (6,).
        cavities: Its cavities, by their order among all, shape (cavity_count,).
        middle: Middle of the sampled range: deformations and pressures [m], [1] and [Pa],
            shape (6 + cavity_count,).
        scaling: z = scaling · (deformations and pressures - middle), shape (n, n).
        coefficients: Of Π [J] by the monomials of z.
        centres: Of c, from the middle of the face on A in the axes of A [m], by the monomials of z
            up to degree 2, shape (3, monomial_count).
        mass: m, of the inner nodes [kg].
        shares: Mass that each frame node of A and B carries of it, shape (8,); None in a file.
    """

    ends: np.ndarray
    end_points: np.ndarray
    rest: np.ndarray
    cavities: np.ndarray
    middle: np.ndarray
    scaling: np.ndarray
    coefficients: np.ndarray
    centres: np.ndarray
    mass: float
    shares: np.ndarray | None = None


def frame_axes() -> np.ndarray:
    """Axes of A as sums of its frame nodes, shape (3, 8)."""
    axes = np.zeros((3, POINTS))
    for k in range(3):
        axes[k, [0, 1 + k]] = -1.0, 1.0
    return axes


@njit(**INNER)
def write_deformations(x, nodes, chord, rest, e, slopes):
    """e of one superelement, and ∂e/∂x of its points."""
    y = (0.0, 0.0, 0.0)
    for n in range(POINTS):
        y = add_scaled(y, subtract(row(x, nodes[n]), row(x, nodes[0])), chord[n])
    for k in range(DEFORMATIONS):
        for n in range(POINTS):
            for i in range(3):
                slopes[k, n, i] = 0.0
    for k in range(3):
        along = scaled(add(axis_at(x, nodes, 0, k), axis_at(x, nodes, 4, k)), 0.5)
        e[k] = dot(along, y) - rest[k]
        for n in range(POINTS):
            set_row(slopes[k], n, scaled(along, chord[n]))
        _add_axis_slope(slopes[k], 0, k, y, 0.5)
        _add_axis_slope(slopes[k], 4, k, y, 0.5)
        i, j = (k + 1) % 3, (k + 2) % 3
        a_i, a_j = axis_at(x, nodes, 0, i), axis_at(x, nodes, 0, j)
        b_i, b_j = axis_at(x, nodes, 4, i), axis_at(x, nodes, 4, j)
        e[3 + k] = 0.5 * (dot(a_j, b_i) - dot(a_i, b_j)) - rest[3 + k]
        _add_axis_slope(slopes[3 + k], 0, j, b_i, 0.5)
        _add_axis_slope(slopes[3 + k], 4, i, a_j, 0.5)
        _add_axis_slope(slopes[3 + k], 0, i, b_j, -0.5)
        _add_axis_slope(slopes[3 + k], 4, j, a_i, -0.5)


@njit(**INLINED)
def axis_at(x, nodes, origin, k):
    """Axis k of the frame whose origin is a point of the superelement."""
    return subtract(row(x, nodes[origin + 1 + k]), row(x, nodes[origin]))


@njit(**INLINED)
def _add_axis_slope(slopes, origin, k, vector, share):
    """Add the derivative of share · vector · axis by the points of the axis."""
    tip = origin + 1 + k
    set_row(slopes, tip, add_scaled(row(slopes, tip), vector, share))
    set_row(slopes, origin, add_scaled(row(slopes, origin), vector, -share))


@njit(**ONCE)
def _write_scaled(s, e, pressures, cavities, middle, scaling, offset, z):
    """z of superelement s; gives the largest |z|."""
    for k in range(len(z)):
        c = k - len(e)
        value = 0.0
        if c < 0:
            value = e[k]
        elif cavities[s, c] >= 0:
            value = pressures[cavities[s, c]]
        offset[k] = value - middle[s, k]
    largest = 0.0
    for k in range(len(z)):
        value = 0.0
        for j in range(len(z)):
            value += scaling[s, k, j] * offset[j]
        z[k] = value
        largest = max(largest, abs(value))
    return largest


@njit(**INNER)
def _pull_back(scaling, by_z, by_variables, work):
    """scalingᵀ · by_z · scaling."""
    n = len(scaling)
    for k in range(n):
        for j in range(n):
            work[k, j] = 0.0
            by_variables[k, j] = 0.0
    for k in range(n):
        for m in range(n):
            for j in range(n):
                work[k, j] += by_z[k * n + m] * scaling[m, j]
    for m in range(n):
        for k in range(n):
            for j in range(n):
                by_variables[k, j] += scaling[m, k] * work[m, j]


@njit(**ONCE)
def _evaluate_enthalpy(
    s, scaling, monomials, gradients, curvatures, centre_values, centre_gradients,
    centre_curvatures, pulls, slope, bend, work, gradient, curvature, centre, centre_slopes,
):
    """∂Π/∂(e, p) and ∂²Π/∂(e, p)² of superelement s, with c and ∂c/∂(e, p).

    `pulls` is the weight along the axes of A. Monomials are the outer loop, so that the inner one
    runs over contiguous results.
    """
    n = len(gradient)
    slope[:n] = 0.0
    bend[: n * n] = 0.0
    for m in range(gradients.shape[1]):
        for k in range(n):
            slope[k] += gradients[s, m, k] * monomials[m]
    for m in range(curvatures.shape[1]):
        for k in range(n * n):
            bend[k] += curvatures[s, m, k] * monomials[m]
    for axis in range(3):
        total = 0.0
        for m in range(centre_values.shape[2]):
            total += centre_values[s, axis, m] * monomials[m]
        centre[axis] = total
        for k in range(n):
            work[0, k] = 0.0
        for m in range(centre_gradients.shape[2]):
            for k in range(n):
                work[0, k] += centre_gradients[s, axis, m, k] * monomials[m]
        for k in range(n):
            slope[k] -= pulls[axis] * work[0, k]
            total = 0.0
            for j in range(n):
                total += scaling[s, j, k] * work[0, j]
            centre_slopes[axis, k] = total
        for k in range(n * n):
            bend[k] -= pulls[axis] * centre_curvatures[s, axis, k]
    for k in range(n):
        total = 0.0
        for j in range(n):
            total += scaling[s, j, k] * slope[j]
        gradient[k] = total
    _pull_back(scaling[s], bend, curvature, work)


@njit(**KERNEL)
def _evaluate_all(
    x, nodes, chords, rests, pressures, cavities, middle, scaling, parents, factors, gradients,
    curvatures, centre_values, centre_gradients, centre_curvatures, weights, pulls, offset, z,
    monomials, slope, bend, work, axes, e, slopes, by_unknowns, levers, drawn, gradient, curvature,
    centres, centre_slopes, ranges,
):
    """Deformations and derivatives of Π of every superelement."""
    for s in range(len(nodes)):
        write_deformations(x, nodes[s], chords[s], rests[s], e[s], slopes[s])
        _write_unknown_slopes(
            x, nodes[s], axes, row(weights, s), slopes[s], by_unknowns[s], levers[s], drawn[s]
        )
        for k in range(3):
            pulls[k] = dot(row(weights, s), axis_at(x, nodes[s], 0, k))
        ranges[s] = _write_scaled(s, e[s], pressures, cavities, middle, scaling, offset, z)
        write_monomials(z, parents, factors, monomials)
        _evaluate_enthalpy(
            s, scaling, monomials, gradients, curvatures, centre_values, centre_gradients,
            centre_curvatures, pulls, slope, bend, work, gradient[s], curvature[s], centres[s],
            centre_slopes[s],
        )


@njit(**ONCE)
def _write_unknown_slopes(x, nodes, axes, weight, slopes, by_unknowns, levers, drawn):
    """∂e by the unknowns of both frames, and what turns the weight along the axes of A.

    Unknowns are the translation and the rotation of A, then those of B: dx_n = u + θ × ρ_n, where
    the lever ρ_n of an origin is zero and that of a tip an axis.
    """
    for n in range(POINTS):
        set_row(levers, n, subtract(row(x, nodes[n]), row(x, nodes[n - n % 4])))
    for k in range(len(slopes)):
        for f in range(2):
            force, torque = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            for n in range(4 * f, 4 * f + 4):
                own = row(slopes[k], n)
                force = add(force, own)
                torque = add(torque, cross(row(levers, n), own))
            set_row(by_unknowns[k], 2 * f, force)
            set_row(by_unknowns[k], 2 * f + 1, torque)
    for k in range(3):
        set_row(drawn, k, cross(row(levers, 1 + k), weight))


@njit(**KERNEL)
def _add_enthalpy_forces(unknowns, gradient, by_unknowns, weights, axes, centres, levers, shares, forces):
    """Add -∂Π by the unknowns of every superelement."""
    for s in range(len(unknowns)):
        weight = row(weights, s)
        for u in range(4):
            n = unknowns[s, u]
            if n < 0:
                continue
            force = (0.0, 0.0, 0.0)
            for k in range(by_unknowns.shape[1]):
                force = add_scaled(force, row(by_unknowns[s, k], u), -gradient[s, k])
            for a in range(2 * u - 2 * (u % 2), 2 * u - 2 * (u % 2) + 4):
                share = shares[s, a]
                for k in range(3):
                    share += centres[s, k] * axes[k, a]
                pull = weight if u % 2 == 0 else cross(row(levers[s], a), weight)
                force = add_scaled(force, pull, share)
            set_row(forces, n, add(row(forces, n), force))


@njit(**ONCE)
def _write_stiffness(curvature, by_unknowns, work, out):
    """∂e/∂qᵀ ∂²Π/∂e² ∂e/∂q over the twelve numbers of the unknowns."""
    count = len(by_unknowns)
    rows = by_unknowns.reshape(count, 12)
    out[:] = 0.0
    for k in range(count):
        for i in range(12):
            work[i] = 0.0
        for j in range(count):
            for i in range(12):
                work[i] += curvature[k, j] * rows[j, i]
        for i in range(12):
            for j in range(12):
                out[i, j] += rows[k, i] * work[j]


@njit(**INLINED)
def add_block(out, first, second, block, share):
    """Add a 3×3 block at two unknowns, and its transpose at the same two exchanged."""
    for i in range(3):
        for j in range(3):
            out[3 * first + i, 3 * second + j] += share * block[i][j]
            out[3 * second + j, 3 * first + i] += share * block[i][j]


@njit(**INLINED)
def _turned_product(a, b):
    """Matrix of (θ × a)·(φ × b) by θ and φ: a·b 1 - b aᵀ."""
    along = dot(a, b)
    return (
        (along - b[0] * a[0], -b[0] * a[1], -b[0] * a[2]),
        (-b[1] * a[0], along - b[1] * a[1], -b[1] * a[2]),
        (-b[2] * a[0], -b[2] * a[1], along - b[2] * a[2]),
    )


@njit(**ONCE)
def _add_bending(gradient, ends, levers, out):
    """Add Σ ∂Π/∂e_k ∂²e_k by the unknowns, of products of first changes.

    d is a product of axes and the chord y, ω one of axes of both frames; of Σ ∂Π/∂d_k d_k the
    axes sum up to one vector p in each frame.
    """
    p_a, p_b, r_a, r_b = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(3):
        a, b = row(levers, 1 + k), row(levers, 5 + k)
        p_a, p_b = add_scaled(p_a, a, 0.5 * gradient[k]), add_scaled(p_b, b, 0.5 * gradient[k])
        r_a, r_b = add_scaled(r_a, a, ends[0, k]), add_scaled(r_b, b, ends[1, k])
    # (θ_A × p_a + θ_B × p_b)·(u_B + θ_B × r_b - u_A - θ_A × r_a), twice.
    across_a, across_b = cross_matrix(p_a), cross_matrix(p_b)
    add_block(out, 1, 0, across_a, -1.0)
    add_block(out, 1, 2, across_a, 1.0)
    add_block(out, 3, 0, across_b, -1.0)
    add_block(out, 3, 2, across_b, 1.0)
    add_block(out, 1, 1, _turned_product(p_a, r_a), -1.0)
    add_block(out, 1, 3, _turned_product(p_a, r_b), 1.0)
    add_block(out, 3, 1, _turned_product(p_b, r_a), -1.0)
    add_block(out, 3, 3, _turned_product(p_b, r_b), 1.0)
    for k in range(3):
        i, j, share = (k + 1) % 3, (k + 2) % 3, 0.5 * gradient[3 + k]
        add_block(out, 1, 3, _turned_product(row(levers, 1 + j), row(levers, 5 + i)), share)
        add_block(out, 1, 3, _turned_product(row(levers, 1 + i), row(levers, 5 + j)), -share)


@njit(**INNER)
def add_turning(gradient, slopes, shares, weight, levers, out):
    """Add the change of the torques ρ × f by rotations, symmetric; see `kinematics`."""
    for a in range(POINTS):
        force = scaled(weight, shares[a])
        for k in range(len(slopes)):
            force = add_scaled(force, row(slopes[k], a), -gradient[k])
        add_lever_turning(force, row(levers, a), 6 * (a // 4) + 3, out)


@njit(**ONCE)
def _add_drawn(centre_slopes, by_unknowns, drawn, out):
    """Add what the displaced centre of mass and the turned weight do to each other."""
    count = len(by_unknowns)
    rows = by_unknowns.reshape(count, 12)
    for k in range(3):
        for i in range(12):
            along = 0.0
            for j in range(count):
                along += centre_slopes[k, j] * rows[j, i]
            for j in range(3):
                out[i, 3 + j] -= along * drawn[k, j]
                out[3 + j, i] -= along * drawn[k, j]


@njit(**KERNEL)
def _add_enthalpy_stiffness(
    order, ends, gradient, curvature, slopes, by_unknowns, weights, axes, centres, centre_slopes,
    levers, shares, drawn, projected, offsets, strides, own_shares, work, whole, storage,
):
    """Add ∂²Π by the unknowns of every superelement; projected, only that of ∂²Π/∂e²."""
    for s in range(len(order)):
        _write_stiffness(curvature[s], by_unknowns[s], work, whole)
        if not projected:
            for a in range(POINTS):
                own_shares[a] = shares[s, a]
                for k in range(3):
                    own_shares[a] += centres[s, k] * axes[k, a]
            _add_bending(gradient[s], ends[s], levers[s], whole)
            add_turning(gradient[s], slopes[s], own_shares, row(weights, s), levers[s], whole)
            _add_drawn(centre_slopes[s], by_unknowns[s], drawn[s], whole)
        add_stencil_matrix(order[s], offsets[s], strides[s], whole, storage)


@njit(**KERNEL)
def add_growths(
    cavities, deformations, gradient, curvature, by_unknowns, drawn, centre_slopes, entry,
    values, blocks, compliance,
):
    """Add growth -∂Π/∂p of every cavity, its rows -∂²Π/∂q∂p, and its compliance -∂²Π/∂p²."""
    for s in range(len(cavities)):
        for c in range(cavities.shape[1]):
            cavity = cavities[s, c]
            if cavity < 0:
                continue
            p = deformations + c
            values[cavity] -= gradient[s, p]
            for d in range(cavities.shape[1]):
                if cavities[s, d] >= 0:
                    compliance[cavity, cavities[s, d]] -= curvature[s, p, deformations + d]
            for u in range(4):
                place = entry[s, c, u]
                if place < 0:
                    continue
                block = row(blocks, place)
                for k in range(deformations):
                    block = add_scaled(block, row(by_unknowns[s, k], u), -curvature[s, p, k])
                if u == 1:
                    for k in range(3):
                        block = add_scaled(block, row(drawn[s], k), centre_slopes[s, k, p])
                set_row(blocks, place, block)


@njit(**KERNEL)
def is_known(x, nodes, points, pressures, told):
    """Whether the points of the superelements and the pressures are those that were stored."""
    for s in range(len(nodes)):
        for a in range(nodes.shape[1]):
            for i in range(3):
                if x[nodes[s, a], i] != points[s, a, i]:
                    return False
    for c in range(len(pressures)):
        if pressures[c] != told[c]:
            return False
    return True


@njit(**KERNEL)
def store(x, nodes, points, pressures, told):
    """Store the points of the superelements and the pressures."""
    for s in range(len(nodes)):
        for a in range(nodes.shape[1]):
            for i in range(3):
                points[s, a, i] = x[nodes[s, a], i]
    for c in range(len(pressures)):
        told[c] = pressures[c]


class Superelements(ForceTerm):
    """Force term of all superelements of one reduced body, at given pressures of its cavities.

    Attributes:
        pressures: Gauge pressure of each cavity [Pa], shape (cavity_count,); others may be
            written here, at which all is evaluated from then on.
        count: Number of superelements.
        ranges: Largest |z| of each at the state evaluated last; above 1 it is out of what was
            sampled, shape (count,).
    """

    name = "superelements"
    is_traceable = True

    def __init__(
        self, fits: tuple[SuperelementFit, ...], degree: int, frame_nodes: np.ndarray,
        cavity_count: int, frame_unknowns: np.ndarray, gravity=(0.0, 0.0, 0.0),
    ):  # fmt: skip
        """Lay out the polynomials.

        Args:
            fits: The superelements.
            degree: Total degree of Π.
            frame_nodes: First frame node of each vertebra, shape (vertebra_count,).
            cavity_count: Number of cavities of the scene.
            frame_unknowns: Translation of each vertebra, -1 where it is fixed; its rotation comes
                next, shape (vertebra_count,).
            gravity: Acceleration [m/s²], shape (3,).
        """
        self.count, self.pressures = len(fits), np.zeros(cavity_count)
        most = max((len(fit.cavities) for fit in fits), default=0)
        n = DEFORMATIONS + most
        self._monomials = Monomials(n, degree)
        corners = np.arange(4)
        self._nodes = np.array(
            [[*(frame_nodes[fit.ends[0]] + corners), *(frame_nodes[fit.ends[1]] + corners)]
             for fit in fits], np.int64,
        ).reshape(-1, POINTS)  # fmt: skip
        ends = np.array([frame_unknowns[fit.ends] for fit in fits], np.int64).reshape(-1, 2)
        self.unknowns = self._stencils = of_frames(ends)
        self._ends = np.array([fit.end_points for fit in fits]).reshape(-1, 2, 3)
        self._chords = np.array([_chord(*fit.end_points) for fit in fits])
        self._rests = np.array([fit.rest for fit in fits])
        self.cavities = np.full((self.count, most), -1, np.int64)
        self._middle, self._scaling = np.zeros((self.count, n)), np.zeros((self.count, n, n))
        self._values = np.zeros((self.count, self._monomials.count))
        centres = Monomials(n, CENTRE_DEGREE)
        self._centre_values = np.zeros((self.count, 3, centres.count))
        for s, fit in enumerate(fits):
            own = DEFORMATIONS + len(fit.cavities)
            self.cavities[s, : len(fit.cavities)] = fit.cavities
            self._middle[s, :own], self._scaling[s, :own, :own] = fit.middle, fit.scaling
            self._values[s, _places(own, self._monomials)] = fit.coefficients
            self._centre_values[s][:, _places(own, centres)] = fit.centres
        self._centre_gradients = np.ascontiguousarray(
            np.swapaxes(centres.gradient_coefficients(self._centre_values), 2, 3)
        )
        curvatures = centres.curvature_coefficients(self._centre_values)
        self._centre_curvatures = curvatures.reshape(self.count, 3, n * n)
        self._axes, self._pulls = frame_axes(), np.zeros(3)
        self._weights = np.array([fit.mass * np.asarray(gravity, float) for fit in fits])
        self._shares = np.array([_shares(fit) for fit in fits])
        self._centres, self._centre_slopes = np.zeros((self.count, 3)), np.zeros((self.count, 3, n))
        self._levers, self._drawn = np.zeros((self.count, POINTS, 3)), np.zeros((self.count, 3, 3))
        self._by_unknowns = np.zeros((self.count, DEFORMATIONS, 4, 3))
        self._own_shares, self._line = np.zeros(POINTS), np.zeros(12)
        self._whole = np.zeros((12, 12))
        self._gradients = _monomials_first(self._monomials.gradient_coefficients(self._values))
        self._curvatures = _monomials_first(self._monomials.curvature_coefficients(self._values))
        # Of the monomials, the derivatives need those of one degree less.
        low = self._gradients.shape[1]
        self._parents, self._factors = (table[:low] for table in self._monomials.recipe)
        self._offset, self._z, self._slope = np.zeros(n), np.zeros(n), np.zeros(n)
        self._low_monomials, self._bend, self._work = np.zeros(low), np.zeros(n * n), np.zeros((n, n))
        self.deformations = np.zeros((self.count, DEFORMATIONS))
        self._slopes = np.zeros((self.count, DEFORMATIONS, POINTS, 3))
        self._gradient, self._curvature = np.zeros((self.count, n)), np.zeros((self.count, n, n))
        self.ranges = np.zeros(self.count)
        # Those of the state that is known: none yet.
        self._points, self._told = np.full((*self._nodes.shape, 3), np.nan), np.zeros(cavity_count)

    def evaluate(self, positions: np.ndarray) -> None:
        """Evaluate the derivatives of Π, unless they are known from the last call.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        state = positions, self._nodes, self._points, self.pressures, self._told
        if is_known(*state):
            return
        store(*state)
        _evaluate_all(
            positions, self._nodes, self._chords, self._rests, self.pressures, self.cavities,
            self._middle, self._scaling, self._parents, self._factors, self._gradients,
            self._curvatures, self._centre_values, self._centre_gradients,
            self._centre_curvatures, self._weights, self._pulls, self._offset, self._z,
            self._low_monomials, self._slope, self._bend, self._work, self._axes,
            self.deformations, self._slopes, self._by_unknowns, self._levers, self._drawn,
            self._gradient, self._curvature, self._centres, self._centre_slopes,
            self.ranges,
        )  # fmt: skip

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces [N] and torques [N m] at the told pressures; see `ForceTerm.add_forces`.
        """
        self.evaluate(positions)
        _add_enthalpy_forces(
            self.unknowns, self._gradient, self._by_unknowns, self._weights, self._axes,
            self._centres, self._levers, self._shares, forces,
        )  # fmt: skip
        return 0

    def add_stiffness(self, positions, storage, projected: bool) -> None:
        """Add the stiffness; see `ForceTerm.add_stiffness`.

        Projected, it adds the stiffness without that of ∂²e/∂q² and of weight, and takes the
        magnitudes of the principal stiffnesses of ∂²Π/∂e².
        """
        curvature = self._curvature
        if projected:
            curvature = self._curvature[:, :DEFORMATIONS, :DEFORMATIONS]
            stretches, axes = np.linalg.eigh(curvature)
            # Magnitudes: with zeros in place of negative ones, vertebrae could be free.
            curvature = np.ascontiguousarray(
                (axes * np.abs(stretches)[:, None, :]) @ axes.transpose(0, 2, 1)
            )
        _add_enthalpy_stiffness(
            self._bound.order, self._ends, self._gradient, curvature, self._slopes,
            self._by_unknowns, self._weights, self._axes, self._centres, self._centre_slopes,
            self._levers, self._shares, self._drawn, projected, self._bound.offsets,
            self._bound.strides, self._own_shares, self._line, self._whole, storage,
        )  # fmt: skip

    def energy(self, positions: np.ndarray) -> float:
        """Elastic energy Π + Σ p δ at the told pressures [J], without weight; see `ForceTerm`."""
        self.evaluate(positions)
        told = np.where(self.cavities >= 0, self.pressures[self.cavities], 0.0)
        bare = self._bare_enthalpy()
        return float(bare - (told * self._gradient[:, DEFORMATIONS:]).sum())

    def _bare_enthalpy(self) -> float:
        """Sum of Π without weight [J], at the state evaluated last."""
        z = np.array([self.scaled_variables(index) for index in range(self.count)])
        return float((self._monomials.values(z) * self._values).sum())

    def enthalpy(self, positions: np.ndarray) -> float:
        """Π at the told pressures, with the potential of the weight [J].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        self.evaluate(positions)
        points = positions[self._nodes]
        shares = self._shares + self._centres @ self._axes
        weight = float(np.einsum("sa,sai,si->", shares, points, self._weights))
        return self._bare_enthalpy() - weight

    def add_growths(
        self, positions: np.ndarray, entry: np.ndarray, values: np.ndarray, blocks: np.ndarray,
        compliance: np.ndarray,
    ) -> None:  # fmt: skip
        """Add growths of cavities, their rows, and the compliance of their walls.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            entry: Entry of H of each superelement, cavity and unknown, -1 for none,
                shape (count, most cavities, 4).
            values: Growths [m³], shape (cavity_count,); added to.
            blocks: Entries of H [m²], shape (entry_count, 3); added to.
            compliance: Growth by pressure at held vertebrae [m³/Pa], shape (cavity_count, same);
                added to.
        """
        self.evaluate(positions)
        add_growths(
            self.cavities, DEFORMATIONS, self._gradient, self._curvature, self._by_unknowns,
            self._drawn, self._centre_slopes, entry, values, blocks, compliance,
        )  # fmt: skip

    def scaled_variables(self, index: int) -> np.ndarray:
        """z of a superelement at the state evaluated last; zero behind its own, shape (n,).

        Args:
            index: The superelement.
        """
        own = self.cavities[index]
        pressures = np.where(own >= 0, self.pressures[own], 0.0) if len(own) else np.empty(0)
        variables = np.concatenate([self.deformations[index], pressures])
        return self._scaling[index] @ (variables - self._middle[index])


def _places(variable_count: int, monomials: Monomials) -> list[int]:
    """Places of the monomials of the first variables among those of all."""
    narrow = Monomials(variable_count, monomials.degree).exponents
    padded = np.pad(narrow, ((0, 0), (0, monomials.variable_count - variable_count)))
    places = {tuple(row): place for place, row in enumerate(monomials.exponents.tolist())}
    return [places[tuple(row)] for row in padded.tolist()]


def _shares(fit: SuperelementFit) -> np.ndarray:
    """x_A less the shared centre, as sums of the frame nodes, shape (8,)."""
    face = np.zeros(POINTS)
    end = fit.end_points[0]
    face[:4] = 1.0 - end.sum(), *end
    return face if fit.shares is None or fit.mass == 0.0 else face - fit.shares / fit.mass


def _chord(end_a: np.ndarray, end_b: np.ndarray) -> np.ndarray:
    """x_B - x_A as a sum of the frame nodes, shape (8,)."""
    return np.concatenate([[end_a.sum() - 1.0], -end_a, [1.0 - end_b.sum()], end_b])


def _monomials_first(coefficients: np.ndarray) -> np.ndarray:
    """Coefficients of derivatives (count, ..., monomials) as (count, monomials, derivatives)."""
    count, monomials = coefficients.shape[0], coefficients.shape[-1]
    flat = coefficients.reshape(count, -1, monomials)
    return np.ascontiguousarray(np.swapaxes(flat, 1, 2))
