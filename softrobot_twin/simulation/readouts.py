"""Readable properties of a simulation: names, sizes, and positions at its current state."""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.observed_loads import ObservedLoads
from softrobot_twin.mechanics.touch_loads import TouchState
from softrobot_twin.simulation.appearance import (
    Pose,
    beam_skin,
    body_skin,
    named_poses,
    own_skin,
    rigid_poses,
)
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.sensor_kinds import (
    ANGLE,
    FORCE,
    LENGTH,
    PRESSURE,
    SENSOR_KINDS,
    VOLUME,
    in_order,
    kind_of,
)
from softrobot_twin.simulation.effects.stiffness_targets import stiffness_of_scene
from softrobot_twin.simulation.effects.trusted_ranges import reduced_bodies
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import StepPart


class Readouts:
    """Properties of a simulation that can be read without a step.

    Attributes:
        model: The built scene.
        state: Its current state.
        scene: Its scene.
        terms: All terms that a step sums.
        stages: Names of the stages of a step.
        actuators: The actuators, with their kinds, units and scales.
        limits: Limits of the actuators.
        actuator_names: Names of the actuators, in the order of all their arrays.
        rest_setpoints: Setpoints at rest, such as lengths of cables [m], shape (actuator_count,).
        pulleys: Pulleys that wind cables, with their angles.
        motors: Names of the cables of each motor, by the motor's name.
        effector_names: Names of the effectors, in the order of all their arrays.
        oriented_effectors: Whether each effector asks for an orientation.
        stiff_effectors: Whether each effector asks for a stiffness.
        scene_stiffness: Stiffness of each effector that the scene asks for along x, y and z [N/m],
            shape (effector_count, 3); NaN where none is wanted.
        effector_markers: For each effector, indices into `marker_ids` of the markers that move with
            it.
        marker_ids: Ids of the markers, shape (marker_count,).
        touch_names: Names of the touches, in the order of all their arrays.
        sensor_names: Names of the sensors, in the order of all their arrays; `length_sensors`,
            `angle_sensors`, `volume_sensors`, `pressure_sensors` and `force_sensors` are those of
            one quantity.
        wanted_sensors: Whether each sensor may have targets, by its name.
        sensor_columns: Name of each sensor by its column in files, such as ``spine_length_m``.
        base_names: ``base`` where the base of the scene moves; empty elsewhere.
        grip_names: Names of the grips, likewise.
        reaction_names: Names of the reactions, likewise.
        observed_names: Names of the forces that an observer looks for, likewise.
        observed_with_torque: Whether each comes with a torque.
        rigid_names: Names of the rigid bodies, in the order of all their arrays.
        guided_names: Names of the rigid bodies that follow commanded poses; others are moved by
            slides.
        node_count: Number of nodes of all meshes, including fixed ones.
        tet_count: Number of tetrahedra of all meshes.
        hexahedron_count: Number of hexahedra of all meshes.
        beam_element_count: Number of elements of all beams.
        dof_count: Number of unknowns: three for each free node, six for each free frame. Frames are
            rigid bodies, vertebrae and nodes of beams.
        has_reduced_bodies: Whether a body has the coordinates of a basis as its unknowns.
        skins: Surface by which each deformable body is drawn: its own, or the finer one of the
            scene; then those of the beams.
        parts: The optional effects around its steps.
    """

    model: Model
    state: State
    skins: tuple
    parts: tuple[StepPart, ...]

    def _take(self, model: Model) -> None:
        """Take the built scene, and what never changes of it."""
        self.model, self.scene, self.terms, self.stages = model, model.scene, model.terms, model.stages
        self.actuators, self.limits = model.actuators, model.actuators.limits
        self.actuator_names, self.pulleys = self.actuators.names, self.actuators.pulleys
        self.rest_setpoints = self.actuators.rest_setpoints
        self.motors = {motor.name: motor.cables for motor in self.scene.motors}
        effectors = self.scene.effectors
        self.effector_names = tuple(effector.name for effector in effectors)
        self.oriented_effectors = tuple(bool(one.orientation) for one in effectors)
        self.stiff_effectors = tuple(bool(one.stiffness) for one in effectors)
        self.scene_stiffness = stiffness_of_scene(self.scene)
        self.marker_ids, self.effector_markers = model.marker_ids, model.effector_markers
        self.touch_names = tuple(touch.name for touch in self.scene.touches)
        sensed = [(SENSOR_KINDS[kind_of(one)].quantity, one) for _, one in in_order(self.scene)]
        self.sensor_names = tuple(one.name for _, one in sensed)
        self.wanted_sensors = {one.name: bool(one.weight) for _, one in sensed}
        self.sensor_columns = {column(one.name, quantity): one.name for quantity, one in sensed}
        (self.length_sensors, self.angle_sensors, self.volume_sensors, self.pressure_sensors,
         self.force_sensors) = (
            tuple(one.name for quantity, one in sensed if quantity == own)
            for own in (LENGTH, ANGLE, VOLUME, PRESSURE, FORCE)
        )
        self.base_names = ("base",) if self.scene.moving_base else ()
        self.grip_names = tuple(grip.name for grip in self.scene.grips)
        self.reaction_names = tuple(reaction.name for reaction in self.scene.reactions)
        places = observed.places if (observed := model.force_term(ObservedLoads)) else ()
        self.observed_names = tuple(place.name for place in places)
        self.observed_with_torque = tuple(place.is_wrench for place in places)
        self.rigid_names = tuple(part.name for part in model.rigid)
        sliding = {slide.body for slide in self.scene.slides}
        self.guided_names = tuple(part.name for part in model.rigid if part.is_guided and part.name not in sliding)
        meshes = [body.mesh for body in model.bodies]
        self.node_count = sum(mesh.node_count for mesh in meshes)
        self.tet_count, self.hexahedron_count = (
            sum(mesh.cell_counts.get(kind, 0) for mesh in meshes) for kind in ("tets", "hexahedra"))
        self.beam_element_count = sum(len(beam.lengths) for beam in model.beams)
        free_axes = model.nodes.free_axes
        self.dof_count = 3 * model.nodes.free_node_count if free_axes is None else int(free_axes.sum())
        self.has_reduced_bodies = bool(reduced_bodies(model))

    def _find_surface(self) -> None:
        beams, known, told = [*map(beam_skin, self.model.beams)], self.model.notes, list[str]()
        self._surfaces = [*map(own_skin, self.model.bodies), *beams]
        self.skins = (*(body_skin(body, self.scene, told) for body in self.model.bodies), *beams)
        known.extend(note for note in self.scene.source.notes(told) if note not in known)

    @property
    def notes(self) -> tuple[str, ...]:
        """Repairs and warnings, a sentence each."""
        return tuple(self.model.notes)

    @property
    def touches(self) -> TouchState | None:
        """The touches now; None in a scene without any."""
        return TouchState.of(self.state.memory)

    def effector_positions(self) -> np.ndarray:
        """Positions of the effectors [m], shape (effector_count, 3)."""
        return self.model.effectors.positions(self.state.positions)

    @property
    def lengths_per_radian(self) -> np.ndarray:
        """Displacement that counts as much as one radian of each effector's orientation [m/rad].

        Shape (effector_count,); zero for effectors without orientation.
        """
        lengths = np.zeros(len(self.scene.effectors))
        for orientation in self.model.effectors.orientations if any(self.oriented_effectors) else ():
            lengths[orientation.effector] = orientation.length
        return lengths

    def effector_orientations(self) -> np.ndarray | None:
        """Turn of each effector from rest (x, y, z, w), shape (effector_count, 4).

        Returns:
            The quaternions, NaN for effectors without orientation; None if the scene has none.
        """
        if not any(self.oriented_effectors):
            return None
        return self.model.effectors.quaternions(self.state.positions)

    def orientation_angles(self, targets: np.ndarray | None) -> np.ndarray | None:
        """Angle of each effector from a wanted turn, over what its orientation asks for.

        Args:
            targets: Wanted turns from rest (x, y, z, w), NaN where free, shape (effector_count, 4);
                None where no effector asks for an orientation.

        Returns:
            Angles [rad], NaN without a target, shape (effector_count,); None without targets.
        """
        if targets is None:
            return None
        term = self.model.effectors
        return term.angles_to(targets, term.rotations(self.state.positions))

    def marker_positions(self) -> np.ndarray:
        """Predicted positions of the markers [m], shape (marker_count, 3)."""
        return self.model.markers.positions(self.state.positions)

    def sensor_readings(self) -> np.ndarray:
        """What the sensors show, each in its unit, shape (sensor_count,)."""
        sensors = self.model.sensors
        return sensors.readings(self.state.positions) if sensors else np.empty(0)

    def actuator_paths(self) -> dict[str, np.ndarray]:
        """Lines by which actuators are drawn, by their names [m], each of shape (point_count, 3).

        A cable's begins at its pull point. Actuators without a line are left out.
        """
        return self.model.actuators.paths(self.state.positions)

    @property
    def surface_triangles(self) -> np.ndarray:
        """Triangles of the surfaces of bodies and beams, as indices into `surface_positions`.

        Shape (triangle_count, 3).
        """
        own = [surface.triangles for surface in self._surfaces]
        firsts = np.cumsum([0, *(triangles.max(initial=-1) + 1 for triangles in own)])
        shifted = [triangles + first for triangles, first in zip(own, firsts)]
        return np.concatenate([np.empty((0, 3), np.int64), *shifted])

    def surface_positions(self) -> np.ndarray:
        """Positions of the surface's nodes [m], shape (surface_node_count, 3)."""
        own = [surface.positions(self.state.positions) for surface in self._surfaces]
        return np.concatenate([np.empty((0, 3)), *own])

    def skin_positions(self) -> tuple[np.ndarray, ...]:
        """Points of the skin of each deformable body and beam [m], each (point_count, 3)."""
        return tuple(skin.positions(self.state.positions) for skin in self.skins)

    def rigid_poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses of the coordinates in which the scene gives the rigid bodies' shapes.

        Returns:
            Positions [m], shape (rigid_body_count, 3), and quaternions (x, y, z, w), shape
            (rigid_body_count, 4).
        """
        return rigid_poses(self.model, self.state.positions)

    def poses(self) -> dict[str, Pose]:
        """Pose of each rigid body, by name."""
        return named_poses(self.model, self.state.positions)
