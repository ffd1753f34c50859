"""Measures what markers for RViz, the status and transforms cost a tick of the twin.

``python tools/measure_markers.py diamond trunk fetch`` prints, for each robot, medians and 99th
percentiles in microseconds: while nobody listens, and of each message while somebody does.
"""

import argparse
import time

import numpy as np
import rclpy
from rclpy.parameter import Parameter
from visualization_msgs.msg import MarkerArray

from softrobot_twin.ros.topics import NEWEST
from softrobot_twin.ros.twin_node import TwinNode

_REPEATS = 200


def cost(call) -> str:
    """Median and 99th percentile of the time of a call, made with 0, 1, 2 and so on [µs]."""
    times = []
    for count in range(_REPEATS):
        begin = time.perf_counter()
        call(count)
        times.append(1e6 * (time.perf_counter() - begin))
    return f"{np.median(times):8.1f} µs (99 %: {np.percentile(times, 99):.0f})"


def measure(robot: str) -> None:
    """Prints the times of one robot."""
    given = {"scene_file": f"scenes/{robot}.yaml", "mesh_error": False, "reduction_error": False}
    node = TwinNode(parameter_overrides=[Parameter(key, value=given[key]) for key in given])
    node.stop()
    node.tick()
    newest, now = node.window.newest, node.monotonic() + 1.0
    markers, status = node.visualization, node.status
    status.offer(newest, now)
    print(f"{robot}, {node.loop.simulation.node_count} nodes")
    print("  markers, nobody listens ", cost(lambda count: markers.offer(newest, 0, now + count)))
    print("  status, unchanged       ", cost(lambda count: status.offer(newest, now + count)))
    print("  /tf, nobody listens     ", cost(lambda _: node._transforms.publish(newest, None)))
    probe = rclpy.create_node("probe")
    probe.create_subscription(MarkerArray, "/twin/visualization", lambda _: None, NEWEST)
    while not node.count_subscribers("/twin/visualization"):
        time.sleep(0.05)
    markers.offer(newest, 0, now + 1e4)
    print("  markers, each message   ",
          cost(lambda count: markers.offer(newest, 0, now + 2e4 + count)))  # fmt: skip
    print("  markers, between them   ",
          cost(lambda _: markers.offer(newest, 0, now + 2e4 + _REPEATS - 1.0)))  # fmt: skip
    probe.destroy_node()
    node.destroy_node()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="+", help="names of scenes in config/scenes")
    rclpy.init()
    for name in parser.parse_args().robots:
        measure(name)
    rclpy.try_shutdown()
