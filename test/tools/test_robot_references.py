"""References of shipped robots: what errors of elements are measured against."""

import numpy as np
import pytest
import robot_references
from robot_references import CASES, errors_of, read_references, scene_of

from softrobot_twin.simulation.mesh_error import MeshErrorEstimator

pytestmark = pytest.mark.sampled


@pytest.fixture(scope="module")
def known():
    return read_references()


UNSURE = {"fetch": (0.25, 0.04), "pneunet": (0.15, 0.05), "segment": (0.04, 0.4)}
"""Robots whose meshes are too coarse for a reference that is known well."""


def test_every_robot_has_a_reference_and_says_how_well_it_is_known(known):
    assert known.keys() == CASES.keys()
    for name, entry in known.items():
        assert entry["mesh"] == CASES[name].fine[1]
        efforts, setpoints = UNSURE.get(name, (0.03, 0.03))
        assert 0.0 < entry["by_effort_uncertainty"] < efforts, name
        assert 0.0 < entry["by_setpoint_uncertainty"] < setpoints, name


def test_a_reference_is_that_of_its_meshes(known, monkeypatch, tmp_path):
    """Of the finger, whose meshes are small."""
    monkeypatch.setattr(robot_references, "FILE", tmp_path / "references.yaml")
    monkeypatch.setattr("sys.argv", ["robot_references", "finger"])
    robot_references.main()
    found = read_references()["finger"]
    for key in ("by_effort", "by_setpoint"):
        np.testing.assert_allclose(found[key], known["finger"][key], rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("mesh, forces, lengths, state", [
    ("diamond_200.vtk", 0.08, 0.025, 0.04), ("diamond_600.vtk", 0.04, 0.025, 0.04),
])  # fmt: skip
def test_smoothed_elements_of_the_diamond_are_near_its_reference(
    known, mesh, forces, lengths, state
):
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
    ("diamond", "diamond_200.vtk"), ("diamond", "diamond_400.vtk"), ("springy", "springy_400.msh"),
    ("octoleg", "octoleg_120.vtk"), ("octoleg", "octoleg_173.vtk"), ("octoleg", "octoleg_400.vtk"),
    ("finger", "finger_99.msh"),
)  # fmt: skip


@pytest.mark.parametrize("element", ["linear", "smoothed"])
@pytest.mark.parametrize("name, mesh, given", [
    pytest.param(*robot, given,
                 marks=FACETED if robot[0] == "springy" and given == "lengths" else ())
    for given in ("forces", "lengths") for robot in ROBOTS
])  # fmt: skip
def test_the_estimate_of_the_mesh_s_error_is_near_that_by_the_reference(
    known, name, mesh, given, element
):
    scene, reference = scene_of(CASES[name], mesh, element), known[name]
    true = getattr(errors_of(name, mesh, element, reference), given)
    loads = [one for one in MeshErrorEstimator(scene).at_rest().own.loads if one.load != "gravity"]
    told = max(getattr(one, given) for one in loads)
    key = {"forces": "by_effort", "lengths": "by_setpoint"}[given]
    doubt = reference[f"{key}_uncertainty"]
    assert (true - doubt) / 1.5 <= told <= 1.5 * (true + doubt)
