"""States that a reduction is trained on: what is sampled, equilibria of chains, and their files."""

import math
import shutil

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.harness.sample_workers import RunError, SampleOutcome, scene_fingerprint
from softrobot_twin.harness.sampled_axes import sampled_axes
from softrobot_twin.reduction import reduction_states
from softrobot_twin.reduction.reduction_states import (
    Columns,
    FinderMaker,
    Sampling,
    StateFinder,
    StateStore,
    chains,
    columns_of,
    find_states,
    refuse_unreducible,
    samples_of,
    training_scene,
)
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.simulation.building.scene_layout import lay_out
from test.scene_changes import entries_of, repeat_step, yaml_file

TIP = (0.01, 0.01, 0.10)
SAMPLING = Sampling("body", 0.05, ((TIP,), ((0.0, 0.0, 0.06),)), math.radians(30.0))


@pytest.fixture(scope="module")
def finder(column):
    return StateFinder(training_scene(load_scene(column), SAMPLING), "body")


def samples(finder, count, seed=0, boxes=(), sampling=SAMPLING):
    axes = sampled_axes(finder.simulation)
    return samples_of(finder.simulation, axes, sampling, boxes, count, seed)


def test_a_state_is_an_equilibrium_of_the_scene(column):
    found = StateFinder(training_scene(load_scene(column), Sampling("body")), "body")
    drawn = samples(found, 4, sampling=Sampling("body"))
    states = found(drawn)
    assert states.is_found.all() and states.iterations.min() >= 1
    simulation = Simulation.from_scene_file(column)
    result = repeat_step(simulation, CommandSetpoints(states.setpoints[3], 1e6), 40)
    assert result.report.residual < 1e-6
    shift = simulation.state.positions - simulation.model.nodes.rest_positions
    np.testing.assert_allclose(states.displacements[3], shift, atol=1e-8)
    np.testing.assert_allclose(states.effectors[3], simulation.effector_positions(), atol=1e-8)
    np.testing.assert_allclose(states.efforts[3], simulation.state.efforts, atol=1e-5)


def test_a_chain_does_not_depend_on_the_one_before_it(finder):
    drawn = samples(finder, 7)
    alone = finder(drawn[:4])
    finder(drawn[4:])
    again = finder(drawn[:4])
    for name, first, second in zip(alone._fields, alone, again, strict=True):
        np.testing.assert_array_equal(first, second, err_msg=name)


def test_a_load_and_a_tilt_move_the_tip_their_way(finder):
    columns = columns_of(finder.simulation)
    drawn = np.repeat(samples(finder, 1), 3, axis=0)
    _, _, forces, gravity = columns.split(drawn)
    forces[1, 0] = [0.02, 0.0, 0.0]
    gravity[2] = [0.0, 9.81, 0.0]
    at_rest, loaded, tilted = finder(drawn).effectors[:, 0]
    assert loaded[0] - at_rest[0] > 4 * abs(loaded[1] - at_rest[1])
    assert tilted[1] - at_rest[1] > 4 * abs(tilted[0] - at_rest[0])
    # A plain scene with that gravity sags as far.
    scene = finder.simulation.scene.model_copy(update={"gravity": (0.0, 9.81, 0.0)})
    plain = Simulation(scene, with_warnings=False)
    for _ in range(20):
        plain.step(CommandSetpoints(plain.rest_setpoints, 1e6))
    np.testing.assert_allclose(plain.effector_positions()[0], tilted, atol=1e-8)


def test_a_state_of_a_target_has_the_effector_near_it(finder):
    near = reduction_states.NEAR * finder.simulation.model.nodes.size
    drawn = np.repeat(samples(finder, 1), 2, axis=0)
    _, targets, _, _ = columns_of(finder.simulation).split(drawn)
    targets[1, 0] = [0.016, 0.012, 0.098]
    states = finder(drawn)
    assert states.is_found.all()
    assert np.linalg.norm(states.effectors[1, 0] - targets[1, 0]) <= 0.1 * near
    assert states.missed[1] <= 0.1 * near and np.isnan(states.missed[0])
    # Held there, the same equilibrium is found without the target.
    held = finder(states.held(columns_of(finder.simulation)))
    np.testing.assert_allclose(held.effectors, states.effectors, atol=1e-7)


def test_a_target_that_a_whole_step_misses_is_sought_anew(finder, monkeypatch):
    """The first way is cut after one step, which ends far from targets across the workspace."""
    size, follow = finder.simulation.model.nodes.size, StateFinder.follow
    calls = []

    def cut_short(self, wanted, is_last):
        calls.append(is_last)
        if len(calls) == 2:  # of the second target, which the chain reaches from the first
            return self.simulation.state.setpoints.copy()
        return follow(self, wanted, is_last)

    drawn = np.repeat(samples(finder, 1), 3, axis=0)
    _, targets, _, _ = columns_of(finder.simulation).split(drawn)
    targets[1, 0], targets[2, 0] = [0.015, 0.008, 0.098], [0.006, 0.013, 0.098]
    plain = finder(drawn)
    assert plain.is_found.all() and not plain.has_missed(size).any()
    monkeypatch.setattr(StateFinder, "follow", cut_short)
    states = finder(drawn)
    assert len(calls) > 2 and states.is_found.all() and not states.has_missed(size).any()
    np.testing.assert_allclose(states.effectors[1:, 0], targets[1:, 0], atol=1.1e-3 * size)
    np.testing.assert_allclose(states.missed[1:], np.linalg.norm(
        states.effectors[1:, 0] - targets[1:, 0], axis=1))  # fmt: skip


def test_a_target_out_of_reach_is_told_by_how_much_it_is_missed(finder):
    drawn = np.repeat(samples(finder, 1), 3, axis=0)
    _, targets, _, _ = columns_of(finder.simulation).split(drawn)
    targets[1, 0], targets[2, 0] = [0.010, 0.010, 0.150], [0.016, 0.012, 0.098]
    states = finder(drawn)
    size = finder.simulation.model.nodes.size
    assert states.is_found.all() and states.has_missed(size).tolist() == [False, True, False]
    # A nearest point of the workspace: it is not missed by more than the rest shape misses it.
    assert 0.04 < states.missed[1] <= 0.0505


def test_a_state_that_is_not_found_is_told_and_the_chain_goes_on(finder):
    drawn = samples(finder, 4)
    _, _, forces, _ = columns_of(finder.simulation).split(drawn)
    forces[1, 0] = [1e5, 0.0, 0.0]
    states = finder(drawn)
    assert states.is_found.tolist() == [True, False, True, True]
    assert np.isnan(states.displacements[1]).all() and np.isnan(states.setpoints[1]).all()
    assert len(states.found().samples) == 3


def chain_of(value, columns=Columns(2, 1, 0)):
    return np.full((3, columns.width), float(value))


class Counted:
    """Computes chains in place of processes, and counts them; fails at some values."""

    def __init__(self, failing=()):
        self.computed, self._failing = [], failing

    def run(self, job, left):
        for index, chain in left:
            self.computed.append(chain[0, 0])
            is_lost = chain[0, 0] in self._failing
            states = reduction_states.States(
                chain, np.array([True, True, False]), np.zeros((3, 5, 3), np.float32),
                chain[:, :2], chain[:, :2], chain[:, 2:5].reshape(3, 1, 3),
                np.zeros(3), np.arange(3),
            )  # fmt: skip
            yield SampleOutcome(index, None if is_lost else states, "no power" if is_lost else "")


def test_chains_of_a_stopped_run_are_not_computed_again(tmp_path):
    run, asked = {"scene": "this", "points": ((0.0, 1.0),)}, [chain_of(k) for k in range(4)]
    store = StateStore(tmp_path / "r.npz", run)
    crew = Counted(failing=(2.0,))
    found, causes = find_states("first", crew, None, asked, store)
    assert [states is None for states in found] == [False, False, True, False]
    assert causes == ["3 states are lost: no power"]
    assert store.count() == 3
    # One file is broken: it was being written when the power failed.
    broken = next(store.path.glob("*.npz"))
    broken.write_bytes(broken.read_bytes()[:100])
    again = Counted()
    found, causes = find_states("again", again, None, asked, StateStore(tmp_path / "r.npz", run))
    assert len(again.computed) == 2 and 2.0 in again.computed and not causes
    assert [states.samples[0, 0] for states in found] == [0.0, 1.0, 2.0, 3.0]
    store.remove()
    assert list(tmp_path.iterdir()) == []


def test_chains_of_another_run_are_refused_by_name(tmp_path):
    StateStore(tmp_path / "r.npz", {"scene": "this", "body": "a"})
    with pytest.raises(RunError, match="r.npz.part: is of a run with another body"):
        StateStore(tmp_path / "r.npz", {"scene": "this", "body": "b"})


def test_a_worker_refuses_another_scene(column, tmp_path):
    shutil.copytree(column.parent, tmp_path / "copy")
    content = scene_fingerprint(load_scene(column))
    maker = FinderMaker(Sampling("body"))
    assert maker(tmp_path / "copy" / column.name, content).simulation.effector_names == ("tip",)
    mesh = tmp_path / "copy" / "column.vtk"
    mesh.write_bytes(mesh.read_bytes() + b"\n")
    with pytest.raises(RunError, match="is not the scene of this run"):
        maker(tmp_path / "copy" / column.name, content)


@pytest.mark.parametrize("key, value, told", [
    ("volume", "patches", "body.volume"), ("viscosity", [{"share": 0.2, "time": 1.0}],
                                           "body.material.viscosity"),
])  # fmt: skip
def test_what_is_not_built_is_refused_by_name(column, key, value, told):
    mapping = entries_of(column, {"body.material.law": "neo_hookean"})
    if key == "volume":
        mapping["body"]["volume"] = value
    else:
        mapping["body"]["material"] |= {key: value}
        mapping["integration"] = "dynamic"
    scene = yaml_file(column.parent / f"{key}.yaml", mapping)
    read = load_scene(scene)
    (body,) = lay_out(read, []).bodies
    with pytest.raises(SceneError, match=f"{told}.* is not built|{told}.*not built"):
        refuse_unreducible(read, body)
