"""Compliances and Jacobians over ROS: computed only where somebody receives them."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header

from softrobot_twin.analysis.apparent_compliance import EffectorCompliance, apparent_compliance

CABLES = ["north", "west", "south", "east"]


def read_matrix(message):
    """The matrix of `matrix_message`, and its stamp."""
    layout, data = message.layout, message.data
    shape = [dimension.size for dimension in layout.dim]
    matrix = np.array(data[layout.data_offset :]).reshape(shape)
    return matrix, Time(sec=int(data[0]), nanosec=int(data[1]))


@pytest.fixture
def computed(monkeypatch):
    """A list to which each computation of a compliance is appended, with its memory as None."""
    calls = []
    make, after_step = EffectorCompliance.__init__, EffectorCompliance.after_step

    def counting_make(self, simulation):
        calls.append(None)
        make(self, simulation)

    def counting_step(self, *given):
        calls.append(after_step(self, *given))
        return calls[-1]

    monkeypatch.setattr(EffectorCompliance, "__init__", counting_make)
    monkeypatch.setattr(EffectorCompliance, "after_step", counting_step)
    return calls


def command_of(world, positions=(), efforts=()):
    return JointState(header=Header(stamp=world.stamp()), name=CABLES,
                      position=list(map(float, positions)), effort=list(map(float, efforts)))


def test_the_matrices_are_those_of_the_twin_with_its_stamp_and_names(world, make_twin):
    twin = make_twin(mode="direct")
    cables = world.hear(JointState, "/twin/cables", 1000)
    compliances = world.hear(Float64MultiArray, "/twin/compliance/tip", 10)
    jacobians = world.hear(Float64MultiArray, "/twin/jacobian/tip", 10)
    speaker = world.speaker(JointState, "/twin/command/cables")
    lengths = twin.loop.simulation.rest_setpoints - [0.008, 0.004, 0.002, 0.004]
    speaker.publish(command_of(world, lengths))
    world.until(lambda: cables and np.allclose(cables[-1].position, lengths, atol=1e-12))
    world.until(lambda: twin.loop.simulation.state.efforts.min() > 0.0)
    first = len(compliances), len(jacobians)
    world.until(lambda: len(compliances) > first[0] + 20 and len(jacobians) > first[1] + 20)
    compliance, stamp = read_matrix(compliances[-1])
    jacobian, _ = read_matrix(jacobians[-1])
    found = apparent_compliance(twin.loop.simulation)
    np.testing.assert_allclose(compliance, found.compliance[0], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(jacobian, found.jacobian[0], rtol=1e-3, atol=1e-4)
    assert any(message.header.stamp == stamp for message in cables)
    rows, columns = compliances[-1].layout.dim
    assert (rows.label, columns.label) == ("x_m y_m z_m", "fx_N fy_N fz_N")
    rows, columns = jacobians[-1].layout.dim
    assert rows.label == "x_m y_m z_m"
    assert columns.label.split() == [f"{name}_shortening_m" for name in CABLES]
