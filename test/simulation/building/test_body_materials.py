"""Several materials in one body, by named regions of the mesh file and by boxes."""

import meshio
import numpy as np
import pytest

from softrobot_twin.analysis.mesh_error import MeshErrorEstimator
from softrobot_twin.errors import SceneError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Hold
from test.builder import builder
from test.scene_changes import repeat_step

FOOT = [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}]
LENGTH, SIDE = 0.2, 0.01
BELOW = {"minimum": [-1, -1, -1], "maximum": [1, 1, SIDE / 2]}


@builder
def beam_entry(tmp_path, block, /, cells=(12, 1, 2), element="quadratic", **entries) -> dict:
    """Makes the entry of a beam along x, held at its foot; its file names `below` and `above`."""
    mesh = block(size=(LENGTH, SIDE, SIDE), cells=cells, shake=0.0)
    below = mesh.node_positions[mesh.cells].mean(axis=1)[:, 2] < SIDE / 2
    path = tmp_path / "beam.inp"
    meshio.Mesh(
        mesh.node_positions, [("tetra", mesh.cells)],
        cell_sets={"below": [np.flatnonzero(below)], "above": [np.flatnonzero(~below)]},
    ).write(path, file_format="abaqus")  # fmt: skip
    material = {"young_modulus": 1e6, "poisson_ratio": 0.3, "density": 1000.0}
    return {"name": "beam", "mesh": {"file": str(path)}, "element": element, "fixed": FOOT,
            "material": material, **entries}  # fmt: skip


def tip(simulation) -> np.ndarray:
    """Mean displacement of the beam's end [m]."""
    rest = simulation.model.nodes.rest_positions
    end = rest[:, 0] > LENGTH - 1e-9
    return (simulation.state.positions - rest)[end].mean(axis=0)


def settled(simulation, steps=3, residual=1e-8):
    result = repeat_step(simulation, Hold(0.05), steps)
    assert result.report.residual < residual
    return simulation


@pytest.mark.sampled
@pytest.mark.parametrize("ratio", [3.0, 30.0])
@pytest.mark.parametrize("by", [{"region": "below"}, {"box": BELOW}])
def test_a_bilayer_beam_bends_as_a_composite_beam(ratio, by, simulate, beam_entry):
    """Its bending stiffness is D - B²/A, with the stiffnesses A, B, D of the section."""
    stiff = {**by, "young_modulus": ratio * 1e6, "density": 2000.0}
    g = 1e-3  # so small that it bends linearly
    body = beam_entry((20, 2, 4), materials=[stiff])
    scene = settled(simulate(body=body, gravity=[0, 0, -g]))
    moduli, heights = np.array([ratio * 1e6, 1e6]), np.array([-SIDE / 4, SIDE / 4])
    area = SIDE * SIDE / 2
    axial, coupling = moduli.sum() * area, (moduli * heights).sum() * area
    own = SIDE * (SIDE / 2) ** 3 / 12 + area * heights**2
    bending = (moduli * own).sum() - coupling**2 / axial
    expected = (1000.0 + 2000.0) * area * g * LENGTH**4 / (8.0 * bending)
    assert -tip(scene)[2] == pytest.approx(expected, rel=0.02)


def test_a_region_and_the_box_around_it_are_the_same_cells(simulate, beam_entry):
    stiff = {"young_modulus": 5e6, "poisson_ratio": 0.4, "density": 1500.0}
    first, second = (
        settled(simulate(body=beam_entry(materials=[{**stiff, **by}]), gravity=[0, 0, -1.0]))
        for by in ({"region": "below"}, {"box": BELOW})
    )
    np.testing.assert_array_equal(first.state.positions, second.state.positions)
    assert first.notes == second.notes == ()


@pytest.mark.parametrize("element", ["linear", "quadratic"])
@pytest.mark.parametrize("mass", ["lumped", "consistent", "uniform"])
def test_equal_materials_of_all_parts_are_one_material(element, mass, simulate, beam_entry):
    same = {"young_modulus": 1e6, "poisson_ratio": 0.3, "density": 1000.0}
    moved = []
    for materials in ([], [{"region": "above", **same}, {"region": "below", **same}]):
        entry = beam_entry((6, 1, 2), element, materials=materials, mass=mass,
                           damping={"mass": 2.0, "stiffness": 0.002})  # fmt: skip
        simulation = simulate(body=entry, integration="dynamic")
        repeat_step(simulation, Hold(0.01), 5)
        moved.append(simulation.state.positions - simulation.model.nodes.rest_positions)
    assert np.abs(moved[0]).max() > 1e-3
    np.testing.assert_allclose(moved[1], moved[0], atol=1e-12 * LENGTH, rtol=0)


def test_what_is_not_stated_is_that_of_the_body(simulate, beam_entry):
    entry = beam_entry((6, 1, 2), materials=[{"region": "below", "young_modulus": 1e6}])
    entry["material"]["law"] = "linear"
    divided = settled(simulate(body=entry))
    whole = settled(simulate(body=entry | {"materials": []}))
    np.testing.assert_allclose(divided.state.positions, whole.state.positions, atol=1e-12)


@pytest.mark.parametrize("element", ["linear", "quadratic"])
def test_a_part_a_million_times_stiffer_acts_like_a_fixed_part(element, simulate, beam_entry):
    half = {"minimum": [-1, -1, -1], "maximum": [LENGTH / 2 + 1e-9, 1, 1]}
    entry = beam_entry((8, 2, 2), element)
    entry["material"]["young_modulus"] = 1e5
    stiff = simulate(body=entry | {"materials": [{"box": half, "young_modulus": 1e11}]})
    held = simulate(body=entry | {"fixed": [{"box": half}]})
    settled(held)
    settled(stiff, residual=1e-6)  # the rounding of forces in the stiff part
    assert tip(held)[2] < -1e-3
    np.testing.assert_allclose(
        stiff.state.positions, held.state.positions, atol=2e-5 * abs(tip(held)[2])
    )


@pytest.mark.parametrize("mass", ["lumped", "consistent", "uniform"])
def test_mass_and_weight_are_the_sum_of_the_parts(mass, simulate, beam_entry):
    heavy = {"region": "below", "young_modulus": 1e6, "density": 4000.0}
    simulation = simulate(body=beam_entry(materials=[heavy], mass=mass, fixed=[]),
                          integration="dynamic")  # fmt: skip
    expected = (1000.0 + 4000.0) * LENGTH * SIDE**2 / 2
    assert simulation.model.bodies[0].mass == pytest.approx(expected)
    weight = next(term for term in simulation.model.forces if term.name == "gravity").weights
    assert weight.sum(axis=0) == pytest.approx([0, 0, -9.81 * expected])
    inertia = next(term for term in simulation.model.forces if "inertia" in term.name)
    velocities = np.ones((simulation.model.nodes.free_node_count, 3))
    assert inertia.momentum(velocities) == pytest.approx(3 * [expected])
    # It falls without bending, as heavy and light bodies do.
    rest = simulation.model.nodes.rest_positions
    fallen = simulation.step(Hold(0.01)).state.positions - rest
    if mass != "uniform":
        np.testing.assert_allclose(fallen, np.tile([0, 0, -9.81e-4], (len(rest), 1)), atol=1e-11)


def test_a_stiffer_part_is_as_much_more_viscous(simulate, beam_entry):
    entry = beam_entry((6, 1, 2), damping={"stiffness": 0.01}, materials=[
        {"region": "below", "young_modulus": 5e6}])  # fmt: skip
    simulation = simulate(body=entry, integration="dynamic")
    simulation.step(Hold(0.01))
    soft, stiff = [t for t in simulation.model.forces if t.name == "strain-rate damping"]
    rest = simulation.model.nodes.rest_positions
    for term in (soft, stiff):
        term.begin_step(rest, np.zeros_like(rest), 0.01)
    stretched = rest * [1.01, 1.0, 1.0]
    assert stiff.heat(stretched) == pytest.approx(5.0 * soft.heat(stretched))


def test_the_error_of_the_mesh_knows_each_material(beam_entry, tmp_path):
    def error(young_modulus, base):
        entry = beam_entry((6, 1, 2), "linear", materials=[
            {"region": "below", "young_modulus": young_modulus, "density": 1000.0}])  # fmt: skip
        entry["material"]["young_modulus"] = base
        return MeshErrorEstimator(scene_from_mapping({
            "name": "beam", "body": entry,
            "effectors": [{"name": "tip", "points": [[LENGTH, SIDE / 2, SIDE / 2]]}],
        }, tmp_path / "scene.yaml")).responses()  # fmt: skip

    one, same, stiff = error(1e6, 1e6), error(3e6, 3e6), error(1e9, 1e6)
    for first, second in zip(one, same, strict=True):
        np.testing.assert_allclose(first.gravity, 3.0 * second.gravity, rtol=1e-6, atol=1e-9)
    # Of a beam that is stiff below and soft above, the limit is the bending of the stiff layer.
    assert abs(stiff[2].gravity[2]) < 0.02 * abs(one[2].gravity[2])


@pytest.mark.parametrize("materials, key, told", [
    ([{"region": "side"}], "body.materials[0].region",
     "beam.inp has no volume region named side; of this kind it names above, below"),
    ([{"box": {"minimum": [1, 1, 1], "maximum": [2, 2, 2]}}], "body.materials[0].box",
     "holds the centre of no cell of the body, which reaches from [0.0, 0.0, 0.0] to "),
    ([{"region": "above"}, {"region": "below"}, {"box": BELOW}], "body.materials[2].box",
     "that body.materials[1] claims too"),
    ([{"region": "above"}, {"region": "above"}], "body.materials[1].region",
     "that body.materials[0] claims too"),
    ([{"region": "above", "box": BELOW}], "body.materials[0]", "exactly one of region, box"),
    ([{}], "body.materials[0]", "exactly one of region, box"),
])  # fmt: skip
def test_an_entry_that_cannot_be_used_is_refused(materials, key, told, simulate, beam_entry):
    entries = [{"young_modulus": 1e5, **entry} for entry in materials]
    with pytest.raises(SceneError) as caught:
        simulate(body=beam_entry(materials=entries))
    assert caught.value.key == key and told in caught.value.reason


def test_a_total_mass_of_several_materials_is_refused(simulate, beam_entry):
    entry = beam_entry(materials=[{"region": "above", "young_modulus": 1e5}])
    entry["material"] = {"young_modulus": 1e5, "poisson_ratio": 0.3, "total_mass": 1.0}
    with pytest.raises(SceneError, match="needs material.density"):
        simulate(body=entry)


def test_cells_that_a_box_cuts_and_unlikely_values_are_reported(simulate, beam_entry):
    cut = {"minimum": [-1, -1, -1], "maximum": [1, 1, 0.4 * SIDE]}
    entry = beam_entry(materials=[{"box": cut, "young_modulus": 10.0}])
    notes = simulate(body=entry).notes
    assert any("body.materials[0].box: " in note and "partly inside" in note for note in notes)
    assert any("body.materials[0].young_modulus = 10 Pa is outside" in note for note in notes)


def test_a_box_may_be_given_in_the_coordinates_of_the_mesh(simulate, beam_entry):
    entry = beam_entry(materials=[{"box": BELOW, "frame": "mesh", "young_modulus": 1e5}], fixed=[
        {"frame": "mesh", **FOOT[0]}])  # fmt: skip
    entry["mesh"] |= {"rotation": [0.3, 0.5, 0.7], "translation": [0.1, 0.2, 0.3]}
    (stiff,) = (p for p in simulate(body=entry).model.bodies[0].materials if "s[0]" in p.key)
    assert stiff.volume == pytest.approx(LENGTH * SIDE**2 / 2)
