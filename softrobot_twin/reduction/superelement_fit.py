"""Makes superelements: solves a soft part between its vertebrae at many poses, and fits Π to it.

A soft part is solved by itself, with all its elements and the walls of its cavities: A is held, B is
placed as deformations e ask for, cavities have pressures p, and Newton's method finds the inner
nodes. At each of these samples the enthalpy Π, its slopes by e (from the forces on B) and its
slopes by p (the volumes) are known. The coefficients of Π follow by linear least squares on all of
them at once. In scaled variables z all slopes are energies, so that the equations have one unit.
Slopes are the more numerous equations: a sample gives one energy, but as many slopes as variables.

Samples are Sobol points in a box whose axes are the principal ones of the deformations that occur
when the robot moves: a soft direction has a long edge, a stiff one a short edge. On the way from
rest to a sample the states in between are samples too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.constraints.cavity import Cavities
from softrobot_twin.harness.sampled_axes import shifted_sobol
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.polynomials import Monomials
from softrobot_twin.mechanics.superelements import (
    CENTRE_DEGREE,
    DEFORMATIONS,
    SuperelementFit,
)
from softrobot_twin.simulation.build import bound_factorization
from softrobot_twin.simulation.building.cavity_walls import joined_walls
from softrobot_twin.simulation.building.deformable_body import strained_terms
from softrobot_twin.simulation.building.vertebrae import Division, SoftPart
from softrobot_twin.solvers.multifrontal import Multifrontal

# Steps from rest to a sample; each is a sample itself.
STAGES = (0.35, 0.7, 1.0)
# Newton's method: most iterations, most halvings of a move, and the residual at which it has
# converged, as a share of the largest force on a node.
MOST_ITERATIONS, MOST_HALVINGS, TOLERANCE = 25, 6, 1.0e-9
# Samples whose equations outnumber the coefficients of Π so often.
OVERSAMPLING = 8.0
# The sampled range beyond what occurred; least range of an axis by that of the largest.
MARGIN, LEAST_RANGE = 1.25, 0.15


def axial(matrix: np.ndarray) -> np.ndarray:
    """Axial vector of the antisymmetric part of a matrix.

    Args:
        matrix: The matrix, shape (3, 3).
    """
    half = 0.5 * (matrix - matrix.T)
    return np.array([half[2, 1], half[0, 2], half[1, 0]])


def rotation_of(bend: np.ndarray) -> np.ndarray:
    """Rotation whose antisymmetric part has the axial vector ω, below 90°.

    Args:
        bend: ω, the sine of the angle along the axis, shape (3,).
    """
    sine = float(np.linalg.norm(bend))
    angle = np.arcsin(min(sine, 1.0))
    return Rotation.from_rotvec(angle / sine * bend if sine else bend).as_matrix()


def deformations_between(turn: np.ndarray, chord: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """e of a part whose end B is turned and displaced against A; see `mechanics.superelements`.

    Args:
        turn: R_AᵀR_B, shape (3, 3).
        chord: x_B - x_A in the axes of A [m], shape (3,).
        rest: The chord at rest [m], shape (3,).
    """
    return np.concatenate([0.5 * (chord + turn.T @ chord) - rest, axial(turn)])


class Sample(NamedTuple):
    """An equilibrium of a soft part.

    Attributes:
        variables: e and p [m], [1], [Pa], shape (n,).
        enthalpy: Π [J].
        slopes: ∂Π/∂(e, p), shape (n,).
        centre: Centre of mass of the inner nodes, from the middle of the face on A [m], shape (3,).
    """

    variables: np.ndarray
    enthalpy: float
    slopes: np.ndarray
    centre: np.ndarray


class SoftPartModel:
    """A soft part with all its nodes, between A, which is held, and B, which is placed.

    Attributes:
        rest: Chord between its ends at rest [m], shape (3,).
        rest_volumes: Volumes of its cavities at rest [m³].
        rest_areas: Areas of their walls at rest [m²].
        masses: Of the inner nodes [kg], shape (inner_count,).
    """

    def __init__(self, division: Division, part: SoftPart):
        """Build elements, walls and a factorization.

        Args:
            division: The body, divided.
            part: One of its soft parts.
        """
        self._division, self._part = division, part
        positions = division.positions
        self._b_nodes = division.nodes[part.ends[1]]
        self.rest = part.end_points[1] - part.end_points[0]
        inner = np.full(len(positions), -1)
        inner[part.inner] = np.arange(len(part.inner))
        every = np.arange(len(positions))
        self._terms, self._cavities = self._build(inner)
        self._free_terms, self._free_cavities = self._build(every)
        for term in self._free_terms:
            # Of all nodes only the forces are asked for, which need no places of stiffness.
            term.bind(every, lambda rows, columns: (np.zeros_like(rows), np.zeros_like(columns)))
        walls = [] if self._cavities is None else [self._cavities]
        self._factorization = bound_factorization(Multifrontal, [*self._terms, *walls], len(part.inner))
        self.masses = division.body.node_masses()[part.inner]
        cavities, none = self._cavities, np.empty(0)
        self.rest_volumes = none if cavities is None else cavities.rest_volumes
        self.rest_areas = none if cavities is None else cavities.rest_areas

    def _build(self, index: np.ndarray) -> tuple[list[ForceTerm], Cavities | None]:
        """Force terms and cavities for some numbering of unknowns."""
        division, part, body = self._division, self._part, self._division.body
        mesh, terms = body.mesh.renumbered(division.positions, 0), []
        for material in body.materials:
            cells = np.intersect1d(part.cells, material.cells_in(mesh))
            if len(cells):
                terms += strained_terms(mesh, material, cells, index, body.entry.has_patches)
        if not part.cavities:
            return terms, None
        walls = [division.walls[w] for w in part.walls]
        surfaces = [joined_walls([wall for wall in walls if wall.name == name], name)
                    for name in (division.cavities[c] for c in part.cavities)]
        return terms, Cavities(tuple(surfaces), index, division.positions)

    @property
    def variable_count(self) -> int:
        """Number of deformations and pressures."""
        return DEFORMATIONS + len(self._part.cavities)

    def _place(self, positions: np.ndarray, deformations: np.ndarray) -> np.ndarray:
        """Place B; gives its rotation."""
        turn = rotation_of(deformations[3:DEFORMATIONS])
        chord = 2.0 * np.linalg.solve(np.eye(3) + turn.T, deformations[:3] + self.rest)
        at_rest = self._division.positions[self._b_nodes] - self._part.end_points[1]
        positions[self._b_nodes] = self._part.end_points[0] + chord + at_rest @ turn.T
        return turn

    def sample_towards(self, variables: np.ndarray) -> list[Sample]:
        """Equilibria on the way from rest to deformations and pressures, as far as they exist.

        Args:
            variables: e and p of the last one, shape (n,).
        """
        positions, before, samples = self._division.positions.copy(), None, []
        inner = self._part.inner
        for index, stage in enumerate(STAGES):
            wanted = stage * variables
            begin = positions[inner].copy()
            if before is not None:
                reach = (stage - STAGES[index - 1]) / (STAGES[index - 1] - before[0])
                positions[inner] += reach * (begin - before[1])
            turn = self._place(positions, wanted)
            if not self._solve(positions, wanted[DEFORMATIONS:]):
                positions[inner] = begin
                if not self._solve(positions, wanted[DEFORMATIONS:]):
                    break
            before = (0.0 if index == 0 else STAGES[index - 1]), begin
            samples.append(self._sample(positions, wanted, turn))
        return samples

    def _solve(self, positions: np.ndarray, pressures: np.ndarray) -> bool:
        """Newton's method for the inner nodes; False where it finds no equilibrium."""
        forces, load = self._inner_forces(positions, pressures)
        norm = np.linalg.norm(forces)
        for _ in range(MOST_ITERATIONS):
            if norm <= TOLERANCE * load:
                return self._inverted == 0
            if not self._factor(positions, pressures):
                return False
            move = self._factorization.solve(forces).copy()
            share, start = 1.0, positions[self._part.inner].copy()
            for _ in range(MOST_HALVINGS):
                positions[self._part.inner] = start + share * move
                forces, load = self._inner_forces(positions, pressures)
                tried = np.linalg.norm(forces)
                if self._inverted == 0 and (tried < norm or tried <= TOLERANCE * load):
                    break
                share *= 0.5
            else:
                return False
            norm = tried
        return False

    def _inner_forces(self, positions, pressures) -> tuple[np.ndarray, float]:
        """Forces on the inner nodes [N], and the sum of their parts as their scale."""
        forces = np.zeros((len(self._part.inner), 3))
        self._inverted = sum(term.add_forces(positions, forces) for term in self._terms)
        load = np.linalg.norm(forces)
        if self._cavities is not None:
            pushed = self._pushed(self._cavities, positions, pressures, len(forces))
            load = max(load, np.linalg.norm(pushed))
            forces += pushed
        moduli = [material.young_modulus for material in self._division.body.materials]
        # At least the force that strains the part by about one, times a small strain.
        return forces, max(float(load), 1.0e-3 * min(moduli) * float(self.rest @ self.rest))

    @staticmethod
    def _pushed(cavities: Cavities, positions, pressures, count: int) -> np.ndarray:
        """Forces of the pressures on the unknowns [N]."""
        blocks, _ = cavities.rows_at(positions)
        forces = np.zeros((count, 3))
        np.add.at(forces, cavities.entry_nodes, blocks * pressures[cavities.entry_rows, None])
        return forces

    def _factor(self, positions, pressures) -> bool:
        for projected in (False, True):
            self._factorization.clear()
            storage, unused = self._factorization.storage, np.zeros((len(self._part.inner), 3))
            for term in self._terms:
                term.add(positions, unused, storage, projected)
            if self._cavities is not None:
                self._cavities.add_stiffness(positions, pressures, storage, projected)
            if self._factorization.factor():
                return True
        return False

    def _sample(self, positions: np.ndarray, variables: np.ndarray, turn: np.ndarray) -> Sample:
        """Π and its slopes at an equilibrium."""
        pressures, growths = variables[DEFORMATIONS:], np.empty(0)
        forces = np.zeros_like(positions)
        for term in self._free_terms:
            term.add_forces(positions, forces)
        enthalpy = sum(term.energy(positions) for term in self._terms)
        if self._free_cavities is not None:
            growths = self._cavities.volumes(positions) - self.rest_volumes
            forces += self._pushed(self._free_cavities, positions, pressures, len(positions))
            enthalpy -= float(pressures @ growths)
        chord = 2.0 * np.linalg.solve(np.eye(3) + turn.T, variables[:3] + self.rest)
        own = forces[self._b_nodes]
        arms = positions[self._b_nodes] - (self._part.end_points[0] + chord)
        wrench = np.concatenate([own.sum(axis=0), np.cross(arms, own).sum(axis=0)])
        slopes = np.linalg.solve(_pose_slopes(turn, chord).T, -wrench)
        return Sample(variables, enthalpy, np.concatenate([slopes, -growths]), self._centre(positions))

    def _centre(self, positions: np.ndarray) -> np.ndarray:
        """Centre of mass of the inner nodes, from the middle of the face on A [m], shape (3,)."""
        own = positions[self._part.inner]
        return self.masses @ own / self.masses.sum() - self._part.end_points[0]

    def at_rest(self) -> Sample:
        """The state without deformation and pressure."""
        still = np.zeros(self.variable_count)
        return Sample(still, 0.0, still, self._centre(self._division.positions))


def _pose_slopes(turn: np.ndarray, chord: np.ndarray) -> np.ndarray:
    """∂e by the displacement of B and by a small rotation on top of its own, shape (6, 6)."""
    slopes = np.zeros((6, 6))
    slopes[:3, :3] = 0.5 * (np.eye(3) + turn.T)
    for k, axis in enumerate(np.eye(3)):
        turned = np.cross(axis, turn.T).T
        slopes[:3, 3 + k] = 0.5 * turned.T @ chord
        slopes[3:, 3 + k] = axial(turned)
    return slopes


class SampledRange(NamedTuple):
    """The box in which a superelement is sampled: |z_k| ≤ 1.

    Attributes:
        middle: e and p in its middle, shape (n,).
        scaling: z = scaling · (variables - middle), shape (n, n).
    """

    middle: np.ndarray
    scaling: np.ndarray

    def scaled(self, variables: np.ndarray) -> np.ndarray:
        """z of deformations and pressures, shape (count, n).

        Args:
            variables: Deformations and pressures, shape (count, n) or (n,).
        """
        return (np.atleast_2d(variables) - self.middle) @ self.scaling.T

    def variables(self, z: np.ndarray) -> np.ndarray:
        """Deformations and pressures of z, shape (count, n).

        Args:
            z: Scaled ones, shape (count, n) or (n,).
        """
        return np.linalg.solve(self.scaling, np.atleast_2d(z).T).T + self.middle


def range_of(deformations: np.ndarray, pressure_bounds: np.ndarray, length: float) -> SampledRange:
    """The box around the deformations that occur.

    Args:
        deformations: e that occur [m] and [1], shape (state_count, 6).
        pressure_bounds: Least and greatest pressure of each cavity [Pa], shape (cavity_count, 2).
        length: Length of the part, to which displacements are compared [m].
    """
    units = np.array([1.0 / length] * 3 + [1.0] * 3)
    occurring = np.vstack([np.zeros(DEFORMATIONS), deformations]) * units
    mean = occurring.mean(axis=0)
    _, _, axes = np.linalg.svd(occurring - mean, full_matrices=True)
    along = occurring @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    half = 0.5 * MARGIN * (high - low)
    half = np.maximum(half, LEAST_RANGE * half.max())
    middle = axes.T @ (0.5 * (low + high)) / units
    scaling = (axes * units) / half[:, None]
    count = len(pressure_bounds)
    n = DEFORMATIONS + count
    whole, centre = np.zeros((n, n)), np.zeros(n)
    whole[:DEFORMATIONS, :DEFORMATIONS], centre[:DEFORMATIONS] = scaling, middle
    if count:
        centre[DEFORMATIONS:] = pressure_bounds.mean(axis=1)
        spans = 0.5 * np.ptp(pressure_bounds, axis=1)
        whole[range(DEFORMATIONS, n), range(DEFORMATIONS, n)] = 1.0 / spans
    return SampledRange(centre, whole)


def sample_count(variable_count: int, degree: int) -> int:
    """Number of samples, apart from those on the way to them.

    Args:
        variable_count: Number of deformations and pressures.
        degree: Degree of the polynomial of the energy.
    """
    coefficients = Monomials(variable_count, degree).count
    return int(np.ceil(OVERSAMPLING * coefficients / (1 + variable_count)))


class FittedPart(NamedTuple):
    """A superelement and how it was made.

    Attributes:
        fit: Π; end points in mesh coordinates.
        shares: Residual of ∂Π of each sample by what is usual, both scaled to energies, shape (sample_count,).
        lost: Samples for which no equilibrium was found.
    """

    fit: SuperelementFit
    shares: np.ndarray
    lost: int


def sample(model: SoftPartModel, within: SampledRange, count: int, seed: int):
    """Solve a soft part at Sobol points of a box.

    Args:
        model: The soft part.
        within: The box.
        count: Number of points.
        seed: Of the shift of Sobol's sequence.

    Returns:
        The samples, and the number of points that were not reached.
    """
    points = shifted_sobol(model.variable_count, count, seed)
    samples, lost = [model.at_rest()], 0
    for variables in within.variables(2.0 * points - 1.0):
        found = model.sample_towards(variables)
        lost += len(found) < len(STAGES)
        samples += found
    return samples, lost


def fit_enthalpy(
    model: SoftPartModel, part: SoftPart, within: SampledRange, samples: list[Sample], degree: int,
    lost: int = 0,
) -> FittedPart:  # fmt: skip
    """Fit Π to samples by linear least squares on energies, forces and volumes.

    Args:
        model: The soft part.
        part: The same, as part of a division.
        within: The box of z.
        samples: The samples.
        degree: Total degree of Π.
        lost: Samples that could not be solved.
    """
    monomials = Monomials(model.variable_count, degree)
    z = within.scaled(np.array([s.variables for s in samples]))
    values, slopes = monomials.values(z), monomials.slopes(z)
    # By z all slopes are energies.
    wanted = np.linalg.solve(within.scaling.T, np.array([s.slopes for s in samples]).T).T
    enthalpies = np.array([s.enthalpy for s in samples])
    equations = np.vstack([values, slopes.reshape(-1, monomials.count)])
    found, *_ = np.linalg.lstsq(equations, np.concatenate([enthalpies, wanted.ravel()]))
    residuals = slopes @ found - wanted
    low = monomials.count_up_to(CENTRE_DEGREE)
    centres, *_ = np.linalg.lstsq(values[:, :low], np.array([s.centre for s in samples]))
    usual = np.sqrt((wanted**2).sum(axis=1).mean())
    rest = np.concatenate([model.rest, np.zeros(3)])
    fit = SuperelementFit(
        np.array(part.ends), part.end_points, rest, np.array(part.cavities, np.int64),
        within.middle, within.scaling, found, centres.T, float(model.masses.sum()),
    )  # fmt: skip
    return FittedPart(fit, np.linalg.norm(residuals, axis=1) / usual, lost)
