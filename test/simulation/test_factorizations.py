"""A factorization that is defined here, outside the package: a dense Cholesky."""

from typing import get_args

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve

from softrobot_twin.scene.schema import Solver
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation
from softrobot_twin.solvers import FACTORIZATIONS
from softrobot_twin.solvers.factorization import Condensed
from test.scene_changes import repeat_step

pytestmark = pytest.mark.libraries


class DenseCholesky:
    """See `Factorization`; A is stored whole, column by column."""

    name = "dense Cholesky"

    def __init__(self, rows, columns, node_count):
        self.size = 3 * node_count
        self.elimination_rank = np.arange(node_count)
        self.storage = np.zeros(self.size**2)

    def slots(self, rows, columns):
        offsets = 3 * (self.size * np.asarray(columns) + np.asarray(rows))
        return offsets, np.full(offsets.shape, self.size)

    def prepare_rows(self, node_index, row_count):
        """Nothing to prepare."""

    def clear(self):
        self.storage[:] = 0.0

    def factor(self):
        try:
            self.L = cho_factor(self.storage.reshape(self.size, self.size).T, lower=True)
        except np.linalg.LinAlgError:
            return False
        return True

    def condense(self, H, b):
        self.Ht, self.b = H.transposed(self.size // 3), b.ravel()
        solved = cho_solve(self.L, np.column_stack([self.Ht, self.b]))
        return Condensed(self.Ht.T @ solved[:, :-1], self.Ht.T @ solved[:, -1])

    def condense_low_rank(self, H, b):
        return None

    def expand(self, multipliers):
        return self.solve(self.b + self.Ht @ multipliers)

    def solve(self, b):
        return cho_solve(self.L, b.ravel()).reshape(-1, 3)


@pytest.fixture(params=["targets", "setpoints", "contact"])
def steps(request, beam, rod):
    """Makes the beam, runs some steps, and returns the last result."""
    setpoints = request.param != "targets"

    def run(**factorization):
        scene = beam((lambda mapping: rod(mapping, x=0.025)) if request.param == "contact" else None).scene
        simulation = Simulation(scene, **factorization)
        target = simulation.effector_positions() + [0.004, 0.002, -0.001]
        wound = simulation.rest_setpoints - [0.004, 0.0, 0.0, 0.0]
        command = CommandSetpoints(wound, 0.1) if setpoints else FollowTargets(target, 0.1)
        return repeat_step(simulation, command, 5)

    return run


def test_a_factorization_from_outside_gives_the_same_steps(steps):
    result = steps(factorization_type=DenseCholesky)
    expected = steps()
    assert not result.status.is_failure
    np.testing.assert_allclose(result.state.positions, expected.state.positions, atol=1e-9)
    np.testing.assert_allclose(result.efforts, expected.efforts, rtol=1e-6, atol=1e-6)


def test_one_line_gives_it_a_name(beam, monkeypatch):
    monkeypatch.setitem(FACTORIZATIONS, "superlu", DenseCholesky)
    simulation = beam(lambda mapping: mapping["solver"].update(factorization="superlu"))
    assert simulation.model.factorization.name == "dense Cholesky"
    known = get_args(Solver.model_fields["factorization"].annotation)
    assert known == tuple(FACTORIZATIONS)
