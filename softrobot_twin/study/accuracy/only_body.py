"""The one body of a scene whose accuracy can be studied, and the refusal of all others."""

from __future__ import annotations

from softrobot_twin.scene import Scene
from softrobot_twin.simulation.body import Body, build_body
from softrobot_twin.study.accuracy.accuracy_error import AccuracyError


def check_one_body(scene: Scene) -> None:
    """Refuses a scene in which a mesh cannot be judged against finer ones.

    Raises:
        AccuracyError: The scene has several bodies or none, moves in time, or touches.
    """
    if scene.body is None:
        count = len(scene.bodies)
        raise AccuracyError(scene.name, "meshes, elements and laws are compared on the one body "
                            f"that a scene has under 'body'; this scene has {count} under "
                            "'bodies'")
    if scene.integration != "quasi_static":
        raise AccuracyError(scene.name, "errors are measured at equilibria, which integration "
                            f"{scene.integration} passes by; make a quasi_static scene")
    if scene.contact is not None:
        raise AccuracyError(scene.name, "where things touch differs from mesh to mesh: the error "
                            "of one mesh has no reference; take the contact out")


def only_body(scene: Scene) -> Body:
    """The scene's one body, its mesh read and placed.

    Raises:
        AccuracyError: See `check_one_body`.
        SoftRobotTwinError: Its mesh cannot be used.
    """
    check_one_body(scene)
    return build_body(scene.body, "body", 0, scene, [])
