"""Counts late ticks of a twin while programs of ordinary priority keep all cores busy.

    python tools/late_ticks.py                     # without a view
    python tools/late_ticks.py -p view:=true -p view_port:=0
    python tools/late_ticks.py --robot finger -p rate:=50.0 -p record:=/tmp/run.mcap

A twin of a robot follows a target that moves, this process hears its commands, and loops of Python
keep the cores busy. A tick is late when it comes 5 ms after its time; one of two hundred may. The
stamps of the commands tell when ticks came. It takes a ROS domain of its own.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[1]
LOOPS_FOR_EACH_CORE = 8
LATE = 0.005
"""A period longer than that of the rate by more is late [s]."""
MOST_LATE = 1 / 200
PATIENCE = 600.0


def read_arguments(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="diamond")
    parser.add_argument("--seconds", type=float, default=24.0)
    parser.add_argument("--quiet", action="store_true", help="keep no core busy")
    parser.add_argument("-p", dest="parameters", action="append", default=[], metavar="NAME:=VALUE")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Measures; 0 where few enough ticks are late, else 1."""
    asked = read_arguments(arguments)
    os.environ["ROS_DOMAIN_ID"] = str(random.randrange(100, 120))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    import rclpy
    from geometry_msgs.msg import PointStamped
    from sensor_msgs.msg import JointState

    file = ROOT / "config" / f"{asked.robot}.yaml"
    given = yaml.safe_load(file.read_text())["/**"]["ros__parameters"]
    command = [sys.executable, "-m", "softrobot_twin.ros.process", "twin", "--ros-args",
               "--params-file", str(file)]  # fmt: skip
    for parameter in ("use_device:=false", "mesh_error:=false", *asked.parameters):
        command += ["-p", parameter]
    rclpy.init()
    node, stamps = rclpy.create_node("late_ticks"), []
    effector = given.get("target_effector", "tip")
    start: list[tuple[float, float, float]] = []

    def hear(message: JointState) -> None:
        stamps.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)

    def see(message: PointStamped) -> None:
        start.append((message.point.x, message.point.y, message.point.z))

    node.create_subscription(JointState, "/twin/cables", hear, 500)
    seen = node.create_subscription(PointStamped, f"/twin/effectors/{effector}", see, 1)
    targets = node.create_publisher(PointStamped, f"/twin/target/{effector}", 1)
    spinning = threading.Thread(target=rclpy.spin, args=(node,), daemon=True)
    spinning.start()
    twin = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.DEVNULL)
    busy: list[subprocess.Popen] = []
    try:
        end = time.monotonic() + PATIENCE
        while not start:
            if twin.poll() is not None or time.monotonic() > end:
                print("the twin does not start")
                return 1
            time.sleep(0.1)
        node.destroy_subscription(seen)
        for task in os.listdir("/proc/self/task"):
            try:  # What this process hears late must be late.
                policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(int(task), policy, os.sched_param(3))
            except OSError:
                break
        if not asked.quiet:
            loop = [sys.executable, "-c", "while True: pass"]
            busy = [subprocess.Popen(loop) for _ in range(LOOPS_FOR_EACH_CORE * os.cpu_count())]
        time.sleep(3.0)
        begin = time.time()
        while (now := time.time()) < begin + asked.seconds:
            message = PointStamped()
            message.header.frame_id = "base_link"
            x, y, z = start[0]
            message.point.x, message.point.y, message.point.z = x + 0.01 * math.sin(now), y, z
            targets.publish(message)
            time.sleep(0.02)
        time.sleep(1.0)
        found = np.diff([stamp for stamp in stamps if begin < stamp < now])
    finally:
        for process in busy:
            process.kill()
        twin.send_signal(signal.SIGINT)
        try:
            twin.wait(20.0)
        except subprocess.TimeoutExpired:
            twin.kill()
        rclpy.try_shutdown()
        spinning.join(2.0)
    rates = [one.partition(":=")[2] for one in asked.parameters if one.startswith("rate:=")]
    period = 1.0 / float(rates[-1] if rates else given["rate"])
    late = int((found > period + LATE).sum())
    print(f"{late} of {len(found)} ticks late, median {1e3 * np.median(found):.1f}, "
          f"p99 {1e3 * np.percentile(found, 99):.1f}, longest {1e3 * found.max():.1f} ms")  # fmt: skip
    is_good = late <= MOST_LATE * len(found)
    print("ok" if is_good else "too many")
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
