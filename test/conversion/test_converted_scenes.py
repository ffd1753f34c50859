"""Scenes of SOFA of all kinds: what they become, and that they run."""

import re

import meshio
import numpy as np
import pytest

from softrobot_twin.__main__ import main

GOOD = {"ok", "linearized", "rate_limited"}
# Exit code and step [s] of each scene.
SCENES = {
    "diamond.py": (0, 1.0), "stiff_layer.py": (0, 0.02), "pneumatic_fingers.py": (3, 0.01), "grid.py": (0, 0.01),
    "rubber.py": (0, 0.01), "prefabs.py": (0, 0.01), "rigid_end.py": (0, 0.01), "beam.py": (0, 0.01),
    "centre.py": (0, 0.05), "foreign.py": (3, 0.01), "bar.scn": (0, 0.01), "mapped_grids.py": (3, 0.01), "sparse.scn": (0, 0.01),
    "gid.py": (0, 0.01), "articulated.py": (0, 0.01), "layers.scn": (0, 0.01), "grids.scn": (0, 0.01), "volume.scn": (0, 0.01),
    "patches.scn": (0, 0.01), "planes.scn": (0, 0.01), "slide.scn": (0, 1.0),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_converted_and_runs_twenty_steps(convert, run_alone, name):
    code, time_step = SCENES[name]
    converted = convert(name)
    assert converted.code == code, converted.told
    _, statuses = run_alone(converted.scene, time_step)
    assert set(statuses) <= GOOD


def test_loader_and_state_place_the_file_of_the_body(convert):
    mesh = convert("diamond.py").scene.deformables[0].mesh
    assert mesh.scale == 1e-3 and mesh.file.name == "diamond.vtk"
    np.testing.assert_allclose(mesh.rotation, [np.pi / 2, 0.0, 0.0])
    np.testing.assert_allclose(mesh.translation, [0.0, 0.0, 0.035])


def test_values_are_in_si_by_the_gravity_of_the_file(convert):
    scene = convert("diamond.py").scene
    body = scene.deformables[0]
    assert body.material.young_modulus == 180e3 and body.material.total_mass == 0.5
    assert body.fixed[0].box.minimum == (-0.015, -0.015, -0.04)
    assert scene.cables[0].shortening == (-np.inf, 0.02)
    assert scene.cables[0].pull_point == (0.0, 0.01, 0.03)
    assert scene.gravity == (0.0, 0.0, -9.81)


@pytest.mark.parametrize("units, young, length", [
    ("mm-kg-s", 180e3, 0.125), ("mm-g-s", 180.0, 0.125), ("m-kg-s", 180.0, 125.0)])  # fmt: skip
def test_units_that_are_given_go_before_gravity(convert, units, young, length):
    scene = convert("diamond.py", None, "--units", units).scene
    assert scene.deformables[0].material.young_modulus == pytest.approx(young)
    assert scene.effectors[0].points[0][2] == pytest.approx(length)


@pytest.mark.parametrize("name, kind, header, first, last", [
    ("diamond", "targets", "time_s,tip_x_m,tip_y_m,tip_z_m", "0,0,0,0.122", "20,0,0,0.122"),
    ("stiff_layer", "commands", "time_s,flexor_shortening_m", "0,0", "0.4,0.002"),
    ("prefabs", "commands", "time_s,cable_tension_N", "0,0", "0.2,0.0001"),  # 0.001 mN s in 0.01 s
])  # fmt: skip
def test_goals_and_values_of_actuators_are_targets_and_commands(convert, folder, name, kind, header, first, last):
    told = convert(f"{name}.py").told
    rows = (folder / f"{name}_{kind}.csv").read_text().splitlines()
    assert (rows[0], rows[1], rows[-1]) == (header, first, last)
    assert ("impulses" in told) == (name == "prefabs")


def test_force_fields_on_the_same_cells_add_up(convert):
    body = convert("stiff_layer.py").scene.deformables[0]
    assert body.material.young_modulus == 500e3
    assert [part.young_modulus for part in body.materials] == [1.5e6]
    assert body.material.density == pytest.approx(0.04 / (0.1 * 0.02 * 0.02))


def test_a_cable_without_a_pull_point_begins_on_the_body(convert):
    cable = convert("prefabs.py").scene.cables[0]
    assert cable.pull_point_on == "body" and cable.pull_point == (0.02, 0.02, 0.01)
    assert cable.points == ((0.09, 0.02, 0.01),)


@pytest.mark.exhaustive
def test_a_controller_by_keys_is_a_note_and_another_is_not_converted(convert):
    assert "by keys" in convert("stiff_layer.py").told
    told = convert("pneumatic_fingers.py").told
    assert re.search(r"Controller +pneumatic_fingers.py:\d+ +has no counterpart", told)


def test_pairs_that_may_touch_follow_from_groups_and_from_what_can_move(convert):
    scene = convert("pneumatic_fingers.py").scene
    pairs = {frozenset(one.pair) for one in scene.contact.between}
    assert pairs == {frozenset(pair) for pair in (
        ("floor", "cube"), ("floor", "finger1"), ("floor", "finger2"), ("cube", "finger1"), ("cube", "finger2"))}
    assert scene.contact.friction == 0.6
    assert (scene.contact.alarm_distance, scene.contact.contact_distance) == (0.005, 0.001)
    assert scene.obstacles[0].plane is not None


def test_a_region_of_another_body_gives_its_points(convert):
    first, second = convert("pneumatic_fingers.py").scene.deformables
    assert first.fixed[0].box is not None
    assert len(second.fixed[0].nodes) == 25


def test_a_chamber_that_is_placed_like_its_body_keeps_its_file(convert):
    wall = convert("pneumatic_fingers.py").scene.cavities[0].walls[0]
    assert wall.file.name == "chamber.obj" and wall.scale == 1e-3


def test_constants_of_rubber_are_those_of_the_law_here(convert):
    material = convert("rubber.py").scene.deformables[0].material
    assert material.law == "mooney_rivlin" and material.bulk_modulus == 4e6
    assert material.constants == {"c10": 60e3, "c01": 20e3}


def test_soft_springs_to_the_rest_shape_pull_back_from_it(convert):
    springs = convert("rubber.py").scene.springs
    assert len(springs) == 18
    assert all(one.stiffness == 3.0 and one.rest_length == 0.0 for one in springs)
    assert all(one.ends[0].point == one.ends[1].point for one in springs)


def test_hexahedra_of_a_file_in_python_are_written(convert, folder):
    body = convert("grid.py").scene.deformables[0]
    assert body.element == "hexahedral" and body.mass == "consistent"
    assert body.mesh.file.name == "grid_bar.msh" and (folder / "grid_bar.msh").is_file()


def test_regular_grids_are_bodies_of_tetrahedra_and_of_hexahedra(convert, folder):
    rubber, _ = convert("grids.scn").scene.deformables
    assert rubber.material.constants == {"shear_moduli": (2400.0,), "exponents": (2.5,)}
    for name, kind, count, ends in (("rubber", "tetra", 6 * 24, [[2, 0, 0], [3, 1, 3]]),
                                    ("bricks", "hexahedron", 8, [[0, -2, 0], [0.5, 0, 1]])):
        mesh = meshio.read(folder / f"grids_{name}.msh")
        assert len(mesh.cells_dict[kind]) == count
        np.testing.assert_allclose([mesh.points.min(axis=0), mesh.points.max(axis=0)], ends, atol=1e-9)


def test_a_force_on_two_points_and_a_wanted_volume_are_converted(convert, folder):
    """Each point bears the force of the file, an impulse in a step of 0.01 s: twice 50 mN / 0.01."""
    scene = convert("volume.scn").scene
    assert scene.forces[0].force == (0.0, 10.0) and scene.forces[0].rate == pytest.approx(200.0)
    assert scene.sensors[0].weight == 1.0
    assert (folder / "volume_targets.csv").read_text().splitlines()[:2] == ["time_s,chamber_volume_m3", "0,7.9e-06"]


def test_rigid_parts_carry_points_of_their_body(convert):
    scene = convert("rigid_end.py").scene
    fixed, free = scene.rigid_bodies
    assert (fixed.motion, free.motion) == ("fixed", "free")
    assert len(scene.deformables[0].attached[1].nodes) == 18
    np.testing.assert_allclose(free.position, [0.095, 0.01, 0.01])


def test_frames_with_a_beam_field_are_a_beam(convert):
    beam = convert("beam.py").scene.beams[0]
    assert beam.elements == 8 and beam.fixed == ("start",)
    assert (beam.section.rectangle.thickness, beam.section.rectangle.width) == (0.004, 0.006)
    assert beam.thickness_direction == (0.0, 1.0, 0.0)
    assert beam.material.young_modulus == 2e8 and beam.material.density == pytest.approx(1000.0)


def test_motion_without_inertia_has_the_mass_as_drag(convert):
    scene = convert("centre.py").scene
    assert scene.integration == "first_order" and scene.deformables[0].damping.mass == 1.0


def test_an_effector_may_be_the_mean_of_points(convert):
    effector = convert("centre.py").scene.effectors[0]
    np.testing.assert_allclose(np.mean(effector.points, axis=0), [0.1, 0.01, 0.01])


def test_unequal_factors_of_scale_are_written_into_a_mesh(convert):
    assert convert("bar.scn").scene.deformables[0].mesh.file.name == "bar_bar.msh"


def test_a_servo_of_a_hinge_is_a_motor_on_a_stiff_arm(convert, folder):
    scene = convert("articulated.py").scene
    (arm,), (motor,) = scene.beams, scene.hinge_motors
    assert arm.points == ((0.0, 0.0, 0.0), (0.045, 0.0, 0.0))
    assert (arm.joined[0].to, arm.joined[0].by, arm.joined[0].axis) == ("world", "hinge", (0.0, 0.0, 1.0))
    assert (motor.beam, motor.angle, motor.rate) == ("elbow", (-1.0, 1.0), 1.0)
    assert scene.effectors[0].body == "elbow"
    joint = 'JointConstraint", name="elbow", index=0, maxDisplacement=1.0, minDisplacement=-1.0, maxForce=40, value={}'
    given = 'JointActuator", name="elbow", index=0, maxAngle=1.0, minAngle=-1.0, maxAngleVariation=0.01'
    text = (folder / "articulated.py").read_text()
    for value, column, told in (("0.3", "angle_rad", "0.3"), ('[20.0], valueType="force"', "torque_Nm", "0.002")):
        motor, = convert("joint.py", text.replace(given, joint.format(value))).scene.hinge_motors
        assert (motor.angle, motor.torque) == ((-1.0, 1.0), (-np.inf, 0.004))
        rows = (folder / "joint_commands.csv").read_text().splitlines()
        assert (rows[0], rows[-1]) == (f"time_s,elbow_motor_{column}", f"0.2,{told}")


def test_forces_on_a_surface_act_on_its_points_in_each_sphere(convert):
    """A point at the centre bears λ, one at a fifth of the radius from the border a fifth; λ is an impulse."""
    near, far, _ = convert("patches.scn").scene.forces
    assert near.points == ((0.06, 0.02, 0.02), (0.06, 0.04, 0.02), (0.06, 0.02, 0.04))
    np.testing.assert_allclose(near.shares, [1.0, 0.2, 0.2])
    np.testing.assert_allclose(near.force, 1.4 * np.array([-1.0, 0.5]))
    np.testing.assert_allclose(far.shares, 1.0 - np.sqrt(0.5), rtol=1e-9)
    assert near.direction[0] > 0.0 > far.direction[0] and near.turns_with_body


def test_points_that_slide_are_moved_by_a_force_and_a_frame_by_a_slide(convert, folder):
    pusher = convert("patches.scn").scene.forces[2]
    assert (pusher.control, pusher.displacement, pusher.force) == ("displacement", (-0.002, 0.004), (-np.inf, 8.0))
    assert pusher.rate == 0.05 and pusher.direction == (0.0, 0.0, -3.0)
    assert (folder / "patches_commands.csv").read_text().splitlines()[::2][:2] == ["time_s,pusher_displacement_m", "0.01,0.001"]
    scene = convert("slide.scn").scene
    (rail,), (carriage,) = scene.slides, scene.rigid_bodies
    assert (rail.body, rail.travel, rail.rate, carriage.motion) == ("carriage", (-0.005, 0.02), 0.003, "guided")
    assert "rail_length_m" in (folder / "slide_commands.csv").read_text()


def test_a_modulus_changes_beside_that_of_other_fields_on_the_cells(convert):
    scene = convert("patches.scn").scene
    (jam,), (layer,) = scene.stiffeners, scene.deformables[0].materials
    assert (jam.region, layer.young_modulus) == (layer.region, 150e3)
    assert (jam.young_modulus, jam.rate) == ((120e3, 500e3), 500e3)


def test_lengths_of_cables_and_volumes_are_sensors_and_those_of_effectors_are_wanted(convert, folder):
    span, wire, gauge = convert("patches.scn").scene.sensors
    assert (len(span.string), span.weight, span.pull_point) == (2, 1.0, None)
    assert (wire.string, wire.weight, wire.pull_point) == (((0.04, 0.04, 0.06),), None, (0.04, 0.04, 0.09))
    assert gauge.walls and gauge.weight is None
    assert (folder / "patches_targets.csv").read_text().splitlines()[1] == "0,0.029"


def test_a_plane_holds_a_body_and_a_triangle_a_point(convert, run_alone):
    scene = convert("planes.scn").scene
    plane = scene.obstacles[0].plane
    assert (plane.point, plane.normal) == ((0.0, 0.0, -0.0003), (0.0, 0.0, 1.0))
    (point,) = scene.contact.points
    assert point.point == (0.06, 0.0, 0.02) and point.against == pytest.approx((0.17 / 3.0, 0.01 / 3.0, 0.01))
    least = [run_alone(one, 0.01)[0].state.positions[:, 2].min() for one in (scene, scene.changed(contact=None))]
    assert least[0] > -0.00031 and least[1] < -0.0004


def test_a_list_of_moduli_makes_parts_and_springs_hold_at_other_places(convert):
    scene = convert("layers.scn").scene
    body = scene.deformables[0]
    assert (body.material.young_modulus, body.materials[0].young_modulus) == (3e4, 3e5)
    near, far = scene.springs[0].ends
    np.testing.assert_allclose(np.subtract(far.point, near.point), [0.0, 0.0, 0.001], atol=1e-12)
    assert [one.pair for one in scene.contact.between] == [("block", "floor")]


def test_surfaces_of_one_body_in_other_groups_may_touch_each_other(convert, folder):
    text = (folder / "layers.scn").read_text().replace("<TriangleCollisionModel/>", (
        '<TriangleCollisionModel group="1"/><Node name="shell"><MeshOBJLoader name="l" filename="mesh/cube.obj" '
        'scale="0.05" translation="0.05 0.05 0.15"/><MeshTopology src="@l"/><MechanicalObject/>'
        '<TriangleCollisionModel group="2"/><BarycentricMapping/></Node>'))
    pairs = [one.pair for one in convert("shells.scn", text).scene.contact.between]
    assert ("block", "block") in pairs


# --- what is refused, or told ---------------------------------------------------------------------


def test_what_has_no_counterpart_is_listed_by_component_and_line(convert):
    converted = convert("foreign.py")
    for kind, line, why in (("TetrahedronFEMForceField", 12, "plasticMaxThreshold"),
                            ("CableConstraint", 18, "pullPoint is not known"),
                            ("ConstantForceField", 15, "no counterpart"),
                            ("ForcePointActuator", 19, "no direction"),
                            ("IndexValueMapper", 21, "no counterpart"),
                            ("UnilateralPlaneConstraint", 22, "not before the plane")):
        assert re.search(rf"{kind} +foreign.py:{line} .*{why}", converted.told)
        assert re.search(rf"# Not converted: {kind}", converted.path.read_text())
    assert not converted.scene.cables and "GridTopology" not in converted.told


def test_points_fixed_along_some_axes_are_held_along_these(convert):
    everywhere, in_part = convert("foreign.py").scene.deformables[0].fixed
    assert everywhere.axes == ("x", "y", "z") and (in_part.nodes, in_part.axes) == ((7,), ("x",))


@pytest.mark.parametrize("lines, unknown", [
    ("Unheard(root, stiffness=3)", "stlib3.nowhere.Unheard"),
    ("for one in nowhere.legs():\n        pass", "nowhere.legs"),
])  # fmt: skip
def test_functions_and_numbers_of_missing_modules_are_listed(convert, lines, unknown):
    text = ("import nowhere\nfrom scipy import signal\nfrom stlib3.nowhere import Unheard\n"
            "from grid import createScene as grid\ndef createScene(root):\n    grid(root)\n"
            f"    assert signal.gausspulse\n    {lines}\n")  # fmt: skip
    converted = convert("unheard.py", text)
    assert converted.code == 3 and f"{unknown} (unheard.py:8) is not known" in converted.told


def test_a_file_that_stops_is_converted_up_to_there_and_says_so(convert, folder):
    converted = convert("broken.py", (folder / "gid.py").read_text() + "    bar.nothing.here = 1\n")
    assert converted.code == 3 and "stopped at broken.py:14 (AttributeError" in converted.told
    assert converted.scene.deformables


@pytest.mark.parametrize("name, text, reason", [
    ("none.py", "x = 1\n", "none.py: has no function createScene"),
    ("wrong.py", "def createScene(root)\n", "SyntaxError"),
    ("empty.py", "def createScene(root):\n    root.addChild('a')\n", "no body can be converted"),
    ("lost.py", "def createScene(root):\n    root.addObject('MeshVTKLoader', name='l', filename='no.vtk')\n"
     "    root.addObject('MeshTopology', src='@l')\n    root.addObject('MechanicalObject')\n"
     "    root.addObject('TetrahedronFEMForceField')\n", r"its file no\.vtk is not found"),
    ("leave.py", "import sys\ndef createScene(root):\n    sys.exit(1)\n", "SystemExit"),
    ("cut.scn", "<Node name='a'><Node>", "cut.scn:1: is no XML"),
    ("other.scn", "<html/>", "begins with <html>, not with <Node>"),
    ("attack.scn", None, "attack.scn:2: has a document type"),
    ("scene.txt", "", "is neither .py nor .scn nor .xml"),
])  # fmt: skip
def test_a_file_that_is_no_scene_gives_a_reason_and_exit_code_two(convert, name, text, reason):
    converted = convert(name, text)
    assert converted.code == 2 and re.search(reason, converted.told)
    assert not converted.path.exists()


@pytest.mark.parametrize("scene, field, other, reason", [
    ("slide.scn", "<StaticSolver/>", "<EulerImplicitSolver/>", "SlidingActuator +.*motion in time"),
    ("slide.scn", 'direction="2 0 0 0 0 0"', 'direction="0 0 0 0 0 1"', "SlidingActuator +.*turns a frame"),
    ("slide.scn", 'fixedDirections="0 1 1 1 1 1"', '', "SlidingActuator +.*nothing holds"),
    ("slide.scn", 'maxPositiveDisp="20"', "", "SlidingActuator +.*both limits of its travel"),
    ("articulated.py", "maxAngle=1.0, ", "", "JointActuator +.*both limits of its angle"),
    ("patches.scn", 'youngModulus="50" poissonRatio="0.3"', 'youngModulus="50" poissonRatio="0.4"', "YoungModulusActuator +.*Poisson's"),
    ("patches.scn", 'minYoung="20"', 'minYoung="60"', "YoungModulusActuator +.*must lie within the limits"),
    ("patches.scn", 'radii="25 20"', 'radii="25 2"', "ForceSurfaceActuator +.*no point of its surface"),
    ("patches.scn", "<CableEffector", "<CableEquality", "CableEquality +.*an equality"),
    ("planes.scn", '<PlaneForceField normal="0 0 2"', '<PlaneForceField bilateral="1"', "PlaneForceField +.*both sides"),
    ("bar.scn", 'indices="0 1"', 'indices="0 -1"', "CableConstraint +.*has -1, and indices begin with 0"),
    ("bar.scn", 'dt="0.01"', 'dt="0"', "its root node: dt '0' must be a time above zero"),
    ("planes.scn", "60 0 20  50 0 10", "60 0 11  50 0 10", "UnilateralPlaneConstraint +.*corner of its triangle"),
])  # fmt: skip
def test_what_an_actuator_or_a_plane_has_not_here_is_refused_by_its_line(convert, folder, scene, field, other, reason):
    text = (folder / scene).read_text()
    assert field in text
    converted = convert(f"refused_{scene}", text.replace(field, other))
    assert converted.code in (2, 3) and re.search(reason, converted.told), converted.told


@pytest.mark.parametrize("field, reason", [
    ('youngModulus="@other.youngModulus"/><MechanicalObject name="other" youngModulus="@FEM.youngModulus"', "in a circle"),
    ('youngModulus="soft"', "is no list of numbers"), ('youngModulus="1 2 3"', "3 moduli"),
    ('youngModulus="0"', "is zero"), ('poissonRatio="0.5"', "must be below 0.5"), ('youngModulus="nan"', "no number"),
    ('youngModulus="@nowhere.E"', "leads nowhere"),
    ('youngModulus="@m.outputValues"/><IndexValueMapper name="m" value="3"', "comes from IndexValueMapper"), ('poissonRatio="0 . 3"', "is no list of numbers"),
])  # fmt: skip
def test_odd_values_are_refused_by_component_and_line(convert, folder, field, reason):
    text = (folder / "bar.scn").read_text().replace('<FastTetrahedralCorotationalForceField youngModulus="600"',
                                                    f'<TetrahedronFEMForceField name="FEM" {field}')
    text = re.sub(r' poissonRatio="0.4" method="qr"(?=/>)', "", text) if "poisson" in field else text
    converted = convert("odd.scn", text)
    assert converted.code == 2 and re.search(rf"TetrahedronFEMForceField \(odd.scn:11\).*{reason}", converted.told)


@pytest.mark.exhaustive
def test_a_scene_that_does_not_end_is_stopped(convert):
    converted = convert("endless.py", "while True: pass\n", "--time-limit", "2")
    assert converted.code == 2 and "ran longer than 2 s" in converted.told


def test_masses_and_velocities_that_are_not_read_are_listed(convert, folder):
    text = (folder / "bar.scn").read_text().replace('name="dofs"', 'name="dofs" velocity="0 0 5"').replace(
        '<Node name="chains">', '<Node name="ball"><MechanicalObject/><UniformMass/></Node><Node name="chains">')
    told = convert("moving.scn", text).told
    assert re.search(r"MechanicalObject +moving.scn:9 +its field velocity = 0 0 5 has no counterpart", told)
    assert re.search(r"UniformMass +moving.scn:14 +the points that it belongs to move", told)


@pytest.mark.parametrize("kept", ["kept.yaml", "kept_bar.msh"])
def test_existing_files_are_kept(folder, kept):
    (folder / kept).write_text("mine\n")
    assert main(["convert", str(folder / "grid.py"), "--output", str(folder / "kept.yaml")]) == 2
    assert (folder / kept).read_text() == "mine\n"
    (folder / kept).unlink()


def test_a_scene_that_cannot_be_built_leaves_no_file(convert, folder):
    text = (folder / "grid.py").read_text().replace('indices="@end.indices"', "indices=[0]")
    converted = convert("loose.py", text)
    assert converted.code == 2 and "the body is not held" in converted.told
    assert not list(folder.glob("loose*.msh")) and not converted.path.exists()
