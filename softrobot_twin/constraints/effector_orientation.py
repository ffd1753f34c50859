"""Effectors with orientation: beside the mean of its points, the rotation of a patch or a frame.

The rotation R of a patch is the best fit of its points x_i to their places X_i at rest, the proper
rotation of Kabsch 1976, so R = 1 at rest. With arms r_i = X_i - X̄, and with the shape functions
N_in of the nodes that carry the points, the correlation is linear in the nodes:

    F = Σ_i x_i r_iᵀ = Σ_n x_n s_nᵀ,   s_n = Σ_i N_in r_i,   F = V R with V symmetric.

A motion of the nodes turns it by dθ = (tr V - V)⁻¹ Σ_n (R s_n) × dx_n. A rigid frame is a patch
whose points are the tips of its axes: V = 1, and R is the rotation of the frame.

An orientation has the unit [rad], a position [m]. The rows are in metres all the same: each angle
is multiplied by the effector's length ℓ per radian. A *full rotation* has three rows, an axis that
is to *point* along a direction has two:

    δ = τ + ℓ log(R R_dᵀ)                  about the axes of the world
    δ = τ + ℓ B log_d(R a)                 B: two directions at right angles to d

with the target's rotation R_d or direction d; log_d(v) is the vector at d along the great circle to
v, as long as the angle. The error is therefore always taken at the target: it is the shortest turn
that is left, whatever the robot and the target did before. τ adds up by how much the *target* has
turned, so that its motion is seen in the wanted coordinates, which are τ; it drops out of the error.
The rotation vector jumps where the error passes π, and so does the great circle of an axis that passes
the place where it points exactly backwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.effector import EffectorPoints, Effectors
from softrobot_twin.errors import CommandError
from softrobot_twin.geometry.matrix3 import rows, transform
from softrobot_twin.geometry.vector3 import (
    add_scaled,
    cross,
    dot,
    norm,
    row,
    scaled,
    set_row,
    subtract,
)
from softrobot_twin.kernels.compilation import KERNEL, ONCE, njit
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.rotation import (
    inverse_jacobian,
    quaternion_from_rotation,
    rotation_from_quaternion,
    turn_between,
)

# A patch's points span a plane where its second extent is at least this share of its first.
LEAST_EXTENT = 1.0e-2
# Below this share of the largest singular value, tr V - V is as good as singular.
FLAT = 1.0e-9
# Below this sine the direction from one vector to another is round-off.
NO_ANGLE = 1.0e-12
# An axis within this sine of pointing exactly backwards has rows as if it were this far from it.
BACKWARDS = 1.0e-3
# τ begins anew before it is so large that it would take digits from the error [rad].
LARGEST_TURN = 100.0
# A quaternion whose components are all smaller is no rotation.
LEAST_COMPONENT = 1.0e-3


class PatchOrientation(NamedTuple):
    """Orientation of one effector.

    Attributes:
        effector: Index of the effector.
        nodes: Nodes that carry the patch, each once, shape (n,).
        arms: s_n of each [m], shape (n, 3); of the nodes of a rigid frame, those of its tips.
        is_rigid: Whether they are the nodes of one rigid frame.
        axis: Axis that is to point, a unit vector in the world at rest, shape (3,); None for a full
            rotation.
        weight: Weight of its squared error [m²] in the inverse problem.
        length: ℓ, the displacement that counts as much as one radian [m/rad].
    """

    effector: int
    nodes: np.ndarray
    arms: np.ndarray
    is_rigid: bool
    axis: np.ndarray | None
    weight: float
    length: float

    @property
    def row_count(self) -> int:
        """Number of its rows."""
        return 3 if self.axis is None else 2


def patch_arms(points: BarycentricMapping, rest_positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and arms of a patch.

    Args:
        points: Its points.
        rest_positions: Node positions at rest [m], shape (node_count, 3).

    Returns:
        The nodes, shape (n,), and s_n [m], shape (n, 3).
    """
    places = points.positions(rest_positions)
    away = places - places.mean(axis=0)
    nodes, place = np.unique(points.nodes, return_inverse=True)
    shares = points.barycentric_weights[:, :, None] * away[:, None, :]
    arms = np.zeros((len(nodes), 3))
    np.add.at(arms, place.ravel(), shares.reshape(-1, 3))
    carrying = np.zeros(len(nodes), bool)
    np.logical_or.at(carrying, place.ravel(), points.barycentric_weights.ravel() != 0.0)
    return nodes[carrying], arms[carrying]


def frame_arms(first_node: int, rest_positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and arms of a rigid frame, whose turn from rest is then the rotation of the patch.

    Args:
        first_node: Its origin among all nodes.
        rest_positions: Node positions at rest [m], shape (node_count, 3).
    """
    nodes = first_node + np.arange(4)
    tips = rest_positions[nodes[1:]] - rest_positions[first_node]
    return nodes, np.vstack([-tips.sum(axis=0), tips])


def spans_a_plane(places: np.ndarray) -> bool:
    """Whether points are enough for an orientation: not all (nearly) on one line.

    Args:
        places: The points [m], shape (point_count, 3).
    """
    extents = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return len(extents) > 1 and bool(extents[1] > LEAST_EXTENT * extents[0] > 0.0)


@njit(**ONCE)
def fit_rotation(F, is_rigid, R, turning):
    """Write the proper rotation nearest to F, and (tr V - V)⁻¹.

    Args:
        F: Correlation of points and arms [m²], shape (3, 3); a rotation for a rigid frame.
        is_rigid: Whether it is one.
        R: Takes the rotation, shape (3, 3).
        turning: Takes the symmetric (tr V - V)⁻¹ [1/m²], shape (3, 3).
    """
    if is_rigid:
        for i in range(3):
            for j in range(3):
                R[i, j] = F[i, j]
                turning[i, j] = 0.5 if i == j else 0.0
        return
    U, s, Vt = np.linalg.svd(F)
    # A patch in a plane has no third singular value, and may be seen from either side.
    sign = 1.0 if np.linalg.det(U) * np.linalg.det(Vt) > 0.0 else -1.0
    third, least = sign * s[2], FLAT * s[0]
    first = 1.0 / max(s[1] + third, least)
    second, last = 1.0 / max(s[0] + third, least), 1.0 / max(s[0] + s[1], least)
    for i in range(3):
        for j in range(3):
            R[i, j] = U[i, 0] * Vt[0, j] + U[i, 1] * Vt[1, j] + sign * U[i, 2] * Vt[2, j]
            turning[i, j] = (
                first * U[i, 0] * U[j, 0] + second * U[i, 1] * U[j, 1] + last * U[i, 2] * U[j, 2]
            )


@njit(**KERNEL)
def write_rotations(x, nodes, arms, ends, are_rigid, rotations, turnings):
    """Rotation of every patch; nodes of a patch are contiguous. See `fit_rotation`.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes that carry the patches, patch after patch, shape (arm_count,).
        arms: s_n of each of these nodes [m], shape (arm_count, 3).
        ends: Where the nodes of each patch end in `nodes`, shape (patch_count,).
        are_rigid: Whether a rigid frame carries each patch, shape (patch_count,).
        rotations: Takes R of each patch, shape (patch_count, 3, 3).
        turnings: Takes (tr V - V)⁻¹ of each patch [1/m²], same shape.
    """
    first = 0
    for p in range(len(ends)):
        F, start = np.zeros((3, 3)), row(x, nodes[first])
        for n in range(first, ends[p]):
            # The arms of a patch add up to zero, so that any point may be the origin.
            place = subtract(row(x, nodes[n]), start)
            for i in range(3):
                for j in range(3):
                    F[i, j] += place[i] * arms[n, j]
        fit_rotation(F, are_rigid[p], rotations[p], turnings[p])
        first = ends[p]


@njit(**KERNEL)
def pointing_error(pointed, wanted, basis, error, gradients):
    """log_d of an axis in two directions, and its derivatives by a turn of the axis.

    With the angle θ, the unit vector u at d towards the axis v, and w = d × u, it is θ u. A turn
    about w changes θ as much, and one about v × w moves u along w by 1 / sin θ.

    Args:
        pointed: Where the axis points, the unit vector v.
        wanted: Where it is to point, the unit vector d.
        basis: Two unit vectors at right angles to d and to each other, shape (2, 3).
        error: Takes the two components [rad], shape (2,).
        gradients: Takes their derivatives by a rotation vector, shape (2, 3).
    """
    cosine = dot(wanted, pointed)
    across = add_scaled(pointed, wanted, -cosine)
    sine = norm(across)
    angle = np.arctan2(sine, cosine)
    # In line with d, and exactly backwards, one great circle is as good as another.
    outward = scaled(across, 1.0 / sine) if sine > NO_ANGLE else row(basis, 0)
    aside = cross(wanted, outward)
    factor = angle / max(sine, BACKWARDS) if cosine < 0.0 else angle / sine if sine > 0.0 else 1.0
    turning = scaled(cross(pointed, aside), factor)
    for k in range(2):
        direction = row(basis, k)
        error[k] = angle * dot(direction, outward)
        gradient = scaled(aside, dot(direction, outward))
        set_row(gradients, k, add_scaled(gradient, turning, dot(direction, aside)))


@njit(**KERNEL)
def write_turn_rows(
    rotations, turnings, axes, are_pointing, lengths, wanted, basis, turned, arms,
    entry_patch, entry_row, entry_arm, blocks, values,
):  # fmt: skip
    """Rows of all orientations.

    Args:
        rotations: R of each patch, shape (patch_count, 3, 3).
        turnings: (tr V - V)⁻¹ of each [1/m²], same shape.
        axes: Axis at rest that is to point, of any content for a full rotation, (patch_count, 3).
        are_pointing: Whether each has one, shape (patch_count,).
        lengths: ℓ of each [m/rad], shape (patch_count,).
        wanted: R_d of each; of an axis, its first row is d, shape (patch_count, 3, 3).
        basis: B of each, shape (patch_count, 2, 3).
        turned: τ of each [m], shape (patch_count, 3).
        arms: s_n [m], shape (n, 3).
        entry_patch: Patch of each entry, shape (entry_count,).
        entry_row: Its row, shape (entry_count,).
        entry_arm: Its arm, shape (entry_count,).
        blocks: Takes the entries, shape (entry_count, 3).
        values: Takes δ [m], shape (row_count,).
    """
    gradients, r = np.empty((len(values), 3)), 0
    error, slopes = np.empty(2), np.empty((2, 3))
    for p in range(len(lengths)):
        turning, length = rows(turnings[p]), lengths[p]
        if are_pointing[p]:
            pointed = transform(rows(rotations[p]), row(axes, p))
            pointing_error(pointed, row(wanted[p], 0), basis[p], error, slopes)
            for k in range(2):
                values[r] = turned[p, k] + length * error[k]
                set_row(gradients, r, scaled(transform(turning, row(slopes, k)), length))
                r += 1
        else:
            vector = turn_between(rows(wanted[p]), rows(rotations[p]))
            J = inverse_jacobian(vector)
            for k in range(3):
                values[r] = turned[p, k] + length * vector[k]
                set_row(gradients, r, scaled(transform(turning, J[k]), length))
                r += 1
    for e in range(len(entry_row)):
        arm = transform(rows(rotations[entry_patch[e]]), row(arms, entry_arm[e]))
        set_row(blocks, e, cross(row(gradients, entry_row[e]), arm))


class PosedEffectors(Effectors):
    """Constraint term of effectors of which at least one has an orientation.

    The rows of all positions come first, then those of the orientations. They are those at the
    target that `aim` was given last.

    Attributes:
        orientations: The orientations.
        row_lengths: ℓ of each row of an orientation [m/rad], shape (turn rows,).
    """

    def __init__(
        self, effectors: tuple[EffectorPoints, ...], orientations: tuple[PatchOrientation, ...],
        free_index: np.ndarray,
    ):  # fmt: skip
        """Lay out the rows.

        Args:
            effectors: The effectors.
            orientations: Orientations of some of them, by ascending effector, at least one.
            free_index: Free-node index of each node, -1 where fixed, shape (node_count,).
        """
        super().__init__(effectors, free_index)
        self.orientations = orientations
        self._patch_of_row = np.repeat(
            np.arange(len(orientations)), [one.row_count for one in orientations]
        )
        self._lay_out_rows()
        self._lay_out_entries(free_index)
        self._are_rigid = np.array([one.is_rigid for one in orientations])
        self._are_pointing = np.array([one.axis is not None for one in orientations])
        self._axes = np.array(
            [np.zeros(3) if one.axis is None else one.axis for one in orientations]
        )
        self._lengths = np.array([one.length for one in orientations])
        self.forget_targets()

    def _lay_out_rows(self) -> None:
        owners = np.array([one.effector for one in self.orientations], np.int64)
        self._owners, patch = owners, self._patch_of_row
        weights = np.array([one.weight for one in self.orientations])
        self.row_lengths = np.array([one.length for one in self.orientations])[patch]
        first = np.searchsorted(patch, patch)
        self.row_effector = np.concatenate([self.row_effector, owners[patch]])
        # Axes of rotations are numbered after those of positions.
        self.row_axis = np.concatenate([self.row_axis, 3 + np.arange(len(patch)) - first])
        self.row_weights = np.concatenate([self.row_weights, weights[patch]])
        self.row_count = len(self.row_effector)

    def _lay_out_entries(self, free_index: np.ndarray) -> None:
        self._patch_nodes = np.concatenate([one.nodes for one in self.orientations])
        self._arms = np.concatenate([one.arms for one in self.orientations])
        self._patch_ends = np.cumsum([len(one.nodes) for one in self.orientations])
        starts = self._patch_ends - [len(one.nodes) for one in self.orientations]
        entries = [
            (patch, row, arm)
            for row, patch in enumerate(self._patch_of_row)
            for arm in range(starts[patch], self._patch_ends[patch])
            if free_index[self._patch_nodes[arm]] >= 0
        ]
        table = np.array(entries, np.int64).reshape(-1, 3)
        self._entry_patch, self._entry_row, self._entry_arm = np.ascontiguousarray(table.T)
        self._position_entries = len(self.entry_rows)
        self.entry_rows = np.concatenate([self.entry_rows, self.position_row_count + self._entry_row])
        nodes = free_index[self._patch_nodes[self._entry_arm]]
        self.entry_nodes = np.concatenate([self.entry_nodes, nodes])

    def forget_targets(self) -> None:
        """Set all targets to the orientations at rest."""
        count = len(self.orientations)
        self._wanted = np.tile(np.eye(3), (count, 1, 1))
        self._basis, self._turned = np.zeros((count, 2, 3)), np.zeros((count, 3))
        self._is_aimed = np.zeros(count, bool)
        for patch, orientation in enumerate(self.orientations):
            if orientation.axis is not None:
                self._point(patch, orientation.axis)

    def _point(self, patch: int, direction: np.ndarray) -> None:
        """Set where an axis is to point, with any basis at right angles."""
        self._wanted[patch, 0] = direction
        start = np.eye(3)[np.abs(direction).argmin()]
        first = np.cross(direction, start)
        self._basis[patch, 0] = first / np.linalg.norm(first)
        self._basis[patch, 1] = np.cross(direction, self._basis[patch, 0])

    def rotations(self, positions: np.ndarray) -> np.ndarray:
        """Rotation of each orientation from rest, shape (orientation_count, 3, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self._fitted(positions)[0]

    def _fitted(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count = len(self.orientations)
        rotations, turnings = np.empty((count, 3, 3)), np.empty((count, 3, 3))
        write_rotations(
            positions, self._patch_nodes, self._arms, self._patch_ends, self._are_rigid,
            rotations, turnings,
        )  # fmt: skip
        return rotations, turnings

    def quaternions(self, positions: np.ndarray) -> np.ndarray:
        """Rotation of each effector from rest (x, y, z, w), shape (effector_count, 4).

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            The quaternions; a row of NaN for an effector without orientation.
        """
        found = np.full((len(self.effectors), 4), np.nan)
        for owner, rotation in zip(self._owners, self.rotations(positions), strict=True):
            found[owner] = quaternion_from_rotation(rotation)
        return found

    def aim(self, quaternions: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Set the targets of all orientations.

        Args:
            quaternions: Wanted turn of each effector from rest (x, y, z, w), of any length but
                zero, NaN where free, shape (effector_count, 4).
            positions: Node positions at the beginning of the step [m], shape (node_count, 3).

        Returns:
            The wanted value τ of each row of an orientation [m], NaN where free,
            shape (turn rows,).

        Raises:
            CommandError: A quaternion is no rotation, or is given for an effector without
                orientation.
        """
        self._refuse_misfits(quaternions)
        wanted = np.full((len(self.orientations), 3), np.nan)
        now = self.rotations(positions)
        for patch, orientation in enumerate(self.orientations):
            quaternion = quaternions[orientation.effector]
            if np.isnan(quaternion[0]):
                self._is_aimed[patch] = False
                self._begin_at(patch, now[patch])
                continue
            rotation = rotation_from_quaternion(quaternion)
            if self._is_aimed[patch]:
                self._turn_to(patch, rotation)
            else:
                self._begin_at(patch, rotation)
            self._is_aimed[patch] = True
            wanted[patch] = self._turned[patch]
        kinds = self.row_axis[self.position_row_count :] - 3
        return wanted[self._patch_of_row, kinds]

    def _refuse_misfits(self, quaternions: np.ndarray) -> None:
        for effector, quaternion in enumerate(quaternions):
            missing = np.isnan(quaternion)
            if missing.all():
                continue
            name = self.effectors[effector].name
            if effector not in self._owners:
                raise CommandError("orientations", f"{name} asks for no orientation")
            if missing.any() or np.abs(quaternion).max() < LEAST_COMPONENT:
                raise CommandError("orientations", f"of {name}: {quaternion.tolist()} is no rotation")

    def _begin_at(self, patch: int, rotation: np.ndarray) -> None:
        """Set a target that is no motion of the last one."""
        self._turned[patch] = 0.0
        axis = self.orientations[patch].axis
        if axis is None:
            self._wanted[patch] = rotation
        else:
            self._point(patch, _unit(rotation @ axis))

    def _turn_to(self, patch: int, rotation: np.ndarray) -> None:
        """Turn a target, and add up by how much."""
        axis, length = self.orientations[patch].axis, self._lengths[patch]
        before = self._wanted[patch]
        if axis is None:
            vector = np.array(turn_between(_rows(before), _rows(rotation)))
            self._turned[patch] += length * vector
            self._wanted[patch] = rotation
        else:
            old, new = before[0].copy(), _unit(rotation @ axis)
            error, unused = np.empty(2), np.empty((2, 3))
            pointing_error(tuple(new), tuple(old), self._basis[patch], error, unused)
            self._turned[patch, :2] += length * error
            self._carry_basis(patch, old, new)
        if np.abs(self._turned[patch]).max() > LARGEST_TURN * length:
            self._turned[patch] = 0.0

    def _carry_basis(self, patch: int, old: np.ndarray, new: np.ndarray) -> None:
        """Carry B along the great circle from one direction to another."""
        turn = 1.0 + old @ new
        if turn < BACKWARDS**2:
            self._point(patch, new)
            return
        for direction in self._basis[patch]:
            direction -= (direction @ new) / turn * (old + new)
        # Many small turns must not add up to a basis that is none.
        first = _unit(self._basis[patch, 0] - (self._basis[patch, 0] @ new) * new)
        self._basis[patch] = first, np.cross(new, first)
        self._wanted[patch, 0] = new

    def angles(self, positions: np.ndarray) -> np.ndarray:
        """Angle of each effector from its target [rad], shape (effector_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            The angles, over what the orientation asks for; NaN without a target.
        """
        found = np.full(len(self.effectors), np.nan)
        for patch, rotation in enumerate(self.rotations(positions)):
            if self._is_aimed[patch]:
                orientation = self.orientations[patch]
                found[orientation.effector] = _angle(orientation.axis, rotation, self._wanted[patch])
        return found

    def angles_to(self, quaternions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Angle of rotations from some targets [rad], shape (effector_count,); NaN without one.

        Args:
            quaternions: Wanted turns from rest (x, y, z, w), NaN where free,
                shape (effector_count, 4).
            rotations: Rotations from rest; see `rotations`.
        """
        found = np.full(len(self.effectors), np.nan)
        for orientation, rotation in zip(self.orientations, rotations, strict=True):
            quaternion, axis = quaternions[orientation.effector], orientation.axis
            if np.isfinite(quaternion).all():
                wanted = rotation_from_quaternion(quaternion)
                wanted = wanted if axis is None else (wanted @ axis)[None, :]
                found[orientation.effector] = _angle(axis, rotation, wanted)
        return found

    def misses(self, errors: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Errors of positions and orientations together [m], shape (effector_count,).

        Args:
            errors: Distances from the targets [m], NaN without one, shape (effector_count,).
            angles: Angles from them [rad], NaN without one, same shape.
        """
        lengths = np.zeros(len(errors))
        lengths[self._owners] = self._lengths
        both = np.hypot(np.nan_to_num(errors), lengths * np.nan_to_num(angles))
        return np.where(np.isnan(errors) & np.isnan(angles), np.nan, both)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H, the controlled coordinates [m], and those of the orientations [m]."""
        entries, count = self._position_entries, self.position_row_count
        super().evaluate(positions, blocks[:entries], values[:count])
        rotations, turnings = self._fitted(positions)
        write_turn_rows(
            rotations, turnings, self._axes, self._are_pointing, self._lengths, self._wanted,
            self._basis, self._turned, self._arms, self._entry_patch, self._entry_row,
            self._entry_arm, blocks[entries:], values[count:],
        )  # fmt: skip


def _angle(axis: np.ndarray | None, rotation: np.ndarray, wanted: np.ndarray) -> float:
    """Angle between two rotations, or between where an axis points and its direction [rad]."""
    if axis is None:
        return float(norm(turn_between(_rows(wanted), _rows(rotation))))
    pointed, direction = rotation @ axis, wanted[0]
    return float(np.arctan2(np.linalg.norm(np.cross(direction, pointed)), direction @ pointed))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _rows(matrix: np.ndarray) -> tuple:
    """A 3×3 array as a matrix of `matrix3`."""
    return tuple(map(tuple, matrix.tolist()))
