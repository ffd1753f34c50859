"""Stages that one driver runs: the same bits as in Python, and only what may be traced."""

import numpy as np
import pytest

from softrobot_twin.geometry.vector_arrays import add_vectors, are_same
from softrobot_twin.kernels import traced_stage
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.kernels.traced_stage import TracedStages, clear
from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation
from test.places import SCENES

LARGE = {"fetch", "fast_pneunet_device", "pneunet_inverse", "trunk_cylinders"}  # Their steps take long.
# Those of which all terms are traceable, and which the driver must therefore run.
TRACED = {"diamond", "diamond_reduced", "trunk", "flexo", "fetch_reduced", "octoleg", "grasper", "finger"}


@njit(**KERNEL)
def has_negative(vectors):
    return vectors.min() < 0.0


def count_driven(monkeypatch):
    """The number of stages that the driver ran to their end."""
    run, counts = traced_stage.run_calls, [0]

    def counted(calls, *memory):
        done = run(calls, *memory)
        counts[0] += done == len(calls)
        return done

    monkeypatch.setattr(traced_stage, "run_calls", counted)
    return counts


def states_of(path, drawn_seed):
    """Positions and efforts over a few steps of all kinds."""
    simulation, random = Simulation.from_scene_file(path), np.random.default_rng(drawn_seed)
    actuators, found = simulation.actuators, []
    wanted = simulation.state.setpoints + 0.02 * random.uniform(0.0, 1.0, actuators.count) * (
        actuators.setpoints(actuators.limits.drive_scale)
    )
    here = simulation.effector_positions()
    targets = here + 1.0e-3 * simulation.model.nodes.size * random.uniform(-1.0, 1.0, here.shape)
    follows = simulation.inverse is not None
    for time_step in (0.01, 0.02):
        for command in (
            *4 * [Hold(time_step)], *4 * [CommandSetpoints(wanted, time_step)],
            *4 * follows * [FollowTargets(targets, time_step)],
        ):
            simulation.step(command)
            found.append(np.concatenate([simulation.state.positions.ravel(), simulation.state.efforts]))
    return found


@pytest.mark.sampled
@pytest.mark.parametrize("path", [
    pytest.param(path, id=path.stem, marks=[pytest.mark.exhaustive] * (path.stem in LARGE))
    for path in sorted(SCENES.glob("*.yaml"))])
def test_the_driver_gives_the_same_bits_as_python(path, monkeypatch, drawn_seed):
    driven = count_driven(monkeypatch)
    found = states_of(path, drawn_seed)
    assert driven[0] > 0 or path.stem not in TRACED
    monkeypatch.setattr(TracedStages, "trace_stage", lambda self, known, given: known.stage(*given))
    driven[0] = 0
    for one, other in zip(found, states_of(path, drawn_seed), strict=True):
        np.testing.assert_array_equal(one, other)
    assert driven[0] == 0


@pytest.mark.sampled
@pytest.mark.parametrize(
    "name, time_step", [("diamond_reduced", 0.001), ("diamond", 0.002), ("flexo", 0.01)]
)
def test_targets_that_move_do_not_send_stages_back_to_python(name, time_step, monkeypatch):
    traces = []
    trace = traced_stage.Trace
    monkeypatch.setattr(traced_stage, "Trace", lambda *given: traces.append(given[0]) or trace(*given))
    simulation = Simulation.from_scene_file(SCENES / f"{name}.yaml")
    here = simulation.effector_positions()
    for k in range(500):
        if k == 200:
            traces.clear()
        # As a teleop does it: a new target in each 20 ms.
        at = 0.02 * (k * time_step // 0.02)
        move = [0.05 * simulation.model.nodes.size * np.sin(at), 0.0, 0.0]
        simulation.step(FollowTargets(here + move, time_step), budget=1.0)
    # To learn a stage takes as long as several steps.
    assert len(traces) <= 10


@pytest.mark.libraries
def test_a_kernel_that_returns_something_else_sends_the_stage_back_to_python(monkeypatch):
    driven, vectors, sums = count_driven(monkeypatch), np.ones((5, 3)), np.zeros((5, 3))

    def stage():
        clear(sums.reshape(-1))
        add_vectors(vectors, sums)
        if has_negative(vectors):
            add_vectors(vectors, sums)
            return "twice"
        return "once"

    stages = TracedStages(True, stage)
    assert [stages.run(0) for _ in range(4)] == 4 * ["once"]
    vectors[0, 0] = -1.0
    assert stages.run(0) == "twice"
    np.testing.assert_array_equal(sums, 2.0 * vectors)
    assert driven[0] == 2


def test_where_one_stage_does_something_else_none_is_run_by_the_driver(monkeypatch):
    driven, vectors, noted = count_driven(monkeypatch), np.ones((5, 3)), []

    def first():
        noted.append(has_negative(vectors))

    def second():
        return noted[-1] and are_same(vectors, vectors)

    stages = TracedStages(True, first, second)
    # All are known, or one that was learned while the other one was not.
    for learned in (4 * (0, 1), (0, 1, 1)):
        vectors[0, 0] = 1.0
        assert not [stages.run(place) for place in learned][-1]
        vectors[0, 0] = -1.0
        for _ in range(3):
            stages.run(0)
        assert stages.run(1)
    assert driven[0] > 0


@njit(**{**KERNEL, "cache": False})
def digest(matrices, numbers, flags, weights, found):
    k = 0
    for matrix in matrices:
        found[k] = matrix[1, 2]
        k += 1
    for number in numbers:
        found[k] = number
        k += 1
    for flag in flags:
        found[k] = flag
        k += 1
    for weight in weights:
        found[k] = weight
        k += 1
    return k, weights[-1], flags[0]


@pytest.mark.libraries
@pytest.mark.parametrize("counts", [(1, 1, 1, 1), (2, 7, 2, 11), (9, 3, 4, 9)])
def test_arguments_of_all_kinds_reach_a_kernel_in_registers_and_on_the_stack(counts, monkeypatch):
    driven, found = count_driven(monkeypatch), np.zeros(40)
    matrices, numbers, flags, weights = counts
    given = (
        tuple(np.arange(12.0).reshape(3, 4) + k for k in range(matrices)),
        tuple(range(-1, numbers - 1)), (True, *(flags - 1) * [False]), tuple(0.1 * k for k in range(weights)),
        found,
    )  # fmt: skip
    stages, expected = TracedStages(True, lambda: digest(*given)), (sum(counts), given[3][-1], True)
    assert [stages.run(0), stages.run(0)] == 2 * [expected]
    values = found.copy()
    found[:] = np.nan
    assert stages.run(0) == expected and driven[0] == 1
    np.testing.assert_array_equal(found[: sum(counts)], values[: sum(counts)])


def test_a_kernel_of_more_words_than_the_driver_has_code_for_stays_in_python(monkeypatch):
    driven, found = count_driven(monkeypatch), np.zeros(1)
    many = tuple(np.zeros((80, 1)))  # seven words each

    @njit(**{**KERNEL, "cache": False})
    def count_all(rows, found):
        found[0] += len(rows)

    stages = TracedStages(True, lambda: count_all(many, found))
    for _ in range(4):
        stages.run(0)
    assert found[0] == 320 and driven[0] == 0


@pytest.mark.libraries
def test_a_kernel_whose_arguments_numba_converts_stays_in_python(monkeypatch):
    driven, numbers = count_driven(monkeypatch), np.zeros(3)

    @njit(**{**KERNEL, "cache": False})
    def add_scaled(scale, numbers):
        for k in range(len(numbers)):
            numbers[k] += scale

    add_scaled.compile("void(float64, float64[::1])")
    add_scaled.disable_compile()
    stages = TracedStages(True, lambda: add_scaled(1, numbers))
    for _ in range(5):
        stages.run(0)
    np.testing.assert_array_equal(numbers, 5.0)
    assert driven[0] == 0


def test_a_term_from_outside_is_not_traced_unless_it_says_so():
    class Wind(Gravity):
        def add_forces(self, positions, forces):
            forces[:, 0] += positions[:, 2]
            return 0

    assert Gravity.is_traceable
    assert not Wind.is_traceable
