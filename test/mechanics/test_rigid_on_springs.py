"""Facts of a rigid body that hangs on springs: inertia, springs and weight in one step."""

import numpy as np
from scipy.linalg import eigh

from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.kinematics import CarriedPoints, on_unknowns
from softrobot_twin.mechanics.rigid_bodies import RigidFrames, RigidInertia
from softrobot_twin.mechanics.springs import Springs
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU

MASS, SIDE, STIFFNESS, LENGTH = 0.03, 0.04, 200.0, 0.1
CORNERS = 0.5 * SIDE * np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
MOMENT = MASS * SIDE**2 / 6.0


class HungCube:
    """A cube hung by its upper corners on four upright springs."""

    def __init__(self, weight):
        self.frames = frames = RigidFrames(0, [True], 0, 2)
        self.start = frames.rest_nodes([(np.zeros(3), np.eye(3))])
        self.inertia = RigidInertia(frames, [MASS], [MOMENT * np.eye(3)])
        above = CORNERS + [0.0, 0.0, LENGTH]
        springs = Springs(
            frames.points(0, CORNERS), None, STIFFNESS, LENGTH, 0.0, frames.free_index(), above
        )
        self.springs = on_unknowns(springs, CarriedPoints(2, (frames,)))
        weights = Gravity(np.array([1.0, 0.0]), [0.0, 0.0, -weight])
        self.terms = [self.inertia, self.springs, weights]
        self.matrix = SuperLU(*stencil_pairs(self.springs.stencils()), 2)
        for term in self.terms:
            term.bind(self.matrix.elimination_rank, self.matrix.slots)
        self.weight = weight

    def assembled(self, terms, x):
        forces = np.zeros((2, 3))
        self.matrix.clear()
        for term in terms:
            term.add(x, forces, self.matrix.storage, False)
        return forces, self.matrix.matrix().toarray()

    def step(self, x, v, h):
        before = x.copy()
        for term in self.terms:
            if term.remembers_start:
                term.begin_step(before, v, h)
        for _ in range(12):
            forces, A = self.assembled(self.terms, x)
            self.frames.advance(x, np.linalg.solve(A, forces.ravel()).reshape(2, 3), 1.0)
        self.frames.displacement(before, x, v)
        v /= h

    def energy(self, x, v):
        stored = self.springs.energy(x) + self.weight * x[0, 2]
        return stored + self.inertia.kinetic_energy(x, v)


def test_a_hung_cube_bounces_tilts_and_swings_at_its_natural_frequencies():
    cube = HungCube(0.0)
    cube.inertia.begin_step(cube.start, np.zeros((2, 3)), 1.0)
    _, M = cube.assembled([cube.inertia], cube.start)
    _, K = cube.assembled([cube.springs], cube.start)
    squares = np.sort(eigh(K, M, eigvals_only=True))
    # Springs without tension have no stiffness across: three motions are free.
    np.testing.assert_allclose(squares[:3], 0.0, atol=1e-7 * squares[-1])
    bounce = 4.0 * STIFFNESS / MASS
    tilt = 4.0 * STIFFNESS * (0.5 * SIDE) ** 2 / MOMENT
    np.testing.assert_allclose(squares[3:], np.sort([bounce, tilt, tilt]), rtol=1e-10)


def test_a_shaken_cube_never_gains_energy_and_comes_to_rest_at_its_equilibrium():
    cube = HungCube(0.3)
    x, v = cube.start.copy(), np.array([[0.1, 0.0, 0.2], [3.0, -2.0, 1.0]])
    energies = [cube.energy(x, v)]
    for _ in range(400):
        cube.step(x, v, 0.02)
        energies.append(cube.energy(x, v))
    energies = np.array(energies)
    assert np.all(np.diff(energies) <= 1e-12 * np.ptp(energies))
    origin, rotation = cube.frames.pose(x, 0)
    np.testing.assert_allclose(origin[2], -0.3 / (4.0 * STIFFNESS), rtol=1e-2)
    np.testing.assert_allclose(rotation[2], [0.0, 0.0, 1.0], atol=1e-3)
