"""The table of topics is what the nodes open: name, type, quality of service."""

import re

import pytest

from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.target_node import TargetNode
from softrobot_twin.ros.topics import (
    DEVICE_TOPICS,
    NODES,
    TARGET_TOPICS,
    TWIN_SERVICES,
    TWIN_TOPICS,
    Direction,
)

pytestmark = pytest.mark.libraries

ROOT_TOPICS = ("/rosout", "/parameter_events", "/clock")


def opened_by(node, world):
    """Triples of name, type and direction of what a node has open, and their qualities."""
    graph, found = world.probe, {}
    name, space = node.get_name(), node.get_namespace()
    for direction, by_node, infos in (
        (Direction.OUT, graph.get_publisher_names_and_types_by_node,
         graph.get_publishers_info_by_topic),
        (Direction.IN, graph.get_subscriber_names_and_types_by_node,
         graph.get_subscriptions_info_by_topic),
    ):  # fmt: skip
        for topic, kinds in by_node(name, space):
            if topic in ROOT_TOPICS:
                continue
            own = [info for info in infos(topic) if info.node_name == name]
            found[topic, kinds[0].replace("/msg/", "/"), direction] = own[0].qos_profile
    return found


def declared(topics, node, twin):
    """Patterns of the full names of declared topics."""
    for topic in topics.values():
        name = topic.name.replace("<twin>", twin).replace("~", node)
        yield re.compile(re.sub(r"<[^>]+>", r"[^/]+", name)), topic


@pytest.mark.parametrize(("kind", "topics", "least"), [
    ("twin", TWIN_TOPICS, 13), (DeviceNode, DEVICE_TOPICS, 4), (TargetNode, TARGET_TOPICS, 2),
])  # fmt: skip
def test_a_node_opens_what_its_table_declares_and_nothing_else(
    world, make_twin, small_scene_file, kind, topics, least
):
    if kind == "twin":
        node = make_twin()
    elif kind is DeviceNode:
        node = world.add(DeviceNode, device_scene_file=str(small_scene_file))
    else:
        node = world.add(TargetNode, target_center=[0.0, 0.0, 0.13])
    world.until(lambda: len(opened_by(node, world)) >= least)
    patterns = list(declared(topics, node.get_fully_qualified_name(), "/twin"))
    for (name, type_name, direction), quality in opened_by(node, world).items():
        if direction is Direction.IN and name == "/twin/cables/claim":
            continue  # Twins publish it, and hear each other.
        found = [topic for pattern, topic in patterns
                 if pattern.fullmatch(name) and topic.direction is direction]  # fmt: skip
        assert len(found) == 1, (name, direction)
        assert found[0].type_name == type_name
        # The graph of some middlewares does not tell the depth.
        assert quality.reliability == found[0].quality.reliability, name
        assert quality.durability == found[0].quality.durability, name


def test_the_twin_offers_the_services_of_its_table(world, make_twin):
    make_twin()
    found = {}

    def offered():
        found.update(world.probe.get_service_names_and_types_by_node("twin", "/"))
        return "/twin/reset" in found

    world.until(offered)
    # This scene has no grips.
    for service in (one for one in TWIN_SERVICES if "<" not in one.name):
        name = service.name.replace("~", "/twin")
        assert found[name] == [service.type_name.replace("/", "/srv/")]


def test_every_topic_has_a_unit():
    topics = [topic for of_node in NODES.values() for topic in of_node.values()]
    without = {topic.type_name for topic in topics if not topic.unit}
    assert all(kind.startswith(("diagnostic_msgs/", "std_msgs/String")) for kind in without), without
