"""The linear model of few modes, against steps of the simulation and against its static compliance."""

import copy

import numpy as np
import pytest
import yaml

import softrobot_twin as st
from softrobot_twin.analysis.apparent_compliance import EffectorCompliance
from softrobot_twin.analysis.linear_model import ModalTangent
from softrobot_twin.errors import CommandError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Simulation
from test.simulation.conftest import SCENE_FILE

STEP = 0.01
ALPHA = {"time_scheme": "generalized_alpha", "spectral_radius": 0.9}
TENSIONS = np.array([3.0, 1.5])


def finger_mapping(**changes):
    """A finger of few quadratic elements, which vibrates at 7 Hz where its tensions are given."""
    mapping = yaml.safe_load(SCENE_FILE.with_name("finger.yaml").read_text())
    box = {"size": [0.1, 0.018, 0.018], "cells": [5, 1, 1]}
    mapping["body"] |= {
        "mesh": {"box": box, "translation": [0, -0.009, -0.009]}, "element": "quadratic",
        "damping": {"mass": 0.5, "stiffness": 2e-3},
        "fixed": [{"box": {"minimum": [-1e-3, -1, -1], "maximum": [1e-3, 1, 1]}}],
    }
    return mapping | {"integration": "dynamic", "solver": {"newton_iterations": 20,
                      "residual_tolerance": 1e-11}} | changes  # fmt: skip


def at_rest(mapping, command=None, step=0.05, count=400):
    """A simulation that stands still under a command."""
    simulation = Simulation(scene_from_mapping(mapping))
    for _ in range(count):
        simulation.step(command or Hold(step))
    for _ in range(3):  # The past of the scheme fits the step of the test.
        result = simulation.step(Hold(STEP) if command is None else CommandEfforts(command.efforts, STEP))
    assert np.abs(result.state.velocities).max() < 1e-9
    return simulation


def deviations(simulation, model, changes):
    """Motion of the outputs by changes of the inputs in steps, of the simulation and of the model."""
    start, found, predicted = simulation.effector_positions().ravel(), [], []
    setpoints, efforts = simulation.state.setpoints, simulation.state.efforts
    A, B, C, D = model.discrete()
    x = np.zeros(len(A))
    for change in changes:
        if model.is_by_effort.any():
            simulation.step(CommandEfforts(efforts + change, STEP))
        else:
            simulation.step(CommandSetpoints(setpoints - change, STEP))
        x = A @ x + B @ change
        found.append(simulation.effector_positions().ravel() - start)
        predicted.append(C @ x)
    return np.array(found), np.array(predicted)


SPRING = {"name": "damper", "stiffness": 20.0, "damping": 0.2, "rest_length": 0.08,
          "ends": [{"point": [0.05, 0.0, 0.1]}, {"on": "body", "point": [0.1, 0.0, 0.009]}]}  # fmt: skip


@pytest.mark.sampled
@pytest.mark.parametrize("scheme", [{}, ALPHA, ALPHA | {"springs": [SPRING]}])
@pytest.mark.parametrize("driven_by", ["tensions", "lengths"])
def test_steps_of_small_changes_are_those_of_the_simulation(scheme, driven_by):
    by_tension = driven_by == "tensions"
    command = CommandEfforts(TENSIONS, 0.05) if by_tension else None
    simulation = at_rest(finger_mapping(**scheme), command)
    if not by_tension:
        pulled = simulation.state.setpoints - [0.002, 0.001]
        for _ in range(400):
            simulation.step(CommandSetpoints(pulled, 0.05))
        for _ in range(3):
            simulation.step(CommandSetpoints(pulled, STEP))
    model = ModalTangent(simulation, np.full(2, by_tension)).at_state(None, STEP)
    small = np.array([2e-4, -1e-4]) if by_tension else np.array([2e-7, -1e-7])
    changes = np.where(np.arange(25)[:, None] < 15, small, -small)
    found, predicted = deviations(simulation, model, changes)
    assert np.abs(found - predicted).max() < 1e-3 * np.abs(found).max()
    # A first step has no curvature yet.
    assert np.abs(found - predicted)[0].max() < 1e-4 * np.abs(found).max()


def test_few_modes_tell_nearly_the_motion_of_all():
    simulation = at_rest(finger_mapping(**ALPHA), CommandEfforts(TENSIONS, 0.05))
    tangent = ModalTangent(simulation, np.ones(2, bool))
    few, every = tangent.at_state(5, STEP), tangent.at_state(None, STEP)
    assert len(every.K) > 200
    for frequency in few.frequencies:
        assert np.abs(every.frequencies / frequency - 1.0).min() < 1e-6
    responses = []
    for model in (few, every):
        A, B, C, D = model.discrete()
        x, seen = np.zeros(len(A)), []
        for _ in range(50):
            x = A @ x + B @ [1.0, 0.0]
            seen.append(C @ x)
        responses.append(np.array(seen))
    apart = np.abs(responses[0] - responses[1]).max(axis=1) / np.abs(responses[1]).max()
    # Modes that the model leaves out follow a jump at once.
    assert apart.max() < 1e-2 and apart[10:].max() < 1e-3


@pytest.mark.sampled
@pytest.mark.parametrize("count", [1, 4, None])
def test_a_robot_that_stands_yields_as_its_compliance_says(air_scene, count):
    """Pressures, a volume and the length of a cable together."""
    mapping = copy.deepcopy(air_scene) | {"integration": "dynamic"}
    mapping["body"]["damping"] = {"mass": 1.0, "stiffness": 1e-2}
    simulation = Simulation(scene_from_mapping(mapping))
    wanted = simulation.state.setpoints + [-0.003, 5e3, 2e3, 2e-7]
    for _ in range(60):
        simulation.step(CommandSetpoints(wanted, 0.1))
    model = ModalTangent(simulation).at_state(count, STEP)
    assert model.inputs == ("east_shortening_m", "low_pressure_Pa", "high_pressure_Pa",
                            "syringe_growth_m3")  # fmt: skip
    assert model.is_by_effort.tolist() == [False, True, True, False]
    jacobian = EffectorCompliance(simulation).at_state().jacobian.reshape(-1, 4)
    scale = np.abs(jacobian).max(axis=0)
    assert np.abs((model.static_gain - jacobian) / scale).max() < 1e-8
    for A, B, C, D in (model.discrete(), model.sampled()):
        gain = C @ np.linalg.solve(np.eye(len(A)) - A, B) + D
        assert np.abs((gain - jacobian) / scale).max() < 1e-6
    A, B, C, D = model.continuous()
    assert np.abs((D - C @ np.linalg.solve(A, B) - jacobian) / scale).max() < 1e-6


@pytest.fixture(scope="module")
def finger():
    return st.build(**finger_mapping(**ALPHA))


def test_a_long_step_of_held_tensions_is_two_of_half_the_time(finger):
    finger.step(st.efforts(flexor_tension_N=3.0, extensor_tension_N=1.5))
    model = finger.linear_model(4)
    assert model.inputs == ("flexor_tension_N", "extensor_tension_N")
    assert model.outputs == ("tip_x_m", "tip_y_m", "tip_z_m")
    (A, B, *_), (a, b, *_) = model.sampled(0.02), model.sampled(0.01)
    assert a @ a == pytest.approx(A, abs=1e-9 * np.abs(A).max())
    assert a @ b + b == pytest.approx(B, abs=1e-9 * np.abs(B).max())


def test_damping_is_that_of_the_scene(finger):
    finger.settle(st.setpoints(flexor_shortening_m=2e-4, extensor_shortening_m=2e-4))
    model = finger.linear_model(6)
    omega = 2 * np.pi * model.frequencies
    assert model.damping_ratios == pytest.approx(0.5 * (0.5 / omega + 2e-3 * omega), rel=0.02)
    assert model.static_gain == pytest.approx(np.asarray(finger.jacobian("tip")), abs=1e-9)


def test_a_scene_without_a_linear_model_is_refused_by_what_it_lacks():
    mapping = finger_mapping(integration="quasi_static")
    mapping["body"].pop("damping")
    with pytest.raises(CommandError, match="linear_model: needs integration dynamic"):
        st.build(**mapping).linear_model()
    mapping = finger_mapping()
    with pytest.raises(CommandError, match="flexor: is neither slack nor under tension"):
        st.build(**mapping).linear_model()
    mapping.pop("effectors")
    with pytest.raises(CommandError, match="needs an effector"):
        st.build(**mapping).linear_model()
    mapping = finger_mapping()
    mapping["body"]["material"] |= {"law": "neo_hookean",
                                    "viscosity": [{"share": 0.2, "time": 0.1}]}  # fmt: skip
    with pytest.raises(CommandError, match="materials that remember"):
        st.build(**mapping).linear_model()
