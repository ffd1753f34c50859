"""``explain --stiffness``: principal stiffnesses, compliance and Jacobian of each effector."""

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.apparent_compliance import apparent_compliance
from softrobot_twin.study.equilibrium import bring_to_rest
from softrobot_twin.study.stiffness import actuation


def cells_of(output, title):
    """Cells of the lines below a title, up to an empty line."""
    lines = output.splitlines()
    first = next(index for index, line in enumerate(lines) if line.startswith(title))
    below = lines[first + 2 :]
    return [line.split() for line in below[: below.index("")]]


def at_rest(scene, given=()):
    simulation = Simulation.from_scene_file(scene)
    drives = actuation(simulation, given)
    assert bring_to_rest(simulation, simulation.actuators.setpoints(drives)).is_reached
    return simulation, apparent_compliance(simulation)


def test_it_prints_what_the_effectors_yield(column, call):
    given = ["a_shortening_m=0.004", "b_shortening_m=0.002"]
    done = call("explain", "--stiffness", column, "--at", *given)
    assert done.code == 0, done.errors
    simulation, found = at_rest(column, given)
    stiffness, directions = found.principal_stiffness(0)
    rows = cells_of(done.output, "Stiffness of the effectors")
    np.testing.assert_allclose([float(row[1]) for row in rows], stiffness, rtol=1e-3)
    printed = np.array([[float(cell) for cell in row[2:]] for row in rows])
    np.testing.assert_allclose(printed, directions, atol=6e-4)
    rows = cells_of(done.output, "Compliance of tip")
    printed = np.array([[float(cell) for cell in row[1:]] for row in rows])
    np.testing.assert_allclose(printed, found.compliance[0], rtol=1e-3, atol=1e-12)
    rows = cells_of(done.output, "Jacobian of tip")
    assert [row[0] for row in rows] == list(simulation.actuator_names)
    printed = np.array([[float(cell) for cell in row[2:5]] for row in rows])
    np.testing.assert_allclose(printed.T, found.jacobian[0], rtol=1e-3, atol=1e-7)
    assert all(row[1] == "shortening" and row[5] == "m/m" for row in rows)
    held = [row[6] == "shortening" for row in rows]
    assert held == found.is_held.tolist() and any(held) and not all(held)


def test_a_setpoint_and_a_displacement_name_the_same(column):
    simulation = Simulation.from_scene_file(column)
    length = float(simulation.rest_setpoints[0]) - 0.004
    one = actuation(simulation, ["a_shortening_m=0.004"])
    np.testing.assert_allclose(actuation(simulation, [f"a_length_m={length!r}"]), one, atol=1e-12)
    assert one[0] == 0.004 and not one[1:].any()
