"""Poses in which meshes are compared: all cables but one wound, or pulled, by given amounts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.simulation import CommandSetpoints, CommandEfforts, Simulation
from softrobot_twin.study.accuracy.accuracy_error import AccuracyError
from softrobot_twin.study.accuracy.only_body import only_body
from softrobot_twin.study.accuracy.scene_variant import (
    with_element,
    with_newton,
    without_rate_limits,
    without_tension_limits,
)

# What the actuated cables are wound in by, as shares of their limits; the last cable of a scene is
# not actuated: wound by nothing, pulled with nothing.
POSE_SHARES = ((0.10, 0.30, 0.20), (0.20, 0.30, 0.15))
# Share of the tensions found for wound cables that is prescribed where forces are: with a cable
# less to hold it, the body gives way further.
TENSION_SHARE = 0.15
# What stands for the limit of a cable's shortening where it has none, as a share of its length.
OPEN_SHARE = 0.4
_INCREMENTS = 2
_MOST_ITERATIONS = 25
# Residual down to which Newton goes, by the force that strains a body of this size by one.
_RELATIVE_TOLERANCE = 1.0e-10
# Time enough for any change of length [s].
_LONG = 1.0


class Poses(NamedTuple):
    """Equilibria of one scene.

    Attributes:
        positions: Effectors [m], shape (pose_count, effector_count, 3); NaN where none was found.
        rest: The same at the unloaded rest shape [m], shape (effector_count, 3).
        tensions: Cable tensions [N], shape (pose_count, actuator_count).
    """

    positions: np.ndarray
    rest: np.ndarray
    tensions: np.ndarray

    @property
    def found(self) -> bool:
        """Whether there is an equilibrium for every pose."""
        return bool(np.all(np.isfinite(self.positions)))


def shortenings(scene: Scene) -> np.ndarray:
    """What the cables are wound in by [m], shape (pose_count, actuator_count).

    Raises:
        AccuracyError: The scene has no cables or no effector.
    """
    if not scene.cables or not scene.effectors:
        raise AccuracyError(scene.name, "accuracy is measured at an effector that cables move; "
                            "this scene lacks cables or effectors")
    poses = np.zeros((len(POSE_SHARES), len(scene.cables)))
    for index, cable in enumerate(scene.cables):
        if index == len(scene.cables) - 1 and index > 0:
            continue
        for pose, shares in zip(poses, POSE_SHARES, strict=True):
            pose[index] = shares[index % len(shares)] * _most_wound(cable)
    return poses


def _most_wound(cable) -> float:
    """The limit of a cable's shortening; where it has none, a share of its length [m]."""
    if np.isfinite(cable.shortening[1]):
        return cable.shortening[1]
    stretches = np.diff(np.array([cable.pull_point, *cable.points]), axis=0)
    return OPEN_SHARE * float(np.linalg.norm(stretches, axis=1).sum())


def prescribed_tensions(scene: Scene, tensions: np.ndarray) -> np.ndarray:
    """Tensions to prescribe, from those of wound cables [N], shape (pose_count, actuator_count)."""
    prescribed = TENSION_SHARE * tensions
    if len(scene.cables) > 1:
        prescribed[:, -1] = 0.0
    return prescribed


def exact_simulation(scene: Scene, **parts) -> Simulation:
    """A simulation whose every step goes down to rounding, within no limit of rate or tension."""
    size = only_body(with_element(scene, "linear")).size
    tolerance = _RELATIVE_TOLERANCE * scene.body.material.young_modulus * size**2
    free = without_tension_limits(without_rate_limits(scene))
    return Simulation(with_newton(free, _MOST_ITERATIONS, tolerance), **parts)


def wind_poses(scene: Scene, poses: np.ndarray) -> Poses:
    """Equilibria with cables wound in by given shortenings [m]."""
    simulation = exact_simulation(scene)
    return _solve(simulation, [
        [CommandSetpoints(simulation.rest_setpoints - share * pose, _LONG) for share in _shares()]
        for pose in poses])


def pull_poses(scene: Scene, poses: np.ndarray) -> Poses:
    """Equilibria with cables pulled by given tensions [N]."""
    loose = _without_shortening_limits(scene)
    simulation = exact_simulation(loose)
    return _solve(simulation, [
        [CommandEfforts(share * pose, _LONG) for share in _shares()] for pose in poses])


def _shares():
    return np.arange(1, _INCREMENTS + 1) / _INCREMENTS


def _solve(simulation: Simulation, loads: list) -> Poses:
    rest = simulation.effector_positions()
    positions, tensions = [], []
    for commands in loads:
        simulation.reset()
        for command in [CommandEfforts(np.zeros(len(simulation.actuator_names)), _LONG), *commands]:
            result = simulation.step(command)
        good = (result.report.residual <= simulation.scene.solver.residual_tolerance
                and not result.report.inverted_count)
        positions.append(result.effector_positions if good else np.full_like(rest, np.nan))
        tensions.append(result.efforts)
    return Poses(np.array(positions), rest, np.array(tensions))


def _without_shortening_limits(scene: Scene) -> Scene:
    """Who prescribes forces takes whatever lengths come."""
    wide = {"shortening": (-10.0, 10.0)}
    return scene.model_copy(update={
        "cables": tuple(cable.model_copy(update=wide) for cable in scene.cables)})
