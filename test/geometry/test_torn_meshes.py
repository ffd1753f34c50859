"""Mesh files damaged at random: each is read, or refused by one line that names the file."""

import random

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.reading import read_tet_mesh

FORMATS = {
    ".msh": {"file_format": "gmsh22", "binary": False}, ".vtk": {"file_format": "vtk42"},
    ".vtu": {"file_format": "vtu", "binary": False}, ".inp": {"file_format": "abaqus"},
}  # fmt: skip
BITS = (b"", b"-1", b"0", b"9" * 12, b"nan", b"1e400", b"x", b" ", b"\n", b"\xff\x00", b"<", b"*")


def torn(content: bytes, chance: random.Random) -> bytes:
    """The content with pieces replaced, or with its end cut off."""
    for _ in range(chance.choice((1, 1, 2, 8))):
        place = chance.randrange(max(len(content), 1))
        if chance.random() < 0.1:
            content = content[: max(place, 1)]
        else:
            end = place + chance.choice((0, 1, 3, 12))
            content = content[:place] + chance.choice(BITS) + content[end:]
    return content


@pytest.mark.parametrize("nodes", [4, 10])
@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.filterwarnings("ignore")
def test_a_torn_file_is_read_or_refused_by_name(suffix, nodes, block, tmp_path, capfd):
    mesh = block(cells=(1, 1, 2))
    kind = "tetra"
    if nodes == 10:
        mesh, kind = add_mid_edge_nodes(mesh), "tetra10"
    file = tmp_path / f"body{suffix}"
    meshio.Mesh(mesh.node_positions, [(kind, mesh.cells)]).write(file, **FORMATS[suffix])
    content = file.read_bytes()
    capfd.readouterr()  # of the writer
    chance = random.Random(f"{suffix}{nodes}")
    for _ in range(60):
        file.write_bytes(torn(content, chance))
        try:
            reading = read_tet_mesh(file)
        except MeshError as error:
            assert error.path == file and str(error).startswith(f"{file}: ")
            assert "\n" not in str(error) and len(str(error)) < 600
        else:
            assert (reading.mesh.volumes > 0.0).all()
            assert np.isfinite(reading.mesh.node_positions).all()
    assert capfd.readouterr() == ("", "")
