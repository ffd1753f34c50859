"""Facts of reduced bodies in contact: as the full model where the basis spans everything, and
pressed hard, sliding along a rod, released, on a slide and with friction."""

import meshio
import numpy as np
import pytest

from softrobot_twin.analysis.reduction_error import FullModelError
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.scene.scene_changes import reduced_scene
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation, Status
from softrobot_twin.simulation.building.reduced_body import (
    BodyReduction,
    reduction_fingerprints,
    write_body_reduction,
)

from .building.test_reduced_body import every_point, spanning_basis
from .test_slides import CART, FOOT, SLIDE
from test.builder import builder
from test.scene_changes import LEFT_OUT, changed, repeat_step


def saved_beside(simulation, basis, path) -> Simulation:
    """The same scene, its beam reduced to a basis, with all quadrature points."""
    (body,), count = simulation.model.bodies, basis.shape[2]
    points = every_point(body)
    write_body_reduction(
        path, BodyReduction(basis, count, points, points, np.ones(count), np.full(2, np.nan), {}),
        reduction_fingerprints(body),
    )  # fmt: skip
    return Simulation(reduced_scene(simulation.scene, "beam", path), with_warnings=False)


@builder
def spanned(beam, tmp_path, /, change):
    """Makes a beam, and the same reduced to a basis that spans everything."""
    full = beam({"solver": {"newton_iterations": 30, "residual_tolerance": 1e-9}}, change)
    basis = spanning_basis(full.model.bodies[0])
    return full, saved_beside(full, basis, tmp_path / "reduced.npz")


def modes_of(states: np.ndarray, count: int) -> np.ndarray:
    """Leading modes of displacements, shape (node_count, 3, count).

    A mode beyond the rank of the states is round-off: it differs between processors, and moves the
    foot, where all states are zero.
    """
    _, sizes, modes = np.linalg.svd(states.reshape(len(states), -1), full_matrices=False)
    assert sizes[count - 1] > 1e-7 * sizes[0]
    modes = modes[:count].reshape(count, -1, 3)
    return (modes / np.linalg.norm(modes, axis=2).max(axis=1)[:, None, None]).transpose(1, 2, 0)


def deepest(simulation) -> float:
    """Deepest overlap of any pair, detected at the state [m]."""
    return float(simulation.model.contacts.deepest_overlaps(simulation.state.positions).max())


def pressing(result) -> np.ndarray:
    """Normal forces of contacts that press [N]."""
    return np.linalg.norm(result.contacts.forces, axis=1)


TIP = np.array([0.01, 0.01, 0.1])


def wound(simulation, *shortenings) -> np.ndarray:
    setpoints = simulation.rest_setpoints.copy()
    setpoints[: len(shortenings)] -= shortenings
    return setpoints


# --- stiffness of facets that press ---------------------------------------------------------------


def smooth_modes(body) -> np.ndarray:
    """Six smooth modes, zero at fixed nodes."""
    x = body.mesh.node_positions
    basis = np.zeros((len(x), 3, 6))
    for m in range(6):
        basis[:, m % 3, m] = np.sin((12.0 + 3.0 * m) * x[:, 2]) * (1.0 + 9.0 * x[:, (m + 1) % 3])
    basis[body.fixed] = 0.0
    return basis / np.linalg.norm(basis, axis=1).max(axis=0)


def matrix_of(factorization):
    """The assembled matrix, full and symmetric."""
    count = len(factorization.elimination_rank)
    rows, columns = factorization.blocks()
    offsets, strides = factorization.slots(rows, columns)
    blocks = np.zeros((count, count, 3, 3))
    for row, column, offset, stride in zip(rows, columns, offsets, strides, strict=True):
        block = [factorization.storage[offset + j * stride :][:3] for j in range(3)]
        blocks[column, row] = block
        blocks[row, column] = np.transpose(block)
    return blocks.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_folded_stiffness_is_minus_force_times_the_second_derivative_of_the_gap(beam, tmp_path, shape):
    """∂²gap/∂q² of the gap as it is detected, by differences."""

    def add(mapping):
        entry = {"sphere": {"centre": [0.0325, 0.0080, 0.0712], "radius": 0.0125}}
        if shape == "cylinder":
            ends = [[0.0325, -0.03, 0.0712], [0.0325, 0.05, 0.0755]]
            entry = {"cylinder": {"ends": ends, "radius": 0.0125}}
        mapping["obstacles"] = [{"name": "round", **entry}]
        mapping["contact"] = {"between": [{"pair": ["beam", "round"]}], "alarm_distance": 0.004}

    full = beam(add)
    basis = smooth_modes(full.model.bodies[0])
    model = saved_beside(full, basis, tmp_path / "reduced.npz").model
    contacts, nodes, factorization = model.contacts, model.nodes, model.factorization
    size, force, h = basis.shape[2], 0.7, 2e-5
    here = np.random.default_rng(0).normal(size=size) * 2e-4

    def positions_at(coordinates):
        positions = nodes.rest_positions.copy()
        positions[: size // 3] = coordinates.reshape(-1, 3)
        for kind in nodes.kinds:
            kind.place(positions)
        return positions

    contacts.begin_step(positions_at(here), np.zeros((0, 3)), 0.0)

    def gaps_at(*moves):
        moved = here.copy()
        for place, move in moves:
            moved[place] += move
        contacts.detect(positions_at(moved))
        keys = contacts.memory.known
        return dict(zip(keys, contacts.gaps(positions_at(moved)), strict=True))

    known = list(gaps_at())
    corners = [np.unique(own[own >= 0]).size for own in contacts.nodes[: contacts.count, :3]]
    rolling = [index for index, count in enumerate(corners) if count > 1]
    assert rolling
    second = np.empty((size, size, len(known)))
    for i, j in np.ndindex(size, size):
        values = []
        for a, b in ((h, h), (h, -h), (-h, h), (-h, -h)):
            gaps = gaps_at((i, a), (j, b))
            values.append(np.array([gaps[key] for key in known]))
        second[i, j] = (values[0] - values[1] - values[2] + values[3]) / (4 * h * h)
    x = positions_at(here)
    contacts.detect(x)
    for index in rolling:
        forces = np.zeros(contacts.row_count)
        # The curvature of the shape is that at its surface.
        radius, gap = 0.0125, contacts.gaps(x)[index]
        forces[index] = force
        contacts.choose_stiffness(True)
        contacts.limit_stiffness(False)
        factorization.clear()
        contacts.add_stiffness(x, forces, factorization.storage)
        found = matrix_of(factorization)
        expected = -force * second[:, :, index]
        scale = np.abs(expected).max()
        assert scale > 1.0
        np.testing.assert_allclose(found, expected, atol=(0.02 + 2 * abs(gap) / radius) * scale)
        contacts.limit_stiffness(True)
        factorization.clear()
        contacts.add_stiffness(x, forces, factorization.storage)
        definite = matrix_of(factorization)
        assert np.linalg.eigvalsh(definite).min() > -1e-9 * scale


# --- as the full model ----------------------------------------------------------------------------


def assert_same(full, reduced, command, steps, atol=1e-8):
    for _ in range(steps):
        first, second = [simulation.step(command) for simulation in (full, reduced)]
    assert first.status == second.status
    assert first.report.contact_count == second.report.contact_count
    np.testing.assert_allclose(reduced.surface_positions(), full.surface_positions(), atol=atol)
    np.testing.assert_allclose(pressing(second).sum(), pressing(first).sum(), rtol=1e-3, atol=1e-6)
    return first, second


def test_a_spanning_basis_presses_on_a_rod_as_the_full_model_does(spanned, rod):
    full, reduced = spanned(rod)
    for share in (0.25, 0.5, 0.75, 1.0):
        command = CommandSetpoints(wound(full, 0.012 * share), 1.0)
        first, second = assert_same(full, reduced, command, 6)
    assert pressing(second).sum() > 0.05
    assert deepest(reduced) < 1e-6


def test_a_spanning_basis_sticks_and_slips_as_the_full_model_does(spanned, rod):
    full, reduced = spanned(lambda m: rod(m, friction=0.4))
    assert full.model.contacts.rubs
    for east, north in ((0.006, 0.0), (0.01, 0.0), (0.01, 0.004), (0.01, 0.008)):
        command = CommandSetpoints(wound(full, east, north), 1.0)
        first, second = assert_same(full, reduced, command, 6, atol=1e-6)
    assert pressing(second).sum() > 0.05


on_a_cart = changed({
    "body.fixed": LEFT_OUT, "body.attached": [{"to": "cart", "box": FOOT}],
    "rigid_bodies": [CART.copy()], "slides": [SLIDE.copy()], "cables.*.pull_point_on": "cart",
})  # fmt: skip


def test_a_spanning_basis_rides_on_a_slide_as_the_full_model_does(spanned, rod):
    full, reduced = spanned(changed(on_a_cart, rod))
    setpoints = wound(full, 0.006)
    assert_same(full, reduced, CommandSetpoints(setpoints, 1.0), 4)
    for setpoints[-1] in (0.002, 0.004, 0.006):
        first, second = assert_same(full, reduced, CommandSetpoints(setpoints, 1.0), 6)
    assert pressing(second).sum() > 0.02
    target = full.effector_positions() + [[-0.001, 0.001, -0.003]]
    assert_same(full, reduced, FollowTargets(target, 1.0), 30, atol=1e-6)
    state = reduced.state
    on = reduced.step(FollowTargets(target + 0.001, 0.05))
    reduced.restore(state)
    again = reduced.step(FollowTargets(target + 0.001, 0.05))
    np.testing.assert_allclose(again.state.positions, on.state.positions, atol=1e-9)


def test_the_full_model_judges_a_body_where_its_slide_has_brought_it(spanned):
    full, reduced = spanned(on_a_cart)
    setpoints = wound(full, 0.006)
    setpoints[-1] = 0.006
    for simulation in (full, reduced):
        repeat_step(simulation, CommandSetpoints(setpoints, 1.0), 8)
    judge = FullModelError(reduced)
    lifted = judge.lifted(reduced.state)
    np.testing.assert_allclose(lifted.positions, full.state.positions, atol=1e-8)
    assert judge.errors(reduced.state)["beam"].distance < 1e-8


@pytest.mark.parametrize("own_surface", [False, True], ids=["of_the_mesh", "of_a_file"])
def test_a_guided_ball_pushes_a_spanning_basis_as_the_full_model(spanned, write_surface, own_surface):
    """The shape moves; the surface is that of the mesh, or one that the body carries."""

    def change(mapping):
        mapping["rigid_bodies"] = [{"name": "ball", "motion": "guided", "speed": 1.0,
                                    "sphere": {"radius": 0.006}, "position": [0.028, 0.011, 0.083]}]
        mapping["contact"] = {"between": [{"pair": ["beam", "ball"]}]}
        if own_surface:
            mapping["body"]["contact_surface"] = {"file": write_surface()}

    full, reduced = spanned(change)
    for x in (0.0259, 0.0245, 0.023, 0.0215):
        for simulation in (full, reduced):
            simulation.model.guides.aim("ball", [x, 0.011, 0.083])
        first, second = assert_same(full, reduced, Hold(1.0), 5, atol=1e-7)
    assert pressing(second).sum() > 0.05
    for simulation in (full, reduced):
        simulation.model.guides.aim("ball", [0.03, 0.011, 0.083])
    assert_same(full, reduced, Hold(1.0), 4, atol=1e-7)


@builder
def write_surface(tmp_path, block, /) -> str:
    """Writes a finer surface of the same beam; gives its file."""
    mesh = block(size=(0.02, 0.02, 0.1), cells=(2, 2, 10), shake=0.0)
    triangles = boundary_triangles(mesh.cells)
    used, index = np.unique(triangles, return_inverse=True)
    file = tmp_path / "skin.vtk"
    cells = [("triangle", index.reshape(-1, 3))]
    meshio.write(file, meshio.Mesh(mesh.node_positions[used], cells))
    return str(file)


# --- few modes ------------------------------------------------------------------------------------


@pytest.fixture
def few(beam, rod, tmp_path):
    """A beam beside a slanted rod with fifteen modes of its way past it, and the full beam."""

    def slanted(mapping):
        mapping["obstacles"] = [{"name": "rod", "cylinder": {
            "ends": [[0.029, -0.05, 0.075], [0.029, 0.07, 0.085]], "radius": 0.005}}]
        mapping["contact"] = {"between": [{"pair": ["beam", "rod"]}]}

    full = beam(slanted)
    states = visit(full, way_past(8), 6)[0]
    reduced = saved_beside(full, modes_of(np.array(states), 15), tmp_path / "few.npz")
    full.reset()
    return reduced, full


def way_past(count: int) -> list[tuple[float, float]]:
    """Shortenings: pressed hard, slid along the rod at the same, released."""
    shares = np.linspace(0.0, 1.0, count + 1)[1:]
    pressed = [(0.012 * share, 0.006) for share in shares]
    slid = [(0.012, 0.006 + 0.0055 * share) for share in shares]
    released = [(0.012 * share, 0.0115 * share) for share in 1.0 - shares]
    return [*pressed, *slid, *released]


def visit(simulation, way, steps):
    """Displacements of the nodes, last results and tips on a way."""
    rest, states, results, tips = simulation.model.nodes.rest_positions, [], [], []
    for shortenings in way:
        for _ in range(steps):
            result = simulation.step(CommandSetpoints(wound(simulation, *shortenings), 1.0))
        states.append(result.state.positions - rest)
        results.append(result)
        tips.append(simulation.effector_positions()[0])
    return states, results, tips


def test_pressed_hard_sliding_and_released_it_keeps_its_gaps_and_forces(few):
    """Small versions of the catalogue's rows of contact, on a body with fifteen modes."""
    simulation, full = few
    places, count = [], 4
    # Other states than those of the training.
    for place, shortenings in enumerate(way_past(count)):
        for own in (full, simulation):
            _, (result,), (tip,) = visit(own, [shortenings], 6)
            if own is full:
                truth, bent = (result, tip, deepest(own)), np.linalg.norm(tip - TIP)
        assert result.status is Status.OK, place
        assert deepest(simulation) <= truth[2] + 2e-6, place
        np.testing.assert_allclose(tip, truth[1], atol=0.01 * bent + 1e-5, err_msg=str(place))
        forces, wanted = pressing(result).sum(), pressing(truth[0]).sum()
        np.testing.assert_allclose(forces, wanted, rtol=0.03, atol=0.01, err_msg=str(place))
        if place == count - 1:
            assert forces > 0.5
        if place in (count - 1, 2 * count - 1):
            places.append(result.contacts.positions.mean(axis=0))
    assert places[1][1] - places[0][1] > 0.005
    assert not len(pressing(result))
    assert simulation.step(Hold()).status is Status.OK
    np.testing.assert_allclose(simulation.effector_positions()[0], TIP, atol=1e-6)
