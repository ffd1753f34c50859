"""Optional effects around a step: `Fatigue` is one from outside of the
package, and has all that the package's have."""

import io
import tokenize
from pathlib import Path

import numpy as np
import pytest

import softrobot_twin
from softrobot_twin.errors import CommandError, SceneError
from softrobot_twin.simulation import CommandSetpoints, Hold


def pull(simulation, count):
    lengths = simulation.rest_setpoints - 0.001
    return [simulation.step(CommandSetpoints(lengths - 0.0005 * k, 1.0)) for k in range(count)]


def test_a_part_remembers_replaces_commands_and_reports(fatigue, beam):
    simulation = beam()
    found = pull(simulation, 4)
    assert [one.report.figures for one in found] == [{"fatigue.steps": k} for k in (1.0, 2.0, 3.0, 4.0)]
    assert [one.report.active_limits for one in found] == [(), (), ("fatigue.rest",), ()]
    assert np.array_equal(found[2].setpoints, found[1].setpoints)
    assert np.all(found[3].setpoints < found[1].setpoints)
    assert simulation.state.memory["fatigue.steps"] == 4.0


def test_what_a_part_remembers_is_restored_and_reset(fatigue, beam):
    simulation = beam()
    pull(simulation, 2)
    state = simulation.state
    first = pull(simulation, 2)
    simulation.restore(state)
    again = pull(simulation, 2)
    for one, other in zip(first, again, strict=True):
        assert one.report.active_limits == other.report.active_limits
        np.testing.assert_array_equal(one.state.positions, other.state.positions)
    simulation.reset()
    assert simulation.state.memory["fatigue.steps"] == 0.0


def test_a_part_refuses_what_it_is_not_built_beside(fatigue, beam, rod):
    with pytest.raises(SceneError, match="fatigue.* is not built beside contact"):
        beam(rod)


def test_states_with_another_memory_and_unknown_measurements_are_refused(fatigue, beam, monkeypatch):
    with_it = beam()
    monkeypatch.undo()
    without = beam()
    assert without.parts == () and without.state.memory == {}
    with pytest.raises(CommandError, match="not of this scene"):
        without.restore(with_it.state)
    with pytest.raises(CommandError, match="nothing in this scene"):
        without.step(Hold(1.0), measured=3.0)


EFFECTS = (
    "touch", "guide", "stiffness_targets", "wanted_stiffness", "friction",
    "rubs", "slip", "explor", "strain", "vertebra", "superelement", "reduc", "sampled", "hinge",
    "motor", "cable", "cavit", "beam",
)  # fmt: skip


@pytest.mark.parametrize("path", ["simulation.py", "step/newton.py"])
def test_the_step_names_no_effect(path):
    """By words of the code; comments may give examples."""
    source = (Path(softrobot_twin.__file__).parent / "simulation" / path).read_text()
    names = {
        token.string for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.NAME
    }  # fmt: skip
    named = {name for name in names if any(effect in name.lower() for effect in EFFECTS)}
    assert not named
