"""Materials by name, and strains that are told to be outside of the range of a law."""

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.material_presets import MATERIAL_PRESETS, POISSON_RATIO
from softrobot_twin.simulation import Hold
from test.builder import builder


def scene_of(tmp_path, whole=None, **material):
    body = {"mesh": "none.vtk", "material": whole or material, "fixed": [{"nodes": [0]}]}
    return scene_from_mapping({"name": "scene", "body": body}, tmp_path / "scene.yaml")


@builder
def hung(simulate, write_block, /, gravity, **material):
    """Makes a bar that hangs by its end, under a multiple of its weight."""
    return simulate(gravity=[-gravity, 0.0, 0.0], body={
        "name": "bar", "mesh": {"file": write_block((0.06, 0.02, 0.02), (2, 1, 1))},
        "element": "linear", "material": material,
        "fixed": [{"box": {"minimum": [0.029, -1, -1], "maximum": [1, 1, 1]}}],
    })  # fmt: skip


@pytest.mark.parametrize("name", MATERIAL_PRESETS)
def test_a_preset_gives_law_constants_density_and_range(tmp_path, name):
    material, preset = scene_of(tmp_path, preset=name).body.material, MATERIAL_PRESETS[name]
    assert material.law == preset.law and material.constants == preset.constants
    assert material.density == preset.density and material.poisson_ratio == POISSON_RATIO
    assert material.strain_range == preset.strain_range


def test_the_name_of_a_preset_stands_for_its_section(tmp_path):
    by_name = scene_of(tmp_path, "ecoflex_00_30").body.material
    assert by_name == scene_of(tmp_path, preset="ecoflex_00_30").body.material


def test_density_mass_poisson_ratio_and_range_may_be_given_beside_a_preset(tmp_path):
    given = {"poisson_ratio": 0.45, "density": 1000.0, "strain_range": (-0.2, 0.3)}
    material = scene_of(tmp_path, preset="ecoflex_00_30", **given).body.material
    assert {key: getattr(material, key) for key in given} == given
    weighed = scene_of(tmp_path, preset="ecoflex_00_30", total_mass=0.1).body.material
    assert weighed.density is None and weighed.total_mass == 0.1
    bulky = scene_of(tmp_path, preset="ecoflex_00_30", bulk_modulus=1e6).body.material
    assert bulky.poisson_ratio is None and bulky.bulk_modulus == 1e6


def test_strain_outside_of_the_range_is_told_after_the_step(hung):
    simulation = hung(9.81, preset="ecoflex_00_30")
    inside = simulation.step(Hold()).report
    assert inside.strains == () and not any("strain" in name for name in inside.active_limits)
    simulation = hung(9.81, preset="ecoflex_00_30", strain_range=[-0.5, 0.001])
    report = simulation.step(Hold()).report
    (outside,) = report.strains
    assert "bar.strain_range" in report.active_limits
    assert outside.body == "bar" and outside.key == "body.material"
    assert outside.greatest > 0.001 and outside.range == (-0.5, 0.001)
    words = outside.in_words()
    assert "bar" in words and "0 %" in words and f"{100 * outside.greatest:.0f} %" in words
    # The same strain by numpy.
    nodes = simulation.model.bodies[0].mesh.cells
    positions = simulation.state.positions, simulation.model.nodes.rest_positions
    after, before = (np.diff(x[nodes], axis=1) for x in positions)
    F = np.linalg.solve(before, after)
    stretches = np.linalg.svd(F, compute_uv=False)
    assert outside.greatest == pytest.approx(stretches.max() - 1.0, rel=1e-6)
