"""Runs without commands from the command line: a body sags, a cube falls."""

import meshio
import pytest

from softrobot_twin.tables.run_columns import TEXT_COLUMNS
from test.run_files import rows_of
from test.scene_changes import yaml_file

DENSITY, YOUNG, SIZE = 1000.0, 2.0e5, (0.02, 0.02, 0.1)


@pytest.fixture
def hung(tmp_path, block):
    """Scene file of a column that hangs from its top, without actuators or effectors."""
    mesh = block(size=SIZE, cells=(2, 2, 6), shake=0.0)
    meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)]).write(tmp_path / "column.vtk")
    return yaml_file(tmp_path / "hung.yaml", {
        "name": "hung",
        "body": {
            "mesh": "column.vtk", "element": "quadratic",
            "material": {"young_modulus": YOUNG, "poisson_ratio": 0.0, "density": DENSITY},
            "fixed": {"box": {"minimum": [-1, -1, 0.099], "maximum": [1, 1, 1]}}},
        "markers": {"id": 7, "point": [0.01, 0.01, 0.0]}})


@pytest.fixture
def falling(tmp_path):
    """Scene file of a cube 100 mm above a floor."""
    return yaml_file(tmp_path / "falling.yaml", {
        "name": "falling", "integration": "dynamic",
        "rigid_bodies": {"name": "cube", "mass": 0.05, "position": [0.0, 0.0, 0.12],
                         "box": {"size": [0.04, 0.04, 0.04]}},
        "obstacles": {"name": "floor", "plane": {}},
        "contact": {"between": {"pair": ["cube", "floor"]}}})


def values_of(path):
    return [{key: value if key in TEXT_COLUMNS else float(value) for key, value in row.items()}
            for row in rows_of(path)]


def test_a_hanging_body_stretches_under_its_weight(hung, tmp_path, call):
    call("simulate", hung, "--steps", 8, "--output", tmp_path / "run.csv")
    row = values_of(tmp_path / "run.csv")[-1]
    length, stress = SIZE[2], DENSITY * 9.81 * SIZE[2]
    stretch = stress * length / (2.0 * YOUNG)
    assert row["status"] == "ok"
    assert row["body_moved_m"] == pytest.approx(stretch, rel=0.02)
    assert row["marker_7_z_m"] == pytest.approx(-stretch, rel=0.02)
    assert row["body_centre_z_m"] == pytest.approx(length / 2 - 2 * stretch / 3, abs=0.1 * stretch)
    # At rest the elastic energy is half of the lost potential energy.
    assert row["elastic_energy_J"] == pytest.approx(-0.5 * row["gravity_energy_J"], rel=0.02)
    assert row["kinetic_energy_J"] == 0.0


def test_a_cube_falls_by_the_square_of_time_and_rests_on_the_floor(falling, tmp_path, call):
    call("simulate", falling, "--seconds", 0.5, "--rate", 1000, "--output", tmp_path / "run.csv")
    rows = values_of(tmp_path / "run.csv")
    assert len(rows) == 500
    flying, resting = rows[99], rows[-1]
    assert flying["time_s"] == pytest.approx(0.1)
    assert flying["cube_z_m"] == pytest.approx(0.12 - 0.5 * 9.81 * 0.1**2, abs=6e-4)
    assert flying["kinetic_energy_J"] == pytest.approx(-flying["gravity_energy_J"], rel=0.02)
    assert resting["cube_z_m"] == pytest.approx(0.02, abs=1e-6)
    assert resting["gravity_energy_J"] == pytest.approx(-0.05 * 9.81 * 0.1, rel=1e-4)
    assert resting["kinetic_energy_J"] < 1e-9
    assert resting["force_on_cube_by_floor_z_N"] == pytest.approx(0.05 * 9.81, rel=1e-3)
