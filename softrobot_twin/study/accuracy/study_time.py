"""How long a study of meshes will take, told before it begins and shown while it runs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median

from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study.accuracy.accuracy_study import Limits, dof_count
from softrobot_twin.study.accuracy.mesh_family import MeshLevel
from softrobot_twin.study.accuracy.scene_variant import with_element, with_newton
from softrobot_twin.study.reports.terminal import progress

# The time of a step grows with this power of the unknowns: of factors of bodies, 4/3 in the plane
# and 2 in space.
_GROWTH = 1.4
# Linearizations of the equilibria of one mesh, and what building one takes, in steps.
_LINEARIZATIONS, _BUILDING = 150, 40
_MOST_TIMING = 3.0
_PROBES = 5


def study_seconds(levels: list[MeshLevel], limits: Limits) -> float:
    """What a study will take on this machine, to within a factor of two or so [s].

    Args:
        levels: Meshes, the coarsest first.
        limits: How fine the study goes.
    """
    probe = levels[0]._replace(scene=with_element(levels[0].scene, "quadratic"))
    simulation = Simulation(with_newton(probe.scene, 1, 1.0e-300))
    simulation.step(Hold(1.0))
    times = [simulation.step(Hold(1.0)).report.compute_time for _ in range(_PROBES)]
    unit, size = median(times), dof_count(probe)

    seconds = 0.0
    for element in ("linear", "quadratic"):
        for level in levels:
            dof = dof_count(level._replace(scene=with_element(level.scene, element)))
            step = unit * (dof / size) ** _GROWTH
            equilibria = step * (_LINEARIZATIONS + _BUILDING)
            timing = min(_MOST_TIMING, limits.timed_steps * step) + step * _BUILDING
            if element == "quadratic" and dof <= limits.reference_dof:
                seconds += equilibria
            if dof <= limits.timed_dof:
                # Both laws are judged; equilibria of the reference are known by then.
                seconds += 2.0 * timing + (1 + (element == "linear")) * equilibria
    return seconds


def in_words(seconds: float) -> str:
    """A duration as a person would say it."""
    if seconds < 90.0:
        return f"about {max(5, 5 * round(seconds / 5.0))} s"
    return f"about {seconds / 60.0:.0f} minutes"


@contextmanager
def shown_progress(name: str, total: float) -> Iterator[Callable[[str], None]]:
    """Shows what is being done and how much is left; silent where there is no terminal.

    Args:
        name: What takes the time.
        total: Things to be begun.

    Yields:
        Takes a line for each thing begun.
    """
    begun = 0
    with progress() as bar:
        task = bar.add_task(name, total=total, note="")

        def tell(words: str) -> None:
            nonlocal begun
            bar.update(task, completed=begun, note=words)
            begun += 1

        yield tell


def study_parts(levels: list[MeshLevel], limits: Limits) -> int:
    """Things that a study begins: a reference's mesh, or a mesh with an element and a law."""
    count = 0
    for element in ("linear", "quadratic"):
        for level in levels:
            dof = dof_count(level._replace(scene=with_element(level.scene, element)))
            count += 2 * (dof <= limits.timed_dof)
            count += element == "quadratic" and dof <= limits.reference_dof
    return count


def announce(words: str) -> None:
    """A line on standard error, terminal or not: it is what somebody waits for."""
    print(words, file=sys.stderr, flush=True)
