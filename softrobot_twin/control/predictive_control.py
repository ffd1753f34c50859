"""Predictive control of fast motion: a Kalman filter and a quadratic program over a linear model.

The model is that of `LinearModel.sampled`, a step for each tick, with x the modes and the last inputs.
A disturbance d on each measured output, constant but for a slow drift, takes up what the model does
wrong, so that a robot that stands is where it should be (offset-free control):

    x⁺ = A x + B u,    d⁺ = d,    y = C x + d.

**Filter.** A measurement belongs to the time of its stamp. The filter stands at the tick before the
newest measurement, with the covariance that follows from rates and gaps of the measurements; from
there x is predicted to the time at which a command of now takes effect, by the commands sent since.

**Program.** Inputs over the horizon are straight between knots, which are dense at first. The sum of
squares of y - target, of the moves of the inputs, each as a small share of the motion it makes at
rest, and of what moves no output away from the inputs of the model's state, is least within limits
and rates of the inputs, by DAQP. Only the input of the first tick is sent.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from softrobot_twin.analysis.linear_model import LinearModel, StateSpace
from softrobot_twin.solvers.daqp_program import solve_program

IDLE_SHARE = 1.0e-2
"""What moves no output costs as much as this share of the motion of the other inputs."""
LEAST_GAIN = 1.0e-3
"""Inputs that move the outputs by less than this share of the greatest gain move none."""
DRIFT = 0.14
"""Drift of the disturbance in a tick, as a standard deviation, by the noise of the outputs."""
MODE_DRIFT = 0.1
"""What the model misses of each mode in a tick, by the noise of the outputs."""
MOST_UNKNOWNS = 50
"""Unknowns of the program, so that it is solved in a part of a millisecond."""
LONGEST_PREDICTION = 200
"""Ticks that the filter is predicted ahead at most; without measurements it goes on behind."""
SCANNED, MOST_DELAY = np.geomspace(1.0, 4.0, 29)[1:], 30
"""Factors of the stiffness, and their inverses, and ticks of delay that a margin is looked for in."""
LEAST_MARGIN = 0.1
"""A control is used where it bears a stiffness that is wrong by this share."""
FARTHEST = 0.1
"""Inputs are scaled by their ranges, or by a motion of this size [m]: their units differ."""
KILO = 1.0e3
"""Lengths of the program are in millimetres, of which the solver's tolerances are for."""


class Tuning(NamedTuple):
    """How fast a control reacts: the faster, the less the model may be wrong.

    Attributes:
        move_share: A move of an input costs as much as this share of the motion it makes at rest.
        model_error: What the model misses in a tick, as an error of each input whose motion at rest is
            so many standard deviations of the noise of the outputs.
    """

    move_share: float
    model_error: float


TUNINGS = (Tuning(0.1, 1.5), Tuning(0.3, 0.75), Tuning(1.0, 0.4), Tuning(1.0, 0.2), Tuning(3.0, 0.1))
"""From fast to calm."""


class InputRange(NamedTuple):
    """What the inputs may be, in their units, each of shape (input_count,).

    Attributes:
        low: Least inputs.
        high: Greatest inputs.
        rates: Greatest rates, in units per second; infinite without a limit.
    """

    low: np.ndarray
    high: np.ndarray
    rates: np.ndarray


class Planned(NamedTuple):
    """What a tick found.

    Attributes:
        inputs: Inputs to send, shape (input_count,).
        is_solved: Whether the program was solved; else the inputs are those of the tick before.
    """

    inputs: np.ndarray
    is_solved: bool


def knots_of(horizon: int, input_count: int) -> np.ndarray:
    """Ticks of the knots between which inputs are straight, 0 the first, dense at the beginning.

    Args:
        horizon: Ticks of the horizon.
        input_count: Number of inputs.
    """
    count = int(np.clip(MOST_UNKNOWNS // input_count, 4, horizon))
    if count == horizon:
        return np.arange(horizon)
    # The distances grow by one factor, and are at least one tick.
    grown = np.geomspace(1.0, horizon, count) - 1.0
    knots = np.arange(count)
    for place in range(1, count):
        knots[place] = max(knots[place - 1] + 1, round(grown[place]))
    return knots


class PredictiveControl:
    """Offset-free predictive control of some outputs of a linear model.

    Attributes:
        model: The linear model.
        period: Time of a tick [s].
        outputs: Which outputs of the model are controlled and measured, shape (controlled_count,).
        horizon: Ticks over which it looks ahead.
        delay: Ticks from a command to its effect.
        tuning: How fast it reacts.
        last_inputs: Inputs that were sent last, shape (input_count,).
        innovation: Measured minus expected outputs of the newest measurement [m], same shape.
    """

    def __init__(
        self, model: LinearModel, period: float, outputs: np.ndarray, allowed: InputRange,
        noise: float = 1.0e-4, horizon: int = 25, delay: int = 0, tuning: Tuning = TUNINGS[0],
    ):  # fmt: skip
        """Build the filter and the program.

        Args:
            model: The linear model.
            period: Time of a tick [s].
            outputs: Which outputs are controlled and measured, shape (controlled_count,).
            allowed: Limits of the inputs.
            noise: Standard deviation of each measured output [m].
            horizon: Ticks over which it looks ahead.
            delay: Ticks from a command to its effect.
            tuning: How fast it reacts.
        """
        self.tuning = tuning
        self.model, self.period, self.outputs = model, period, outputs
        self.horizon, self.delay, self._noise = horizon, delay, noise
        plant = plant_of(model, period, outputs)
        self._A, self._B, self._C = plant.A, plant.B, plant.C
        self._size, self._input_count = plant.B.shape
        self._allowed, self._reach = allowed, allowed.rates * period
        self._gain = model.static_gain[outputs]
        middle = model.input_values
        self._scales = scales = _scales(self._gain, allowed)
        around = InputRange((allowed.low - middle) / scales, (allowed.high - middle) / scales,
                            allowed.rates / scales)  # fmt: skip
        scaled = plant._replace(B=plant.B * scales)
        self._program = Program(scaled, self._gain * scales, around, horizon, period, tuning.move_share)
        self._process_noise = self._noise_of_steps()
        self._settled = self._settled_covariance()
        self.reset()

    def reset(self, inputs: np.ndarray | None = None, at: np.ndarray | None = None) -> None:
        """Begins anew, at rest.

        Args:
            inputs: Inputs under which the robot stands, shape (input_count,); None for those of the
                model's state.
            at: Where the outputs stand [m], shape (controlled_count,); None for where the model
                expects them.
        """
        before = self.model.input_values if inputs is None else inputs
        self._x = self._standing(before - self.model.input_values)
        if at is not None:
            self._x[-len(self.outputs):] = at - self.model.output_values[self.outputs] - self._C @ self._x
        self._covariance = self._settled.copy()
        self._tick = self._seen = 0
        # Inputs that take effect in the ticks from `_seen` on.
        self._sent: deque[np.ndarray] = deque([before - self.model.input_values] * self.delay)
        self.last_inputs = before.copy()
        self.innovation = np.zeros(len(self.outputs))

    def _standing(self, inputs: np.ndarray) -> np.ndarray:
        """States of a robot that stands under inputs, shape (state_count,)."""
        modes = self.model.H.shape[1]
        x = np.zeros(self._size)
        x[:modes] = np.linalg.solve(self.model.K, self.model.H.T @ inputs)
        x[modes : 2 * modes] = -self.model.H_rates.T @ inputs
        x[2 * modes : 2 * modes + self._input_count] = inputs
        return x

    def measure(self, outputs: np.ndarray, age: float) -> None:
        """Takes a measurement; one that is older than another before is not used.

        Args:
            outputs: Measured outputs [m], shape (controlled_count,); NaN where they are hidden.
            age: How long before this tick it was taken [s].
        """
        when = self._tick - max(age, 0.0) / self.period
        tick = int(np.floor(when))
        if tick < self._seen or tick > self._tick:
            return
        while self._seen < tick:
            self._advance()
        share = when - tick
        is_seen = np.isfinite(outputs)
        C, expected = self._C, self._C @ self._x
        if share > 0.0 and self._sent:
            after = self._A @ self._x + self._B @ self._sent[0]
            expected = (1.0 - share) * expected + share * (self._C @ after)
            C = (1.0 - share) * C + share * (C @ self._A)
        expected += self.model.output_values[self.outputs]
        C = C[is_seen]
        self.innovation = np.where(is_seen, outputs - expected, 0.0)
        cross = self._covariance @ C.T
        gain = np.linalg.solve(C @ cross + self._noise**2 * np.eye(len(C)), cross.T).T
        self._x = self._x + gain @ self.innovation[is_seen]
        self._covariance -= gain @ cross.T

    def _advance(self) -> None:
        """The filter goes on by a tick."""
        self._x = self._A @ self._x + self._B @ self._sent.popleft()
        self._covariance = self._A @ self._covariance @ self._A.T + self._process_noise
        self._seen += 1

    def plan(self, targets: np.ndarray) -> Planned:
        """Finds the inputs of this tick.

        Args:
            targets: Where the outputs shall be at the ends of the coming ticks, from the effect of
                these inputs on [m], shape (horizon, controlled_count).
        """
        while len(self._sent) > LONGEST_PREDICTION:
            self._advance()
        x = self._x
        for inputs in self._sent:
            x = self._A @ x + self._B @ inputs
        last = (self.last_inputs - self.model.input_values) / self._scales
        found = self._program.solve(x, last, targets - self.model.output_values[self.outputs])
        inputs = self.last_inputs if found is None else self._scales * found + self.model.input_values
        low, high = self._allowed.low, self._allowed.high
        low, high = np.maximum(low, self.last_inputs - self._reach), np.minimum(high, self.last_inputs + self._reach)
        inputs = np.maximum(np.minimum(inputs, high), low)
        return Planned(inputs, found is not None)

    def send(self, inputs: np.ndarray) -> None:
        """Takes what was sent in this tick, and goes on to the next.

        Args:
            inputs: Shape (input_count,).
        """
        self._sent.append(inputs - self.model.input_values)
        self.last_inputs = np.array(inputs)
        self._tick += 1

    def _noise_of_steps(self) -> np.ndarray:
        """Covariance of what the model misses in a tick, shape (state_count, state_count)."""
        gains = _gains(self._gain * self._scales)
        by_inputs = self._B * (self.tuning.model_error * self._noise * self._scales / gains)
        drift = 1.0e-8 * (by_inputs**2).max(axis=1)  # Units of the states differ.
        drift[-len(self.outputs) :] = (DRIFT * self._noise) ** 2
        seen = np.linalg.norm(self.model.E[self.outputs], axis=0)
        seen = np.maximum(seen, LEAST_GAIN * seen.max(initial=0.0))
        drift[: len(seen)] += (MODE_DRIFT * self._noise / seen) ** 2
        return by_inputs @ by_inputs.T + np.diag(drift)

    def _settled_covariance(self) -> np.ndarray:
        """Covariance after measurements in all ticks, shape (state_count, state_count)."""
        P, R = self._process_noise.copy(), self._noise**2 * np.eye(len(self._C))
        for _ in range(LONGEST_PREDICTION):
            cross = P @ self._C.T
            P = P - cross @ np.linalg.solve(self._C @ cross + R, cross.T)
            P = self._A @ P @ self._A.T + self._process_noise
        return P

    def filter_gain(self) -> np.ndarray:
        """Gain of the filter with measurements in all ticks, shape (state_count, controlled_count)."""
        cross = self._settled @ self._C.T
        R = self._noise**2 * np.eye(len(self._C))
        return np.linalg.solve(self._C @ cross + R, cross.T).T

    def feedback(self) -> np.ndarray:
        """Inputs by the states while no limit holds, shape (input_count, state_count)."""
        on_states, on_last = self._program.feedback()
        first = self._size - len(self.outputs) - self._input_count
        on_states[:, first : first + self._input_count] += on_last / self._scales
        return self._scales[:, None] * on_states


def plant_of(model: LinearModel, period: float, outputs: np.ndarray) -> StateSpace:
    """A step of some outputs of a model in a tick, with a disturbance on each of them.

    Args:
        model: The linear model.
        period: Time of a tick [s].
        outputs: Which outputs, shape (controlled_count,).
    """
    A, B, C, D = model.sampled(period)
    count, own = len(outputs), np.eye(len(outputs))
    return StateSpace(block_diag(A, own), np.vstack([B, np.zeros((count, B.shape[1]))]),
                      np.hstack([C[outputs], own]), D[outputs])  # fmt: skip


class Program:
    """The quadratic program of a tick in the values of the inputs at knots."""

    def __init__(
        self, plant: StateSpace, gain: np.ndarray, allowed: InputRange, horizon: int, period: float,
        move_share: float,
    ):  # fmt: skip
        """Condense the horizon.

        Args:
            plant: A step of the model, by scaled inputs.
            gain: Outputs at rest by the inputs, shape (controlled_count, input_count).
            allowed: Limits of the inputs, as deviations.
            horizon: Ticks.
            period: Time of a tick [s].
            move_share: See `Tuning`.
        """
        A, B, C, _ = plant
        (size, k), p = B.shape, len(C)
        self._knots = knots_of(horizon, k)
        ticks = np.arange(horizon)
        shares = np.array([np.interp(ticks, self._knots, row) for row in np.eye(len(self._knots))]).T
        spread = np.kron(shares, np.eye(k))
        # Outputs by the states, and by an input so many ticks before.
        free, answers, power = [], [], np.eye(size)
        for _ in range(horizon):
            answers.append(C @ power @ B)
            power = A @ power
            free.append(C @ power)
        forced = np.zeros((horizon * p, horizon * k))
        for i in range(horizon):
            for j in range(i + 1):
                forced[i * p : (i + 1) * p, j * k : (j + 1) * k] = answers[i - j]
        forced, self._free = KILO * forced @ spread, KILO * np.vstack(free)
        by_move = move_share * _gains(KILO * gain)
        moves = np.kron(np.eye(horizon) - np.eye(horizon, k=-1), np.diag(by_move)) @ spread
        idle = IDLE_SHARE * np.kron(np.eye(len(self._knots)), _idle(KILO * gain))
        self._hessian = np.ascontiguousarray(forced.T @ forced + moves.T @ moves + idle.T @ idle)
        self._by_state = forced.T @ self._free
        # The first move is from the inputs of the tick before.
        self._by_last = -moves.T[:, :k] * by_move
        self._forced = forced
        count = len(self._knots)
        self._low, self._high = np.tile(allowed.low, count), np.tile(allowed.high, count)
        spans = np.diff(self._knots, prepend=-1)
        limited = np.isfinite(allowed.rates)
        steps = np.kron(np.eye(count) - np.eye(count, k=-1), np.eye(k))
        self._limited = np.tile(limited, count)
        self._steps = np.ascontiguousarray(steps[self._limited])
        self._reach = np.kron(spans * period, np.where(limited, allowed.rates, 0.0))[self._limited]
        self._k, self._is_first = k, np.arange(count * k) < k

    def solve(self, x: np.ndarray, last: np.ndarray, targets: np.ndarray) -> np.ndarray | None:
        """The inputs of the first tick, as deviations; None where the program is not solved.

        Args:
            x: States, shape (state_count,).
            last: Inputs of the tick before, shape (input_count,).
            targets: From where outputs are counted [m], shape (horizon, controlled_count).

        Returns:
            Shape (input_count,).
        """
        gradient = self._by_state @ x + self._by_last @ last
        gradient -= self._forced.T @ (KILO * targets.ravel())
        held = np.where(self._is_first, np.tile(last, len(self._knots)), 0.0)[self._limited]
        upper = np.concatenate([self._high, held + self._reach])
        lower = np.concatenate([self._low, held - self._reach])
        found = solve_program(self._hessian, gradient, self._steps, lower, upper)
        return found.x[: self._k] if found.is_found else None

    def feedback(self) -> tuple[np.ndarray, np.ndarray]:
        """Inputs of the first tick by the states, and by the last inputs, without limits.

        Returns:
            Shapes (input_count, state_count) and (input_count, input_count).
        """
        return tuple(-np.linalg.solve(self._hessian, one)[: self._k]
                     for one in (self._by_state, self._by_last))  # fmt: skip


def _gains(gain: np.ndarray) -> np.ndarray:
    """Motion of the outputs at rest by each input over its range, at least a share of the greatest."""
    gains = np.linalg.norm(gain, axis=0)
    return np.maximum(gains, LEAST_GAIN * gains.max(initial=0.0))


def _scales(gain: np.ndarray, allowed: InputRange) -> np.ndarray:
    """Range of each input, or what moves the outputs by `FARTHEST` where it is wider, shape (k,)."""
    gains = np.linalg.norm(gain, axis=0)
    moves = np.divide(FARTHEST, gains, out=np.full_like(gains, np.inf), where=gains > 0.0)
    scales = np.minimum(allowed.high - allowed.low, moves)
    return np.where(np.isfinite(scales) & (scales > 0.0), scales, 1.0)


def _idle(gain: np.ndarray) -> np.ndarray:
    """Rows that weigh what moves no output, shape (input_count, input_count).

    Args:
        gain: Outputs at rest by the inputs, shape (controlled_count, input_count).
    """
    scales = np.linalg.norm(gain, axis=0)
    scales = np.where(scales > 0.0, scales, scales.max(initial=0.0) or 1.0)
    _, sizes, V = np.linalg.svd(gain / scales, full_matrices=True)
    rank = int(np.count_nonzero(sizes > LEAST_GAIN * sizes.max(initial=0.0)))
    return (V[rank:].T @ V[rank:]) * scales


class StabilityMargin(NamedTuple):
    """How wrong the model may be while the loop without limits stays stable.

    Attributes:
        softest: Stiffness of the robot by that of the model down to which it is stable.
        stiffest: The same, up to which.
        delay: Delay that may come on top [s].
        growth: Greatest factor by which deviations grow in a tick, below 1 where it is stable.
    """

    softest: float
    stiffest: float
    delay: float
    growth: float

    @property
    def is_enough(self) -> bool:
        """Whether it bears the errors that real robots have at least."""
        return (self.growth < 1.0 and self.softest <= 1.0 - LEAST_MARGIN
                and self.stiffest >= 1.0 + LEAST_MARGIN and self.delay > 0.0)  # fmt: skip

    def in_words(self) -> str:
        """What a user reads."""
        if self.growth >= 1.0:
            return f"not stable: deviations grow by {self.growth:.3f} in a tick"
        stiff = f"{self.stiffest:.2f}" + (" or more" if self.stiffest >= SCANNED[-1] else "")
        return (f"stable for {self.softest:.2f} to {stiff} times the stiffness of the model, and for "
                f"{1e3 * self.delay:.0f} ms of delay more")


def stability_margin(control: PredictiveControl, age: int = 0) -> StabilityMargin:
    """The margin of a control whose measurements arrive in each tick.

    Args:
        control: The control.
        age: Age of the measurements, in ticks.
    """
    growth = _growth(control, age, 1.0, 0)
    if growth >= 1.0:
        return StabilityMargin(1.0, 1.0, 0.0, growth)

    def farthest(factors: np.ndarray) -> float:
        stable = 1.0
        for factor in factors:
            if _growth(control, age, factor, 0) >= 1.0:
                break
            stable = float(factor)
        return stable

    more = next((n for n in range(1, MOST_DELAY) if _growth(control, age, 1.0, n) >= 1.0), MOST_DELAY)
    return StabilityMargin(farthest(1.0 / SCANNED), farthest(SCANNED), (more - 1) * control.period, growth)


def with_margin(
    model: LinearModel, period: float, outputs: np.ndarray, allowed: InputRange, age: int = 0, **options
) -> tuple[PredictiveControl, StabilityMargin]:
    """The fastest control whose margin is enough; the calmest where none is.

    Args:
        model: The linear model.
        period: Time of a tick [s].
        outputs: Which outputs are controlled and measured, shape (controlled_count,).
        allowed: Limits of the inputs.
        age: Age of the measurements, in ticks.
        **options: See `PredictiveControl`.
    """
    for tuning in TUNINGS:
        control = PredictiveControl(model, period, outputs, allowed, tuning=tuning, **options)
        margin = stability_margin(control, age)
        if margin.is_enough:
            break
    return control, margin


def _growth(control: PredictiveControl, age: int, factor: float, more: int) -> float:
    """Spectral radius of the loop with a robot of another stiffness and more delay.

    Args:
        control: The control.
        age: Age of the measurements, in ticks.
        factor: Stiffness of the robot by that of the model.
        more: Ticks of delay of which the control does not know.
    """
    model = control.model
    forces = np.where(model.is_by_effort, 1.0, factor)  # Held displacements pull the more.
    real = replace(model, K=factor * model.K, H=forces[:, None] * model.H, D=model.D * forces / factor)
    plant = plant_of(real, control.period, control.outputs)
    A, B, C, _ = plant_of(model, control.period, control.outputs)
    gain, feedback = control.filter_gain(), control.feedback()
    ahead, (size, k), p = age + control.delay, B.shape, len(C)

    def step(x, seen, guess, sent):
        """The robot, outputs on their way, the filter at their time, and inputs on their way."""
        seen = [plant.C @ x, *seen]
        guess = guess + gain @ (seen[age] - C @ guess)
        after = guess
        for inputs in sent[more : more + ahead]:
            after = A @ after + B @ inputs
        sent = [*sent, feedback @ after]
        takes, knows = sent[age], sent[more]
        return plant.A @ x + plant.B @ takes, seen[:age], A @ guess + B @ knows, sent[1:]

    widths = [size, *[p] * age, size, *[k] * (ahead + more)]
    columns = []
    for unit in np.eye(sum(widths)):
        parts = np.split(unit, np.cumsum(widths)[:-1])
        x, seen, guess, sent = step(parts[0], parts[1 : 1 + age], parts[1 + age], parts[2 + age :])
        columns.append(np.concatenate([x, *seen, guess, *sent]))
    # The disturbances of the robot itself stay as they are.
    kept = np.r_[: size - p, size : sum(widths)]
    loop = np.array(columns).T[np.ix_(kept, kept)]
    return float(np.abs(np.linalg.eigvals(loop)).max()) if np.isfinite(loop).all() else np.inf
