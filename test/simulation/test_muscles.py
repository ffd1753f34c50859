"""Muscles as actuators: threads and regions that contract, against closed forms."""

import numpy as np
import pytest

from softrobot_twin.constraints.muscles import force_length
from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Simulation,
)
from softrobot_twin.tables.run_columns import RunColumns
from test.builder import builder
from test.finite_differences import assert_slopes_of_actuators
from test.scene_changes import built, hold, repeat_step

LENGTH, SIDE, E = 0.1, 0.02, 1e5
FOOT, TIP = [0.01, 0.01, 0.0], [0.01, 0.01, LENGTH]
ALL = {"minimum": [-1, -1, -1], "maximum": [1, 1, 1]}
HALF = {"minimum": [-1, -1, -1], "maximum": [SIDE / 2, 1, 1]}
BELL = {"force_length": {"optimum": 1.1, "width": 0.4}}
LINE = {"free_contraction": 0.2}


def thread(**entries):
    """A muscle along the axis of the column."""
    return {"name": "thread", "points": [FOOT, TIP], "force": 4.0} | entries


def region(**entries):
    """A muscle that is the whole column."""
    return {"name": "region", "box": ALL, "direction": [0, 0, 1], "stress": 1e4} | entries


@builder
def column(*muscles, change=None, element="quadratic", cells=(2, 1, 4)) -> Simulation:
    """Makes an upright column without Poisson's ratio, clamped at its foot, with muscles."""
    mapping = {
        "name": "column", "gravity": [0.0, 0.0, 0.0],
        "body": {
            "name": "column", "element": element,
            "mesh": {"box": {"size": [SIDE, SIDE, LENGTH], "cells": list(cells)}},
            "material": {"young_modulus": E, "poisson_ratio": 0.0, "density": 1000.0},
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}],
        },
        "muscles": list(muscles),
        "effectors": [{"name": "tip", "points": [TIP]}],
        "solver": {"newton_iterations": 40, "residual_tolerance": 1e-9},
    }  # fmt: skip
    return built(mapping, change)


def contraction(result):
    return 1.0 - result.effector_positions[0, 2] / LENGTH


@pytest.mark.parametrize("element", ["quadratic", "linear", "smoothed"])
def test_a_whole_column_contracts_by_its_active_stress(column, element):
    # σ a = E ε with the corotational law of small strains; ν = 0.
    simulation = column(region(), element=element, cells=(1, 1, 4))
    assert contraction(hold(simulation, 0.5)) == pytest.approx(0.05, rel=5e-3)


@pytest.mark.parametrize("law, relation", [
    ({}, lambda x: 1.0), (LINE, lambda x: 1.0 - (1.0 - x) / 0.2),
    (BELL, lambda x: np.exp(-(((x - 1.1) / 0.4) ** 2))),
])  # fmt: skip
def test_its_stress_is_that_of_its_force_length_relation(column, law, relation):
    for activation in (0.3, 1.0):
        shorter = contraction(hold(column(region(**law), cells=(1, 1, 2)), activation))
        assert E * shorter == pytest.approx(1e4 * activation * relation(1.0 - shorter), rel=1e-6)


def test_an_artificial_muscle_contracts_freely_by_its_contraction(column):
    strong = column(region(stress=1e7, **LINE), cells=(1, 1, 2))
    result = repeat_step(strong, CommandSetpoints(np.ones(1), 1.0), 10)
    assert contraction(result) == pytest.approx(0.2, rel=0.01)


def test_a_muscle_at_one_side_bends_and_a_thread_pulls_as_a_cable_does(column):
    bent = hold(column(region(box=HALF)), 0.5)
    assert bent.effector_positions[0, 0] < 0.01 - 0.003
    ends = [[0.002, 0.01, 0.0], [0.002, 0.01, LENGTH]]
    by_thread = hold(column(thread(points=ends)), 0.25)
    cable = {"name": "cable", "pull_point": ends[0], "pull_point_on": "body", "points": ends[1:]}
    with_cable = column(change={"cables": [cable], "muscles": []})
    length = np.linalg.norm(with_cable.effector_positions()[0] - FOOT)
    assert length == pytest.approx(LENGTH)
    tensed = with_cable.step(CommandEfforts(np.array([1.0]), 1.0))
    np.testing.assert_allclose(tensed.state.positions, by_thread.state.positions, atol=1e-8)


def test_muscles_follow_a_target_within_their_limits_and_rates(column):
    simulation = column(region(box=HALF, rate=0.5), region(name="other"))
    reached = column(region(box=HALF), region(name="other"))
    hold(reached, 0.4, 0.3)
    target = reached.effector_positions()
    first = simulation.step(FollowTargets(target, 0.1))
    assert first.setpoints[0] <= 0.05 + 1e-12 and "region.rate" in first.report.active_limits
    result = repeat_step(simulation, FollowTargets(target, 0.1), 30)
    np.testing.assert_allclose(result.setpoints, [0.4, 0.3], atol=1e-3)
    far = target - [0.0, 0.0, 0.1]
    result = repeat_step(simulation, FollowTargets(far, 0.5), 40)
    assert "other.activation_max" in result.report.active_limits


def test_the_relations_have_the_slopes_that_they_say():
    for law in ((0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (0.0, 1.1, 0.4)):
        own = np.array([1.0, 1.0, *law])
        for stretch in (0.5, 0.9, 1.0, 1.3):
            (ahead, more, _), (behind, less, _) = (
                force_length.py_func(stretch + h, own) for h in (1e-6, -1e-6))
            work, force, slope = force_length.py_func(stretch, own)
            assert (ahead - behind) / 2e-6 == pytest.approx(force, abs=1e-8)
            assert (more - less) / 2e-6 == pytest.approx(slope, abs=1e-8)
            assert (work > 0.0) == (stretch > 1.0)


@pytest.mark.parametrize("law", [{}, LINE, BELL])
def test_rows_and_stiffness_are_slopes(column, law):
    simulation = column(region(box=HALF, **law), thread(**law), cells=(1, 1, 2), element="linear")
    term, nodes = simulation.actuators.terms[0], simulation.model.nodes
    assert_slopes_of_actuators(term, nodes, np.array([0.7, 0.9]), 2e-3)


def test_rows_and_stiffness_on_frames_are_slopes(column):
    ball = {"name": "ball", "motion": "free", "mass": 0.1, "sphere": {"radius": 0.01},
            "position": [0.01, 0.01, LENGTH]}  # fmt: skip
    top = {"to": "ball", "box": {"minimum": [-1, -1, LENGTH - 1e-6], "maximum": [1, 1, 1]}}
    across = thread(points=[[0.01, 0.01, 0.05], [0.01, 0.02, LENGTH], [0.02, 0.01, LENGTH]],
                    also_on=["ball"], body="column", **BELL)  # fmt: skip
    simulation = column(across, region(), cells=(1, 1, 2), element="linear",
                        change={"rigid_bodies": [ball], "body.attached": [top]})  # fmt: skip
    term, nodes = simulation.actuators.terms[0], simulation.model.nodes
    assert_slopes_of_actuators(term, nodes, np.array([0.7, 0.4]), 1e-3)


def test_columns_name_a_muscle(column):
    header = RunColumns(column(thread(**LINE))).names
    assert header[header.index("thread_activation") :][:2] == ("thread_activation", "thread_work_J")


@pytest.mark.parametrize("entry, key, why", [
    (thread(force=None), "muscles[0].force", "is required of a thread"),
    (region(force=1.0), "muscles[0].force", "is not a key of a region"),
    (region(points=[FOOT, TIP]), "muscles[0]", "exactly one of"),
    (region(direction=None), "muscles[0].direction", "is required of a region"),
    (thread(**LINE, **BELL), "muscles[0].free_contraction", "force_length says"),
    (thread(activation=[0.0, 1.5]), "muscles[0].activation", "within 0 and 1"),
    (thread(points=[FOOT, FOOT]), "muscles[0].points", "one place"),
    (thread(points=[FOOT, [0, 0, 0]]), "muscles[0]", "moves nothing"),
    (region(box={"minimum": [1, 1, 1], "maximum": [2, 2, 2]}), "muscles[0].box", "no cell"),
    (thread(free_contraction=1.0), "muscles[0].free_contraction", "below 1"),
])  # fmt: skip
def test_a_muscle_that_cannot_be_is_refused(column, entry, key, why):
    with pytest.raises(SceneError) as refused:
        column(entry)
    assert key in str(refused.value) and why in str(refused.value)
