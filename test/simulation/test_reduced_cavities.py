"""Facts of scenes whose cavities are on bodies that are reduced to a basis."""

import numpy as np
import pytest

from softrobot_twin.constraints.reduced_cavities import ReducedCavities
from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.reduced_elements import SampledPoints, all_points
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Status
from softrobot_twin.view.drawn_parts import CavityDisplay
from softrobot_twin.simulation.building.cavity_walls import check_walls_of_reduced
from softrobot_twin.simulation.building.reduced_body import (
    BodyReduction,
    reduction_fingerprints,
    write_body_reduction,
)
from test.builder import builder
from test.scene_changes import changed

STEP = 0.02
BLOCK = {"size": (0.03, 0.03, 0.03), "cells": (3, 3, 3), "hole": ((1, 2), (1, 2), (1, 2))}


def save_whole_basis(path, body):
    """A reduced model whose modes are all displacements of all free nodes, with all points."""
    free = np.flatnonzero(~body.fixed)
    basis = np.zeros((len(body.fixed), 3, 3 * len(free)))
    basis[np.repeat(free, 3), np.tile(range(3), len(free)), np.arange(3 * len(free))] = 1.0
    parts = [all_points(block) for part in body.materials for block in body.mesh.blocks(part.cells)]
    points = SampledPoints(*map(np.concatenate, zip(*parts, strict=True)))
    modes = basis.shape[2]
    reduction = BodyReduction(basis, modes, points, points, np.ones(modes), np.full(2, np.nan), {})
    write_body_reduction(path, reduction, reduction_fingerprints(body))


@builder
def pair(inflatable, tmp_path, /, change=None, **entries):
    """Makes a scene with a full body, and the same in a basis that spans everything."""
    full = inflatable(change, body=BLOCK, **entries)
    path = tmp_path / "block.npz"
    save_whole_basis(path, full.model.bodies[0])
    return full, inflatable(change, {"body.reduced": {"file": str(path)}}, body=BLOCK, **entries)


turned = changed({"body.mesh.rotation": [0.0, 0.0, 0.7], "body.mesh.translation": [0.2, -0.1, 0.0]})


def walls_of(simulation):
    skin, = CavityDisplay(simulation.model).skins
    return skin.positions(simulation.state.positions)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("entries", "setpoints"),
    [({}, [8e3, 2e4, -1e4]), ({"control": "volume"}, [1.3e-6, 1.8e-6, 0.7e-6])],
)
def test_a_basis_that_spans_everything_inflates_as_the_full_body(pair, entries, setpoints):
    full, reduced = pair(turned, pressure=[-2e4, 2e4], **entries)
    assert isinstance(reduced.model.actuators.terms[0], ReducedCavities)
    for setpoint in setpoints:
        expected = full.step(CommandSetpoints([setpoint], STEP))
        result = reduced.step(CommandSetpoints([setpoint], STEP))
        assert expected.status is result.status is Status.OK
        assert abs(expected.displacements[0]) > 1e-8
        np.testing.assert_allclose(result.displacements, expected.displacements, rtol=1e-9)
        np.testing.assert_allclose(result.efforts, expected.efforts, rtol=1e-9)
        np.testing.assert_allclose(walls_of(reduced), walls_of(full), atol=1e-9 * 0.03)
        volumes = [CavityDisplay(one.model).volumes(one.state) for one in (reduced, full)]
        np.testing.assert_allclose(*volumes, rtol=1e-12)


def test_a_cavity_whose_walls_are_all_fixed_is_refused(inflatable, tmp_path):
    low = [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 0.021]}}]
    held = {**BLOCK, "fixed": low}
    body = inflatable(lambda mapping: mapping.pop("cavities"), body=held).model.bodies[0]
    save_whole_basis(tmp_path / "held.npz", body)
    with pytest.raises(SceneError, match=r"cavities\[0\]\.walls.*nothing changes its volume"):
        inflatable({"body.reduced": {"file": str(tmp_path / "held.npz")}}, body=held)


@builder
def two_blocks(simulate, hollow, tmp_path, /, reduced, walls_on=("left", "right")):
    """Makes a scene of two hollow blocks, those of given names reduced; and its cavity's walls."""
    bodies, walls = [], []
    for name in ("left", "right"):
        body, surface = hollow(**BLOCK, name=name)
        body["mesh"]["translation"] = [0.1 * len(bodies), 0.0, 0.0]
        bodies.append(body)
        walls.append({"body": name, "file": surface})
    cavity = {"name": "air", "walls": [wall for wall in walls if wall["body"] in walls_on]}
    scene = {"gravity": [0.0, 0.0, 0.0], "bodies": bodies, "cavities": [cavity]}
    if not reduced:
        return simulate(**scene)
    built = simulate(**scene).model.bodies
    for name, entry, body in zip(("left", "right"), bodies, built, strict=True):
        if name in reduced:
            entry["reduced"] = {"file": str(tmp_path / f"{name}.npz")}
            save_whole_basis(tmp_path / f"{name}.npz", body)
    return simulate(**scene)


def test_one_cavity_inflates_two_reduced_bodies(two_blocks):
    full, reduced = two_blocks(()), two_blocks(("left", "right"))
    expected, result = (one.step(CommandSetpoints([8e3], STEP)) for one in (full, reduced))
    assert expected.status is result.status is Status.OK
    np.testing.assert_allclose(result.displacements, expected.displacements, rtol=1e-9)
    assert len(walls_of(full)) == len(walls_of(reduced)) == 16
    np.testing.assert_allclose(walls_of(reduced), walls_of(full), atol=1e-9 * 0.03)


def scene_of(tmp_path, change):
    """A scene of a reduced and a full body, each with a cavity; it is not built."""
    material = {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1e3}
    bodies = [
        {"name": name, "mesh": {"file": f"{name}.vtk"}, "material": material,
         "fixed": [{"box": {"minimum": [0, 0, 0], "maximum": [1, 1, 1]}}]}
        for name in ("soft", "other")
    ]  # fmt: skip
    bodies[0]["reduced"] = {"file": "soft.npz"}
    walls = [{"body": "soft", "file": "air.stl"}]
    mapping = {"name": "scene", "bodies": bodies, "cavities": [{"name": "air", "walls": walls}]}
    change(mapping)
    return scene_from_mapping(mapping, tmp_path / "scene.yaml")


with_liquid = changed({"cavities.0.liquid_density": 1000.0})


def with_a_wall_elsewhere(mapping):
    mapping["cavities"][0]["walls"].append({"body": "other", "file": "air.stl"})


def with_a_cavity_elsewhere(mapping):
    mapping["cavities"].insert(0, {"name": "oil", "walls": [{"body": "other", "file": "oil.stl"}]})


with_a_wall_of_both = changed({"cavities.0.walls.0.also_on": ["other"]})


def with_a_wall_of_the_other_and_it(mapping):
    mapping["cavities"][0]["walls"][0].update(body="other", also_on=["soft"])


def with_sealed_gas(mapping):
    mapping["sealed_cavities"] = mapping.pop("cavities")


@pytest.mark.parametrize("change, says", [
    (with_liquid, r"cavities\[0\]\.liquid_density = 1000\.0 kg/m³.*reduced body is not built"),
    (with_a_wall_elsewhere, r"cavities\[0\]\.walls = 'air'.*lies on other, which is not reduced"),
    (with_a_cavity_elsewhere, r"cavities\[0\]\.walls = 'oil'.*lies on other, which is not"),
    (with_a_wall_of_both, r"cavities\[0\]\.walls\[0\]\.also_on.*soft is reduced"),
    (with_a_wall_of_the_other_and_it, r"cavities\[0\]\.walls\[0\]\.also_on.*soft is reduced"),
    (with_sealed_gas, r"sealed_cavities\[0\]\.walls = 'air'.*gas sealed there is not built"),
])  # fmt: skip
def test_what_is_not_built_on_reduced_bodies_is_refused_by_name(tmp_path, change, says):
    check_walls_of_reduced(scene_of(tmp_path, lambda mapping: None))
    with pytest.raises(SceneError, match=says):
        check_walls_of_reduced(scene_of(tmp_path, change))
