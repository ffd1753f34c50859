"""Numbers of a run as JSON, and the calls that a recording knows."""

import json
import math
import random
import struct
from functools import partial

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival, Input, Refusal
from softrobot_twin.control.twin_loop import SERVICES, is_call
from softrobot_twin.record.loop_calls import READERS, call_to_json, repeat
from softrobot_twin.record.replay import Replay
from softrobot_twin.record.run_file import RunFile
from softrobot_twin.record.run_values import numbers, plain, state_digest

pytestmark = pytest.mark.libraries


def through_json(value):
    return json.loads(json.dumps(plain(value), allow_nan=False))


def test_each_number_comes_back_from_json_with_all_its_bits(drawn_seed):
    drawn = random.Random(drawn_seed)
    bits = [drawn.getrandbits(64) for _ in range(2000)]
    values = np.array(bits, dtype=np.uint64).view(float)
    values = np.concatenate([values, [0.0, -0.0, math.inf, -math.inf, 5e-324, 0.1, 1e308]])
    back = numbers(through_json(values))
    finite = ~np.isnan(values)
    assert (back[finite].view(np.uint64) == values[finite].view(np.uint64)).all()
    assert np.isnan(back[~finite]).all()


def test_every_input_and_service_of_a_loop_is_recorded(recorded):
    loop = Replay(RunFile(recorded.path)).loop
    parts = {name: part for name, part in vars(loop).items() if isinstance(part, Input)}
    accepting = {
        f"{name}.{method}" for name, part in parts.items() for method in dir(part)
        if method.startswith("accept")
    }  # fmt: skip
    assert {*accepting, *SERVICES} == {*loop.calls} and all(map(partial(is_call, loop), loop.calls))
    assert not any(map(partial(is_call, loop), ("tick", "simulation.reset", "targets.reset")))


def test_a_recorded_call_of_what_a_loop_does_not_have_is_answered_by_a_refusal(recorded):
    loop = Replay(RunFile(recorded.path)).loop
    arrival = ["base_link", 0, 0, 0.0]
    answer = repeat(loop, "touches.accept_force", [0, [0.0, 0.0, -1.0], arrival])
    assert answer == Refusal.WRONG_NAMES.value


@pytest.mark.parametrize("position", [(0.1, math.nan, -0.0), (math.inf,)])
def test_the_arguments_of_a_call_come_back_with_their_types(position):
    arrival = Arrival("base\0\udce9", 2**63, -(2**63), -0.0)
    call = call_to_json("targets.accept_point", (1, position, arrival), None)
    made = json.loads(json.dumps(call, allow_nan=False))
    effector, point, header = made["arguments"]
    header, point = READERS["arrival"](header), numbers(point)
    assert effector == 1 and header == arrival
    assert struct.pack("d", header.time) == struct.pack("d", -0.0)
    assert np.array_equal(point, position, equal_nan=True)


def test_the_digest_of_a_state_changes_with_one_bit_of_one_node(recorded):
    state = recorded.outcomes[-1].result.state
    before = state_digest(state)
    positions = state.positions.copy()
    positions[-1, 2] = np.nextafter(positions[-1, 2], 1.0)
    assert state_digest(type(state)(positions, state.setpoints, state.efforts,
                                    velocities=state.velocities,
                                    memory=state.memory)) != before  # fmt: skip
    assert state_digest(state) == before
