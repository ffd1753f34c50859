"""Repair of surfaces that enclose no solid."""

import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.cad_meshing import read_shells
from test.shapes import Capsule
from softrobot_twin.study.meshing import mesh_part
from test.cad_parts import box, inside_out, joined, write_stl

CUBE = box((20, 20, 20))


def holed():
    """A capsule without its upper end and with a window, and its volume without the end."""
    points, triangles = Capsule([[0, 0, 0], [0, 0, 50]], 20.0).surface(5.0)
    middle = points[triangles].mean(axis=1)
    window = (np.abs(middle[:, 0]) < 8) & (np.abs(middle[:, 2] - 20) < 10) & (middle[:, 1] > 0)
    return points, triangles[~window & (middle[:, 2] < 60)]


@pytest.mark.parametrize("part, volume, word", [
    ((CUBE[0], CUBE[1][2:]), 8000.0, "closed a hole of 3 edges"),
    (joined(CUBE, box((20, 20, 20), (7, 3, 1))), 16000.0 - 13 * 17 * 19, "united 2 solids"),
    (joined(CUBE, box((8, 8, 20), (0, 0, 15))), 8000.0 + 64 * 15, "united 2 solids"),
    (joined(CUBE, box((20, 20, 20), (20, 0, 0))), 16000.0, "walls between touching solids"),
    (joined(CUBE, box((10, 10, 10), (15, 0, 0))), 9000.0, "united 2 solids"),
    (joined(CUBE, inside_out(box((10, 10, 10))), box((20, 20, 20), (15, 3, 1))),
     15000.0 - 5 * 17 * 19, "united 2 solids"),
    (joined(CUBE, box((12, 12, 12)), box((4, 4, 4))), 8000.0 - 12**3 + 4**3, ""),
], ids=["holes", "overlap", "through", "a wall", "a part of a wall", "a cavity", "nested"])  # fmt: skip
def test_a_repaired_surface_encloses_the_union(part, volume, word, tmp_path):
    path = write_stl(tmp_path / "part.stl", part)
    if word:
        with pytest.raises(MeshError, match="mesh part.stl --repair"):
            read_shells(path, 1e-3)
    shells = read_shells(path, 1e-3, repair=True)
    assert 1e9 * shells.volume == pytest.approx(volume, rel=1e-5)
    assert word in "; ".join(shells.notes)


def test_holes_of_many_edges_are_closed_with_their_places(tmp_path):
    shells = read_shells(write_stl(tmp_path / "part.stl", holed()), 1e-3, repair=True)
    told = [note for note in shells.notes if "closed a hole" in note]
    assert len(told) == 2 and "(0.000, 0.000, 60" in " ".join(told)
    # Of facets, the capsule without its cap above 60 mm and flat across its window.
    whole = np.pi * 400.0 * 50.0 + 4.0 / 3.0 * np.pi * 8000.0 - np.pi * 10.0**2 * (20.0 - 10.0 / 3.0)
    assert 1e9 * shells.volume == pytest.approx(whole, rel=0.04)


def test_solids_that_share_an_edge_alone_are_refused(tmp_path):
    path = write_stl(tmp_path / "part.stl", joined(CUBE, box((20, 20, 20), (20, 20, 0))))
    with pytest.raises(MeshError, match="more than two triangles.*that is not repaired"):
        read_shells(path, 1e-3, repair=True)


def test_the_repaired_surface_is_written_in_the_unit_of_the_part(tmp_path, capsys):
    path = write_stl(tmp_path / "part.stl", (CUBE[0], CUBE[1][1:]))
    assert mesh_part(path, tmp_path / "out.stl", repair=True) == 0
    assert "closed a hole" in capsys.readouterr().err
    assert 1e9 * read_shells(tmp_path / "out.stl", 1e-3).volume == pytest.approx(8000.0, rel=1e-5)
