"""A scene pays for what it names and nothing else: terms, rows, memory and stages of a step."""

import numpy as np
import pytest

from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold
from softrobot_twin.simulation.step.contact_solvers import ContactSolvers
from test.builder import builder

PLAIN = {"corotational elements", "gravity"}
FLOOR = {"name": "floor", "plane": {}, "position": [0, 0, -0.011]}
PLATE = {"name": "plate", "motion": "guided", "box": {"size": [0.1, 0.1, 0.1]}}
BALL = {"name": "ball", "mass": 1.0, "sphere": {"radius": 0.1}}
SPRING = {"name": "spring", "stiffness": 10.0,
          "ends": [{"point": [0.05, 0, 0]}, {"on": "bar", "point": [0.02, 0, 0]}]}  # fmt: skip
EFFECTS = {
    "nothing": (set(), {}),
    "dynamic": ({"lumped inertia"}, {"integration": "dynamic"}),
    "first_order": ({"mass damping"}, {"integration": "first_order"}),
    "springs": ({"springs"}, {"springs": [SPRING]}),
    "guided": (set(), {"rigid_bodies": [PLATE]}),
    "free": ({"lumped inertia", "rigid inertia"},
             {"integration": "dynamic", "rigid_bodies": [BALL]}),
    "contact": ({"contacts"}, {
        "obstacles": [FLOOR], "contact": {"between": [{"pair": ["bar", "floor"]}]}}),
    "obstacle": (set(), {"obstacles": [FLOOR]}),
}  # fmt: skip


@builder
def bar(simulate, write_block, /, effect):
    """Makes a held bar with one effect besides."""
    damping = {"damping": {"mass": 5.0}} if effect == "first_order" else {}
    return simulate(body={
        "name": "bar", "mesh": {"file": write_block((0.04, 0.02, 0.02), (2, 1, 1))},
        "element": "linear",
        "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [-0.019, 1, 1]}}], **damping,
    }, **EFFECTS[effect][1])  # fmt: skip


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_alone_adds_only_its_own_terms_and_stages(bar, effect):
    simulation = bar(effect)
    model = simulation.model
    assert {term.name for term in model.terms} == PLAIN | EFFECTS[effect][0]
    assert len(model.terms) == len(PLAIN) + len(EFFECTS[effect][0])
    stages = simulation.step(Hold(0.002)).report.stage_times
    assert ("detect" in stages) == (effect == "contact")
    assert set(stages) <= set(simulation.stages)
    assert (model.contacts is not None) == (effect == "contact")
    assert (model.guides is not None) == (effect == "guided")
    assert model.slides is None and not model.actuators.count and not model.effectors.effectors


def test_the_diamond_stores_no_contacts_frames_or_velocities(diamond):
    simulation = diamond()
    model, rows = simulation.model, simulation.model.rows
    assert model.contacts is None and model.slides is None and "detect" not in simulation.stages
    assert model.rigid == () and model.guides is None and model.nodes.kinds == ()
    assert model.nodes.carried is None and model.beginners == ()
    assert type(rows) is RowStack
    assert rows.row_capacity == rows.row_count == model.actuators.row_count + model.effectors.row_count
    assert simulation.state.velocities.shape == (0, 3)
    result = simulation.step(Hold())
    assert "detect" not in result.report.stage_times and "optimise" in simulation.stages
    assert set(result.report.stage_times) <= set(simulation.stages)
    assert result.contacts is None
    assert result.report.contact_count == 0 and result.report.contact_sweeps == 0
    assert result.report.contact_residual == 0.0
    assert result.report.contact_force_residual == 0.0
    simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.002, 0.02))
    result = simulation.step(FollowTargets(simulation.effector_positions(), 0.02))
    assert "detect" not in result.report.stage_times and result.report.contact_count == 0


CABLE = {
    "name": "cable", "pull_point": [-0.04, 0.0, 0.0],
    "points": [[-0.019, 0.0, 0.0], [0.019, 0.0, 0.0]], "tension": [0.0, 5.0],
}  # fmt: skip
TIP = {"name": "tip", "points": [[0.019, 0.0, 0.0]], "directions": ["x", "y", "z"]}
PULLED = {"cables": [CABLE], "effectors": [TIP]}


@builder
def built(simulate, write_block, /, more):
    """Makes the held bar with further effects."""
    return simulate(body={
        "name": "bar", "mesh": {"file": write_block((0.04, 0.02, 0.02), (2, 1, 1))},
        "element": "linear",
        "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [-0.019, 1, 1]}}],
    }, **more)  # fmt: skip


def above(height):
    return {"obstacles": [{**FLOOR, "position": [0, 0, height]}],
            "contact": {"between": [{"pair": ["bar", "floor"]}]}}  # fmt: skip


@pytest.fixture
def without_contact(monkeypatch):
    """Lets everything of contact fail."""

    def fail(*_, **__):
        raise AssertionError("a scene without contact pays for contact")

    for name in ("__init__", "warm_up", "solve"):
        monkeypatch.setattr(ContactSolvers, name, fail)
    for name in ("__init__", "begin_step", "detect", "evaluate", "add_stiffness"):
        monkeypatch.setattr(Contacts, name, fail)


def test_the_diamond_builds_and_computes_nothing_of_contact(diamond, without_contact):
    simulation = diamond()
    simulation.warm_up()
    here = simulation.effector_positions()
    for command in (Hold(0.02), FollowTargets(here + 0.002, 0.02),
                    CommandSetpoints(simulation.rest_setpoints - 0.001, 0.02)):  # fmt: skip
        result = simulation.step(command)
        assert result.status.is_success or result.report.active_limits
        assert result.contacts is None


def test_a_distant_contact_does_not_change_the_answer(built):
    results = []
    for more in (PULLED, {**PULLED, **above(-1.0)}):
        simulation = built(more)
        commands = CommandSetpoints(simulation.rest_setpoints - 0.002, 1.0)
        results.append([simulation.step(commands) for _ in range(3)][-1])
    alone, with_floor = results
    # The contact solver's tolerance is 1e-8 m by default.
    np.testing.assert_allclose(with_floor.state.positions, alone.state.positions, rtol=0, atol=1e-8)
    np.testing.assert_allclose(with_floor.efforts, alone.efforts, rtol=1e-4)
    assert with_floor.report.contact_count == 0
