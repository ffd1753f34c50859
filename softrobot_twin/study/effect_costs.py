"""``python -m softrobot_twin explain --effects``: what each effect of a scene costs and changes.

`python tools/print_effect_costs.py SCENE ...` prints a table for several scenes.

One effect after another is left out of the scene. Both scenes are driven the same way, step by step
in turn, so that what else the machine does falls on both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from softrobot_twin.analysis.apparent_compliance import apparent_compliance
from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.harness.sampled_axes import ActuationError
from softrobot_twin.harness.terminal import console, table, terminal_status, warn
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.body_entries import Damping
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.study.stiffness import actuation

TIME_STEP = 0.02
"""Duration of a step [s]."""
WAY, HOLDING = 50, 50
"""Steps in which the actuators move at least, and in which they then hold."""
TRAVEL = 1.0 / 3.0
"""Share of its travel that the first actuator moves where no actuation is given."""
_SLOWER = 1.25
# Compliances whose directions differ by more are those of bodies that nothing holds, or that hardly
# yield in one direction.
_STIFFEST = 1.0e6
# Steps whose time counts are those after the first ones, in which memory is touched first.
_UNTIMED = 10


class SceneEffect(NamedTuple):
    """An effect that a scene may ask for.

    Attributes:
        name: What it is.
        is_named: Whether a scene has it.
        without: The scene without it.
    """

    name: str
    is_named: Callable[[Scene], bool]
    without: Callable[[Scene], Scene]


def _without_of_materials(name: str, none: object) -> SceneEffect:
    """An effect that materials have."""

    return SceneEffect(
        f"{name} of materials",
        lambda scene: any(getattr(part, name) for body in scene.deformables
                          for part in (body.material, *body.materials)),
        lambda scene: scene.with_deformables({
            "material": {name: none},
            "materials": lambda part: (
                part if getattr(part, name) is None else part.changed(**{name: none}))}),
    )  # fmt: skip


def _without_of_cables(words: str, name: str, none: object) -> SceneEffect:
    """An effect that cables have."""
    return SceneEffect(
        words,
        lambda scene: any(getattr(cable, name) for cable in scene.cables),
        lambda scene: scene.changed(cables={name: none, "presliding": None}),
    )  # fmt: skip


def _is_self(touching) -> bool:
    return touching.pair[0] == touching.pair[1]


def _without_self_contact(scene: Scene) -> Scene:
    kept = tuple(one for one in scene.touching if not _is_self(one))
    return scene.changed(contact={"between": kept, "points": ()} if kept else None)


EFFECTS = (
    SceneEffect("contact", lambda scene: scene.contact is not None,
                lambda scene: scene.changed(contact=None)),
    SceneEffect("friction of contact",
                lambda scene: scene.contact is not None and bool(
                    scene.contact.friction or any(one.friction for one in scene.touching)),
                lambda scene: scene.changed(contact={"between": {"friction": None}, "friction": 0.0})),
    SceneEffect("self-contact",
                lambda scene: scene.contact is not None and bool(
                    scene.contact.points or any(map(_is_self, scene.touching))),
                _without_self_contact),
    SceneEffect("motion in time", lambda scene: scene.integration != "quasi_static",
                lambda scene: scene.changed(integration="quasi_static")),
    SceneEffect("gravity", lambda scene: any(scene.gravity),
                lambda scene: scene.changed(gravity=(0.0, 0.0, 0.0))),
    _without_of_materials("viscosity", ()),
    _without_of_materials("softening", None),
    SceneEffect("damping",
                lambda scene: any(body.damping != Damping() for body in scene.deformables),
                lambda scene: scene.with_deformables({"damping": Damping()})),
    _without_of_cables("stretch of cables", "axial_stiffness", None),
    _without_of_cables("friction along cables", "friction", 0.0),
    SceneEffect("volume patches",
                lambda scene: any(body.has_patches for body in scene.deformables),
                lambda scene: scene.with_deformables({"volume": "per_element"})),
    SceneEffect("strain smoothed over edges",
                lambda scene: any(body.element == "smoothed" for body in scene.deformables),
                lambda scene: scene.with_deformables(_with_linear_elements)),
)  # fmt: skip
"""All effects that can be left out, in the order in which they are told."""


NOTHING = SceneEffect("nothing", lambda scene: True, lambda scene: scene)
"""Left out last: two equal scenes, whose difference in time is that of the measurement."""


def _with_linear_elements(body):
    """Linear tetrahedra in place of smoothed ones, their volumes kept as before."""
    if body.element != "smoothed":
        return body
    volume = "patches" if body.has_patches else "per_element"
    return body.changed(element="linear", volume=volume)


class EffectCost(NamedTuple):
    """What an effect costs and changes.

    Attributes:
        name: The effect.
        cost: Time of a step with it, less that without it [s].
        share: The same as a share of the step with it.
        on_the_way: Greatest distance that it moves an effector by in a step [m].
        at_the_end: Distance where the actuators have held [m].
        force: Force on the effector that moves it as far, at the end [N].
        reason: Why it cannot be left out, or why numbers are missing; empty otherwise.
    """

    name: str
    cost: float = float("nan")
    share: float = float("nan")
    on_the_way: float = float("nan")
    at_the_end: float = float("nan")
    force: float = float("nan")
    reason: str = ""


def effect_costs(scene: Scene, given: Sequence[str] = ()) -> Iterator[EffectCost]:
    """Leaves one effect after another out of a scene.

    Args:
        scene: The scene.
        given: Actuation to which the actuators move, see `actuation`; by default the first one moves
            by `TRAVEL`.

    Yields:
        One for each effect that the scene has, and one for `NOTHING`.

    Raises:
        SoftRobotTwinError: The scene cannot be used, or no actuation is given and the first
            actuator has no limits.
    """
    whole = Simulation(scene, with_warnings=False)
    path = path_of(whole, given)
    whole.warm_up()
    begin = whole.state
    for effect in (*EFFECTS, NOTHING):
        if not effect.is_named(scene):
            continue
        try:
            other = Simulation(effect.without(scene), with_warnings=False)
        except SoftRobotTwinError as error:
            yield EffectCost(effect.name, reason=f"cannot be left out: {error}")
            continue
        other.warm_up()
        whole.restore(begin)
        yield _compared(effect.name, whole, other, path)


def path_of(simulation: Simulation, given: Sequence[str]) -> np.ndarray:
    """Setpoints of all steps, shape (step_count, actuator_count).

    Args:
        simulation: The whole scene.
        given: See `effect_costs`.
    """
    rest, limits = np.array(simulation.rest_setpoints), simulation.limits
    drives = actuation(simulation, given)
    if len(rest) and not given:
        low, high = limits.drive_min[0], limits.drive_max[0]
        if not np.isfinite(high - low):
            raise ActuationError("--at", "is needed: the first actuator has no limits of its travel")
        drives[0] = low + TRAVEL * (high - low) if low >= 0.0 else TRAVEL * high
    goal = simulation.actuators.setpoints(drives)
    reach = limits.reach(TIME_STEP)
    slowest = np.abs(goal - rest) / np.where(reach > 0.0, reach, np.inf)
    steps = max(WAY, int(np.ceil(_SLOWER * slowest.max(initial=0.0))))
    shares = np.minimum(1.0, np.arange(1, steps + HOLDING + 1) / steps)[:, None]
    return rest + shares * (goal - rest)


def _compared(name: str, whole: Simulation, other: Simulation, path: np.ndarray) -> EffectCost:
    """Drives both along the path, step by step in turn."""
    count = len(whole.effector_names)
    times, moved, failed = ([], []), [], 0
    for index, setpoints in enumerate(path):
        results = [one.step(CommandSetpoints(setpoints, TIME_STEP)) for one in (whole, other)]
        failed += any(one.status.is_failure for one in results)
        for own, result in zip(times, results, strict=True):
            if index >= _UNTIMED and not result.report.is_resting:
                own.append(result.report.compute_time)
        apart = results[0].effector_positions - results[1].effector_positions
        moved.append(apart)
    way = float(np.linalg.norm(moved, axis=2).max()) if count else float("nan")
    end = np.linalg.norm(moved[-1], axis=1)
    with_it, without = (median(own) if own else float("nan") for own in times)
    reason = f"{failed} of {len(path)} steps failed" if failed else ""
    return EffectCost(
        name, with_it - without, 1.0 - without / with_it, way,
        float(end.max()) if count else float("nan"), _force(whole, moved[-1]), reason,
    )  # fmt: skip


def _force(whole: Simulation, apart: np.ndarray) -> float:
    """The greatest force that moves an effector as far [N]; NaN where nothing yields to one."""
    forces = []
    for compliance, move in zip(apparent_compliance(whole).compliance, apart, strict=True):
        if np.isfinite(compliance).all() and np.linalg.cond(compliance) < _STIFFEST:
            forces.append(float(np.linalg.norm(np.linalg.solve(compliance, move))))
    return max(forces, default=float("nan"))


def print_effects(scene: Path, given: Sequence[str] = ()) -> int:
    """Prints a table of the effects of a scene.

    Args:
        scene: Scene file.
        given: See `effect_costs`.

    Returns:
        Exit code, 0.

    Raises:
        SoftRobotTwinError: See `effect_costs`.
    """
    loaded = load_scene(scene)
    with terminal_status("leaving out one effect after another"):
        rows = list(effect_costs(loaded, given))
    output = console()
    output.print(f"{loaded.name}: {scene}\n")
    output.print(table(
        "What each effect costs, and what changes without it", "effect", "µs a step", "share",
        "on the way, mm", "at the end, mm", "as a force, N",
        rows=([row.name, *told(row)] for row in rows)))
    output.print(
        "\nA cost is the median time of a step with all effects, less that without this one, driven "
        "the same way; share in %. That of nothing, two equal scenes, tells how well times are known. "
        "Distances are those of the effector that differs most."
    )
    for row in rows:
        if row.reason:
            warn(f"{row.name}: {row.reason}")
    return 0


def told(row: EffectCost) -> list[str]:
    """Its numbers in µs, %, mm and N; empty where one is not known.

    Args:
        row: What an effect costs.
    """
    scaled = (1e6 * row.cost, 100.0 * row.share, 1e3 * row.on_the_way, 1e3 * row.at_the_end, row.force)
    return ["" if value != value else f"{value:.3g}" for value in scaled]
