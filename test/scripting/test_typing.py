"""Types: `python -m mypy` finds nothing, and a user's script is checked by the package's types."""

import subprocess
import sys

import pytest

from test.places import ROOT

SCRIPT = """
import numpy as np
import softrobot_twin as st

robot: st.Robot = st.load("finger.yaml")
result: st.Result = robot.step(st.targets(tip=[0.0, 0.01, 0.12]), time_step=0.01)
place: np.ndarray = result.tip
tension: float = result["north_tension_N"]
other: st.Robot = st.build(name="finger", body={})
try:
    robot.settle(st.hold(), poses={"palm": [0.0, 0.0, 0.1]})
except st.SoftRobotTwinError as error:
    print(error)
"""


def mypy(*arguments) -> subprocess.CompletedProcess:
    """Runs mypy from the root."""
    return subprocess.run([sys.executable, "-m", "mypy", *map(str, arguments)], cwd=ROOT,
                          capture_output=True, text=True, timeout=500)


@pytest.mark.exhaustive
def test_a_users_script_is_checked_by_the_types_of_the_package(tmp_path):
    pytest.importorskip("mypy")
    (tmp_path / "right.py").write_text(SCRIPT)
    (tmp_path / "wrong.py").write_text(
        SCRIPT + "st.lode('finger.yaml')\nrobot.step(3.0)\nrobot.step(time_step='fast')\n")
    right = mypy("--config-file", ROOT / "mypy.ini", tmp_path / "right.py")
    assert right.returncode == 0, right.stdout + right.stderr
    wrong = mypy("--config-file", ROOT / "mypy.ini", tmp_path / "wrong.py")
    assert 'has no attribute "lode"' in wrong.stdout
    assert wrong.stdout.count("[arg-type]") == 2, wrong.stdout
