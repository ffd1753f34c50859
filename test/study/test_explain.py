"""``explain``: the text about a scene."""

import pytest

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.explain import rest_paths, sizes, thin_warnings
from test.places import SCENES


@pytest.mark.exhaustive
@pytest.mark.parametrize("scene", sorted({*SCENES.glob("*.yaml")} - {*SCENES.glob("*_device.yaml")}), ids=lambda path: path.stem)
def test_every_robot_of_the_package_is_explained(scene, call):
    done = call("explain", scene, "--no-mesh-error")
    assert "Estimated error of the effectors" not in done.output
    without = "octoleg", "fetch_reduced"
    told = "elastic energy as mounted" if scene.stem.startswith("emio") else "sag by gravity"
    assert told in done.output or scene.stem in without


@pytest.fixture(scope="module")
def grasper():
    return Simulation.from_scene_file(SCENES / "grasper.yaml")


def test_mass_of_all_is_that_of_bodies_and_free_rigid_bodies_once(grasper):
    told = dict(sizes(grasper))
    fingers = 3.0 * grasper.model.bodies[0].mass
    assert float(told["mass of all"].removesuffix(" kg")) == pytest.approx(fingers + 0.03, rel=1e-5)
    assert told["mass of cube"] == "0.03 kg"


def test_nodes_and_beams_that_a_rigid_body_bears_are_not_counted_twice():
    flexo = Simulation.from_scene_file(SCENES / "flexo.yaml")
    told, model = dict(sizes(flexo)), flexo.model
    own = sum(part.mass for part in (*model.bodies, *model.beams)) + 18 * 0.003
    assert float(told["mass of all"].removesuffix(" kg")) == pytest.approx(own, rel=1e-5)
    assert told["mass of each of hub_1 to hub_17, palm"] == "0.003 kg"
    paths = dict(rest_paths(flexo))
    assert len(paths) == 4
    assert paths["lower_0, lower_1, lower_2 (3)"].startswith("275 mm, lower_0 from [68, 0, 0] ")


def test_one_element_across_the_thinnest_part_is_warned_of(grasper):
    told = dict(sizes(grasper))
    fingers = "finger_0, finger_1, finger_2"
    assert told[f"thinnest part of each of {fingers}"] == "5 mm, 1 linear element across"
    (warning,) = thin_warnings(grasper)
    assert fingers in warning and "quadratic" in warning


def test_a_picture_of_the_scene_at_rest_is_drawn_with_names(column, tmp_path, call):
    image = pytest.importorskip("matplotlib.image")
    done = call("explain", column, "--no-mesh-error", "--picture", tmp_path / "column.png",
                "--picture-view", 10, -40)
    assert f"picture: {tmp_path / 'column.png'}" in done.output
    assert image.imread(tmp_path / "column.png").shape[0] > 400
