"""Steps of shipped robots against docs/bench.csv: a step does not grow unnoticed."""

import pytest
from step_overhead import MORE_CALLS, overhead_of, read_earlier

from softrobot_twin.study.bench_measurement import given_cases
from test.places import ROOT

REFERENCE = read_earlier(ROOT / "docs" / "bench.csv")
# On another processor a robot may take another branch now and then.
MARGIN = 1.03


@pytest.mark.sampled
@pytest.mark.parametrize("robot", ["diamond", "diamond_reduced", "fetch_reduced", "finger", "grasper"])
def test_a_step_makes_no_more_calls_than_in_the_reference(robot):
    held = ROOT / "config" / "commands" / "grasper_lift.csv" if robot == "grasper" else None
    case, = given_cases([ROOT / "config" / "scenes" / f"{robot}.yaml"], held)
    _, calls = REFERENCE[robot]
    assert overhead_of(case).calls <= MARGIN * MORE_CALLS * calls
