"""A scene pays for the effects that it names: only their terms, buffers, solvers and stages exist."""

from __future__ import annotations

import numpy as np
import pytest

from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.mechanics.kinematics import CarriedTerm
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation
from softrobot_twin.simulation.contact_solvers import ContactSolvers

ELASTIC = "corotational tetrahedra"
FLOOR = {"obstacles": [{"name": "floor", "plane": {}, "position": [0, 0, -0.011]}]}
CABLE = {
    "name": "cable", "pull_point": [-0.04, 0.0, 0.0],
    "points": [[-0.019, 0.0, 0.0], [0.019, 0.0, 0.0]], "tension": [0.0, 5.0],
}  # fmt: skip
TIP = {"name": "tip", "points": [[0.019, 0.0, 0.0]], "directions": ["x", "y", "z"]}


def bar(file, **more):
    return {"body": {
        "name": "bar", "mesh": {"file": file},
        "element": "linear",
        "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [-0.019, 1, 1]}}], **more,
    }}  # fmt: skip


@pytest.fixture
def built(write_block):
    """Makes a bar with further effects."""

    def make(more, **of_the_bar):
        file = write_block((0.04, 0.02, 0.02), (2, 1, 1))
        mapping = {"name": "scene", **bar(file, **of_the_bar), **more}
        return Simulation(scene_from_mapping(mapping))

    return make


@pytest.mark.parametrize(
    ("more", "of_the_bar", "added"),
    [
        ({}, {}, []),
        ({"gravity": [0, 0, -9.81]}, {}, ["gravity"]),
        ({"integration": "dynamic"}, {}, ["lumped inertia"]),
        ({"integration": "first_order"}, {"damping": {"mass": 5.0}}, ["mass damping"]),
        ({"springs": [
            {"name": "spring", "stiffness": 10.0,
             "ends": [{"point": [0.05, 0, 0]}, {"on": "bar", "point": [0.02, 0, 0]}]}]},
         {}, ["springs"]),
        ({"rigid_bodies": [
            {"name": "plate", "motion": "guided", "box": {"size": [0.1, 0.1, 0.1]}}]}, {}, []),
        ({"integration": "dynamic",
          "rigid_bodies": [{"name": "ball", "mass": 1.0, "sphere": {"radius": 0.1}}]},
         {}, ["lumped inertia", "rigid inertia"]),
        (FLOOR, {}, []),
        ({**FLOOR, "contact": {"between": [{"pair": ["bar", "floor"]}]}}, {}, ["contacts"]),
        ({"cables": [CABLE]}, {}, ["cables"]),
        ({"cables": [CABLE], "effectors": [TIP]}, {}, ["cables", "effectors"]),
    ],
)  # fmt: skip
def test_an_effect_adds_its_own_terms_and_stages_only(built, more, of_the_bar, added):
    simulation = built({"gravity": [0, 0, 0], **more}, **of_the_bar)
    assert [term.name for term in simulation.terms] == [ELASTIC, *added]
    assert ("detect" in simulation.stages) == ("contacts" in added)
    assert ("optimise" in simulation.stages) == bool({"contacts", "cables"} & set(added))
    result = simulation.step(Hold(0.002))
    assert set(result.report.stage_times) <= set(simulation.stages)
    guided = any(body.get("motion") == "guided" for body in more.get("rigid_bodies", ()))
    assert (simulation.model.guides is not None) == guided
    assert (result.contacts is not None) == ("contacts" in added)


def test_an_effect_allocates_rows_for_itself_only(built):
    alone = built({"cables": [CABLE], "effectors": [TIP]}).model.rows
    floor = {**FLOOR, "contact": {"between": [{"pair": ["bar", "floor"]}]}}
    touching = built({"cables": [CABLE], "effectors": [TIP], **floor}).model.rows
    assert (alone.row_room, touching.row_room) == (4, 4 + touching.terms[-1].row_room)
    assert alone.groups.contacts == slice(4, 4)
    cables, effectors = alone.terms
    assert len(alone.blocks) == len(cables.entry_rows) + len(effectors.entry_rows)
    assert len(built({}).model.rows.blocks) == 0


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
    model = simulation.model
    assert model.contacts is None and model.slides is None
    assert model.rigid == () and model.guides is None and model.beginners == ()
    here = simulation.effector_positions()
    for command in (Hold(0.02), FollowTargets(here + 0.002, 0.02),
                    CommandSetpoints(simulation.rest_setpoints - 0.001, 0.02)):  # fmt: skip
        result = simulation.step(command)
        assert result.status.is_success or result.report.active_limits
        assert "detect" not in result.report.stage_times
        assert result.contacts is None
        assert result.report.contact_count == 0 and result.report.contact_sweeps == 0
        assert result.report.contact_residual == 0.0
        assert result.report.contact_force_residual == 0.0


def test_a_contact_that_is_far_away_leaves_the_answer_as_it_is(built):
    pulled = {"cables": [CABLE], "effectors": [TIP]}
    far = {"obstacles": [{"name": "floor", "plane": {}, "position": [0, 0, -1.0]}],
           "contact": {"between": [{"pair": ["bar", "floor"]}]}}  # fmt: skip
    results = []
    for more in (pulled, {**pulled, **far}):
        simulation = built(more)
        commands = CommandSetpoints(simulation.rest_setpoints - 0.002, 1.0)
        results.append([simulation.step(commands) for _ in range(3)][-1])
    alone, with_floor = results
    np.testing.assert_array_equal(with_floor.state.positions, alone.state.positions)
    np.testing.assert_array_equal(with_floor.efforts, alone.efforts)
    assert with_floor.report.contact_count == 0


@pytest.mark.parametrize(
    "more", [{}, {"cables": [CABLE]}, {"integration": "dynamic"}, FLOOR], ids=str
)
def test_no_term_is_folded_where_it_holds_no_carried_point(built, more):
    model = built({"gravity": [0, 0, 0], **more}).model
    assert not any(isinstance(term, CarriedTerm) for term in model.forces)
    assert model.nodes.carried is None and model.nodes.kinds == ()


def test_only_terms_that_remember_the_beginning_of_a_step_are_asked_to(built):
    touching = {**FLOOR, "contact": {"between": [{"pair": ["bar", "floor"]}]}}
    plate = {"name": "plate", "motion": "guided", "box": {"size": [0.1, 0.1, 0.1]}}
    for more, count in (({}, 0), ({"cables": [CABLE]}, 0), ({"integration": "dynamic"}, 1),
                        (touching, 1), ({"rigid_bodies": [plate]}, 1)):  # fmt: skip
        assert len(built({"gravity": [0, 0, 0], **more}).model.beginners) == count, more
