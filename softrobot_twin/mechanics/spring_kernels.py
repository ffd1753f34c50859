"""Forces and stiffness of springs between points of soft and rigid bodies.

A spring's vector is r = Σ c_a x_a + r_0. By an unknown it changes as B = c 1 - [ρ]×: at a node, or
at a rigid body's translation, c is its share and ρ is zero; at a rigid body's rotation c is zero
and ρ = Σ c_a (x_a - x_origin), which turns with the body. With the energy's gradient f = T d by r
and its second derivative K, the force at an unknown is -Bᵀ f and the stiffness of two is BᵀKB.
The turning of ρ adds ½ (f ρᵀ + ρ fᵀ) - f·ρ 1 at a rotation, in the symmetric part.
"""

from __future__ import annotations

from numba import njit

from softrobot_twin.mechanics.stretch import NO_LENGTH, stretch_vector

# A slack spring is not stiff across, and a net or chain of them nowhere: the projected stiffness
# takes this share of the stiffness along, so that there is a way to where they are taut.
LEAST_ACROSS = 1.0e-3


@njit(cache=True, nogil=True, error_model="numpy")
def spring_law(length, stiffness, rest_length, drag, length_before):
    """T/L, ∂T/∂L and the stiffness across, which is T/L; a spring of no length is isotropic."""
    along = stiffness + drag
    if length > NO_LENGTH:
        tension = stiffness * (length - rest_length) + drag * (length - length_before)
        return tension / length, along, tension / length
    return (stiffness if rest_length == 0.0 else 0.0), along, along


@njit(cache=True, nogil=True, error_model="numpy")
def write_lengths(x, nodes, coefficients, constants, lengths):
    """Length of every spring."""
    for s in range(len(nodes)):
        _, _, _, lengths[s] = stretch_vector(x, nodes[s], coefficients[s], constants[s])


@njit(cache=True, nogil=True, error_model="numpy")
def write_lever(x, origin, local, out):
    """ρ of a rotation, from its coordinates in the body's frame; zero where there is none."""
    for i in range(3):
        out[i] = 0.0
        if origin >= 0:
            for a in range(3):
                out[i] += local[a] * (x[origin + 1 + a, i] - x[origin, i])


@njit(cache=True, nogil=True, error_model="numpy")
def turned_back(c, p, y0, y1, y2):
    """Bᵀ y = c y + ρ × y; B y is the same with -ρ."""
    return (
        c * y0 + p[1] * y2 - p[2] * y1,
        c * y1 + p[2] * y0 - p[0] * y2,
        c * y2 + p[0] * y1 - p[1] * y0,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def add_spring_forces(
    x, nodes, coefficients, constants, laws, lengths_before, unknowns, shares, levers, origins,
    lever, forces,
):  # fmt: skip
    """Add -Bᵀ f of every spring; `laws` holds stiffness, rest length and damping per step."""
    for s in range(len(nodes)):
        r0, r1, r2, length = stretch_vector(x, nodes[s], coefficients[s], constants[s])
        pull, _, _ = spring_law(length, laws[s, 0], laws[s, 1], laws[s, 2], lengths_before[s])
        for u in range(unknowns.shape[1]):
            unknown = unknowns[s, u]
            if unknown < 0:
                continue
            write_lever(x, origins[s, u], levers[s, u], lever)
            f0, f1, f2 = turned_back(shares[s, u], lever, pull * r0, pull * r1, pull * r2)
            forces[unknown, 0] -= f0
            forces[unknown, 1] -= f1
            forces[unknown, 2] -= f2


@njit(cache=True, nogil=True, error_model="numpy")
def add_turning(pull, r, p, o, stride, storage):
    """Add ½ (f ρᵀ + ρ fᵀ) - f·ρ 1, f = T/L r, to a rotation's diagonal block."""
    dot = r[0] * p[0] + r[1] * p[1] + r[2] * p[2]
    for j in range(3):
        for i in range(3):
            storage[o + i] += 0.5 * pull * (r[i] * p[j] + p[i] * r[j])
        storage[o + j] -= pull * dot
        o += stride


@njit(cache=True, nogil=True, error_model="numpy")
def add_plain_block(share, along, across, d, o, stride, storage):
    """The same as `add_block` of two translations, whose shares are multiplied: far less work."""
    for j in range(3):
        bend = share * (along - across) * d[j]
        for i in range(3):
            storage[o + i] += bend * d[i]
        storage[o + j] += share * across
        o += stride


@njit(cache=True, nogil=True, error_model="numpy")
def add_block(shares, levers, a, b, along, across, d, o, stride, storage):
    """Add B_aᵀ (across 1 + (along - across) d dᵀ) B_b of one pair of unknowns."""
    for j in range(3):
        e0, e1, e2 = 1.0 * (j == 0), 1.0 * (j == 1), 1.0 * (j == 2)
        # B e = c e - ρ × e, from its transpose's form.
        z0, z1, z2 = turned_back(-shares[b], levers[b], e0, e1, e2)
        z0, z1, z2 = -z0, -z1, -z2
        bend = (along - across) * (d[0] * z0 + d[1] * z1 + d[2] * z2)
        k0, k1, k2 = turned_back(
            shares[a], levers[a],
            across * z0 + bend * d[0], across * z1 + bend * d[1], across * z2 + bend * d[2],
        )  # fmt: skip
        storage[o] += k0
        storage[o + 1] += k1
        storage[o + 2] += k2
        o += stride


@njit(cache=True, nogil=True, error_model="numpy")
def add_spring_stiffness(
    x, nodes, coefficients, constants, laws, lengths_before, shares, levers, origins, projected,
    offsets, strides, work, storage,
):  # fmt: skip
    """Add BᵀKB of every spring; where projected, without what makes it indefinite or null."""
    width = shares.shape[1]
    for s in range(len(nodes)):
        r = stretch_vector(x, nodes[s], coefficients[s], constants[s])
        length = r[3]
        pull, along, across = spring_law(
            length, laws[s, 0], laws[s, 1], laws[s, 2], lengths_before[s]
        )
        if projected:
            across = max(across, LEAST_ACROSS * along)
        scale = 1.0 / length if length > NO_LENGTH else 0.0
        d = (r[0] * scale, r[1] * scale, r[2] * scale)
        for u in range(width):
            write_lever(x, origins[s, u], levers[s, u], work[u])
        pair = 0
        for b in range(width):
            for a in range(b, width):
                o = offsets[s, pair]
                stride = strides[s, pair]
                if o >= 0 and origins[s, a] < 0 and origins[s, b] < 0:
                    share = shares[s, a] * shares[s, b]
                    add_plain_block(share, along, across, d, o, stride, storage)
                elif o >= 0:
                    add_block(shares[s], work, a, b, along, across, d, o, stride, storage)
                    if a == b and not projected:
                        add_turning(pull, r, work[a], o, stride, storage)
                pair += 1
