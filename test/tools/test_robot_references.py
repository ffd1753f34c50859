"""References of shipped robots: what errors of elements are measured against."""

from functools import cache

import pytest
from robot_references import CASES, errors_of, read_references, scene_of

from softrobot_twin.analysis.mesh_error import MeshErrorEstimator

pytestmark = pytest.mark.sampled


@pytest.fixture(scope="module")
def known():
    return read_references()


@pytest.mark.parametrize("mesh, forces, lengths, state", [
    ("diamond_200.vtk", 0.08, 0.025, 0.04), ("diamond_600.vtk", 0.04, 0.025, 0.04),
])  # fmt: skip
def test_smoothed_elements_of_the_diamond_are_near_its_reference(known, mesh, forces, lengths, state):
    smoothed, linear = (errors_of("diamond", mesh, element, known["diamond"])
                        for element in ("smoothed", "linear"))  # fmt: skip
    assert smoothed.forces < forces < 0.5 * linear.forces
    assert smoothed.lengths < lengths < 0.5 * linear.lengths
    assert smoothed.state < state < 0.3 * linear.state


FACETED = pytest.mark.xfail(
    strict=True, reason="the facets of this mesh change what a volume moves by 5 %, which the "
    "estimate, on the same facets, cannot see",
)  # fmt: skip
ROBOTS = (
    ("diamond", "diamond_200.vtk"), ("springy", "springy_400.msh"), ("octoleg", "octoleg_120.vtk"),
    ("octoleg", "octoleg_400.vtk"), ("finger", "finger_99.msh"),
)  # fmt: skip


@cache
def compared(name, mesh, element):
    """Errors of a mesh against the reference, and what is told of each of its loads."""
    loads = MeshErrorEstimator(scene_of(CASES[name], mesh, element)).at_rest().own.loads
    return (errors_of(name, mesh, element, read_references()[name]),
            [one for one in loads if one.load != "gravity"])  # fmt: skip


@pytest.mark.exhaustive
@pytest.mark.parametrize("element", ["linear", "smoothed"])
@pytest.mark.parametrize("name, mesh, given", [
    pytest.param(*robot, given,
                 marks=FACETED if robot[0] == "springy" and given == "lengths" else ())
    for robot in ROBOTS for given in ("forces", "lengths")
])  # fmt: skip
def test_the_estimate_of_the_mesh_s_error_is_near_that_by_the_reference(known, name, mesh, given, element):
    errors, loads = compared(name, mesh, element)
    true, told = getattr(errors, given), max(getattr(one, given) for one in loads)
    key = {"forces": "by_effort", "lengths": "by_setpoint"}[given]
    doubt = known[name][f"{key}_uncertainty"]
    assert (true - doubt) / 1.5 <= told <= 1.5 * (true + doubt)
