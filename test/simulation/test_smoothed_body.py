"""Bodies of linear tetrahedra whose strain is smoothed over edges: what is built, refused and told."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.patch_volumes import PatchVolumes
from softrobot_twin.simulation import Hold
from test.builder import builder
from test.scene_changes import in_balance

SIZE = (0.1, 0.02, 0.02)


@builder
def beam(simulate, body_of, block, /, element="smoothed", law="corotational", poisson=0.45,
         cells=(10, 2, 2), body=(), **entries):  # fmt: skip
    """Makes a cantilever."""
    held = [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}]
    mesh = block(SIZE, cells, 0.2)
    made = body_of(mesh, "beam", 1e5, poisson, element=element, fixed=held, **dict(body))
    made["material"]["law"] = law
    entries = {"gravity": [0.0, 0.0, -9.81], "solver": {"newton_iterations": 30}, **entries}
    return simulate(body=made, **entries)


def patches_of(simulation):
    return [term for term in simulation.model.forces if isinstance(term, PatchVolumes)]


def sag(simulation):
    result = in_balance(simulation, Hold(), 10)
    assert result.report.inverted_count == 0
    rest = simulation.model.nodes.rest_positions
    return -float((result.state.positions - rest)[rest[:, 0] > SIZE[0] - 1e-9, 2].mean())


@pytest.mark.parametrize("law, is_divided", [
    ("corotational", True), ("neo_hookean", True), ("linear", False),
])  # fmt: skip
def test_patches_keep_volumes_where_the_law_can_be_divided(beam, law, is_divided):
    assert bool(patches_of(beam(law=law))) == is_divided
    assert not patches_of(beam(law=law, body={"volume": "per_element"}))


def test_other_elements_have_rings_and_patches_only_if_a_scene_names_them(beam):
    for element in ("linear", "quadratic"):
        simulation = beam(element)
        assert not patches_of(simulation)
        (term,) = [term for term in simulation.model.forces if isinstance(term, Elements)]
        assert not hasattr(term.mesh, "node_counts")


def test_smoothing_adds_no_unknown(beam):
    smoothed, linear = (beam(element).model.nodes.free_node_count for element in ("smoothed", "linear"))
    assert smoothed == linear


@pytest.mark.sampled
@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
@pytest.mark.parametrize("poisson", [0.3, 0.45, 0.49])
def test_the_sag_is_nearly_that_of_quadratic_elements(beam, law, poisson):
    exact = sag(beam("quadratic", law, poisson, body={"volume": None}))
    smoothed, linear = sag(beam("smoothed", law, poisson)), sag(beam("linear", law, poisson))
    assert exact > 0.2 * SIZE[0]
    assert abs(1.0 - smoothed / exact) < 0.15 < 0.3 < 1.0 - linear / exact


@pytest.mark.parametrize("integration", ["dynamic", "first_order"])
def test_motion_in_time_ends_where_statics_does(beam, integration):
    damping = {"damping": {"mass": 5.0, "stiffness": 0.02}}
    simulation = beam(integration=integration, body=damping)
    rest = simulation.model.nodes.rest_positions
    tip = rest[:, 0] > SIZE[0] - 1e-9
    for _ in range(400):
        state = simulation.step(Hold(0.02)).state
    assert -(state.positions - rest)[tip, 2].mean() == pytest.approx(sag(beam()), rel=0.01)


def test_two_materials_share_no_ring(beam):
    """A stiff half hardly bends; its edges at the interface are in both materials."""
    half = {"box": {"minimum": [-1, -1, -1], "maximum": [SIZE[0] / 2, 1, 1]}}
    simulation = beam(body={"materials": [{**half, "young_modulus": 1e8}]}, cells=(10, 2, 2))
    terms = [term for term in simulation.model.forces if isinstance(term, Elements)]
    edges = [{tuple(sorted(set(ring))) for ring in term.mesh.cells} for term in terms]
    assert len(terms) == 2 and not edges[0] & edges[1]
    assert 0.0 < sag(simulation) < 0.3 * sag(beam())


def test_a_note_tells_that_smoothed_elements_lock_without_patches(beam):
    (note,) = [one for one in beam(poisson=0.49, body={"volume": "per_element"}).notes
               if "lock" in one]  # fmt: skip
    assert "smoothed" in note
    assert not any("lock" in one for one in beam(poisson=0.49).notes)


@pytest.mark.exhaustive
def test_nothing_grows_in_twenty_thousand_steps(simulate, body_of, block):
    """A free block that was thrown and squeezed: neither energy nor momentum grows."""
    body = body_of(block((0.02, 0.02, 0.02), (1, 1, 1), 0.0), "cube", 1e5, 0.45, element="smoothed")
    body["material"]["law"] = "neo_hookean"
    simulation = simulate(body=body, integration="dynamic", time_scheme="generalized_alpha",
                          gravity=[0, 0, 0], solver={"newton_iterations": 4})  # fmt: skip
    nodes, rng = simulation.model.nodes, np.random.default_rng(3)
    thrown = 0.3 * rng.standard_normal((nodes.free_node_count, 3)) + [0.1, 0.2, 0.0]
    simulation.restore(replace(simulation.state, velocities=thrown))
    inertia = next(term for term in simulation.model.forces if "inertia" in term.name)
    momentum = inertia.momentum(simulation.state.velocities)
    energies = []
    for step in range(20_000):
        state = simulation.step(Hold(0.002)).state
        if step % 200 == 0:
            stored = sum(term.energy(state.positions) for term in simulation.model.forces)
            energies.append(stored + inertia.kinetic_energy(state.positions, state.velocities))
    np.testing.assert_allclose(inertia.momentum(state.velocities), momentum, rtol=2e-7)
    assert max(energies[1:]) <= 1.002 * energies[0]
