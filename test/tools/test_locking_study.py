"""The study of locking on a robot, at the size of a test."""

import locking_study
import numpy as np
import pytest
from locking_study import robot_lines, robot_row


@pytest.fixture
def short_ramp(monkeypatch):
    monkeypatch.setattr(locking_study, "RAMP", np.array([0.25, 0.5, 0.75, 1.0, 1.0]))


def test_the_diamond_of_linear_tetrahedra_locks_less_with_patches(short_ramp):
    efforts = np.array([1.0, 0.0, 0.0, 0.0])
    locked, freed = (
        robot_row("diamond", "diamond_150.vtk", "linear", volume, 0.4999, efforts)
        for volume in ("per_element", "patches")
    )
    assert np.linalg.norm(freed.moved) > 1.4 * np.linalg.norm(locked.moved)
    assert freed.unknowns == locked.unknowns
    assert min(freed.assembly, freed.factor, freed.step) > 0.0


def test_a_table_names_error_and_times_of_each_setting(short_ramp):
    settings = [("diamond_150.vtk", "linear", "patches")]
    lines = list(robot_lines("diamond", settings, 0.49, (1.0, 0.0, 0.0, 0.0)))
    assert "ν 0.49" in lines[0] and len(lines) == 4
    assert len({line.count("|") for line in lines[1:]}) == 1
    assert "| 0 |" in lines[-1]
