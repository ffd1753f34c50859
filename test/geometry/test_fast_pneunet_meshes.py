"""The script that makes meshes of the PneuNet with gaps between its chambers."""

from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.geometry.mesh_reading import read_solid_mesh

MESHES = Path(__file__).resolve().parents[2] / "meshes"


@pytest.mark.parametrize("size", [1176, 1400])
def test_the_script_makes_the_committed_mesh(size, mesh_script, tmp_path, capsys):
    script = mesh_script("make_fast_pneunet")
    assert script.main(["--size", str(size), "--output", str(tmp_path)]) == 0
    name = f"fast_pneunet_{size}.msh"
    made, kept = (read_solid_mesh(folder / name).mesh for folder in (tmp_path, MESHES))
    np.testing.assert_array_equal(made.cells, kept.cells)
    np.testing.assert_allclose(made.node_positions, kept.node_positions, rtol=0, atol=1e-12)
    assert f"{name}: {kept.node_count} nodes" in capsys.readouterr().out


def test_its_dimensions_are_those_of_the_shape(mesh_script):
    shape = mesh_script("make_fast_pneunet").Shape()
    made = read_solid_mesh(MESHES / "fast_pneunet_1176.msh").mesh
    length = 7 * (shape.chamber[0] + 2 * shape.wall) + 6 * shape.gap
    height = shape.base + shape.chamber[2] + shape.ceiling
    np.testing.assert_allclose(
        1e3 * made.bounding_box, [[0.0, -9.5, 0.0], [length, 9.5, height]], atol=1e-9)
