"""Superelements: derivatives by finite differences, and no effect of rigid motions.

Three superelements between a fixed frame and two free ones, with random enthalpies; two of them
share a cavity, and one has no cavity.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.constraints.superelement_cavities import SuperelementCavities
from softrobot_twin.mechanics.polynomials import Monomials
from softrobot_twin.mechanics.rigid_bodies import RigidFrames
from softrobot_twin.mechanics.superelements import Superelements, SuperelementFit

SEED, DEGREE, H = 21, 4, 1e-6
ORIGINS = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.05], [0.0, -0.01, 0.1]])
PRESSURES = np.array([1500.0, -400.0])
# So large that what the weight adds is as large as the rest.
GRAVITY = (2.0e3, -1.0e3, 3.0e3)


def random_fit(rng, ends, cavities) -> SuperelementFit:
    n = 6 + len(cavities)
    points = rng.uniform(-0.02, 0.02, (2, 3))
    chord = ORIGINS[ends[1]] + points[1] - ORIGINS[ends[0]] - points[0]
    scaling = np.diag([100.0] * 3 + [4.0] * 3 + [1.0 / 3000.0] * len(cavities))
    scaling += 0.1 * rng.normal(size=(n, n)) * np.sqrt(np.outer(np.diag(scaling), np.diag(scaling)))
    scaling[:6, 6:] = scaling[6:, :6] = 0.0
    middle = np.concatenate([rng.normal(size=3) * 1e-3, rng.normal(size=3) * 0.05,
                             1000.0 * np.ones(len(cavities))])  # fmt: skip
    coefficients = rng.normal(size=Monomials(n, DEGREE).count)
    return SuperelementFit(
        np.array(ends), points, np.concatenate([chord, np.zeros(3)]), np.array(cavities, int),
        middle, scaling, coefficients, rng.normal(size=(3, Monomials(n, 2).count)) * 5e-3,
        rng.uniform(0.01, 0.03), rng.uniform(0.0, 0.004, 8),
    )  # fmt: skip


@pytest.fixture
def chain():
    """The superelements, their cavities, and frames at a random state."""
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    frames = RigidFrames(0, [False, True, True], 0, 4)
    positions = frames.rest_nodes([(origin, np.eye(3)) for origin in ORIGINS])
    rest = positions.copy()
    fits = (random_fit(rng, (0, 1), [0]), random_fit(rng, (1, 2), [1, 0]),
            random_fit(rng, (0, 2), []))  # fmt: skip
    term = Superelements(fits, DEGREE, 4 * np.arange(3), 2, np.array([-1, 0, 2]), GRAVITY)
    cavities = SuperelementCavities((term,), np.full(2, 1e-6), np.full(2, 1e-3))
    cavities.tell_efforts(PRESSURES)
    for body, turn in ((1, [0.2, -0.1, 0.15]), (2, [-0.1, 0.3, 0.05])):
        frames.place(positions, body, ORIGINS[body] + rng.normal(size=3) * 3e-3,
                     Rotation.from_rotvec(turn).as_matrix())  # fmt: skip
    return SimpleNamespace(
        frames=frames, rest=rest, x=positions, term=term, cavities=cavities, fits=fits
    )


def moved(chain, unknown: int, axis: int, by: float) -> np.ndarray:
    positions, move = chain.x.copy(), np.zeros((4, 3))
    move[unknown, axis] = 1.0
    chain.frames.advance(positions, move, by)
    return positions


def each_unknown():
    return [(unknown, axis) for unknown in range(4) for axis in range(3)]


def forces_at(term, positions) -> np.ndarray:
    forces = np.zeros((4, 3))
    term.add_forces(positions, forces)
    return forces


def test_forces_are_slopes_of_the_enthalpy(chain):
    term = chain.term
    forces = forces_at(term, chain.x)
    for unknown, axis in each_unknown():
        up, down = (chain.term.enthalpy(moved(chain, unknown, axis, s * H)) for s in (1, -1))
        slope = (up - down) / (2.0 * H)
        scale = np.abs(forces[unknown]).max()
        assert -forces[unknown, axis] == pytest.approx(slope, rel=1e-6, abs=1e-6 * scale)


def test_stiffness_is_the_slope_of_the_forces(chain):
    term = chain.term
    rank, storage = np.arange(4), np.zeros(12 * 12)
    # A dense matrix, its columns one after the other.
    term.bind(rank, lambda rows, columns: (36 * np.asarray(columns) + 3 * np.asarray(rows),
                                           np.full(np.shape(rows), 12)))  # fmt: skip
    term.add(chain.x, np.zeros((4, 3)), storage, projected=False)
    A = storage.reshape(12, 12).T
    # Lower blocks are stored; those on the diagonal are whole.
    for k in range(4):
        for j in range(k):
            A[3 * j : 3 * j + 3, 3 * k : 3 * k + 3] = A[3 * k : 3 * k + 3, 3 * j : 3 * j + 3].T
    slopes = np.zeros((12, 12))
    for index, (unknown, axis) in enumerate(each_unknown()):
        up, down = (forces_at(term, moved(chain, unknown, axis, s * H)) for s in (1, -1))
        slopes[:, index] = -(up - down).ravel() / (2.0 * H)
    # Rotations are no vector space: only the symmetric part is a second derivative.
    slopes = 0.5 * (slopes + slopes.T)
    scale = np.sqrt(np.outer(np.abs(np.diag(A)), np.abs(np.diag(A))))
    assert np.abs(A - A.T).max() <= 1e-9 * np.abs(A).max()
    assert (np.abs(A - slopes) / scale).max() < 1e-5


def rows_at(chain, positions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    cavities = chain.cavities
    blocks, values = cavities.rows_at(positions)
    dense = np.zeros((2, 4, 3))
    dense[cavities.entry_rows, cavities.entry_nodes] = blocks
    return dense, values, cavities.compliance.copy()


def test_growths_and_rows_are_slopes(chain):
    rows, growths, compliance = rows_at(chain, chain.x)
    for unknown, axis in each_unknown():
        up, down = (rows_at(chain, moved(chain, unknown, axis, s * H))[1] for s in (1, -1))
        slope = (up - down) / (2.0 * H)
        assert rows[:, unknown, axis] == pytest.approx(slope, rel=1e-6, abs=1e-8 * np.abs(rows).max())
    step = 0.1
    for cavity in range(2):
        told = []
        for sign in (1.0, -1.0):
            pressures = PRESSURES.copy()
            pressures[cavity] += sign * step
            chain.cavities.tell_efforts(pressures)
            told.append((chain.term.enthalpy(chain.x), rows_at(chain, chain.x)[1]))
        (up, grown), (down, shrunk) = told
        assert growths[cavity] == pytest.approx(-(up - down) / (2.0 * step), rel=1e-6)
        assert compliance[cavity] == pytest.approx((grown - shrunk) / (2.0 * step), rel=1e-5)


def test_forces_of_a_change_of_pressure_are_the_rows(chain):
    """What is told goes into the forces, and the rows are their slope by the pressure."""
    term, step = chain.term, 0.1
    rows, _, _ = rows_at(chain, chain.x)
    for cavity in range(2):
        found = []
        for sign in (1.0, -1.0):
            chain.cavities.tell_efforts(PRESSURES + sign * step * np.eye(2)[cavity])
            found.append(forces_at(term, chain.x))
        slope = (found[0] - found[1]) / (2.0 * step)
        assert rows[cavity] == pytest.approx(slope, rel=1e-6, abs=1e-8 * np.abs(rows).max())


def test_a_rigid_motion_of_all_stores_nothing_and_turns_the_forces(chain):
    turn = Rotation.from_rotvec([1.1, -2.0, 0.7]).as_matrix()
    carried = chain.x @ turn.T + [0.3, -5.0, 2.0]
    # Here the first frame is free too: it turns with the others.
    fits = chain.fits
    everywhere = Superelements(fits, DEGREE, 4 * np.arange(3), 2, np.array([0, 2, 4]))
    everywhere.pressures[:] = PRESSURES
    forces = np.zeros((6, 3)), np.zeros((6, 3))
    before = everywhere.enthalpy(chain.x)
    everywhere.add_forces(chain.x, forces[0])
    assert everywhere.enthalpy(carried) == pytest.approx(before, rel=1e-10)
    everywhere.add_forces(carried, forces[1])
    assert forces[1] == pytest.approx(forces[0] @ turn.T, abs=1e-9 * np.abs(forces[0]).max())
    # Forces alone: every second unknown is a rotation. Torques balance about any point.
    pushes, twists, origins = forces[0][::2], forces[0][1::2], chain.x[::4]
    assert np.abs(pushes.sum(axis=0)).max() < 1e-9 * np.abs(pushes).max()
    left = (twists + np.cross(origins, pushes)).sum(axis=0)
    assert np.abs(left).max() < 1e-9 * np.abs(twists).max()
