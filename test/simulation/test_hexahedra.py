"""Bodies of hexahedra in scenes: elements, contact, cavities, motion, collapse, refusals."""

from dataclasses import replace

import meshio
import numpy as np
import pytest

import softrobot_twin
from softrobot_twin.analysis.mesh_error import MeshErrorEstimator, MeshErrorUnknown
from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.hexahedral_mesh import INTO_TETS, HexahedralMesh
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandEfforts, FollowTargets, Hold, Simulation, Status
from test.builder import builder
from test.scene_changes import change_scene, changed, repeat_step, solved

FOOT = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]


def mixed_block(size, cells):
    """A block whose upper half is of tetrahedra."""
    grid = read_box(size, cells, of_hexahedra=True).mesh
    cut = grid.node_positions[grid.hexahedra].mean(axis=1)[:, 2] > 0.5 * size[2]
    tets = grid.hexahedra[cut][:, INTO_TETS].reshape(-1, 4)
    return HexahedralMesh(grid.node_positions, tets, grid.hexahedra[~cut])


@builder
def body_of_hexahedra(tmp_path, /, mesh, name="soft", young_modulus=1e5, poisson_ratio=0.45,
                      **entries) -> dict:  # fmt: skip
    """Makes the entry of a soft body of silicone from a mesh; more entries may be given."""
    path = tmp_path / f"{name}.vtk"
    cells = [("hexahedron", mesh.hexahedra), ("tetra", mesh.tets)]
    cells = [block for block in cells if len(block[1])]
    meshio.write(path, meshio.Mesh(mesh.node_positions, cells))
    material = {"young_modulus": young_modulus, "poisson_ratio": poisson_ratio, "density": 1000.0}
    return {"name": name, "mesh": {"file": str(path)}, "material": material, **entries}


@builder
def bar(simulate, body_of_hexahedra, /, change=None, mesh=None, **entries) -> Simulation:
    """Makes an upright bar, held at its foot, with two cables; its tip is the effector."""
    mesh = read_box((0.02, 0.02, 0.1), (2, 2, 5), of_hexahedra=True).mesh if mesh is None else mesh

    def cable(name, x):
        points = [[x, 0.01, z] for z in (0.02, 0.04, 0.06, 0.08, 0.095)]
        return {"name": name, "pull_point": [x, 0.01, 0.0], "points": points,
                "shortening": [0.0, 0.05], "tension": [0.0, 40.0]}  # fmt: skip

    mapping = {
        "gravity": [0.0, 0.0, -9.81],
        "body": body_of_hexahedra(mesh, "bar", fixed=FOOT, **entries),
        "cables": [cable("east", 0.018), cable("west", 0.002)],
        "effectors": [{"name": "tip", "points": [[0.01, 0.01, 0.1]]}],
    }  # fmt: skip
    change_scene(mapping, change)
    return simulate(**mapping)


def test_hexahedra_of_a_file_become_hexahedral_elements(bar):
    simulation = bar()
    (body,) = simulation.model.bodies
    assert body.entry.element == "hexahedral" and body.entry.mass_model == "lumped"
    assert simulation.hexahedron_count == 20 and simulation.tet_count == 0
    assert np.count_nonzero(body.fixed) == 9
    assert body.mass == pytest.approx(0.04)


@pytest.mark.parametrize("poisson", [0.3, 0.49])
def test_a_coarse_bar_bends_as_a_fine_one(bar, poisson):
    def tip(mesh):
        simulation = bar(
            lambda mapping: mapping.update(cables=[], gravity=[2.0, 0.0, -9.81]), mesh=mesh,
            poisson_ratio=poisson,
        )
        rest = simulation.effector_positions()
        result = solved(simulation, Hold())
        return result.effector_positions[0] - rest[0]

    coarse = tip(read_box((0.02, 0.02, 0.1), (1, 1, 5), of_hexahedra=True).mesh)
    fine = tip(read_box((0.02, 0.02, 0.1), (3, 3, 15), of_hexahedra=True).mesh)
    mixed = tip(mixed_block((0.02, 0.02, 0.1), (3, 3, 15)))
    assert np.linalg.norm(fine) > 0.005
    assert np.linalg.norm(coarse - fine) < 0.06 * np.linalg.norm(fine)
    # Linear tetrahedra of the upper half lock.
    assert np.linalg.norm(mixed) < np.linalg.norm(fine)


def test_a_material_of_a_box_is_that_of_its_cells_of_both_kinds(bar):
    stiff = {"young_modulus": 1e6, "box": {"minimum": [-1, -1, 0.04], "maximum": [1, 1, 0.0801]}}
    mesh = mixed_block((0.02, 0.02, 0.1), (1, 1, 5))
    simulation = bar(lambda mapping: mapping["body"].update(materials=[stiff]), mesh=mesh)
    soft, hard = simulation.model.bodies[0].materials
    assert soft.volume == pytest.approx(2.4e-5) and hard.volume == pytest.approx(1.6e-5)
    elastic = [term for term in simulation.model.forces if "corotational" in term.name]
    assert len(elastic) == 4


# --- motion --------------------------------------------------------------------------------------


def test_a_carried_surface_moves_with_hexahedra(tmp_path, bar):
    """A skin 1 mm outside the bar turns with it."""
    grid = read_box((0.022, 0.022, 0.101), (3, 3, 6), of_hexahedra=True).mesh
    points = grid.node_positions - [0.001, 0.001, 0.0]
    meshio.write(tmp_path / "skin.vtk", meshio.Mesh(points, [("triangle", grid.surface_triangles)]))
    simulation = bar(lambda mapping: mapping["body"].update(visual={"file": "skin.vtk"}))
    (skin,) = simulation.skins
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rest = simulation.model.nodes.rest_positions
    at_rest, turned = skin.positions(rest), skin.positions(rest @ turn.T)
    np.testing.assert_allclose(turned, at_rest @ turn.T, atol=1e-9)
    np.testing.assert_allclose(np.ptp(at_rest, axis=0), np.ptp(points, axis=0), atol=1e-6)


@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_a_clamped_bar_vibrates_at_the_frequency_of_beam_theory(simulate, body_of_hexahedra, mass):
    """First bending mode: f = 1.875² √(EI/ρA) / 2πL²; shear lowers it by about 1 %."""
    length, depth = 0.1, 0.01
    mesh = read_box((depth, depth, length), (1, 1, 10), of_hexahedra=True).mesh
    body = body_of_hexahedra(mesh, fixed=FOOT, mass=mass, poisson_ratio=0.3)
    still = simulate(gravity=[0.02, 0.0, 0.0], body=body)
    still.step(Hold())
    moving = simulate(gravity=[0.0, 0.0, 0.0], integration="dynamic", body=body,
                      effectors=[{"name": "tip", "points": [[0.005, 0.005, 0.1]]}])  # fmt: skip
    bent = still.state.positions
    moving.restore(replace(moving.state, positions=bent))
    expected = 1.8751**2 / (2 * np.pi * length**2) * np.sqrt(1e5 * depth**2 / 12 / 1000.0)
    step = 1.0 / expected / 400
    heights = [moving.step(Hold(step)).effector_positions[0, 0] - 0.005 for _ in range(240)]
    crossings = np.flatnonzero(np.diff(np.sign(heights)))
    assert len(crossings) == 1
    # A quarter of a period passes until the first zero.
    assert 0.25 / (crossings[0] * step) == pytest.approx(expected, rel=0.04)


# --- contact and pressure ------------------------------------------------------------------------


def test_a_block_rests_on_a_plane_with_its_weight(simulate, body_of_hexahedra):
    mesh = read_box((0.03, 0.03, 0.02), (3, 3, 2), of_hexahedra=True).mesh
    block = body_of_hexahedra(mesh)
    block["mesh"]["translation"] = [0.0, 0.0, 0.0005]
    simulation = simulate(
        gravity=[0.0, 0.0, -9.81], integration="dynamic", body=block,
        obstacles=[{"name": "floor", "plane": {}}],
        contact={"between": [{"pair": ["soft", "floor"]}], "friction": 0.5},
    )  # fmt: skip
    result = solved(simulation, Hold(0.005), 120)
    lowest = result.state.positions[:, 2].min()
    assert -1e-4 < lowest < 2e-4
    assert np.abs(result.state.velocities).max() < 1e-3
    assert result.contacts.forces.sum(axis=0)[2] == pytest.approx(9.81 * 0.018, rel=0.02)


@builder
def chamber(tmp_path, simulate, body_of_hexahedra, /, cells=(4, 4, 6), poisson_ratio=0.45) -> Simulation:
    """Makes a block with a cavity in the middle of its cells, commanded by pressure."""
    size = (0.02, 0.02, 0.03)
    grid = read_box(size, cells, of_hexahedra=True).mesh
    middle = grid.node_positions[grid.hexahedra].mean(axis=1) / np.array(size)
    inside = (np.abs(middle - 0.5) < 0.26).all(axis=1)
    hole = HexahedralMesh(grid.node_positions, grid.tets, grid.hexahedra[inside])
    used, index = np.unique(grid.hexahedra[~inside], return_inverse=True)
    body = HexahedralMesh(grid.node_positions[used], grid.tets, index.reshape(-1, 8))
    file = tmp_path / "air.vtk"
    wall = meshio.Mesh(grid.node_positions, [("triangle", hole.surface_triangles)])
    meshio.write(file, wall)
    return simulate(
        gravity=[0.0, 0.0, 0.0],
        body=body_of_hexahedra(body, fixed=FOOT, poisson_ratio=poisson_ratio),
        cavities=[{"name": "air", "walls": [{"file": str(file)}], "pressure": [0.0, 5e3]}],
        effectors=[{"name": "top", "points": [[0.01, 0.01, 0.03]]}],
    )  # fmt: skip


def test_a_cavity_in_hexahedra_is_inflated(chamber):
    simulation = chamber()
    rest = simulation.effector_positions()[0, 2]
    result = solved(simulation, CommandEfforts(np.array([2e3]), 0.1))
    assert 2e-5 < result.effector_positions[0, 2] - rest < 2e-3


def test_a_target_in_reach_of_the_pressure_is_met(chamber):
    simulation = chamber()
    target = simulation.effector_positions() + [0.0, 0.0, 1e-4]
    result = repeat_step(simulation, FollowTargets(target, 0.1), 5)
    assert abs(result.effector_positions[0, 2] - target[0, 2]) < 1e-6


# --- collapse (hard case 5) and refusals ---------------------------------------------------------


@pytest.mark.sampled
@pytest.mark.parametrize("collapse", ["plane", "point", "mirror", "random"])
def test_a_collapsed_bar_comes_back_or_says_that_it_is_inside_out(bar, recovers, collapse):
    recovers(bar(lambda mapping: mapping.update(cables=[])), collapse, 40)


def test_a_bar_that_is_crushed_never_calls_an_inverted_cell_converged(simulate, body_of_hexahedra):
    body = body_of_hexahedra(read_box((0.02, 0.02, 0.04), (2, 2, 4), of_hexahedra=True).mesh, fixed=FOOT)
    simulation = simulate(gravity=[0.0, 0.0, -9.81e3], body=body)
    result = repeat_step(simulation, Hold(), 10)
    assert np.all(np.isfinite(result.state.positions))
    if result.status is Status.OK:
        assert result.report.inverted_count == 0


@pytest.mark.parametrize("element", ["linear", "quadratic"])
def test_an_element_of_tetrahedra_is_refused_for_hexahedra(bar, element):
    with pytest.raises(SceneError, match="bar.vtk has hexahedra: omit element, or name one"):
        bar(element=element)


def test_the_hexahedral_element_is_refused_for_tetrahedra(simulate, body_of_hexahedra):
    mesh = read_box((0.02, 0.02, 0.04), (2, 2, 4), of_hexahedra=True).mesh
    tets = HexahedralMesh(mesh.node_positions, mesh.as_tets, np.empty((0, 8)))
    with pytest.raises(SceneError, match="soft.vtk has tetrahedra only: omit element, or name"):
        simulate(body=body_of_hexahedra(tets, fixed=FOOT, element="hexahedral"))


def test_vertebrae_of_hexahedra_are_refused(bar):
    rigid = [{"name": name, "box": {"minimum": [-1, -1, low], "maximum": [1, 1, low + 0.02]}}
             for name, low in (("a", -0.001), ("b", 0.079))]  # fmt: skip
    with pytest.raises(SceneError, match="only bodies of tetrahedra are reduced"):
        bar(vertebrae={"rigid": rigid})


@pytest.mark.parametrize("element", [{}, {"element": "hexahedral"}])
def test_the_mesh_error_of_hexahedra_is_not_estimated(bar, element):
    with pytest.raises(MeshErrorUnknown, match="hexahedral"):
        MeshErrorEstimator(bar(**element).scene)


def test_a_moved_and_turned_bar_bends_alike(bar):
    def tip(change):
        simulation = bar(change)
        rest = simulation.effector_positions()[0]
        result = simulation.step(Hold())
        return np.linalg.norm(result.effector_positions[0] - rest)

    def turned(mapping):
        mapping["body"]["mesh"].update(rotation=[0.0, np.pi / 2, 0.0], translation=[5.0, 0.0, 0.0])
        mapping["body"]["fixed"][0]["frame"] = "mesh"
        mapping.update(cables=[], gravity=[0.0, -4.0, 0.0])
        mapping["effectors"][0]["points"] = [[5.1, 0.01, -0.01]]
    upright = changed({"cables": [], "gravity": [0.0, -4.0, 0.0]})
    assert tip(turned) == pytest.approx(tip(upright), rel=1e-6)


def test_a_scene_of_hexahedra_is_read_from_a_mapping(bar, tmp_path):
    scene = bar().scene
    assert scene.body.element == "quadratic" and "element" not in scene.body.model_fields_set
    again = scene_from_mapping({"name": "again", "body": {
        "mesh": {"file": str(tmp_path / "bar.vtk")}, "element": "hexahedral", "fixed": FOOT,
        "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0}}})  # fmt: skip
    assert Simulation(again).hexahedron_count == 20


# --- large compression and bending ---------------------------------------------------------------

# Force of quadratic tetrahedra [N] at 5, 10, ... 50 %: 8 × 8 × 4 boxes of them, 4 × 12 × 8, 5 × 5 × 5.
FLAT, TALL, CUBE, PAD = (0.02, 0.02, 0.01), (0.009, 0.028, 0.0175), (0.02, 0.02, 0.02), (0.03, 0.03, 0.01)
BONDED = {
    FLAT: (9.18, 19.57, 31.28, 44.37, 58.90, 75.20, 94.86, 121.85, 157.80, 204.42),
    TALL: (4.42, 9.38, 14.97, 21.28, 28.34, 36.16, 44.88, 54.85, 66.15, 79.98),
    CUBE: (7.14, 15.18, 24.28, 34.61, 46.34, 59.61, 74.49, 91.46, 111.05, 134.28),
    PAD: (30.17, 65.16, 105.27, 150.36, 200.77, 262.27, 348.49, 465.7, 621.68, 815.9),
}
POISSON = {FLAT: 0.475, TALL: 0.475, CUBE: 0.475, PAD: 0.49}
TRUSTED = (Status.OK, Status.LINEARIZED)


def bonded_block(size, cells, volume=None, **material):
    """A block whose top is bonded to a guided plate, and its foot held by friction."""
    x, y, height = size
    top = {"minimum": [-1, -1, height - 1e-5], "maximum": [1, 1, 1]}
    material = {"law": "neo_hookean", "young_modulus": 2.75e5, "poisson_ratio": POISSON[size],
                "density": 1000.0} | material  # fmt: skip
    material = {key: value for key, value in material.items() if value is not None}
    return softrobot_twin.build(
        name="block", gravity=[0, 0, 0],
        body={"mesh": {"box": {"size": size, "cells": cells}}, "element": "hexahedral",
              "material": material, "attached": [{"to": "top", "box": top}],
              **({} if volume is None else {"volume": volume})},
        rigid_bodies=[{"name": "top", "motion": "guided", "position": [x / 2, y / 2, height],
                       "box": {"size": [x, y, 1e-3], "centre": [0, 0, 1e-3]}, "speed": 1.0}],
        obstacles=[{"name": "floor", "plane": {"normal": [0, 0, 1]}}],
        contact={"between": [{"pair": ["body", "floor"], "friction": 1.0}]},
        effectors=[{"name": "tip", "body": "top", "points": [[x / 2, y / 2, height]]}],
        solver={"newton_iterations": 30},
    )  # fmt: skip


def pressed(robot, size, compressions):
    """Result at each compression, which is reached in balance."""
    x, y, height = size
    for compression in compressions:
        pose = {"top": [x / 2, y / 2, height * (1.0 - compression)]}
        for _ in range(2):
            result = robot.step(poses=pose, time_step=0.1)
        yield result


@pytest.mark.parametrize("cells", [[2, 2, 4], [2, 6, 3]])
def test_a_bonded_block_of_flat_cells_is_as_stiff_as_quadratic_tetrahedra(cells):
    """Enhanced hexahedra fell from 13 to 9 N where 31 were due."""
    size = FLAT
    results = pressed(bonded_block(size, cells), size, 0.05 * np.arange(1, 11))
    for k, result in enumerate(results):
        if k in (1, 5, 9):
            force = result["force_on_body_by_floor_z_N"]
            assert force == pytest.approx(BONDED[size][k], rel=0.25)



@pytest.mark.parametrize("size, cells", [
    (FLAT, [4, 4, 2]),
    *(pytest.param(*case, marks=pytest.mark.exhaustive) for case in (
        (FLAT, [2, 2, 5]), (FLAT, [2, 6, 3]), (FLAT, [8, 8, 2]), (TALL, [2, 4, 8]),
        (TALL, [2, 6, 4]), (CUBE, [2, 2, 2]), (CUBE, [1, 1, 3]), (PAD, [3, 3, 4]),
    )),
])  # fmt: skip
def test_the_force_is_right_or_hexahedra_are_told_to_be_too_coarse(size, cells):
    """Cells of aspect 1 to 5: two layers between bonded faces are 27 % too stiff at 20 %."""
    results = pressed(bonded_block(size, cells), size, 0.05 * np.arange(1, 11))
    for expected, result in zip(BONDED[size], results, strict=True):
        error = abs(result["force_on_body_by_floor_z_N"] / expected - 1.0)
        is_told = "body.coarse_hexahedra" in result.report.active_limits
        assert error < 0.25 or is_told and result.status is Status.SATURATED
        assert error > 0.03 or not is_told


@pytest.mark.parametrize("layers, nu, is_told", [(1, 0.475, True), (2, 0.475, False), (1, 0.1, False)])
def test_one_layer_whose_sides_cannot_bulge_is_warned_of(layers, nu, is_told):
    robot = bonded_block(FLAT, [4, 4, layers], poisson_ratio=nu)
    assert any("sides cannot bulge" in note for note in robot.simulation.notes) == is_told


def test_a_pad_whose_patches_bear_the_pressure_is_told_of_too():
    """Of two layers, 24 to 40 % too stiff at 15 to 30 %."""
    robot = bonded_block(PAD, [3, 3, 2], volume="patches")
    for result in pressed(robot, PAD, (0.15, 0.2, 0.3)):
        assert "body.coarse_hexahedra" in result.report.active_limits


# Force of quadratic tetrahedra, 6 × 6 × 3 boxes of them [N], at 10, 20 and 30 %.
OTHER_LAWS = [
    ({"law": "corotational"}, (16.1, 29.1, 39.3)),
    ({"law": "yeoh", "young_modulus": None, "constants": {"c1": 46e3, "c2": 2e4, "c3": 0.0}},
     (20.9, 54.6, 113.8)),
    ({"law": "mooney_rivlin", "young_modulus": None, "constants": {"c10": 3.5e4, "c01": 1.1e4}},
     (20.5, 49.0, 88.6)),
    ({"poisson_ratio": 0.4999}, (22.5, 53.1, 95.4)),
]  # fmt: skip


@pytest.mark.exhaustive
@pytest.mark.parametrize("cells", [[4, 4, 2], [2, 2, 4], [3, 3, 3], [4, 4, 4]])
@pytest.mark.parametrize("material, forces", OTHER_LAWS)
def test_the_force_by_other_laws_is_right_or_told(material, forces, cells):
    results = pressed(bonded_block(FLAT, cells, **material), FLAT, (0.1, 0.2, 0.3))
    for expected, result in zip(forces, results, strict=True):
        error = abs(result["force_on_body_by_floor_z_N"] / expected - 1.0)
        assert error < 0.25 or "body.coarse_hexahedra" in result.report.active_limits


def test_a_compressible_block_is_never_told_to_be_too_coarse():
    """Its force is within 6 % with two layers."""
    robot = bonded_block(FLAT, [4, 4, 2], poisson_ratio=0.3)
    results = pressed(robot, FLAT, (0.1, 0.3, 0.5))
    assert all(result.status in TRUSTED for result in results)


def test_targets_that_are_reached_too_coarsely_are_not_met():
    """Four cables press a plate on the block; what is told of commands is told of targets, too."""
    robot = softrobot_twin.build(
        name="press", gravity=[0, 0, 0],
        body={"mesh": {"box": {"size": FLAT, "cells": [2, 2, 2]}}, "element": "hexahedral", "fixed": FOOT,
              "material": {"law": "neo_hookean", "young_modulus": 2.75e5, "poisson_ratio": 0.475,
                           "density": 1000.0},
              "attached": [{"to": "top", "box": {"minimum": [-1, -1, 0.00999], "maximum": [1, 1, 1]}}]},
        rigid_bodies=[{"name": "top", "position": [0.01, 0.01, 0.01], "density": 1000.0,
                       "box": {"size": [0.03, 0.03, 1e-3], "centre": [0, 0, 1e-3]}}],
        cables=[{"name": f"cable_{k}", "body": "top", "points": [[x, y, 0.01]],
                 "pull_point": [x, y, -0.02], "shortening": [0.0, 0.006], "tension": [0.0, 100.0]}
                for k, (x, y) in enumerate([(0, 0), (0.02, 0), (0, 0.02), (0.02, 0.02)])],
        effectors=[{"name": "tip", "body": "top", "points": [[0.01, 0.01, 0.01]], "directions": ["z"]}],
        solver={"newton_iterations": 30},
    )  # fmt: skip
    for height, status, limits in ((0.009, Status.OK, ()),
                                   (0.007, Status.SATURATED, ("body.coarse_hexahedra",))):
        for _ in range(6):
            result = robot.step(softrobot_twin.targets(tip=[0.01, 0.01, height]), time_step=0.1)
        assert abs(result["tip_z_m"] - height) < 1e-6
        assert result.status is status and result.report.active_limits == limits


# --- bending -------------------------------------------------------------------------------------


def bent_slab(cells, angle, steps):
    """Energy [J] of a slab that a guided plate bends along an arc, over that of elastica, and statuses."""
    length, width, height, young = 0.1, 0.02, 0.01, 2.75e5
    end = {"minimum": [length - 1e-6, -1, -1], "maximum": [1, 1, 1]}
    robot = softrobot_twin.build(
        name="slab", gravity=[0, 0, 0],
        body={"mesh": {"box": {"size": [length, width, height], "cells": cells}},
              "element": "hexahedral", "attached": [{"to": "end", "box": end}],
              "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}],
              "material": {"law": "neo_hookean", "young_modulus": young, "poisson_ratio": 0.475,
                           "density": 1000.0}},
        rigid_bodies=[{"name": "end", "motion": "guided", "position": [length, width / 2, height / 2],
                       "box": {"size": [1e-3, width, height], "centre": [1e-3, 0, 0]}}],
        effectors=[{"name": "middle", "points": [[length / 2, width / 2, height / 2]]}],
        solver={"newton_iterations": 30},
    )  # fmt: skip
    results = []
    for turn in angle * np.arange(1, steps + 1) / steps:
        radius = length / turn
        place = [radius * np.sin(turn), width / 2, height / 2 + radius * (1.0 - np.cos(turn))]
        results.append(robot.step(
            poses={"end": (place, [0, -np.sin(turn / 2), 0, np.cos(turn / 2)])}, time_step=1.0))
    positions = robot.simulation.state.positions
    terms = [term.on_points for term in robot.simulation.model.forces]
    energy = sum(term.energy(positions) for term in terms if hasattr(term, "hourglass"))
    elastica = 0.5 * young * width * height**3 / 12.0 * angle**2 / length
    return energy / elastica, results


@pytest.mark.parametrize("cells, bar", [
    ([40, 1, 1], 0.03),
    *(pytest.param(*case, marks=pytest.mark.exhaustive) for case in (
        ([5, 1, 1], 0.08), ([10, 1, 1], 0.05), ([20, 1, 1], 0.04), ([80, 1, 1], 0.03),
        ([80, 2, 1], 0.04), ([10, 8, 1], 0.05), ([10, 1, 4], 0.08), ([5, 1, 8], 0.17),
    )),
])  # fmt: skip
def test_a_slab_that_is_refined_along_one_axis_bends_by_a_right_angle_as_elastica(cells, bar):
    """Enhanced hexahedra folded where one axis alone was refined."""
    share, results = bent_slab(cells, np.pi / 2, 20)
    assert share == pytest.approx(1.0, abs=bar)
    assert all(result.status in TRUSTED for result in results)
    assert not any(result.report.projected_tangent for result in results)


# --- shipped robots ------------------------------------------------------------------------------


@pytest.mark.parametrize("name, shares", [
    ("bar_hexahedra", [[1, 0, 0, 0], [1, 1, 0, 0]]),
    pytest.param("segment", [[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 1]], marks=pytest.mark.exhaustive),
    pytest.param("stifface", [[1, 0, 0, 0] * 2, [1] * 8], marks=pytest.mark.exhaustive),
    pytest.param("fast_pneunet", [[1]], marks=pytest.mark.exhaustive),
])  # fmt: skip
def test_shipped_robots_are_fine_enough_at_their_greatest_efforts(name, shares):
    robot = softrobot_twin.load(f"config/scenes/{name}.yaml")
    simulation = robot.simulation
    most = simulation.limits.effort_max
    for share in shares:
        simulation.reset()
        for part in np.linspace(0.0, 1.0, 41)[1:]:
            result = simulation.step(CommandEfforts(part * np.array(share) * most, 0.1))
            assert not any("coarse" in limit for limit in result.report.active_limits)
