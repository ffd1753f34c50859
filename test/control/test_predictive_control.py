"""Filter and quadratic program over a linear model, against plants that are this model, or nearly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from softrobot_twin.analysis.linear_model import LinearModel
from softrobot_twin.control.predictive_control import (
    TUNINGS,
    InputRange,
    PredictiveControl,
    Program,
    plant_of,
    stability_margin,
    with_margin,
)

PERIOD = 0.01
HORIZON = 25
AT = np.array([0])


def swing(frequency=6.0, inputs=((1.0,),), is_by_effort=(True,), damping=0.02, modes=1, place=0.1):
    """A robot of slow modes that its inputs move; a unit of effort moves it by a millimetre."""
    inputs = np.array(inputs)
    omega = 2 * np.pi * frequency * np.sqrt(np.arange(1, modes + 1) ** 3)
    K, c = np.diag(omega**2), np.diag(2 * damping * omega)
    E = np.ones((len(inputs), modes)) / modes
    E = E if len(inputs) == 1 else np.eye(len(inputs), modes)
    by_effort = np.array(is_by_effort)
    H = 1e-3 * omega**2 * np.tile(inputs.T.sum(axis=1, keepdims=True), modes)
    if len(inputs) > 1:
        H = 1e-3 * inputs.T @ np.diag(omega**2)[: len(inputs)]
    count = inputs.shape[1]
    return LinearModel(
        tuple(f"u{i}" for i in range(count)), tuple(f"y{i}" for i in range(len(E))), by_effort,
        np.full(count, 4.0), np.full(len(E), place), np.eye(modes), K, c, H, np.zeros_like(H), E,
        np.zeros((len(E), count)), np.zeros((1, 3, modes)), None, PERIOD)  # fmt: skip


def free(count, low=-1e3, high=1e3, rate=np.inf):
    return InputRange(np.full(count, low), np.full(count, high), np.full(count, rate))


class Plant:
    """Steps a model by commands that take effect late, and shows it as it was before."""

    def __init__(self, model, delay=0, disturbance=0.0):
        self.model, self.disturbance = model, disturbance
        self.A, self.B, self.C, self.D = model.sampled(PERIOD)
        self.x = np.zeros(len(self.A))
        self.waiting = [np.zeros(self.B.shape[1])] * delay
        self.seen = [self.outputs]

    @property
    def outputs(self):
        return self.C @ self.x + self.model.output_values + self.disturbance

    def step(self, inputs):
        self.waiting.append(inputs - self.model.input_values)
        self.x = self.A @ self.x + self.B @ self.waiting.pop(0)
        self.seen.append(self.outputs)

    def at(self, age):
        """Outputs so many ticks ago, between two ticks on a straight line."""
        last = len(self.seen) - 1
        return np.array([np.interp(last - age, np.arange(last + 1), column)
                         for column in np.array(self.seen).T])  # fmt: skip


def run(control, plant, path, ticks, age=0.0, noise=0.0, rng=None):
    """Outputs and inputs in each tick, and the targets."""
    inputs = []
    for tick in range(ticks):
        y = plant.at(age)[control.outputs]
        if noise:
            y = y + rng.normal(0, noise, len(y))
        control.measure(y, age * PERIOD)
        ahead = tick + control.delay + 1 + np.arange(control.horizon)
        planned = control.plan(np.array([path(PERIOD * one) for one in ahead]).reshape(len(ahead), -1))
        assert planned.is_solved
        control.send(planned.inputs)
        plant.step(planned.inputs)
        inputs.append(planned.inputs)
    return np.array(plant.seen[1:])[:, control.outputs], np.array(inputs)


def sine(amplitude=5e-3, frequency=3.6, place=0.1):
    """A path that begins smoothly."""
    def path(time):
        return place + amplitude * min(1.0, time * frequency) * np.sin(2 * np.pi * frequency * time)
    return path


def wanted(path, ticks):
    return np.array([path(PERIOD * (tick + 1)) for tick in range(ticks)]).reshape(ticks, -1)


def rms(errors):
    return float(np.sqrt((errors[len(errors) // 2 :] ** 2).mean()))


@pytest.mark.parametrize("age, delay", [(0.0, 0), (2.0, 0), (2.4, 0), (0.0, 3), (1.7, 2)])
def test_a_path_at_most_of_the_first_frequency_is_followed_whatever_the_known_delay(age, delay):
    model = swing(modes=2)
    control = PredictiveControl(model, PERIOD, AT, free(1), delay=delay)
    seen, _ = run(control, Plant(model, delay), sine(), 200, age)
    # A robot that is sent where it would be at rest is led by 1 / (1 - 0.6²) too far.
    assert rms(seen - wanted(sine(), 200)) < 0.03 * 5e-3


def test_a_delay_that_is_not_known_costs_more():
    model = swing()
    control = PredictiveControl(model, PERIOD, AT, free(1))
    seen, _ = run(control, Plant(model, 1), sine(), 200)
    assert rms(seen - wanted(sine(), 200)) > 0.1 * 5e-3


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_robot_that_stands_is_where_it_should_be_though_the_model_is_wrong(factor):
    model = swing()
    real = replace(model, K=factor * model.K)
    control = PredictiveControl(model, PERIOD, AT, free(1))
    seen, _ = run(control, Plant(real, disturbance=2e-3), lambda time: 0.104, 400)
    assert np.abs(seen[-20:] - 0.104).max() < 1e-6


def test_commands_keep_limits_and_rates_and_are_the_least_squares_among_them():
    model = swing()
    allowed = free(1, 2.0, 7.0, rate=60.0)
    control = PredictiveControl(model, PERIOD, AT, allowed)
    _, inputs = run(control, Plant(model), sine(), 100)
    steps = np.abs(np.diff(inputs[:, 0], prepend=4.0))
    assert inputs.min() >= 2.0 and inputs.max() <= 7.0 and steps.max() <= 0.6 + 1e-9
    assert (steps > 0.6 - 1e-6).sum() > 10 and (inputs > 7.0 - 1e-6).any()


def test_the_program_is_the_least_sum_of_squares_within_limits_and_rates():
    """Against another solver, whose sum is that of a simulated horizon."""
    model, share = swing(damping=0.1), 0.3
    plant = plant_of(model, PERIOD, AT)
    program = Program(plant, model.static_gain, free(1, -2.0, 3.0, 60.0), 12, PERIOD, share)
    x = 1e-3 * np.array([2.0, 30.0, 900.0, 1.0])  # Place, velocity, the input before, disturbance.
    targets = 1e-3 * (5.0 + np.arange(12.0))[:, None]
    found = program.solve(x, x[2:3], targets)

    def misses(inputs):
        here, before, missed = x, x[2], []
        for one, target in zip(inputs, targets, strict=True):
            here = plant.A @ here + plant.B[:, 0] * one
            missed += [*(1e3 * (plant.C @ here - target)), share * (one - before)]
            before = one
        return np.array(missed)

    # They are linear; SLSQP's own differences of their squares end its search too early.
    J = np.transpose([misses(one) - misses(np.zeros(12)) for one in np.eye(12)])
    rates = [{"type": "ineq", "fun": lambda u, s=sign: 0.6 - s * np.diff(u, prepend=x[2])}
             for sign in (1, -1)]  # fmt: skip
    other = minimize(lambda u: 0.5 * (misses(u) ** 2).sum(), np.full(12, x[2]), jac=lambda u: J.T @ misses(u),
                     bounds=[(-2.0, 3.0)] * 12, constraints=rates, method="SLSQP",
                     options={"ftol": 1e-12, "maxiter": 500})  # fmt: skip
    assert other.success
    assert found[0] == pytest.approx(other.x[0], abs=1e-3)
    by_state, by_last = program.feedback()
    assert by_state.shape == (1, 4) and by_last.shape == (1, 1)


def test_noise_is_filtered(drawn_rng):
    model = swing()
    control = PredictiveControl(model, PERIOD, AT, free(1), noise=2e-4)
    seen, _ = run(control, Plant(model), sine(), 400, noise=2e-4, rng=drawn_rng)
    assert rms(seen - wanted(sine(), 400)) < 3e-4


def test_hidden_outputs_are_predicted():
    model = swing(inputs=((1.0, 0.3), (0.2, 1.0)), is_by_effort=(True, True), modes=2)
    control = PredictiveControl(model, PERIOD, np.array([0, 1]), free(2))
    plant = Plant(model)

    def path(time):
        return np.array([sine()(time), 0.1])

    for tick in range(200):
        y = plant.at(0)
        control.measure(np.where([tick % 3 == 0, tick % 5 == 0], y, np.nan), 0.0)
        control.plan(np.array([path(PERIOD * (tick + 1 + i)) for i in range(HORIZON)]))
        planned = control.plan(np.array([path(PERIOD * (tick + 1 + i)) for i in range(HORIZON)]))
        control.send(planned.inputs)
        plant.step(planned.inputs)
    apart = np.array(plant.seen[1:]) - np.array([path(PERIOD * (i + 1)) for i in range(200)])
    assert rms(apart) < 0.03 * 5e-3


def test_lengths_move_what_they_hold_without_a_jump():
    model = swing(is_by_effort=(False,))
    control = PredictiveControl(model, PERIOD, AT, free(1))
    seen, _ = run(control, Plant(model), sine(), 200)
    assert rms(seen - wanted(sine(), 200)) < 0.03 * 5e-3


@pytest.mark.exhaustive
def test_the_margin_is_where_the_loop_begins_to_swing():
    model = swing()
    control = PredictiveControl(model, PERIOD, AT, free(1), delay=1)
    margin = stability_margin(control, 1)
    assert margin.is_enough and margin.growth < 1.0, margin.in_words()

    def grows(factor, more=0):
        control.reset()
        plant = Plant(replace(model, K=factor * model.K, H=model.H), 1 + more)
        plant.x[0] = 1e-4
        seen, _ = run(control, plant, lambda time: 0.1, 1500, age=1.0)
        apart = np.abs(seen - 0.1)
        return apart[-100:].max() > 1e-4

    assert not grows(0.98 * margin.softest + 0.02) and grows(0.93 * margin.softest)
    assert not grows(0.98 * margin.stiffest + 0.02) and grows(1.07 * margin.stiffest)
    ticks = round(margin.delay / PERIOD)
    assert not grows(1.0, ticks) and grows(1.0, ticks + 1)
    assert f"{margin.softest:.2f} to {margin.stiffest:.2f} times the stiffness" in margin.in_words()


def test_a_model_whose_second_mode_allows_less_is_controlled_more_calmly():
    model = swing(modes=2)
    assert not stability_margin(PredictiveControl(model, PERIOD, AT, free(1))).is_enough
    control, margin = with_margin(model, PERIOD, AT, free(1))
    assert margin.is_enough and control.tuning in TUNINGS[1:]
    for factor in (0.9, 1.1):
        control.reset()
        real = replace(model, K=factor * model.K)
        seen, _ = run(control, Plant(real, disturbance=2e-3), lambda time: 0.104, 1500)
        assert np.abs(seen[-20:] - 0.104).max() < 1e-6


def test_a_loop_that_is_not_stable_says_so():
    """A mode that falls over in a hundredth of a tick is lost before it is seen."""
    model = swing()
    falls = replace(model, K=-1e4 * model.K)
    with np.errstate(all="ignore"):
        margin = stability_margin(PredictiveControl(falls, 0.1, AT, free(1)))
    assert not margin.is_enough and margin.in_words().startswith("not stable")
