"""Facts of a body in the coordinates of a basis: equality with the full model, and refusals."""

import copy

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.reduced_elements import ReducedElements, SampledPoints, all_points
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Simulation,
    Status,
)
from softrobot_twin.simulation.building.reduced_body import (
    BodyReduction,
    reduction_fingerprints,
    write_body_reduction,
)
from softrobot_twin.simulation.building.scene_layout import lay_out
from softrobot_twin.simulation.step.apparent_stiffness import ApparentStiffness
from softrobot_twin.simulation.step.time_budget import StageClock

from ..conftest import MAPPING, SCENE_FILE
from test.builder import builder
from test.scene_changes import repeat_step


def spanning_basis(body):
    """One mode for each unknown of a body: it spans everything."""
    free = np.flatnonzero(~body.fixed)
    basis = np.zeros((body.mesh.node_count, 3, 3 * len(free)))
    basis[free[:, None], np.arange(3), np.arange(3 * len(free)).reshape(-1, 3)] = 1.0
    return basis


def every_point(body):
    """All quadrature points of a body."""
    parts = [all_points(part) for part in body.mesh.blocks()]
    return SampledPoints(*map(np.concatenate, zip(*parts, strict=True)))


def saved(mapping, path, basis_of=spanning_basis, points_of=every_point):
    """Save a reduction of the body of a scene, and return the scene with it."""
    mapping = copy.deepcopy(mapping)
    (body,) = lay_out(scene_from_mapping(mapping, SCENE_FILE), []).bodies
    basis, points = basis_of(body), points_of(body)
    count = basis.shape[2]
    write_body_reduction(
        path, BodyReduction(basis, count, points, points, np.ones(count), np.full(2, np.nan), {}),
        reduction_fingerprints(body),
    )  # fmt: skip
    mapping["body"]["reduced"] = {"file": str(path)}
    return mapping


def coarse(**body):
    """The coarsest Diamond, its solver exact."""
    mapping = copy.deepcopy(MAPPING)
    mapping["body"]["mesh"]["file"] = "../../meshes/diamond_150.vtk"
    mapping["body"].update(body)
    mapping["solver"] = {"newton_iterations": 30, "residual_tolerance": 1.0e-10}
    return mapping


@builder(scope="module")
def pair(tmp_path_factory, /, mapping):
    """A full and a reduced simulation of one scene, whose basis spans everything."""
    path = tmp_path_factory.mktemp("reduced") / "body.npz"
    scene = scene_from_mapping(saved(mapping, path), SCENE_FILE)
    full = Simulation(without_reductions(scene), with_warnings=False)
    return full, Simulation(scene, with_warnings=False)


def assert_same(full, reduced, command, steps=3):
    for _ in range(steps):
        results = [simulation.step(command) for simulation in (full, reduced)]
    first, second = results
    assert first.status == second.status
    scale = np.abs(first.state.efforts).max()
    np.testing.assert_allclose(
        second.state.efforts, first.state.efforts, atol=1e-7 * scale, err_msg="efforts"
    )
    places = [simulation.effector_positions() for simulation in (full, reduced)]
    np.testing.assert_allclose(places[1], places[0], atol=1e-9 * full.model.nodes.size)
    surfaces = [simulation.surface_positions() for simulation in (full, reduced)]
    np.testing.assert_allclose(surfaces[1], surfaces[0], atol=1e-9 * full.model.nodes.size)
    markers = [simulation.marker_positions() for simulation in (full, reduced)]
    np.testing.assert_allclose(markers[1], markers[0], atol=1e-9 * full.model.nodes.size)


@pytest.mark.exhaustive
@pytest.mark.parametrize("body", [
    {},
    {"material": {"law": "neo_hookean", "young_modulus": 180.0e3, "poisson_ratio": 0.4,
                  "density": 1070.0}},
], ids=["corotational", "neo_hookean"])  # fmt: skip
def test_a_basis_that_spans_everything_gives_the_full_model(pair, body):
    full, reduced = pair(coarse(**body))
    rest = full.rest_setpoints
    assert_same(full, reduced, Hold(), 1)
    assert_same(full, reduced, CommandSetpoints(rest - [0.004, 0.0, 0.002, 0.001], 1.0))
    assert_same(full, reduced, CommandEfforts(np.array([0.6, 0.2, 0.1, 0.0]), 1.0))
    target = full.effector_positions() + [[0.003, -0.002, -0.004]]
    # Which of four cables pull how much follows from the least energy, which takes some steps.
    assert_same(full, reduced, FollowTargets(target, 1.0), 60)


def test_contact_rows_act_on_the_coordinates(pair):
    mapping = coarse()
    mapping["obstacles"] = [{
        "name": "ball", "sphere": {"centre": [0.004, 0.002, 0.139], "radius": 0.01}}]
    mapping["contact"] = {"between": [{"pair": ["body", "ball"]}], "alarm_distance": 0.01,
                          "contact_distance": 0.0005}
    full, reduced = pair(mapping)
    for wound in (0.002, 0.004, 0.006, 0.008, 0.008):
        command = CommandSetpoints(full.rest_setpoints - wound, 1.0)
        results = [simulation.step(command) for simulation in (full, reduced)]
    assert [result.report.contact_count for result in results] == [1, 1]
    assert results[0].status == results[1].status == Status.OK
    places = [simulation.effector_positions() for simulation in (full, reduced)]
    np.testing.assert_allclose(places[1], places[0], atol=1e-6 * full.model.nodes.size)


def few_modes(body):
    """Six smooth modes, zero at fixed nodes."""
    x = body.mesh.node_positions
    basis = np.zeros((len(x), 3, 6))
    for m in range(6):
        basis[:, m % 3, m] = np.sin((3.0 + m) * (x[:, 2] - x[:, 2].min()))
    basis[body.fixed] = 0.0
    return basis / np.linalg.norm(basis, axis=1).max(axis=0)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A scene of six modes and twenty points."""

    def twenty(body):
        return SampledPoints(np.arange(20), np.zeros(20, np.int64), np.full(20, 12.0))

    path = tmp_path_factory.mktemp("small") / "body.npz"
    return saved(coarse(), path, few_modes, twenty)


def test_nothing_of_the_mesh_is_placed_but_what_terms_ask_for(small):
    simulation = Simulation(scene_from_mapping(small, SCENE_FILE), with_warnings=False)
    model = simulation.model
    # Two coordinate nodes, four points of cables, where four markers are too, the tip, and the
    # four markers around it.
    assert len(simulation.state.positions) == 2 + 4 + 1 + 4
    assert simulation.dof_count == 6
    assert model.is_dense and len(model.factorization.blocks()[0]) == 3
    elements = [term for term in model.forces if isinstance(term, ReducedElements)]
    assert [term.point_count for term in elements] == [20]
    assert len(simulation.surface_positions()) > 50


def test_points_follow_from_the_coordinates_alone(small):
    simulation = Simulation(scene_from_mapping(small, SCENE_FILE), with_warnings=False)
    command = CommandSetpoints(simulation.rest_setpoints - [0.004, 0.0, 0.0, 0.001], 1.0)
    repeat_step(simulation, command, 5)
    positions = simulation.state.positions.copy()
    positions[2:] = np.nan
    for kind in simulation.model.nodes.kinds:
        kind.place(positions)
    np.testing.assert_array_equal(positions, simulation.state.positions)


def test_restore_and_continue_equals_going_on(small):
    simulation = Simulation(scene_from_mapping(small, SCENE_FILE), with_warnings=False)
    rest = simulation.rest_setpoints
    simulation.step(CommandSetpoints(rest - [0.004, 0.0, 0.0, 0.001], 1.0))
    state = simulation.state
    on = simulation.step(CommandSetpoints(rest - [0.006, 0.0, 0.0, 0.002], 1.0))
    simulation.restore(state)
    again = simulation.step(CommandSetpoints(rest - [0.006, 0.0, 0.0, 0.002], 1.0))
    np.testing.assert_array_equal(again.state.positions, on.state.positions)


def test_a_rotated_and_shifted_body_moves_as_the_one_in_place(small):
    moved = copy.deepcopy(small)
    moved["body"]["mesh"].update(rotation=[0.0, 0.0, np.pi / 2], translation=[0.1, 0.0, 0.0])
    moved["body"]["fixed"][0]["frame"] = "mesh"

    def turned(point):
        return [0.1 - point[1], point[0], point[2]]

    for cable in moved["cables"]:
        cable["pull_point"] = turned(cable["pull_point"])
        cable["points"] = [turned(point) for point in cable["points"]]
    for entry in moved["markers"]:
        entry["point"] = turned(entry["point"])
    moved["effectors"][0]["points"] = [turned(p) for p in moved["effectors"][0]["points"]]
    tips = []
    for mapping in (small, moved):
        simulation = Simulation(scene_from_mapping(mapping, SCENE_FILE), with_warnings=False)
        command = CommandSetpoints(simulation.rest_setpoints - [0.004, 0.0, 0.0, 0.001], 1.0)
        repeat_step(simulation, command, 4)
        tips.append(simulation.effector_positions()[0])
    np.testing.assert_allclose(tips[1], turned(tips[0]), atol=1e-10)


@pytest.mark.parametrize(
    ("change", "key", "reason"),
    [
        (lambda m: m["body"]["reduced"].update(file="missing.npz"), "reduced.file", "no such file"),
        (lambda m: m["body"]["material"].update(young_modulus=1.0e5), "reduced.file", "material"),
        (lambda m: m["body"]["mesh"].update(file="../../meshes/diamond_200.vtk"), "reduced.file",
         "another mesh"),
        (lambda m: m["body"]["fixed"][0]["box"].update(maximum=[0.05, 0.05, 0.06]),
         "reduced.file", "fixed nodes"),
        (lambda m: m["body"].update(vertebrae={"rigid": [
            {"name": "a", "region": "a"}, {"name": "b", "region": "b"}]}), "reduced", "vertebrae"),
        (lambda m: m["body"].update(volume="patches", material={
            "law": "neo_hookean", "young_modulus": 1e5, "poisson_ratio": 0.49, "density": 1e3}),
         "volume", "not built for reduced bodies"),
        (lambda m: m["body"].update(material={
            "law": "neo_hookean", "young_modulus": 1e5, "poisson_ratio": 0.45, "density": 1e3,
            "viscosity": [{"share": 0.1, "time": 1.0}]}),
         "viscosity", "not built for reduced bodies"),
    ],
    ids=["missing", "material", "mesh", "fixed", "vertebrae", "patches", "viscosity"],
)  # fmt: skip
def test_what_is_not_built_or_does_not_fit_is_refused_by_name(small, change, key, reason):
    mapping = copy.deepcopy(small)
    change(mapping)
    with pytest.raises(SceneError) as caught:
        Simulation(scene_from_mapping(mapping, SCENE_FILE), with_warnings=False)
    assert key in str(caught.value)
    assert reason in str(caught.value)


def test_the_compliance_and_its_derivative_are_those_of_the_full_model(pair):
    """The derivative by the actuation goes through the coordinates, and is the same."""
    found = []
    for simulation in pair(coarse()):
        command = CommandSetpoints(simulation.rest_setpoints - [0.004, 0.001, 0.002, 0.0], 1.0)
        for _ in range(3):
            efforts = simulation.step(command).efforts
        newton, positions = simulation.newton, simulation.state.positions.copy()
        newton.linearize(positions, efforts, StageClock())
        stiffness = ApparentStiffness(simulation.model)
        found.append(stiffness.gradient(newton.tangent.linearized_state(positions, efforts), np.arange(3)))
    full, reduced = found
    np.testing.assert_allclose(reduced.compliance, full.compliance, rtol=1e-8)
    scale = np.abs(full.by_multiplier).max()
    np.testing.assert_allclose(reduced.by_multiplier, full.by_multiplier, atol=1e-5 * scale)
    np.testing.assert_allclose(reduced.free, full.free, rtol=1e-5)
