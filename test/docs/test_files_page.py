"""docs/files.md names every column that a run writes."""

import re
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets, Simulation
from softrobot_twin.simulation.runs.run_columns import RunColumns
from softrobot_twin.study.passive_run import BodyReadouts

ROOT = Path(__file__).resolve().parents[2]
TABLES = [line for line in (ROOT / "docs" / "files.md").read_text().splitlines() if line[:1] == "|"]
NAMED = re.findall(r"`([^`\s]+)`", "\n".join(TABLES))
PATTERNS = [re.compile(re.sub(r"<\w+>", r"\\w+", name)) for name in NAMED]


def unnamed(columns):
    """Columns that no name of the page matches."""
    return [one for one in columns if not any(pattern.fullmatch(one) for pattern in PATTERNS)]


@pytest.mark.parametrize("scene", ["finger", "octoleg", "springy", "strider"])
def test_the_page_names_each_column_of_a_run(scene):
    simulation = Simulation.from_scene_file(ROOT / "config" / "scenes" / f"{scene}.yaml")
    followed = FollowTargets(np.array(simulation.effector_positions()), 0.02)
    columns = RunColumns(simulation, followed, BodyReadouts(simulation).columns)
    assert {"step", "time_s", "status"} <= set(columns.names)
    assert unnamed(columns.names) == []
