"""Threads of a step: the same bits for any number, and none where they would gain nothing."""

import gc
import threading

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics import assembly_parts
from softrobot_twin.simulation import CommandSetpoints
from softrobot_twin.solvers.multifrontal import front_tasks


def _helpers():
    return {thread for thread in threading.enumerate() if thread.name == "step helper"}


def _run(simulation):
    setpoints = simulation.state.setpoints
    for number in range(6):
        simulation.step(CommandSetpoints(setpoints + 0.001 * number, 0.02))
    return simulation.state


@pytest.fixture
def threads_pay(monkeypatch):
    """Small systems are cut into small tasks, and small bodies into parts."""
    monkeypatch.setattr(assembly_parts, "LEAST_NODES", 0)
    for name, value in (("LEAST_COST", 0.0), ("LEAST_GAIN", -10.0), ("GRAIN", 1e4), ("WAKE", 0.0)):
        monkeypatch.setattr(front_tasks, name, value)


def test_a_run_has_the_same_bits_for_any_number_of_threads(diamond, threads_pay):
    one = _run(diamond({"solver.threads": 1}))
    for count in (2, 3, 4):
        simulation = diamond({"solver.threads": count})
        assert simulation.model.factorization.thread_count > 1
        assert not simulation.model.forces[0].is_traceable
        state = _run(simulation)
        np.testing.assert_array_equal(state.positions, one.positions)
        np.testing.assert_array_equal(state.efforts, one.efforts)


def test_helpers_end_with_the_simulation(diamond, threads_pay):
    gc.collect()
    before = _helpers()
    simulation = diamond({"solver.threads": 2})
    _run(simulation)
    assert simulation.model.factorization.thread_count == 2
    del simulation
    gc.collect()
    for helper in _helpers() - before:
        helper.join(30.0)
    assert not _helpers() - before


def test_a_small_robot_starts_no_thread(diamond):
    before = _helpers()
    simulation = diamond({"solver.threads": 4})
    _run(simulation)
    assert simulation.model.factorization.thread_count == 1
    assert all(term.is_traceable for term in simulation.model.forces)
    assert _helpers() <= before


def test_threads_for_superlu_are_refused(diamond):
    with pytest.raises(SceneError, match=r"solver\.threads.*SuperLU works on one thread"):
        diamond({"solver.threads": 2, "solver.factorization": "superlu"})
