"""Row 23: a column under its own weight stands below the critical weight and bends over above it.

Greenhill's column: EI θ'' + w (L - s) sin θ = 0, θ(0) = 0, θ'(L) = 0, and straight up to
w L³ / EI = 7.8373; w is the weight per length.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp, trapezoid

from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Status
from softrobot_twin.simulation.result import UNSTABLE
from test.builder import builder
from test.scene_changes import solved

LENGTH, THIN, WIDE, DENSITY, YOUNG = 0.15, 0.010, 0.014, 1000.0, 5.07e5
GREENHILL = 7.8373
# Gravity under which it buckles [m/s²]: w = ρ A g, and EI = E A t²/12.
CRITICAL = GREENHILL * YOUNG * THIN**2 / (12.0 * DENSITY * LENGTH**3)


@builder
def column(simulate, body_of, block, /, share, integration="quasi_static"):
    """Makes a column under a share of its critical gravity; it is thin along x."""
    mesh = block(size=(THIN, WIDE, LENGTH), cells=(1, 1, 10), shake=0.0)
    foot = [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-9]}}]
    body = body_of(mesh, "column", YOUNG, 0.0, element="quadratic", fixed=foot,
                   damping={"mass": 1.0, "stiffness": 0.02})  # fmt: skip
    return simulate(
        body=body, integration=integration, gravity=[0, 0, -share * CRITICAL],
        solver={"newton_iterations": 60, "residual_tolerance": 1e-8},
    )  # fmt: skip


def pushed(simulation, way):
    """Bend it aside, its top by a displacement [m], and release it."""
    x = simulation.model.nodes.rest_positions.copy()
    x[:, 0] += way * (x[:, 2] / LENGTH) ** 2
    simulation.restore(replace(simulation.state, positions=x))


def leaning(simulation):
    """How far its top has gone aside [m], x and y."""
    rest = simulation.model.nodes.rest_positions
    top = rest[:, 2] > LENGTH - 1e-9
    return (simulation.state.positions - rest)[top, :2].mean(axis=0)


def elastica(share):
    """How far the top of a heavy elastica hangs aside [m]."""
    load = GREENHILL * share
    start = np.linspace(0.0, 1.0, 50)
    solution = solve_bvp(
        lambda s, y: np.array([y[1], -load * (1.0 - s) * np.sin(y[0])]),
        lambda foot, top: np.array([foot[0], top[1]]),
        start, np.array([2.0 * start, 2.0 * (1.0 - start)]), tol=1e-6,
    )  # fmt: skip
    s = np.linspace(0.0, 1.0, 1001)
    return LENGTH * trapezoid(np.sin(solution.sol(s)[0]), s)


def is_stable(simulation):
    """Whether the exact tangent of the present state is positive definite."""
    factorization = simulation.model.factorization
    factorization.clear()
    forces = np.zeros((simulation.model.nodes.free_node_count, 3))
    for term in simulation.model.forces:
        term.add(simulation.state.positions, forces, factorization.storage, False)
    return factorization.factor()


def test_the_straight_column_is_stable_up_to_greenhills_weight(column):
    for share, stable in ((0.97, True), (1.03, False)):
        simulation = column(share)
        assert simulation.step(Hold()).status is Status.OK
        assert np.abs(leaning(simulation)).max() < 1e-9
        assert is_stable(simulation) is stable


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_below_the_critical_weight_the_column_returns_upright(column, integration, side):
    simulation = column(0.9, integration)
    pushed(simulation, side * 0.01)
    for _ in range(400):
        solved(simulation, Hold(0.1))
        if np.abs(leaning(simulation)).max() < 1e-5:
            return
    raise AssertionError(f"still {leaning(simulation)} m aside")


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_above_the_critical_weight_the_column_settles_on_the_elastica(column, integration, side):
    simulation = column(1.1, integration)
    # In motion a hair is enough to start with.
    pushed(simulation, side * (0.01 if integration == "quasi_static" else 1e-5))
    before = np.full(2, np.inf)
    for _ in range(400):
        solved(simulation, Hold(0.1))
        if abs(before[0]) > 0.01 and np.abs(leaning(simulation) - before).max() < 1e-7:
            break
        before = leaning(simulation)
    x, y = leaning(simulation)
    assert side * x == pytest.approx(elastica(1.1), rel=0.02)
    assert abs(y) < 0.01 * abs(x)
    assert simulation.model.is_dynamic or is_stable(simulation)


@pytest.mark.parametrize(("wound", "is_named"), [(0.03, True), (0.001, False)])
def test_a_pose_that_would_buckle_under_given_tensions_is_named(diamond, wound, is_named):
    """Cables that raise the tip compress the legs; held at their lengths they keep it in place."""

    simulation = diamond({"body.mesh.file": "../../meshes/diamond_150.vtk", "body.element": "quadratic",
                          "solver": {"newton_iterations": 20}})
    for share in np.linspace(0.1, 1.0, 10):
        at_lengths = simulation.step(
            CommandSetpoints(simulation.rest_setpoints - share * wound, 1.0)
        )
    at_tensions = simulation.step(CommandEfforts(at_lengths.efforts, 1.0))
    assert at_lengths.status is at_tensions.status is Status.OK
    assert UNSTABLE not in at_lengths.report.active_limits
    assert (UNSTABLE in at_tensions.report.active_limits) is is_named
