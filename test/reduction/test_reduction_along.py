"""Training along a path of targets, in the contact of the scene."""

import numpy as np
import pytest
import yaml

from softrobot_twin.reduction.reduction_states import (
    Sampling,
    StateFinder,
    TargetWay,
    columns_of,
    passes,
    samples_along,
    training_scene,
)
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation
from test.scene_changes import entries_of, repeat_step

# The tip leans towards the rod beside the column and goes on along it.
CORNERS = np.array([
    [0.0, 0.010, 0.010, 0.0985], [1.0, 0.017, 0.010, 0.0970], [2.0, 0.017, 0.014, 0.0965],
])  # fmt: skip
IN_CONTACT = Sampling("body", in_contact=True)


@pytest.fixture(scope="module")
def beside_a_rod(column, tmp_path_factory):
    """Scene file of the column with a rod beside it; and the file of a path of its tip."""
    mapping = entries_of(column, {"body.mesh.file": str(column.parent / "column.vtk")})
    mapping["obstacles"] = [{"name": "rod", "cylinder": {
        "ends": [[0.0265, -0.05, 0.07], [0.0265, 0.07, 0.07]], "radius": 0.005}}]
    mapping["contact"] = {"between": [{"pair": ["body", "rod"]}]}
    folder = tmp_path_factory.mktemp("along")
    scene, path = folder / "rod.yaml", folder / "path.csv"
    scene.write_text(yaml.safe_dump(mapping))
    times = np.linspace(0.0, 2.0, 21)
    columns = [np.interp(times, CORNERS[:, 0], column) for column in CORNERS.T[1:]]
    np.savetxt(path, np.column_stack([times, *columns]), delimiter=",", comments="",
               header="time_s,tip_x_m,tip_y_m,tip_z_m")  # fmt: skip
    return scene, path


@pytest.fixture(scope="module")
def finder(beside_a_rod):
    return StateFinder(training_scene(load_scene(beside_a_rod[0]), IN_CONTACT), "body")


def way(radius=0.0):
    return TargetWay(CORNERS[:, 0], CORNERS[:, None, 1:], radius)


@pytest.mark.parametrize("count", [1, 2, 41, 42, 130])
def test_passes_hold_every_sample_once_in_order(count):
    found = passes(count)
    assert np.concatenate(found).tolist() == list(range(count))
    assert max(map(len, found)) <= 41 and min(map(len, found)) > 0


def test_samples_along_a_path_are_its_targets_each_pass_shifted_as_a_whole(finder):
    columns, radius = columns_of(finder.simulation), 0.002
    samples = samples_along(finder.simulation, way(radius), 81, seed=3)
    _, targets, forces, gravity = columns.split(samples)
    assert np.isnan(targets[0]).all() and not forces.size
    assert (gravity == [0.0, 0.0, -9.81]).all()
    plain = columns.split(samples_along(finder.simulation, way(), 81, seed=3))[1]
    for tour in passes(81):
        shifts = (targets - plain)[tour[tour > 0], 0]
        np.testing.assert_allclose(shifts, np.tile(shifts[0], (len(shifts), 1)), atol=1e-12)
        assert 0.0 < np.abs(shifts[0]).max() <= radius
        along = plain[tour[tour > 0], 0]
        low, high = CORNERS[:, 1:].min(axis=0), CORNERS[:, 1:].max(axis=0)
        assert (along >= low).all() and (along <= high).all()
        assert (np.diff(along[:, 0]) >= 0.0).all()


def test_states_along_a_path_are_equilibria_in_the_contact_of_the_scene(finder):
    samples = samples_along(finder.simulation, way(), 13, seed=0)
    states = finder(samples)
    assert states.is_found.all()
    simulation = finder.simulation
    contacts, rest = simulation.model.contacts, simulation.model.nodes.rest_positions
    contacts.begin_step(rest, np.zeros((0, 3)), 0.0)
    depths = [contacts.deepest_overlaps(rest + shift)[0] for shift in states.displacements]
    assert max(depths) < 1e-5
    last = simulation.step(CommandSetpoints(states.setpoints[-1], 1e6))
    assert np.linalg.norm(last.contacts.forces, axis=1).sum() > 0.02
    np.testing.assert_allclose(simulation.effector_positions(), states.effectors[-1], atol=1e-6)


@pytest.mark.exhaustive
def test_a_body_trained_along_a_path_keeps_its_gap_and_presses_as_the_full_one(
    beside_a_rod, call, tmp_path
):
    scene, path = beside_a_rod
    output = tmp_path / "rod_reduced.npz"
    call(
 "reduce", scene, "--along", path, "--around", 0.001, "--snapshots", 82, "--modes", 18,
 "--spare-modes", 6, "--states", 11, "--workers", 1, "--output", output,
    )  # fmt: skip
    mapping = entries_of(scene, {"body.reduced": {"file": str(output)}})
    (tmp_path / "reduced.yaml").write_text(yaml.safe_dump(mapping))
    full, small = (Simulation.from_scene_file(file) for file in (scene, tmp_path / "reduced.yaml"))
    pressed = []
    for target in np.loadtxt(path, delimiter=",", skiprows=1)[:, 1:]:
        repeat_step(full, FollowTargets(target[None], 1e6), 3)
        found = []
        for simulation in (full, small):
            result = repeat_step(simulation, CommandSetpoints(full.state.setpoints, 1e6), 3)
            found.append(np.linalg.norm(result.contacts.forces, axis=1).sum())
        pressed.append(found)
        assert small.model.contacts.deepest_overlaps(small.state.positions)[0] < 1e-5
        tips = [simulation.effector_positions()[0] for simulation in (full, small)]
        assert np.linalg.norm(tips[1] - tips[0]) < 1e-4
    pressed = np.array(pressed)
    assert pressed[:, 0].max() > 0.02
    np.testing.assert_allclose(pressed[:, 1], pressed[:, 0], atol=0.05 * pressed.max())
