"""A scene imports what it names and nothing else: each effect alone brings its own modules only."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from softrobot_twin.simulation import Hold

ROOT = Path(__file__).resolve().parents[2]
# By effect, what must be loaded only where it is named. Names of modules, or of rooms' parts.
PARTS = {
    "contact": (
        "constraints.contact", "constraints.contact_memory",
        "constraints.surfaces_in_contact", "constraints.touching_pairs",
        "simulation.contact_building", "simulation.contact_actuation", "simulation.contact_newton",
        "solvers.contact_problem", "solvers.contact_gauss_seidel", "solvers.contact_newton",
        "solvers.contact_sweeps", "solvers.contact_cone", "geometry.broad_phase",
        "solvers.contact_active_set", "solvers.guessed_bounds", "solvers.least_under_equations",
        "geometry.surface_pairs", "geometry.edge_edge", "geometry.vertex_triangle",
        "geometry.nearest_feature", "geometry.surface_shape", "geometry.surface_shape_edges",
        "geometry.surface_shape_triangles", "geometry.surface_shape_vertices",
        "geometry.self_proximity", "geometry.fixed_pairs", "geometry.proximities",
        "geometry.closed_surface", "geometry.triangle_clusters",
    ),
    "rigid": (
        "mechanics.rotation",
        "simulation.rigid_building",
        "simulation.framed_nodes",
    ),
    "shapes": ("geometry.shapes", "geometry.mass_properties", "simulation.shape_building"),
    "free": ("mechanics.rigid_inertia",),
    "guided": ("simulation.guides",),
    "springs": ("mechanics.springs", "mechanics.spring_kernels", "simulation.spring_building"),
    "inertia": ("mechanics.lumped_inertia", "mechanics.consistent_inertia"),
    "drag": ("mechanics.mass_damping",),
}  # fmt: skip
PROGRAM = """
import json, sys
from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.simulation import FollowTargets, Hold, CommandSetpoints, Simulation
scene = json.loads(sys.argv[1])
if isinstance(scene, str):
    simulation = Simulation(load_scene(scene))
    simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.002, 0.02))
    simulation.step(FollowTargets(simulation.effector_positions(), 0.02))
else:
    simulation = Simulation(scene_from_mapping(scene))
result = simulation.step(Hold(0.002))
own = "softrobot_twin."
loaded = sorted(name.removeprefix(own) for name in sys.modules if name.startswith(own))
print(json.dumps([loaded, list(result.report.stage_times)]))
"""


def loaded_by(scene) -> tuple[set[str], list[str]]:
    """Our modules that a fresh interpreter holds after stepping a scene, and its stages."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, json.dumps(scene)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    modules, stages = json.loads(done.stdout.splitlines()[-1])
    return set(modules), stages


def parts_in(modules: set[str]) -> set[str]:
    """Effects of which anything is loaded."""
    return {
        effect for effect, names in PARTS.items()
        if any(name == m or m.startswith(name + ".") for name in names for m in modules)
    }  # fmt: skip


def bar(file, **more):
    return {"body": {
        "name": "bar", "mesh": {"file": file},
        "element": "linear",
        "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [-0.019, 1, 1]}}], **more,
    }}  # fmt: skip


def test_every_module_watched_for_exists():
    package = ROOT / "softrobot_twin"
    for names in PARTS.values():
        for name in names:
            place = package / Path(*name.split("."))
            assert place.with_suffix(".py").is_file() or place.is_dir(), name


def test_stepping_the_diamond_loads_none_of_it():
    modules, stages = loaded_by(str(ROOT / "config" / "scenes" / "diamond.yaml"))
    assert parts_in(modules) == set()
    assert not any("contact" in name or "rigid" in name for name in modules)
    assert "detect" not in stages and "optimise" in stages


def test_the_diamonds_report_counts_no_contacts(diamond):
    simulation = diamond()
    assert simulation.model.contacts is None and "detect" not in simulation.stages
    assert simulation.model.rigid == () and simulation.model.guides is None
    assert simulation.model.beginners == ()
    result = simulation.step(Hold())
    assert "detect" not in result.report.stage_times
    assert set(result.report.stage_times) <= set(simulation.stages)
    assert result.contacts is None
    assert result.report.contact_count == 0 and result.report.contact_sweeps == 0
    assert result.report.contact_residual == 0.0
    assert result.report.contact_force_residual == 0.0


@pytest.mark.parametrize(
    ("effect", "expected", "scene"),
    [
        ("nothing", set(), {}),
        ("dynamic", {"inertia"}, {"integration": "dynamic"}),
        ("first_order", {"drag"}, {"integration": "first_order"}),
        ("springs", {"springs"}, {"springs": [
            {"name": "spring", "stiffness": 10.0,
             "ends": [{"point": [0.05, 0, 0]}, {"on": "bar", "point": [0.02, 0, 0]}]}]}),
        ("guided", {"rigid", "shapes", "guided"}, {"rigid_bodies": [
            {"name": "plate", "motion": "guided", "box": {"size": [0.1, 0.1, 0.1]}}]}),
        ("free", {"rigid", "shapes", "free", "inertia"}, {
            "integration": "dynamic",
            "rigid_bodies": [{"name": "ball", "mass": 1.0, "sphere": {"radius": 0.1}}]}),
        ("contact", {"contact", "shapes"}, {
            "obstacles": [{"name": "floor", "plane": {}, "position": [0, 0, -0.011]}],
            "contact": {"between": [{"pair": ["bar", "floor"]}]}}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_an_effect_alone_loads_only_its_own_modules(write_block, effect, expected, scene):
    damping = {"damping": {"mass": 5.0}} if effect == "first_order" else {}
    file = write_block((0.04, 0.02, 0.02), (2, 1, 1))
    modules, stages = loaded_by({"name": "scene", **bar(file, **damping), **scene})
    assert parts_in(modules) == expected
    assert ("detect" in stages) == (effect == "contact")


def test_an_obstacle_that_nothing_touches_loads_no_contact(write_block):
    file = write_block((0.04, 0.02, 0.02), (2, 1, 1))
    obstacles = [{"name": "floor", "plane": {}, "position": [0, 0, -0.1]}]
    modules, _ = loaded_by({"name": "scene", **bar(file), "obstacles": obstacles})
    assert "contact" not in parts_in(modules) and "rigid" not in parts_in(modules)
