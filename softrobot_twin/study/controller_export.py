"""``reduce --export``: a reduced robot in one file, to be stepped by some lines of numpy.

The file holds numbers only: sampled points, weight, cables, cavities, effectors, limits. What each
of them is, and the lines that step them, is in ``docs/reduced_controller.md``.

Points of the body are x = rest + Φ q, sampled points deform by F = 1 + G q, and volumes of cavities
are cubic polynomials of q (`reduced_cavities.py`), so no mesh is needed.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.cable import ROUNDED, CablePath
from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.laws.corotational import Corotational
from softrobot_twin.mechanics.laws.neo_hookean import NeoHookean
from softrobot_twin.mechanics.reduced_elements import ReducedElements, point_gradients
from softrobot_twin.mechanics.springs import NO_LENGTH
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.scene_changes import reduced_scene, without_reductions
from softrobot_twin.simulation.build import build_model
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.reduced_body import COMMAND, ReducedNodes
from softrobot_twin.simulation.building.scene_layout import lay_out
from softrobot_twin.simulation.step.augmented_tangent import AUGMENTATION
from softrobot_twin.simulation.step.inverse_actuation import LONGEST_REACH
from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.inverse_problem import LEAST_ENERGY_WEIGHT
from softrobot_twin.study.body_training import output_path, reduce
from softrobot_twin.study.output_file import output_file
from softrobot_twin.study.terminal import console
from softrobot_twin.study.training_options import TrainingOptions

# Version of the file; it grows where lines of numpy for the one before would step it wrongly.
FORMAT = 1
# Sections of a scene that the lines of numpy cannot step.
NOT_BUILT = (
    "rigid_bodies", "mass_springs", "beams", "springs", "tubes", "fibres", "contact",
    "sealed_cavities", "motors", "touches",
)  # fmt: skip
# Keys of their entries that they do not know, and what these ask for.
_REFUSED = (
    ("cables", "friction", "friction along cables"),
    ("cables", "axial_stiffness", "cables that stretch"), ("cavities", "flow", "limits of flow"),
    ("cavities", "liquid_density", "liquid in cavities"),
    ("effectors", "orientation", "a wanted orientation of an effector"),
    ("effectors", "stiffness", "a wanted stiffness of an effector"),
)
# Laws that they know.
LAWS = {"corotational": Corotational, "neo_hookean": NeoHookean}

README = """\
Reduced controller {version} of {name}, law {law}; made by: {command} SCENE --export FILE
Steps by some lines of numpy: docs/reduced_controller.md of softrobot_twin. SI units.
A state is the coordinates q [m], the drives of the actuators and their efforts. A drive is what an
actuator holds: the shortening of a cable [m], the growth of a cavity [m3], or where it
is_effort_driven the gauge pressure [Pa]. setpoint = setpoint_rest + setpoint_slope * drive.
  {modes} coordinates, {points} sampled points, F = 1 + gradients q
  actuators: {actuators}
  effectors: {effectors}
Where the root mean square of q / coordinate_ranges is above 1, it is out of its training.
"""


class ExportError(SceneError):
    """A scene has what a reduced controller is not built for."""


def _refused(scene: Scene, key: str, value: object, reason: str) -> ExportError:
    words = f"{reason}: not built for a reduced controller; omit --export"
    return ExportError(scene.path, key, value, "", words)


def reduce_and_export(path: Path, options: TrainingOptions, output: Path) -> int:
    """Export the reduced body of a scene; train it before where it is asked for or needed.

    Args:
        path: Scene file.
        options: What is asked of the training. With all of them left at their defaults, a scene
            whose body is reduced by a file that is there is not trained again.
        output: File of the controller.

    Returns:
        Exit code: that of the training.

    Raises:
        SoftRobotTwinError: The scene, an option or a file cannot be used.
    """
    scene, code = load_scene(path), 0
    _refuse_unexportable(scene)
    entry = scene.deformables[0].reduced
    if entry is None or not scene.file_path(entry.file).is_file() or options != TrainingOptions():
        # Before the training, which takes minutes.
        (body,) = lay_out(without_reductions(scene), []).bodies
        _check_laws(scene, body)
        code = reduce(path, options)
        scene = reduced_scene(scene, body.name, output_path(scene, body, options).resolve())
    arrays = export_controller(scene, output)
    modes, points, actuators = (len(arrays[name]) for name in ("load", "weights", "actuators"))
    console().print(
        f"exported to {output}, {1e-6 * output.stat().st_size:.1f} MB: {modes} coordinates, "
        f"{points} points, {actuators} actuators; the lines of numpy that step it: "
        "docs/reduced_controller.md"
    )
    return code


def _refuse_unexportable(scene: Scene) -> None:
    """Refuse a scene that the lines of numpy cannot step.

    Raises:
        SceneError: It names the entry.
    """
    if len(scene.deformables) != 1:
        names = ", ".join(body.name for body in scene.deformables)
        raise _refused(scene, "bodies", names, "a robot of one reduced body is asked for")
    if scene.integration != "quasi_static":
        raise _refused(scene, "integration", scene.integration, "motion")
    for section in NOT_BUILT:
        if getattr(scene, section):
            raise _refused(scene, section, _names_in(scene, section), f"scenes with {section}")
    for section, entries in scene.actuator_entries.items():
        if entries and section not in ("cables", "cavities"):
            raise _refused(scene, section, _names_in(scene, section), f"scenes with {section}")
    for section, name, words in _REFUSED:
        for index, entry in enumerate(getattr(scene, section)):
            value = getattr(entry, name)
            if value not in (None, 0.0, np.inf):
                told = value if isinstance(value, float) else entry.name
                raise _refused(scene, f"{section}[{index}].{name}", told, words)


def _names_in(scene: Scene, section: str) -> str:
    entries = getattr(scene, section)
    if not isinstance(entries, tuple):
        return type(entries).__name__.lower()
    return ", ".join(str(getattr(entry, "name", index)) for index, entry in enumerate(entries))


def export_controller(scene: Scene, output: Path) -> dict[str, np.ndarray]:
    """Write all that steps a reduced robot.

    Args:
        scene: A scene whose one body is reduced.
        output: The file.

    Returns:
        Its arrays, by name; see ``docs/reduced_controller.md``.

    Raises:
        SceneError: The scene has what a reduced controller is not built for.
        OutputError: The file cannot be written.
    """
    arrays = controller_arrays(scene)
    with output_file(output) as partial, open(partial, "wb") as stream:
        np.savez_compressed(stream, **arrays)
    return arrays


def controller_arrays(scene: Scene) -> dict[str, np.ndarray]:
    """All that steps a reduced robot; see `export_controller`."""
    _refuse_unexportable(scene)
    (entry,) = scene.deformables
    if entry.reduced is None:
        key = "body" if scene.body is not None else "bodies[0]"
        raise _refused(scene, f"{key}.reduced", None, f"{entry.name} has no reduced model")
    model = build_model(scene, with_warnings=False)
    (body,) = model.bodies
    modes = PointModes(body.reduction, model.nodes.rest_positions)
    arrays = {
        "format": np.array(FORMAT), "name": np.array(scene.name),
        **_elastic_arrays(scene, body),
        "load": body.reduction.weights_of(body, np.array(scene.gravity)).ravel(),
        "coordinate_ranges": _coordinate_ranges(body.reduction),
        **_cable_arrays(scene, model, modes), **_cavity_arrays(model, modes.count),
        **_actuator_arrays(model), **_effector_arrays(model, modes), **_solver_arrays(model),
    }  # fmt: skip
    return {"readme": np.array(_readme(arrays)), **arrays}


class PointModes(NamedTuple):
    """Where points of terms are, as functions of the coordinates.

    Attributes:
        nodes: The nodes of the body.
        rest_positions: All nodes of the scene at rest [m], shape (node_count, 3).
    """

    nodes: ReducedNodes
    rest_positions: np.ndarray

    @property
    def count(self) -> int:
        """Number of coordinates."""
        return self.nodes.mode_count

    def of(self, mapping: BarycentricMapping) -> tuple[np.ndarray, np.ndarray]:
        """Positions at rest [m] and Φ of points, shape (n, 3) and (n, 3, mode_count).

        Args:
            mapping: The points.
        """
        own = self.nodes.point_modes()[1]
        shapes = np.zeros((mapping.point_count, 3, self.count))
        for nodes, weights in zip(mapping.nodes.T, mapping.barycentric_weights.T, strict=True):
            used = weights != 0.0
            places = nodes[used] - self.nodes.first_point
            shapes[used] += weights[used, None, None] * own[places]
        return mapping.positions(self.rest_positions), shapes


def _elastic_arrays(scene: Scene, body: Body) -> dict[str, np.ndarray]:
    """Gradients, weights and law of all sampled points."""
    _check_laws(scene, body)
    nodes, parts, found = body.reduction, [], []
    for part in body.materials:
        for block in body.mesh.strained_blocks(part.cells):
            points = point_gradients(block, nodes.reduction.sampled, nodes.basis)
            found.append(points)
            parts.append(np.tile(np.array(part.law_parameters, float), (len(points.weights), 1)))
    # As a step takes them: see `ReducedElements`.
    precision = float if all(points.are_all for points in found) else np.float32
    gradients = np.concatenate([points.gradients for points in found]).astype(precision)
    parameters = np.concatenate(parts)
    names = LAWS[body.materials[0].law]._fields
    return {
        "law": np.array(body.materials[0].law), "gradients": gradients,
        "weights": np.concatenate([points.weights for points in found]),
        **{name: parameters[:, place] for place, name in enumerate(names)},
    }  # fmt: skip


def _check_laws(scene: Scene, body: Body) -> None:
    if "hexahedra" in body.mesh.cell_counts:
        raise _refused(scene, f"{body.key}.element", body.entry.element, "a body of hexahedra")
    for part in body.materials:
        if part.law not in LAWS:
            words = f"a law other than {' and '.join(LAWS)}"
            raise _refused(scene, f"{part.key}.law", part.law, words)
        if part.law != body.materials[0].law:
            raise _refused(scene, f"{part.key}.law", part.law, "a body of materials of two laws")


def _coordinate_ranges(nodes: ReducedNodes) -> np.ndarray:
    """Largest magnitude of each coordinate in the training, none zero [m], (mode_count,)."""
    ranges = nodes.reduction.ranges[: nodes.mode_count]
    least = np.finfo(np.float32).eps * float(ranges.max(initial=0.0))
    return np.maximum(ranges, max(least, np.finfo(float).tiny))


def _cable_arrays(scene: Scene, model: Model, modes: PointModes) -> dict[str, np.ndarray]:
    """The points of all cables in order, those of one cable side by side."""
    groups = [group for group in model.actuators.groups if group.kind.section == "cables"]
    paths: tuple[CablePath, ...] = groups[0].term.paths if groups else ()
    rest, shapes, cable, smoothed = [np.empty((0, 3))], [np.empty((0, 3, modes.count))], [], []
    for index, path in enumerate(paths):
        points, own = modes.of(path.points)
        if path.pull_point is not None:
            points = np.vstack([path.pull_point, points])
            own = np.concatenate([np.zeros((1, 3, modes.count)), own])
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if lengths.min() <= NO_LENGTH * lengths.max():
            raise _refused(scene, f"cables[{index}].points", path.name,
                           "two points of a cable in one place")  # fmt: skip
        rest.append(points)
        shapes.append(own)
        smoothed.extend(ROUNDED * lengths)
        cable.extend([index] * len(points))
    return {
        "cable_of_point": np.array(cable, np.int64), "cable_rest": np.concatenate(rest),
        "cable_modes": np.concatenate(shapes), "smoothed_below": np.array(smoothed),
    }  # fmt: skip


def _cavity_arrays(model: Model, mode_count: int) -> dict[str, np.ndarray]:
    """Coefficients of the growth of each cavity: g·q + ½ qᵀBq + ⅙ T(q, q, q)."""
    groups = [group for group in model.actuators.groups if group.kind.section == "cavities"]
    count = sum(len(group.names) for group in groups)
    linear, quadratic, cubic = (np.zeros((count, *[mode_count] * degree)) for degree in (1, 2, 3))
    # They are read off the derivatives: ∂H/∂q = B + T(q) is linear in q.
    for volumes in [one for group in groups for one in group.term.bodies]:
        own = volumes.rows
        volumes.evaluate(np.zeros((mode_count // 3, 3)))
        linear[own], quadratic[own] = volumes.gradients, volumes.stiffness
        for mode, q in enumerate(np.eye(mode_count)):
            volumes.evaluate(q.reshape(-1, 3))
            cubic[own, mode] = volumes.stiffness - quadratic[own]
    return {"cavity_linear": linear, "cavity_quadratic": quadratic, "cavity_cubic": cubic}


def _actuator_arrays(model: Model) -> dict[str, np.ndarray]:
    actuators, limits = model.actuators, model.actuators.limits
    return {
        "actuators": np.array(actuators.names),
        "setpoint_rest": np.array(actuators.rest_setpoints, float),
        "extent_rest": actuators.extents(np.zeros(actuators.count)),
        "setpoint_slope": np.array(limits.slopes, float),
        "is_effort_driven": np.array(limits.is_effort_driven),
        "displacement_limits": np.column_stack([limits.displacement_min, limits.displacement_max]),
        "effort_limits": np.column_stack([limits.effort_min, limits.effort_max]),
        "rate": np.array(limits.drive_rate), "augmentation": _augmentation(model),
    }  # fmt: skip


def _augmentation(model: Model) -> np.ndarray:
    """ρ of each actuator that holds a displacement, else zero; see `AugmentedDense`."""
    rest, rows, count = model.nodes.rest_positions, model.rows, model.nodes.free_node_count
    K = np.zeros((3 * count, 3 * count))
    for term in model.forces:
        if isinstance(term, ReducedElements):
            term.add_forces(rest, np.zeros((count, 3)))
            K += term.stiffness(False)
    rows.evaluate(rest)
    H = NodeRows(rows.row_index, rows.node_index, rows.blocks, rows.row_count).transposed(count)
    H = H[:, rows.groups.actuators]
    own = 1.0 / np.einsum("ma,ma->a", H, np.linalg.solve(K, H))
    return np.where(model.actuators.limits.is_effort_driven, 0.0, AUGMENTATION * own)


def _effector_arrays(model: Model, modes: PointModes) -> dict[str, np.ndarray]:
    term = model.effectors
    effectors = () if term is None else term.effectors
    rest, weights = np.zeros((len(effectors), 3)), np.zeros((len(effectors), 3))
    shapes = np.zeros((len(effectors), 3, modes.count))
    for place, effector in enumerate(effectors):
        points, own = modes.of(effector.points)
        rest[place], shapes[place] = points.mean(axis=0), own.mean(axis=0)
        weights[place, list(effector.directions)] = effector.weight
    return {
        "effectors": np.array([effector.name for effector in effectors], str),
        "effector_rest": rest, "effector_modes": shapes, "effector_weights": weights,
    }  # fmt: skip


def _solver_arrays(model: Model) -> dict[str, np.ndarray]:
    solver = model.scene.solver
    return {
        "energy_weight": np.array(max(solver.energy_weight, LEAST_ENERGY_WEIGHT)),
        "longest_reach": np.array(LONGEST_REACH * model.nodes.size),
        "newton_iterations": np.array(solver.newton_iterations),
    }  # fmt: skip


def _readme(arrays: dict[str, np.ndarray]) -> str:
    effectors = ", ".join(arrays["effectors"].tolist())
    return README.format(
        version=FORMAT, name=arrays["name"], law=arrays["law"], command=COMMAND,
        modes=len(arrays["load"]), points=len(arrays["weights"]),
        actuators=", ".join(arrays["actuators"].tolist()), effectors=effectors or "none",
    )
