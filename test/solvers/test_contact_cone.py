"""Facts of one contact alone."""

import numpy as np
import pytest

from softrobot_twin.solvers.contact_cone import CONTACT_SIZE, measure_contact, solve_contact


def local_problem(seed, spread):
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    W = axes @ np.diag(spread ** np.linspace(0.0, 1.0, 3)) @ axes.T
    local = np.zeros(CONTACT_SIZE)
    measure_contact(W, 0, local)
    return W, local, rng


@pytest.mark.parametrize("friction", [1e-6, 0.1, 0.7, 10.0])
@pytest.mark.parametrize("spread", [1.0, 10.0, 1e4])
@pytest.mark.parametrize("seed", range(15))
def test_a_contact_obeys_signorini_and_coulomb_to_round_off(seed, spread, friction):
    W, local, rng = local_problem(seed, spread)
    q = rng.standard_normal(3)
    force = np.array(solve_contact(local, friction, *q))
    motion = W @ force + q
    size = np.abs(W).max() * np.abs(force).max() + np.abs(q).max()
    assert force[0] >= 0.0
    if q[0] >= 0.0:
        assert np.all(force == 0.0)
        return
    assert abs(motion[0]) < 1e-11 * size
    pull, limit = np.hypot(force[1], force[2]), friction * force[0]
    assert pull <= limit * (1.0 + 1e-12)
    if pull < limit * (1.0 - 1e-9):
        assert np.abs(motion[1:]).max() < 1e-11 * size
    else:
        # Along -force: nothing across, and not the other way.
        assert abs(force[1] * motion[2] - force[2] * motion[1]) < 1e-10 * size * pull
        assert force[1] * motion[1] + force[2] * motion[2] <= 1e-10 * size * pull


def test_an_open_contact_has_no_force():
    _, local, _ = local_problem(0, 2.0)
    assert solve_contact(local, 0.5, 1e-3, 1.0, 1.0) == (0.0, 0.0, 0.0)


def test_without_friction_only_the_normal_pushes():
    W, local, _ = local_problem(1, 2.0)
    assert solve_contact(local, 0.0, -1.0, 3.0, 1.0) == (1.0 / W[0, 0], 0.0, 0.0)
