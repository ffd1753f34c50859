"""Row 19 of the hard cases: a rubber balloon at its limit point.

A thick sphere of incompressible Neo-Hookean rubber, outer radius twice the inner one, carries a
pressure of at most 0.81642 µ, at an inner stretch of 1.828 (closed form).
"""

import meshio
import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, Status
from softrobot_twin.study.pneumatic_warnings import burst_warnings
from test.builder import builder
from test.scene_changes import repeat_step, solved

SHEAR, LIMIT, LIMIT_STRETCH = 1.0e5, 0.81642, 1.828


@builder
def balloon(simulate, body_of, tmp_path, icosphere, layered, /, **cavity):
    """Makes a balloon, held at one facet of its outer surface."""
    points, triangles = icosphere(1)
    layers = [radius * points for radius in (0.01, 0.0142, 0.02)]
    meshio.write(tmp_path / "wall.vtk", meshio.Mesh(layers[0], [("triangle", triangles)]))
    held = [{"nodes": [int(2 * len(points) + k) for k in triangles[0]]}]
    body = body_of(layered(layers, triangles), "balloon", 3.0 * SHEAR, 0.4995,
                   element="quadratic", volume="patches", fixed=held)  # fmt: skip
    body["material"]["law"] = "neo_hookean"
    air = {"name": "air", "walls": [{"file": str(tmp_path / "wall.vtk")}], **cavity}
    return simulate(gravity=[0.0, 0.0, 0.0], body=body, cavities=[air],
                    solver={"newton_iterations": 15})  # fmt: skip


def rest_volume(simulation):
    (term,) = simulation.model.actuators.terms
    return term.walls.rest_volumes[0]


def ball_pressure(stretch):
    """P/µ at an inner stretch: Σ (1/λ⁴/4 + 1/λ) between inner and outer wall."""
    outer = ((stretch**3 - 1.0) / 8.0 + 1.0) ** (1.0 / 3.0)
    return 2.0 / outer + 0.5 / outer**4 - 2.0 / stretch - 0.5 / stretch**4


@pytest.mark.exhaustive
def test_volume_control_passes_the_limit_point(balloon):
    simulation = balloon(control="volume")
    whole, found = rest_volume(simulation), []
    stretches = np.concatenate([np.arange(1.1, 2.1, 0.1), [2.2, 2.4, 2.6]])
    for stretch in stretches:
        result = simulation.step(CommandSetpoints([whole * stretch**3], 1.0))
        assert result.status is Status.OK, stretch
        found.append(result.efforts[0] / SHEAR)
    # The wall is a polyhedron of 80 facets.
    np.testing.assert_allclose(found, [ball_pressure(s) for s in stretches], rtol=0.03)
    most = int(np.argmax(found))
    assert found[most] == pytest.approx(LIMIT, rel=0.02)
    assert abs(stretches[most] - LIMIT_STRETCH) < 0.1
    assert np.all(np.diff(found[most:]) < 0.0)


@pytest.mark.exhaustive
def test_pressure_control_stops_at_the_limit_point_and_says_so(balloon):
    simulation = balloon()
    whole = rest_volume(simulation)
    for pressure in (0.2, 0.4, 0.6, 0.7, 0.76, 0.79):
        result = repeat_step(simulation, CommandSetpoints([pressure * SHEAR], 1.0), 3)
        assert result.status is Status.OK, pressure
        assert result.efforts[0] == pytest.approx(pressure * SHEAR)
        assert ("air.near_burst" in result.report.active_limits) is (pressure > 0.59)
    # Above the limit no state balances the pressure: the balloon grows, to its greatest volume.
    for _ in range(6):
        result = simulation.step(CommandSetpoints([0.9 * SHEAR], 1.0))
        assert result.status is not Status.OK
    assert set(result.report.active_limits) - {"solver.newton_iterations"} == {"air.growth_max", "air.near_burst"}
    assert result.efforts[0] < 0.7 * SHEAR
    growth = result.displacements[0] / whole
    assert growth == pytest.approx(26.7, abs=0.2)
    assert np.isfinite(result.state.positions).all()
    # Let out, it shrinks back to where it was.
    for pressure in (0.5, 0.4, 0.4, 0.4, 0.4, 0.4):
        result = simulation.step(CommandSetpoints([pressure * SHEAR], 1.0))
    assert result.status is Status.OK and result.displacements[0] < whole


def test_a_pressure_near_the_limit_is_told_while_steps_still_converge(balloon):
    """C = dV/dp is five times that at rest at 0.73 of the greatest pressure."""
    simulation, told, volumes = balloon(pressure=[0.0, 0.7 * SHEAR]), {}, []
    for pressure in (0.3, 0.5, 0.6, 0.65, 0.651):
        result = solved(simulation, CommandSetpoints([pressure * SHEAR], 1.0))
        told[pressure] = "air.near_burst" in result.report.active_limits
        volumes.append(result.displacements[0])
    assert told == {0.3: False, 0.5: False, 0.6: True, 0.65: True, 0.651: True}
    (compliance,) = simulation.newton.tangent.actuator_compliances
    assert (volumes[-1] - volumes[-2]) / (0.001 * SHEAR) == pytest.approx(compliance, rel=0.01)
    warnings = list(burst_warnings(simulation))
    assert len(warnings) == 1 and "air: at 70 kPa, 1 of the greatest pressure" in warnings[0]
    assert result.report.active_limits and not list(burst_warnings(balloon(pressure=[0.0, 3e4])))


def test_the_closed_form_has_its_limit_where_it_is_published():
    for stretch, pressure in ((1.1, 0.28716), (1.5, 0.75543), (2.0, 0.80693), (3.0, 0.63451)):
        assert ball_pressure(stretch) == pytest.approx(pressure, abs=1e-5)
    stretches = np.linspace(1.7, 2.0, 3001)
    most = np.argmax(ball_pressure(stretches))
    assert ball_pressure(stretches[most]) == pytest.approx(LIMIT, abs=1e-5)
    assert stretches[most] == pytest.approx(LIMIT_STRETCH, abs=1e-3)
