"""Numbers of a scene by their keys."""

import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.loading import read_changes
from softrobot_twin.scene.scene_parameters import changed_scene, joint_changes, parameters, tied, value_at
from softrobot_twin.shared_files import ScenePath
from test.places import CONFIG


SCENES = sorted((CONFIG / "scenes").glob("*.yaml"))


@pytest.fixture(scope="module")
def finger():
    return load_scene(CONFIG / "scenes" / "finger.yaml")


@pytest.mark.sampled
@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_every_number_of_every_scene_can_be_set_to_its_value(path):
    scene = load_scene(path)
    known = parameters(scene)
    for parameter in known[:: max(1, len(known) // 60)]:
        assert parameter.set(scene, parameter.read(scene)) == scene


def test_a_number_is_read_set_and_scaled(finger):
    (modulus,) = parameters(finger, "body.material.young_modulus")
    assert modulus.unit == "Pa" and modulus.read(finger) == 5e5 == 2.0 * modulus.read(modulus.scale(finger, 0.5))
    # Where two handles move one number, their moves add.
    assert joint_changes(finger, [modulus] * 2, (6e5, 4.5e5)) == {modulus.key: 5.5e5}
    other = modulus.set(finger, 1e5)
    assert other.body.material.young_modulus == 1e5 and finger.body.material.young_modulus == 5e5
    assert modulus.set(other, 5e5) == finger


def test_names_and_patterns_stand_for_places(finger):
    by_place = parameters(finger, "cables[0].points[1]")
    assert by_place == parameters(finger, "cables.flexor.points[1]")
    assert [one.key for one in by_place] == [f"cables[0].points[1][{axis}]" for axis in range(3)]
    assert [one.key for one in parameters(finger, "cables.*.rate")] == [
        "cables[0].rate", "cables[1].rate"]  # fmt: skip
    assert {one.key for one in parameters(finger, "body.material.*us")} == {
        "body.material.young_modulus"}  # fmt: skip


def test_a_star_sets_all_that_it_means():
    emio = load_scene(CONFIG / "scenes" / "emio.yaml", read_changes(["hinge_motors.*.offset=0.1", "beams.strip_*.elements=6"]))
    assert [one.offset for one in emio.hinge_motors] == [0.1] * 4
    assert [one.elements for one in emio.beams] == [6] * 4


def test_copies_move_as_their_pattern_turns_them():
    emio = load_scene(CONFIG / "scenes" / "emio.yaml")
    (clamp,) = tied(emio, "beams[0].points[0][0]#")
    places = [beam.points[0] for beam in clamp.set(emio, 0.011).beams]
    assert places == [(0.011, 0.0, -0.022), (0.0, 0.011, -0.022), (-0.011, 0.0, -0.022), (0.0, -0.011, -0.022)]
    (zero,) = tied(emio, "hinge_motors.*.offset#")  # The file leaves it out.
    assert [one.offset for one in zero.set(emio, 0.05).hinge_motors] == [0.05] * 4
    modulus, *_ = tied(emio, "beams[2].material.young_modulus#")
    assert modulus.read(emio) == 35e6
    assert {one.material.young_modulus for one in modulus.set(emio, 30e6).beams} == {30e6}


def test_signs_before_keys_tie_numbers_oppositely():
    emio = load_scene(CONFIG / "scenes" / "emio.yaml")
    for key in ("+-hinge_motors.*.offset", "+-" + "+".join(f"hinge_motors[{i}].offset" for i in range(4))):
        (zero,) = tied(emio, key)
        assert [one.offset for one in zero.set(emio, 0.05).hinge_motors] == [0.05, -0.05, 0.05, -0.05]
    (pair,) = tied(emio, "+-beams[0].points[0][0]#+hinge_motors[0].offset")
    assert [round(share) for share in pair.shares] == [1, 1, -1, -1, -1]
    with pytest.raises(SceneError, match="is no"):
        tied(emio, "+-hinge_motors.*.offst")


def test_sections_that_the_file_leaves_out_can_be_given(finger):
    changed = changed_scene(finger, {"body.damping": {"mass": 0.3}, "solver.newton_iterations": 7})
    assert changed.body.damping.mass == 0.3 and changed.solver.newton_iterations == 7
    assert changed_scene(finger, {"body.damping.mass": 0.3}).body == changed.body
    with pytest.raises(SceneError, match="contact.*between or points is required"):
        changed_scene(finger, {"contact.friction": 0.3})


def test_values_that_depend_on_each_other_are_given_together(finger):
    both = {"body.material.poisson_ratio": None, "body.material.bulk_modulus": 1e7}
    assert changed_scene(finger, both).body.material.bulk_modulus == 1e7


def test_a_preset_gives_way_to_a_constant_of_its_law(finger):
    material = {"preset": "ecoflex_00_30"}
    soft = changed_scene(finger, {"body.material": material})
    (mu,) = parameters(soft, "body.material.constants")[:1]
    harder = mu.scale(soft, 2.0)
    assert mu.read(harder) == 2.0 * mu.read(soft)
    assert harder.body.material.density == soft.body.material.density


@pytest.mark.parametrize("change, words", [
    ("body.material", "must be KEY=VALUE"),
    ("=3", "is no key of a scene"),
    ("body.materil.density=3", "body.materil.*is material meant"),
    ("cables[3].rate=1", r"cables\[3\].rate = 1: .*the scene has flexor, extensor, 0 to 1"),
    ("cables.flexr.rate=1", "is flexor meant"),
    ("springs[0].stiffness=1", r"springs\[0\].*the scene has no entry"),
    ("cables[0].tension.x=1", r"cables\[0\].tension"),
    ("body.material.density=-2", r"finger.yaml:\d+: body.material.density = -2 kg/m³: must be"),
    ("body.material.density={", "is not YAML"),
    ("body..density=1", "is no key of a scene"),
    ("cables.x*.rate=1", "cables.x.*.rate = 1: is no key of a scene"),
    ("*.rate=0.25", r"rate = 0.25( m/s)?: "),
])  # fmt: skip
def test_a_change_that_cannot_be_made_is_refused_with_its_key(finger, change, words):
    with pytest.raises(SceneError, match=words):
        changed_scene(finger, read_changes([change]))


@pytest.mark.parametrize("key", ["body.material.yong_modulus", "name", "cables.*.colour"])
def test_what_is_no_number_is_no_parameter(finger, key):
    with pytest.raises(SceneError, match="is no number of this scene"):
        parameters(finger, key)


def test_the_path_of_a_scene_carries_changes_to_other_processes(finger):
    import pickle

    path = pickle.loads(pickle.dumps(ScenePath(finger.path, ["cables.flexor.rate=0.5"]).resolve()))
    assert load_scene(path).cables[0].rate == 0.5 and path.parent == finger.path.parent.resolve()
    assert value_at(load_scene(path, {}), "cables.flexor.rate") == finger.cables[0].rate
