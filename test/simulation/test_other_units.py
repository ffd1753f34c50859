"""A robot in other units of length, mass and time takes the same steps.

The other units are powers of two, which change no digit of a number. So what differs by more than
round-off hangs on a constant with a unit that stands in the code.
"""

from functools import partial

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.entry import Entry
from softrobot_twin.scene.refusal_messages import unit_at
from softrobot_twin.tables.column_names import unit_of
from test.places import SCENES

pytest.importorskip("pandas")
LENGTH, MASS, TIME = 8.0, 0.25, 2.0
FORCE = LENGTH * MASS / TIME**2
FACTORS = {"m": LENGTH, "kg": MASS, "s": TIME, "N": FORCE, "Pa": FORCE / LENGTH**2, "J": FORCE * LENGTH,
           "m3": LENGTH**3, "Nm": FORCE * LENGTH, "N_per_m": FORCE / LENGTH}  # fmt: skip
# The units that values have in these scenes where entries may have several.
CHOSEN = {"Pa/s or m³/s": "Pa/s", "m or rad": "rad", "m, N, Pa or m³": "m"}
# How far the actuators go.
FAR = {"_shortening_m": 0.004, "_pressure_Pa": 4.0e3, "_angle_rad": 0.2}
NAMES = ("finger", "octoleg", "bar_hexahedra", "tdcr", "diamond", "emio", "fast_trunk", "finray", "flexo",
         "grasper", "pneunet", "pneunet_inverse", "segment", "stifface", "strider", "fast_pneunet",
         "trunk_cylinders", pytest.param("fetch", marks=pytest.mark.exhaustive))


def _factor(unit):
    """Of a value with a unit such as N s/m."""
    factor = 1.0
    for symbols, sign in zip(CHOSEN.get(unit, unit).split("/"), (1, -1)):
        for symbol in symbols.split():
            power = {"²": 2, "³": 3, "⁴": 4}.get(symbol[-1], 1)
            factor *= FACTORS.get(symbol.rstrip("²³⁴"), 1.0) ** (sign * power)
    return factor


def _multiplied(factor, value):
    """Each number of a value times a factor."""
    if isinstance(value, dict):
        return {key: _multiplied(factor, one) for key, one in value.items()}
    if isinstance(value, tuple):
        return tuple(_multiplied(factor, one) for one in value)
    return value * factor if isinstance(value, float) else value


def _in_other_units(entry):
    """An entry with all values in the other units; the constants of a law of materials are stresses."""
    changes = {}
    for name in type(entry).model_fields:
        value, unit = getattr(entry, name), "Pa" if name == "constants" else unit_at(type(entry), (name,))
        first = value[0] if isinstance(value, tuple) and value else value
        if isinstance(first, Entry):
            changes[name] = _in_other_units
        elif unit:
            changes[name] = partial(_multiplied, _factor(unit))
    return entry.changed(**changes)


def _commands(robot, factors, rng):
    """Setpoints that grow, then targets near the effectors."""
    far = {name: rng.uniform(0.2, 1.0) * most * factors.get(unit_of(name), 1.0)
           for name in robot.setpoint_names for end, most in FAR.items()
           if name.endswith(end) and not name.startswith("grip_")}  # fmt: skip
    away = {name: rng.uniform(-0.003, 0.003, 3) * factors["m"] for name in robot.effectors}
    for share in (0.3, 0.6, 1.0):
        yield st.setpoints(**{name: share * most for name, most in far.items()}) if far else st.hold()
    begin = robot.effectors
    for share in (0.5, 1.0, 1.0):
        yield st.targets(**{name: begin[name] + share * away[name] for name in away}) if away else st.hold()


def _rows(scene, factors, seed):
    """The columns of each step, in the units of the first robot."""
    robot = st.Robot(scene)
    for command in _commands(robot, factors, np.random.default_rng(seed)):
        table = robot.run(command, rate=50.0 / factors["s"])
        yield {name: table[name].iloc[0] / factors.get(unit_of(name), 1.0) for name in table.columns
               if table[name].dtype == float and name != "compute_time_s"}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_in_other_units_takes_the_same_steps(name, drawn_seed):
    # The usual tolerance is some part of a millimetre, whatever the size of the robot.
    scene = load_scene(SCENES / f"{name}.yaml").changed(solver={"reach_tolerance": 1.0e-5})
    first = _rows(scene, dict.fromkeys(FACTORS, 1.0), drawn_seed)
    for one, two in zip(first, _rows(_in_other_units(scene), FACTORS, drawn_seed), strict=True):
        assert len(one) > 5
        for column, value in one.items():
            # A component that is nearly zero has the round-off of the others.
            largest = abs(np.nan_to_num([one[name] for name in one if unit_of(name) == unit_of(column)])).max()
            assert two[column] == pytest.approx(value, 1.0e-5, 1.0e-9 + 1.0e-6 * largest, nan_ok=True), column
