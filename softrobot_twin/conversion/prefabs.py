"""What the helper packages STLIB and SoftRobots offer scenes, for users who have not installed them.

A prefab is known by its name and parameters, and adds components that say the same. What is only
drawn or animated is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.conversion.stand_ins import Node, Nothing, Recorder

Vector = Sequence[float]
ORIGIN = (0.0, 0.0, 0.0)


def _loader(node: Node, file: str, rotation: Vector, translation: Vector, scale: Any) -> Any:
    """A loader by the suffix of a file."""
    kinds = {"msh": "MeshGmshLoader", "gidmsh": "GIDMeshLoader", "stl": "MeshSTLLoader",
             "obj": "MeshOBJLoader"}  # fmt: skip
    kind = kinds.get(str(file).rpartition(".")[2].lower(), "MeshVTKLoader")
    factors = [scale] * 3 if np.ndim(scale) == 0 else list(scale)
    return node.addObject(kind, name="loader", filename=str(file), rotation=list(rotation),
                          translation=list(translation), scale3d=factors)  # fmt: skip


# --- scenes ---------------------------------------------------------------------------------------


def main_header(node: Node, gravity: Vector = (0.0, -9.81, 0.0), dt: float = 0.01, **more: Any) -> Node:
    """Sets gravity and step.

    Args:
        node: The root.
        gravity: Gravity.
        dt: Step.
        **more: Plugins; not read.
    """
    node.gravity, node.dt = list(gravity), dt
    node.addObject("VisualStyle")
    settings = node.getChild("Settings") or node.addChild("Settings")
    settings.addObject("MouseButton", name="mouseButton")
    return node


def contact_header(
    applyTo: Node, alarmDistance: float = 3.0, contactDistance: float = 0.5, frictionCoef: float = 0.0
) -> Node:  # fmt: skip
    """Declares contact with friction.

    Args:
        applyTo: The root.
        alarmDistance: Distance of candidates.
        contactDistance: Distance of contact.
        frictionCoef: Coefficient of friction.
    """
    applyTo.addObject("CollisionPipeline")
    applyTo.addObject("CollisionResponse", response="FrictionContactConstraint",
                      responseParams=f"mu={frictionCoef}")  # fmt: skip
    applyTo.addObject("LocalMinDistance", alarmDistance=alarmDistance, contactDistance=contactDistance)
    return applyTo


class Scene:
    """A root with the nodes Settings, Modelling and Simulation; other attributes are the root's."""

    def __init__(self, node: Node, gravity: Vector = (0.0, -9.81, 0.0), dt: float = 0.01, **more: Any):
        """Adds the nodes.

        Args:
            node: The root.
            gravity: Gravity.
            dt: Step.
            **more: Plugins and solver; not read.
        """
        self.__dict__["node"] = node
        for name in ("Settings", "Modelling", "Simulation"):
            node.addChild(name)
        node.Simulation.addObject("EulerImplicitSolver", name="TimeIntegrationSchema")
        main_header(node, gravity, dt)

    def addMainHeader(self) -> None:
        """Nothing: gravity and step are set."""

    def addContact(self, alarmDistance: float, contactDistance: float, frictionCoef: float = 0.0) -> None:
        """See `contact_header`.

        Args:
            alarmDistance: Distance of candidates.
            contactDistance: Distance of contact.
            frictionCoef: Coefficient of friction.
        """
        contact_header(self.node, alarmDistance, contactDistance, frictionCoef)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.node, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.node, name, value)


# --- bodies ---------------------------------------------------------------------------------------


def elastic_material_object(
    attachedTo: Any = None, volumeMeshFileName: str = "", name: str = "ElasticMaterialObject",
    rotation: Vector = ORIGIN, translation: Vector = ORIGIN, scale: Any = (1.0, 1.0, 1.0),
    surfaceMeshFileName: str | None = None, collisionMesh: str | None = None,
    poissonRatio: float = 0.3, youngModulus: float = 18000.0, totalMass: float = 1.0, **more: Any,
) -> Node:  # fmt: skip
    """An elastic body of tetrahedra.

    Args:
        attachedTo: Node that it is added to.
        volumeMeshFileName: Mesh.
        name: Its name.
        rotation: Angles of the mesh [degrees].
        translation: Displacement of the mesh.
        scale: Scale of the mesh.
        surfaceMeshFileName: Drawn surface; not read.
        collisionMesh: Surface for contact.
        poissonRatio: Poisson's ratio.
        youngModulus: Young's modulus.
        totalMass: Mass.
        **more: Colour and solver; not read.
    """
    body = Node(name)
    body.addObject("EulerImplicitSolver", name="integration")
    body.addObject("SparseLDLSolver", name="solver")
    loader = _loader(body, volumeMeshFileName, rotation, translation, scale)
    body.addObject("TetrahedronSetTopologyContainer", src=loader.linkpath, name="container")
    body.addObject("MechanicalObject", template="Vec3", name="dofs")
    body.addObject("UniformMass", totalMass=totalMass, name="mass")
    body.addObject("TetrahedronFEMForceField", name="forcefield", poissonRatio=poissonRatio,
                   youngModulus=youngModulus)  # fmt: skip
    body.addObject("LinearSolverConstraintCorrection", name="correction")
    if isinstance(attachedTo, Node):
        attachedTo.addChild(body)
    if collisionMesh:
        collision_mesh(body, collisionMesh, "CollisionModel", rotation, translation, scale=scale)
    visual_model(surfaceMeshFileName, attachedTo=body)
    return body


def collision_mesh(
    attachedTo: Node, surfaceMeshFileName: str, name: str = "CollisionMesh", rotation: Vector = ORIGIN,
    translation: Vector = ORIGIN, collisionGroup: Any = None, mappingType: str | None = "BarycentricMapping",
    scale: Any = 1.0, **more: Any,
) -> Node:  # fmt: skip
    """A surface for contact.

    Args:
        attachedTo: Node of the body.
        surfaceMeshFileName: The surface.
        name: Its name.
        rotation: Its angles [degrees].
        translation: Its displacement.
        collisionGroup: Its groups.
        mappingType: How it follows the body.
        scale: Its scale.
        **more: Not read.
    """
    node = attachedTo.addChild(name)
    loader = _loader(node, surfaceMeshFileName, rotation, translation, scale)
    node.addObject("MeshTopology", src=loader.linkpath, name="topology")
    node.addObject("MechanicalObject", name="dofs")
    group = {} if collisionGroup is None else {"group": collisionGroup}
    for kind in ("TriangleCollisionModel", "LineCollisionModel", "PointCollisionModel"):
        node.addObject(kind, **group)
    if mappingType:
        node.addObject(mappingType)
    return node


def rigid_object(
    name: str = "RigidObject", surfaceMeshFileName: str | None = None, translation: Vector = ORIGIN,
    rotation: Vector = ORIGIN, uniformScale: float = 1.0, totalMass: float = 1.0, volume: float = 1.0,
    isAStaticObject: bool = False, parent: Any = None, node: Any = None, **more: Any,
) -> Node:  # fmt: skip
    """A rigid body with the surface of a file.

    Args:
        name: Its name.
        surfaceMeshFileName: Its surface.
        translation: Its place.
        rotation: Its angles [degrees].
        uniformScale: Scale of the surface.
        totalMass: Its mass.
        volume: Its volume; not read.
        isAStaticObject: Whether it does not move.
        parent: Node that it is added to.
        node: The same.
        **more: Colour and inertia; not read.
    """
    body = Node(name)
    turned = Rotation.from_euler("xyz", list(rotation), degrees=True).as_quat()
    body.addObject("MechanicalObject", name="mstate", template="Rigid3",
                   position=[[*translation, *turned]])  # fmt: skip
    body.addObject("UniformMass", name="mass", totalMass=totalMass)
    if not isAStaticObject:
        body.addObject("EulerImplicitSolver")
    above = parent if isinstance(parent, Node) else node
    if isinstance(above, Node):
        above.addChild(body)
    if surfaceMeshFileName:
        collision_mesh(body, surfaceMeshFileName, "collision", scale=uniformScale,
                       mappingType="RigidMapping")  # fmt: skip
    return body


def _rigid(name: str, file: str, **usual: Any) -> Callable[..., Node]:
    """A rigid object with the file of a shape."""

    def made(node: Any = None, **given: Any) -> Node:
        return rigid_object(node=node, **{"name": name, "surfaceMeshFileName": file, **usual, **given})

    return made


def visual_model(visualMeshPath: Any = None, name: str = "VisualModel", attachedTo: Any = None, **more: Any) -> Node:  # fmt: skip
    """A drawn surface; nothing of it is kept.

    Args:
        visualMeshPath: Not read.
        name: Its name.
        attachedTo: Node that it is added to.
        **more: Not read.
    """
    node = Node(name)
    for kind in ("loader", "model"):
        node.addObject("OglModel", name=kind)
    if isinstance(attachedTo, Node):
        attachedTo.addChild(node)
    return node


# --- regions --------------------------------------------------------------------------------------


def fixed_box(
    attachedTo: Any = None, atPositions: Any = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0), name: str = "FixedBox",
    constraintStrength: Any = 1e12, applyTo: Any = None, **more: Any,
) -> Node:  # fmt: skip
    """Fixes what is in a box.

    Args:
        attachedTo: Node of the body.
        atPositions: The box.
        name: Name of the new node.
        constraintStrength: Stiffness of the springs.
        applyTo: Node of the body.
        **more: Not read.
    """
    node = (applyTo if isinstance(applyTo, Node) else attachedTo).addChild(name)
    node.addObject("BoxROI", name="BoxROI", box=atPositions)
    node.addObject("RestShapeSpringsForceField", points="@BoxROI.indices", stiffness=constraintStrength)
    return node


def partially_fixed_box(
    attachedTo: Node, box: Any, fixedAxis: Any = (1, 1, 1), name: str = "PartiallyFixedBox", **more: Any
) -> Node:  # fmt: skip
    """Fixes axes of what is in a box.

    Args:
        attachedTo: Node of the body.
        box: The box.
        fixedAxis: Whether each axis is fixed.
        name: Name of the new node.
        **more: Not read.
    """
    node = attachedTo.addChild(name)
    node.addObject("BoxROI", name="BoxROI", box=box)
    node.addObject("PartialFixedProjectiveConstraint", fixedDirections=list(fixedAxis),
                   indices="@BoxROI.indices")  # fmt: skip
    return node


def sub_topology(
    attachedTo: Node, containerLink: Any = None, boxRoiLocation: Any = None, name: str = "modelSubTopo",
    poissonRatio: float = 0.3, youngModulus: float = 18000.0, **more: Any,
) -> Node:  # fmt: skip
    """A stiffer part of a body.

    Args:
        attachedTo: Node of the body.
        containerLink: Its topology.
        boxRoiLocation: Box of the part.
        name: Name of the new node.
        poissonRatio: Poisson's ratio.
        youngModulus: Young's modulus that is added.
        **more: Not read.
    """
    roi = attachedTo.addObject("BoxROI", name=f"{name}Box", box=boxRoiLocation, strict=False)
    node = attachedTo.addChild(name)
    node.addObject("TetrahedronSetTopologyContainer", name="container",
                   position=containerLink or "@../loader.position", tetrahedra=f"{roi.linkpath}.tetrahedraInROI")  # fmt: skip
    node.addObject("TetrahedronFEMForceField", poissonRatio=poissonRatio, youngModulus=youngModulus)
    return node


def oriented_box_roi(
    parent: Node, position: Any = None, name: str = "BoxROI", translation: Vector = ORIGIN,
    eulerRotation: Vector = ORIGIN, scale: Vector = (1.0, 1.0, 1.0),
) -> Any:  # fmt: skip
    """A region in a turned box.

    Args:
        parent: Node that it is added to.
        position: Points that are looked for.
        name: Its name.
        translation: Middle of the box.
        eulerRotation: Its angles [degrees].
        scale: Its edges.
    """
    half = 0.5 * np.asarray(scale, float)
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0]]) * half
    turned = Rotation.from_euler("xyz", list(eulerRotation), degrees=True).apply(corners) + translation
    more = {} if position is None else {"position": position}
    return parent.addObject("BoxROI", name=name, orientedBox=[*turned.ravel(), scale[2]], **more)


def rigidify(
    targetObject: Node, sourceObject: Node, groupIndices: Any, frames: Any = None, name: Any = None
) -> Node:  # fmt: skip
    """Makes groups of a body's points rigid.

    Args:
        targetObject: Node that the parts are added to.
        sourceObject: Node of the body.
        groupIndices: Points of each rigid part.
        frames: Frame of each: angles [degrees] or a quaternion, perhaps behind a place.
        name: Name of the new node.
    """
    state = sourceObject.getMechanicalState()
    points = np.asarray(Recorder.value_of(state, "position")).reshape(-1, 3)
    groups = [np.asarray(list(group), int) for group in groupIndices]
    made = targetObject.addChild(str(name or sourceObject.name))
    rigids = []
    for group, frame in zip(groups, frames or [ORIGIN] * len(groups), strict=True):
        numbers = list(np.asarray(frame, float))
        centre = numbers[:3] if len(numbers) > 4 else list(points[group].mean(axis=0))
        turn = numbers[3:] if len(numbers) > 4 else numbers
        if len(turn) == 3:
            turn = list(Rotation.from_euler("xyz", turn, degrees=True).as_quat())
        rigids.append(centre + turn)
    chosen = np.concatenate(groups)
    others = np.setdiff1d(np.arange(len(points)), chosen)
    free = made.addChild("DeformableParts")
    free.addObject("MechanicalObject", template="Vec3", name="dofs", position=points[others])
    parts = made.addChild("RigidParts")
    parts.addObject("MechanicalObject", template="Rigid3", name="dofs", position=rigids)
    carried = parts.addChild("RigidifiedParticules")
    carried.addObject("MechanicalObject", template="Vec3", name="dofs", position=points[chosen])
    carried.addObject("RigidMapping", name="mapping", globalToLocalCoords=True, rigidIndexPerPoint=[
        number for number, group in enumerate(groups) for _ in group])  # fmt: skip
    pairs = np.zeros((len(points), 2), int)
    pairs[others, 1], pairs[chosen, 0] = np.arange(len(others)), 1
    pairs[chosen, 1] = np.arange(len(chosen))
    for component in list(sourceObject.components):
        if component.kind.startswith(("EulerImplicit", "SparseLDL", "LinearSolverConstraint")):
            sourceObject.removeObject(component)
    sourceObject.addObject(
        "SubsetMultiMapping", name="mapping", input=[free.dofs.linkpath, carried.dofs.linkpath],
        output=state.linkpath, indexPairs=pairs.ravel())  # fmt: skip
    carried.addChild(sourceObject)
    free.addChild(sourceObject)
    return made


# --- actuators and effectors ----------------------------------------------------------------------


def _pulling_cable(kind: str) -> Callable[..., Node]:
    def made(
        attachedTo: Node, name: str = "Cable", cableGeometry: Any = ((1.0, 0.0, 0.0), ORIGIN),
        rotation: Vector = ORIGIN, translation: Vector = ORIGIN, uniformScale: float = 1.0,
        pullPointLocation: Any = None, initialValue: float = 0.0, valueType: Any = None, **more: Any,
    ) -> Node:  # fmt: skip
        node = attachedTo.addChild(name)
        node.addObject("MechanicalObject", position=[list(one) for one in cableGeometry],
                       rotation=list(rotation), translation=list(translation), scale=uniformScale)  # fmt: skip
        pull = {} if pullPointLocation is None else {"pullPoint": list(pullPointLocation)}
        if kind == "CableConstraint":
            pull |= {"value": initialValue, "valueType": valueType or "displacement"}
        node.addObject(kind, indices=list(range(len(cableGeometry))),
                       hasPullPoint=pullPointLocation is not None, **pull, **more)  # fmt: skip
        node.addObject("BarycentricMapping")
        return node

    return made


def _pneumatic_cavity(kind: str) -> Callable[..., Node]:
    def made(
        surfaceMeshFileName: str = "", attachedAsAChildOf: Any = None, attachedTo: Any = None,
        name: str = "PneumaticCavity", rotation: Vector = ORIGIN, translation: Vector = ORIGIN,
        uniformScale: float = 1.0, initialValue: float = 0.0, valueType: Any = None, **more: Any,
    ) -> Node:  # fmt: skip
        above = attachedTo if isinstance(attachedTo, Node) else attachedAsAChildOf
        node = above.addChild(name)
        loader = _loader(node, surfaceMeshFileName, rotation, translation, uniformScale)
        node.addObject("MeshTopology", name="topology", src=loader.linkpath)
        node.addObject("MechanicalObject", src="@topology")
        value = {} if kind != "SurfacePressureConstraint" else {
            "value": initialValue, "valueType": valueType or "volumeGrowth"}  # fmt: skip
        node.addObject(kind, triangles="@topology.triangles", **value, **more)
        node.addObject("BarycentricMapping")
        return node

    return made


def effector_goal(node: Node, position: Any = ORIGIN, name: str = "Goal", **more: Any) -> Node:
    """A place that an effector shall reach.

    Args:
        node: The root.
        position: The place.
        name: Name of the new node.
        **more: Not read.
    """
    goal = node.addChild(name)
    goal.addObject("MechanicalObject", name="goalMO", position=position)
    return goal


def position_effector(
    attachedTo: Node, position: Any = ORIGIN, effectorGoal: Any = ORIGIN, name: str = "PositionEffector",
    **more: Any,
) -> Node:  # fmt: skip
    """Points that shall reach places.

    Args:
        attachedTo: Node of the body.
        position: The points.
        effectorGoal: The places.
        name: Name of the new node.
        **more: Fields of the component.
    """
    node = attachedTo.addChild(name)
    points = np.asarray(position, float).reshape(-1, 3)
    node.addObject("MechanicalObject", position=points)
    node.addObject("PositionEffector", indices=list(range(len(points))), effectorGoal=effectorGoal, **more)
    node.addObject("BarycentricMapping")
    return node


# --- numbers --------------------------------------------------------------------------------------


class Vec3(list):
    """Three numbers with sums and products."""

    def __init__(self, *given: Any):
        """Makes it of a list or of three numbers.

        Args:
            *given: The numbers.
        """
        super().__init__(np.ravel(given[0] if len(given) == 1 else given) if given else ORIGIN)

    def __add__(self, other: Any) -> Any:
        if len(other) != 3:
            return [*self, *other]
        return Vec3(np.add(self, other))

    def __sub__(self, other: Any) -> Vec3:
        return Vec3(np.subtract(self, other))

    def __mul__(self, factor: Any) -> Vec3:
        return Vec3(np.multiply(self, factor))

    def getNorm(self) -> float:
        """Its length."""
        return float(np.linalg.norm(self))


class Quat(list):
    """A quaternion x, y, z, w."""

    def __init__(self, *given: Any):
        """Makes it of four numbers.

        Args:
            *given: The numbers; none for no rotation.
        """
        super().__init__(np.ravel(given[0] if len(given) == 1 else given) if given else (*ORIGIN, 1.0))

    @staticmethod
    def createFromEuler(angles: Vector, axes: str = "sxyz", inDegree: bool = False) -> Quat:
        """A rotation by angles about the fixed axes.

        Args:
            angles: The angles.
            axes: Not read.
            inDegree: Whether they are in degrees.
        """
        return Quat(Rotation.from_euler("xyz", list(angles), degrees=inDegree).as_quat())

    @staticmethod
    def createFromAxisAngle(axis: Vector, angle: float) -> Quat:
        """A rotation about an axis.

        Args:
            axis: The axis.
            angle: The angle [rad].
        """
        return Quat(Rotation.from_rotvec(angle * np.asarray(axis) / np.linalg.norm(axis)).as_quat())

    def rotate(self, vector: Vector) -> Vec3:
        """A vector turned.

        Args:
            vector: The vector.
        """
        return Vec3(Rotation.from_quat(self).apply(vector))


class _Vectors:
    """The functions of the module ``vec3``."""

    vadd = staticmethod(lambda a, b: list(np.add(a, b)))
    vsub = staticmethod(lambda a, b: list(np.subtract(a, b)))
    vmul = staticmethod(lambda a, b: list(np.multiply(a, b)))
    vnorm = staticmethod(lambda a: float(np.linalg.norm(a)))
    vdistance = staticmethod(lambda a, b: float(np.linalg.norm(np.subtract(a, b))))


def set_data(component: Any, **fields: Any) -> None:
    """Sets fields of a component.

    Args:
        component: The component.
        **fields: The fields.
    """
    for name, value in fields.items():
        setattr(component, name, value)


KNOWN: dict[str, Any] = {
    "MainHeader": main_header, "ContactHeader": contact_header, "Scene": Scene,
    "ElasticMaterialObject": elastic_material_object, "CollisionMesh": collision_mesh,
    "VisualModel": visual_model, "RigidObject": rigid_object, "FixedBox": fixed_box,
    "PartiallyFixedBox": partially_fixed_box, "SubTopology": sub_topology, "Rigidify": rigidify,
    "Cube": _rigid("Cube", "mesh/cube.obj"), "Sphere": _rigid("Sphere", "mesh/ball.obj"),
    "Floor": _rigid("Floor", "mesh/floor.obj", isAStaticObject=True),
    "addOrientedBoxRoi": oriented_box_roi, "EffectorGoal": effector_goal,
    "PositionEffector": position_effector, "PullingCable": _pulling_cable("CableConstraint"),
    "PneumaticCavity": _pneumatic_cavity("SurfacePressureConstraint"),
    "Vec3": Vec3, "Quat": Quat, "vec3": _Vectors, "to_radians": math.radians,
    "to_degrees": math.degrees, "sdiv": lambda a, b: list(np.divide(a, b)),
    "sin": math.sin, "cos": math.cos, "pi": math.pi, "setData": set_data,
    "SofaPrefab": lambda made: made, "SofaObject": object, "animate": Nothing(),
    "AnimationManager": Nothing(), "ShowGrid": Nothing(),
}  # fmt: skip
"""What the helper packages offer, by name."""
INVERSE: dict[str, Any] = {
    "PullingCable": _pulling_cable("CableActuator"),
    "PneumaticCavity": _pneumatic_cavity("SurfacePressureActuator"),
}
"""What those for inverse problems offer in their place."""
