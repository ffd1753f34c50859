"""Facts of what a scene loads: nothing of what it does not have."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OF_CONTACT = {
    f"softrobot_twin.{name}" for name in (
        "constraints.contact", "simulation.commanded_cables",
        "simulation.contact_actuation", "simulation.contact_building", "simulation.contact_newton",
        "simulation.inverse_in_contact", "solvers.contact_gauss_seidel",
        "solvers.inverse_contact", "solvers.pivoting",
    )
}  # fmt: skip
RUN = """
import sys
from softrobot_twin.simulation import FollowTargets, Simulation
simulation = Simulation.from_scene_file({scene!r})
simulation.warm_up()
simulation.step(FollowTargets(simulation.effector_positions() + 0.001, 0.02))
print(*sys.modules, sep="\\n")
"""


def loaded_by(scene: str) -> set[str]:
    code = RUN.format(scene=str(ROOT / "config" / "scenes" / scene))
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def test_the_diamond_loads_nothing_of_contact_or_pivoting():
    assert not loaded_by("diamond.yaml") & OF_CONTACT


def test_the_trunk_among_cylinders_loads_what_the_diamond_need_not():
    assert loaded_by("trunk_cylinders.yaml") >= OF_CONTACT
