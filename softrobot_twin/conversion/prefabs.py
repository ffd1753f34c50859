"""What the helper packages STLIB and SoftRobots offer scenes, for users who have not installed them.

`prefabs.yaml` tells the components of most prefabs; those that compute something are here.
"""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from softrobot_twin.conversion.stand_ins import Node, Nothing, Recorder

_LOADERS = {"msh": "MeshGmshLoader", "gidmsh": "GIDMeshLoader", "stl": "MeshSTLLoader", "obj": "MeshOBJLoader"}
TABLE: dict[str, dict[str, Any]] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))


def make(prefab: str, *positional: Any, **named: Any) -> Node:
    """Makes a prefab of the table.

    Args:
        prefab: Its name in the table.
        *positional: The node above, and values of its parameters in their order.
        **named: Values of its parameters.
    """
    told = TABLE[prefab]
    values = dict(told["given"])
    if positional and isinstance(positional[0], Node | Scene):
        named = {told["into"][0]: positional[0]} | named
        positional = positional[1:]
    named = dict(zip(values, positional, strict=False)) | named
    above = next((named[name] for name in told["into"] if named.get(name) is not None), None)
    values |= {key: value for key, value in named.items() if value is not None}
    above = above.node if isinstance(above, Scene) else above
    node = above if told.get("here") else Node(values["name"])
    for kind, fields in told["components"]:
        own = {key: _filled(value, values) for key, value in fields.items()}
        if own.pop("when", True) and not own.pop("unless", False):
            kind = _filled(kind, values)
            if kind == "Loader":
                kind = _LOADERS.get(str(own["filename"]).rpartition(".")[2].lower(), "MeshVTKLoader")
            node.addObject(kind, **{key: value for key, value in own.items() if value is not None and value != []})
    node.fields.update({key: _filled(value, values) for key, value in told.get("set", {}).items()})
    if node is not above and isinstance(above, Node):
        above.addChild(node)
    for inner, fields in told.get("inside", ()):
        own = {key: _filled(value, values) for key, value in fields.items()}
        if own.pop("when", True):
            make(inner, node, **own)
    return node


def _filled(value: Any, values: dict[str, Any]) -> Any:
    """A value of the table with those of parameters."""
    if not isinstance(value, str) or "$" not in value:
        return value
    if found := re.fullmatch(r"\$(\w+)", value):
        return values[found[1]]
    if found := re.fullmatch(r"\$(count|is|each)\((\w+)\)", value):
        if found[1] == "each":
            return np.resize(values[found[2]], 3).tolist()
        own = np.asarray(values[found[2]], float).reshape(-1, 3)
        return list(range(len(own))) if found[1] == "count" else len(own) > 0
    return re.sub(r"\$(\w+)", lambda found: str(values[found[1]]), value)


class Scene:
    """A root with the nodes Settings, Modelling and Simulation; other attributes are the root's."""

    def __init__(self, node: Node, gravity: Any = (0.0, -9.81, 0.0), dt: float = 0.01, **more: Any):
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
        node.Settings.addObject("MouseButton", name="mouseButton")
        node.Simulation.addObject("EulerImplicitSolver", name="TimeIntegrationSchema")
        make("MainHeader", node, gravity=list(gravity), dt=dt)
        self.__dict__.update(addMainHeader=Nothing(), addContact=partial(make, "ContactHeader", node))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.node, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.node, name, value)


def oriented_box_roi(
    parent: Node, position: Any = None, name: str = "BoxROI", translation: Any = (0.0, 0.0, 0.0),
    eulerRotation: Any = (0.0, 0.0, 0.0), scale: Any = (1.0, 1.0, 1.0),
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
    from scipy.spatial.transform import Rotation

    corners = 0.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0]]) * np.asarray(scale, float)
    turned = Rotation.from_euler("xyz", list(eulerRotation), degrees=True).apply(corners) + translation
    more = {} if position is None else {"position": position}
    return parent.addObject("BoxROI", name=name, orientedBox=[*turned.ravel(), scale[2]], **more)


def rigidify(targetObject: Node, sourceObject: Node, groupIndices: Any, frames: Any = None, name: Any = None) -> Node:
    """Makes groups of a body's points rigid.

    Args:
        targetObject: Node that the parts are added to.
        sourceObject: Node of the body.
        groupIndices: Points of each rigid part.
        frames: Frame of each: angles [degrees] or a quaternion, perhaps behind a place.
        name: Name of the new node.
    """
    from scipy.spatial.transform import Rotation

    from softrobot_twin.conversion.computed_values import value_of

    state = sourceObject.getMechanicalState()
    points = np.asarray(value_of(state, "position")).reshape(-1, 3)
    groups = [np.asarray(list(group), int) for group in groupIndices]
    rigids = []
    for group, frame in zip(groups, frames or [[0.0] * 3] * len(groups), strict=True):
        given = np.asarray(frame, float)
        place, turn = (given[:3], given[3:]) if len(given) > 4 else (points[group].mean(axis=0), given)
        if len(turn) == 3:
            turn = Rotation.from_euler("xyz", turn, degrees=True).as_quat()
        rigids.append([*place, *turn])
    chosen = np.concatenate(groups)
    others = np.setdiff1d(np.arange(len(points)), chosen)
    made = targetObject.addChild(str(name or sourceObject.name))
    free, parts = made.addChild("DeformableParts"), made.addChild("RigidParts")
    free.addObject("MechanicalObject", name="dofs", position=points[others])
    parts.addObject("MechanicalObject", template="Rigid3", name="dofs", position=rigids)
    carried = parts.addChild("RigidifiedParticules")
    carried.addObject("MechanicalObject", name="dofs", position=points[chosen])
    carried.addObject("RigidMapping", name="mapping", globalToLocalCoords=True, rigidIndexPerPoint=[
        number for number, group in enumerate(groups) for _ in group])  # fmt: skip
    pairs = np.zeros((len(points), 2), int)
    pairs[others, 1], pairs[chosen, 0], pairs[chosen, 1] = np.arange(len(others)), 1, np.arange(len(chosen))
    sourceObject.components[:] = [one for one in sourceObject.components if not one.kind.startswith(
        ("EulerImplicit", "SparseLDL", "LinearSolverConstraint"))]  # fmt: skip
    sourceObject.addObject("SubsetMultiMapping", name="mapping", input=[free.dofs, carried.dofs], output=state,
                           indexPairs=pairs.ravel())  # fmt: skip
    carried.addChild(sourceObject)
    free.addChild(sourceObject)
    return made


def set_data(component: Any, **fields: Any) -> None:
    """Sets fields of a component.

    Args:
        component: The component.
        **fields: The fields.
    """
    for name, value in fields.items():
        setattr(component, name, value)


KNOWN: dict[str, Any] = {
    **{name: partial(make, name) for name in TABLE}, "Scene": Scene, "Rigidify": rigidify,
    "addOrientedBoxRoi": oriented_box_roi, "setData": set_data, "SofaPrefab": lambda made: made,
    "animate": lambda *given, **named: Recorder.note_unknown("animate"), "AnimationManager": Nothing(),
    "loadPointListFromFile": lambda file: json.loads(Path(file).read_text()),
    "ShowGrid": Nothing(), "SofaObject": object,
}  # fmt: skip
"""What the helper packages offer, by name; behind ``inverse.`` what those for inverse problems do."""
