"""A simulation changes to a better model where its reduced body is too wrong, without a jump."""

import numpy as np
import pytest
import yaml

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation
from softrobot_twin.simulation.effects.fallback import CHECK_EVERY
from test.scene_changes import change_scene

TRAINED, PERIOD = 0.011, 0.01
WANTED = 2.0e-5


def scene_of(half_trained, change=None, **reduced):
    mapping = yaml.safe_load(half_trained.read_text())
    mapping["body"]["reduced"].update(reduced)
    change_scene(mapping, change)
    return scene_from_mapping(mapping, half_trained)


@pytest.fixture(scope="module", params=["enrich", "full_model"])
def falling(request, half_trained):
    """A simulation with a fallback, and its name."""
    scene = scene_of(half_trained, fallback=request.param, error=WANTED)
    return Simulation(scene, with_warnings=False), request.param


def fallback_of(simulation):
    """The part that falls back; None without."""
    return next((part for part in simulation.parts if part.name == "fallback"), None)


def wind(simulation, shortening, steps):
    """Results of steps towards shortenings [m]."""
    command = CommandSetpoints(simulation.rest_setpoints - shortening, PERIOD)
    return [simulation.step(command) for _ in range(steps)]


@pytest.mark.sampled
def test_the_better_model_is_in_use_while_the_error_is_above_the_wanted_one(falling, half_trained):
    simulation, kind = falling
    simulation.reset()
    dof_count = simulation.dof_count
    wind(simulation, np.full(4, 0.002), 40)
    assert not simulation.falls_back
    far = np.array([2.0, 0.4, 1.6, 0.0]) * TRAINED
    results = wind(simulation, far, 80)
    assert simulation.falls_back and simulation.dof_count > dof_count
    assert f"body.{kind}" in results[-1].report.active_limits
    assert f"body.{kind}" not in results[0].report.active_limits
    # Nearer to the full model than the reduced one at the same lengths.
    tips = []
    scene = load_scene(half_trained)
    for other in (without_reductions(scene), scene):
        plain = Simulation(other, with_warnings=False)
        wind(plain, np.full(4, 0.002), 40)
        wind(plain, far, 120)
        tips.append(plain.effector_positions())
    wind(simulation, far, 40)
    error = np.linalg.norm(simulation.effector_positions() - tips[0])
    reduced_error = np.linalg.norm(tips[1] - tips[0])
    assert error < (1.0e-5 if kind == "full_model" else 0.7) * reduced_error
    assert reduced_error > WANTED
    results = wind(simulation, np.full(4, 0.002), 120)
    assert not simulation.falls_back and simulation.dof_count == dof_count
    assert f"body.{kind}" not in results[-1].report.active_limits


def test_both_models_read_one_clock_before_and_after_a_change(falling):
    simulation, _ = falling
    simulation.reset()
    clock = simulation.now
    assert fallback_of(simulation).other.now is clock
    wind(simulation, np.array([2.0, 0.4, 1.6, 0.0]) * TRAINED, 80)
    assert simulation.falls_back
    assert simulation.now is clock and fallback_of(simulation).other.now is clock


def test_commands_do_not_jump_where_the_model_changes(falling):
    simulation, _ = falling
    simulation.reset()
    rate = simulation.scene.cables[0].rate
    tip = simulation.effector_positions()
    changes, was, before, place = 0, False, simulation.state, tip
    for number in range(300):
        # There, beyond the training, and back.
        share = np.sin(np.pi * number / 260.0) if number < 260 else 0.0
        target = tip + share * np.array([[0.030, 0.012, -0.010]])
        simulation.step(FollowTargets(target, PERIOD))
        wound = np.abs(simulation.state.setpoints - before.setpoints).max()
        assert wound <= rate * PERIOD * (1.0 + 1.0e-9)
        moved = np.linalg.norm(simulation.effector_positions() - place)
        if simulation.falls_back != was:
            changes, was = changes + 1, simulation.falls_back
            assert moved < 1.0e-3
        before, place = simulation.state, simulation.effector_positions()
    assert changes >= 2 and not was


def test_a_state_of_either_model_can_be_restored(falling):
    simulation, _ = falling
    simulation.reset()
    wind(simulation, np.full(4, 0.002), 10)
    reduced = simulation.state
    wind(simulation, np.array([2.0, 0.4, 1.6, 0.0]) * TRAINED, 60)
    better = simulation.state
    assert simulation.falls_back and better.positions.shape != reduced.positions.shape
    for state, falls_back in ((reduced, False), (better, True), (reduced, False)):
        simulation.restore(state)
        assert simulation.falls_back == falls_back
        assert simulation.state is state
        wind(simulation, np.full(4, 0.003), 1)
    simulation.reset()
    assert not simulation.falls_back


def test_the_other_model_is_looked_at_every_few_steps(falling, monkeypatch):
    simulation, _ = falling
    simulation.reset()
    assert simulation.model.stages[0] == "fallback"
    other, looks = fallback_of(simulation).other, []
    step = other.step
    monkeypatch.setattr(other, "step", lambda *args, **named: looks.append(1) or step(
        *args, **named))  # fmt: skip
    results = wind(simulation, np.full(4, 0.002), 3 * CHECK_EVERY + 1)
    assert len(looks) == 3
    assert "fallback" in results[0].report.stage_times


def contact(mapping):
    mapping["obstacles"] = [{"name": "floor", "plane": {"normal": [0.0, 0.0, 1.0]}}]
    mapping["contact"] = {"between": [{"pair": ["body", "floor"]}], "alarm_distance": 0.01}


@pytest.mark.parametrize(
    ("reduced", "change", "key", "reason"),
    [
        ({"fallback": "enrich"}, None, "error", "needed beside fallback"),
        ({"error": 1.0e-4}, None, "fallback", "needed beside error"),
        ({"fallback": "pray", "error": 1.0e-4}, None, "fallback", "full_model"),
        ({"fallback": "enrich", "error": -1.0}, None, "error", "above 0"),
        ({"fallback": "enrich", "error": 1.0e-4, "spare_modes": True}, None, "fallback",
         "spare_modes"),
        ({"fallback": "enrich", "error": 1.0e-4}, contact, "fallback", "contact"),
        ({"fallback": "enrich", "error": 1.0e-4}, lambda m: m.pop("effectors"), "fallback",
         "effector"),
    ],
    ids=["no_error", "error_alone", "unknown", "negative", "spare", "contact", "no_effector"],
)  # fmt: skip
def test_what_cannot_be_fallen_back_to_is_refused_by_name(
    half_trained, reduced, change, key, reason
):
    with pytest.raises(SceneError) as caught:
        Simulation(scene_of(half_trained, change, **reduced), with_warnings=False)
    assert f"reduced.{key}" in str(caught.value)
    assert reason in str(caught.value)
