"""Parts of a body that several threads assemble."""

import numpy as np
import pytest

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.smoothed_mesh import smooth
from softrobot_twin.kernels.worker_threads import team_of
from softrobot_twin.mechanics import assembly_parts
from softrobot_twin.mechanics.patch_volumes import PatchVolumes, patched_cells

SIZE = (0.02, 0.02, 0.1)
KINDS = {
    "linear": lambda mesh: mesh,
    "quadratic": lambda _: add_mid_edge_nodes(read_box(SIZE, (2, 2, 10)).mesh),
    "smoothed": smooth,
    "hexahedral": lambda _: read_box(SIZE, (3, 3, 14), of_hexahedra=True).mesh,
}


def _bar(kind):
    return KINDS[kind](read_box(SIZE, (3, 3, 14)).mesh)


@pytest.fixture
def cut(monkeypatch):
    """Small bodies are cut into parts too."""
    monkeypatch.setattr(assembly_parts, "LEAST_NODES", 0)


def patches(mesh, free, _):
    mesh = getattr(mesh, "tets", mesh)
    return PatchVolumes(mesh, free, 1.0e5, patched_cells(mesh).patches)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", ["corotational", "neo_hookean", patches])
def test_parts_give_the_sums_of_the_whole_and_the_same_bits_for_any_number_of_threads(
    kind, law, bind, drawn_rng, monkeypatch
):
    mesh = _bar(kind)
    block = mesh.strained_blocks()[0].mesh
    x = mesh.node_positions + 2e-4 * drawn_rng.standard_normal(mesh.node_positions.shape)
    whole = bind((law, block, 1.0e5, 0.4), fixed=range(9))
    whole.terms[0].use_threads(team_of(2))
    assert whole.terms[0].is_traceable and len(whole.terms[0].parts.begins) == 2
    monkeypatch.setattr(assembly_parts, "LEAST_NODES", 0)
    bound = bind((law, block, 1.0e5, 0.4), fixed=range(9))
    for projected in (False, True):
        forces, stiffness = bound.assemble(x, projected)
        for one, other in zip((forces, stiffness.toarray()), whole.assemble(x, projected), strict=True):
            other = other if isinstance(other, np.ndarray) else other.toarray()
            np.testing.assert_allclose(one, other, atol=1e-13 * np.abs(other).max())
    for count in (1, 2, 3):
        bound.terms[0].use_threads(team_of(count))
        assert not bound.terms[0].is_traceable
        for _ in range(3):
            bound.terms[0].add_forces(mesh.node_positions, np.zeros_like(forces))
            again, of_threads = bound.assemble(x, True)
            np.testing.assert_array_equal(again, forces)
            np.testing.assert_array_equal(of_threads.data, stiffness.data)


@pytest.mark.parametrize("kind", KINDS)
def test_parts_have_each_batch_once_and_wait_for_all_earlier_ones_at_their_nodes(kind, bind, cut):
    term = bind(("corotational", _bar(kind).strained_blocks()[0].mesh, 1.0e5, 0.4)).terms[0]
    parts, nodes = term.parts, [set() for _ in term.parts.begins[1:]]
    np.testing.assert_array_equal(np.sort(parts.batches), np.arange(len(parts.batches)))
    assert len(nodes) > 3
    for part, own in enumerate(nodes):
        for k in parts.batches[parts.begins[part] : parts.begins[part + 1]]:
            own.update(term.mesh.cells[16 * k : 16 * (k + 1)].ravel())
        waits = parts.waits[parts.wait_begins[part] : parts.wait_begins[part + 1]]
        assert list(waits) == [other for other in range(part) if nodes[other] & own]


def test_one_flat_element_takes_the_barrier_from_all_parts(bind, cut):
    """As in a body that is one part; else forces would depend on where a body is cut."""
    mesh = _bar("linear")
    (term,) = (bound := bind(("corotational", mesh, 1.0e5, 0.4))).terms
    x = mesh.node_positions.copy()
    x[:, 2] = np.minimum(x[:, 2], x[:, 2].mean() + 0.02 * (x[:, 2] - x[:, 2].mean()))
    for count in (1, 2):
        bound.forces(x)
        assert term.nearly_flat_count > 0
        folded = x.copy()
        folded[x[:, 2].argmin(), 2] += 0.03
        bound.forces(folded)
        assert term.nearly_flat_count == 0
        term.use_threads(team_of(count))
