"""The pneumatic robots of the package over their range, against converged solids."""

import pytest
from pressure_ranges import ROBOTS, errors_of


@pytest.mark.exhaustive
@pytest.mark.parametrize("name, way", [
    (name, way) for name, robot in ROBOTS.items() for way in robot.ways
])  # fmt: skip
def test_a_robot_moves_as_a_converged_solid_over_its_range(name, way):
    errors = errors_of(name, way)
    print(name, way, errors)
    assert (errors < 0.15).all()
