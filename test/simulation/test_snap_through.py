"""Row 24: a shallow arch snaps through; dynamics passes through, statics follows or reports it."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.simulation import CommandEfforts, Hold, Status
from test.builder import builder

SPAN, RISE, STIFFNESS, LEGS = 0.1, 0.02, 200.0, 4


def carried(height):
    """Load of a spring truss with its top at a height [N]."""
    rest = np.hypot(SPAN, RISE)
    return LEGS * STIFFNESS * (rest / np.hypot(SPAN, height) - 1.0) * height


def limit():
    """Height [m] and load [N] at the limit point."""
    top = minimize_scalar(lambda z: -carried(z), bounds=(0.0, RISE), options={"xatol": 1e-12})
    return top.x, carried(top.x)


@builder
def tent(simulate, /, share_of_limit, integration, damping=20.0):
    """Makes a mass on a shallow tent of four springs."""
    feet = [[SPAN, 0, 0], [-SPAN, 0, 0], [0, SPAN, 0], [0, -SPAN, 0]]
    return simulate(
        mass_springs=[{
            "name": "tent", "points": [[0, 0, RISE], *feet],
            "masses": [share_of_limit * limit()[1] / 9.81], "stiffness": STIFFNESS,
            "damping": damping, "springs": [[0, k] for k in range(1, 5)], "fixed": [1, 2, 3, 4],
        }],
        integration=integration,
    )  # fmt: skip


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
@pytest.mark.parametrize("share", [0.95, 1.05])
def test_a_spring_truss_snaps_through_at_its_limit_load(tent, integration, share):
    scene = tent(share, integration)
    for _ in range(400):
        result = scene.step(Hold(0.02))
        assert np.isfinite(result.state.positions).all()
    assert result.status is Status.OK
    top = result.state.positions[0]
    np.testing.assert_allclose(top[:2], 0.0, atol=1e-12)
    # The load and the springs are in equilibrium in every state.
    assert carried(top[2]) == pytest.approx(share * limit()[1], rel=1e-6)
    if share < 1.0:
        assert limit()[0] < top[2] < RISE
    else:
        assert top[2] < -RISE


@builder
def arch(simulate, body_of, block, /, integration):
    """Makes a soft shallow arch between two clamps, with a cable that pulls its crown down."""
    flat = block(size=(0.1, 0.008, 0.003), cells=(10, 1, 1), shake=0)
    points = flat.node_positions.copy()
    points[:, 2] += 0.005 * (1.0 - np.cos(2 * np.pi * points[:, 0] / 0.1))
    clamps = [
        {"box": {"minimum": [x - 1e-6, -1, -1], "maximum": [x + 1e-6, 1, 1]}}
        for x in (0.0, 0.1)
    ]  # fmt: skip
    body = body_of(
        TetMesh(points, flat.cells), young_modulus=5e5, element="quadratic", fixed=clamps,
        damping={"mass": 40.0},
    )  # fmt: skip
    cable = {
        "name": "pull", "pull_point": [0.05, 0.004, -0.1], "points": [[0.05, 0.004, 0.0102]],
        "hold_radius": 0.006, "shortening": [-0.1, 0.1], "tension": [0.0, 5.0],
    }  # fmt: skip
    return simulate(body=body, cables=[cable], integration=integration, gravity=[0, 0, 0])


@pytest.mark.sampled
@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_soft_arch_snaps_through_once_and_ends_at_its_static_equilibrium(arch, integration):
    scene = arch(integration)
    crown = np.flatnonzero(np.abs(scene.model.nodes.rest_positions[:, 0] - 0.05) < 1e-6)
    heights, statuses = [], []
    for tension in np.linspace(0.0, 0.12, 25):
        for _ in range(12):
            result = scene.step(CommandEfforts(np.array([tension]), 0.02))
            assert np.isfinite(result.state.positions).all()
            statuses.append(result.status)
        heights.append(result.state.positions[crown, 2].mean())
    # A step either follows or reports: at the end all is well again.
    assert result.status is Status.OK
    assert set(statuses) <= {Status.OK, Status.NOT_CONVERGED, Status.INVERTED}
    falls = -np.diff(heights)
    assert falls.max() > 0.006
    assert heights[-1] < -0.005
