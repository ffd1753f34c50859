"""The pneumatic robots of the package over their range, against converged solids."""

import numpy as np
import pressure_ranges
import pytest
from pressure_ranges import ROBOTS, SHARES, error_lines, errors_of, read_references


def test_every_robot_has_a_reference_of_each_way():
    known = read_references()
    assert known.keys() == ROBOTS.keys()
    for name, robot in ROBOTS.items():
        assert known[name].keys() == {"mesh", *robot.ways} and known[name]["mesh"] == robot.mesh
        for way in robot.ways:
            sizes = np.linalg.norm(known[name][way], axis=1)
            assert len(sizes) == len(SHARES) and (np.diff(sizes) > 0.0).all(), (name, way)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name, way", [
    (name, way) for name, robot in ROBOTS.items() for way in robot.ways
])  # fmt: skip
def test_a_robot_moves_as_a_converged_solid_over_its_range(name, way):
    errors = errors_of(name, way)
    print(name, way, errors)
    assert (errors < 0.15).all()


def test_the_springy_does_so_and_the_table_shows_it():
    lines = list(error_lines(["springy"]))
    assert len(lines) == 3 and {line.count("|") for line in lines} == {8}
    assert (errors_of("springy", "the chamber") < 0.05).all()


def test_a_reference_is_kept_in_the_file(monkeypatch, tmp_path):
    found = np.array([[0.0, 0.0, -0.01]]) * np.array(SHARES)[:, None]
    monkeypatch.setattr(pressure_ranges, "FILE", tmp_path / "references.yaml")
    monkeypatch.setattr(pressure_ranges, "limits_of", lambda *given: found)
    monkeypatch.setattr("sys.argv", ["pressure_ranges", "springy"])
    pressure_ranges.main()
    known = read_references()["springy"]
    np.testing.assert_allclose(known["the chamber"], found)
