"""CPU time of reading the graph on a robot with 100 nodes and 300 topics.

Two alert_systems run side by side: one watches ten nodes, ten topics' publishers and a pattern of subscribers, the
other a topic. What the first takes more is the graph's. `BENCHMARK_ROS=ros1 python -m benchmarks.graph_cost` is the
robot: its nodes are registered at a real master, or are nodes of rclpy.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Iterator

from benchmarks.table import Row
from benchmarks.targets import Process, Target

NODES, TOPICS_PER_NODE, WATCHED = 100, 3, 10
MOST_MS = 5.0
SETTLE_S, SLICE_S = 15.0, 10.0
ROUNDS = 5


def rows(target: Target, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the row of the table."""
    signals = [f"node_{at}: {{node: /robot/node_{at}}}" for at in range(WATCHED)]
    signals += [f"topic_{at}: {{publishers: /robot/topic_{at}_0}}" for at in range(WATCHED)]
    signals.append('heard: {subscribers: "/robot/topic_1*_1", error_below: 0}')
    contestants = {"without": ["level: {topic: /level, stale_after_s: 0.0}"], "graph": signals}
    with contextlib.ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory()))
        variables = {**target.variables, "BENCHMARK_ROS": target.package}
        robot = Process([target.python, "-m", "benchmarks.graph_cost"], variables)
        running.callback(robot.end)
        nodes = {}
        for name, lines in contestants.items():
            file = folder / f"{name}.yaml"
            file.write_text(f"alert_system:\n  ros__parameters:\n    signals: {{{', '.join(lines)}}}\n")
            nodes[name] = target.node("alert_system", name, parameters=file)
            running.callback(nodes[name].end)
        time.sleep(SETTLE_S)
        slices = []
        for _ in range(rounds):
            before = {name: node.cpu_s() for name, node in nodes.items()}
            time.sleep(SLICE_S)
            spent = {name: node.cpu_s() - before[name] for name, node in nodes.items()}
            slices.append((spent["graph"] - spent["without"]) / SLICE_S * 1e3)
        robot.require_running()
    cost_ms = statistics.median(slices)
    what = f"{target.name}, a second of reading a graph of {NODES} nodes and {NODES * TOPICS_PER_NODE} topics"
    yield Row(what, "alert_system", f"{cost_ms:.1f} ms", cost_ms / MOST_MS, 1.0, f"to {MOST_MS:g} ms of CPU time")


def _robot_of_ros1() -> None:
    import xmlrpc.client
    import xmlrpc.server

    master = xmlrpc.client.ServerProxy(os.environ["ROS_MASTER_URI"])
    server = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
    server.register_function(lambda caller: (1, "", os.getpid()), "getPid")
    for name in ("publisherUpdate", "paramUpdate", "requestTopic"):
        server.register_function(lambda *arguments: (1, "", 0), name)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    uri = f"http://127.0.0.1:{server.server_address[1]}/"
    for at in range(NODES):
        for topic in range(TOPICS_PER_NODE):
            kind = master.registerSubscriber if topic == 1 else master.registerPublisher
            kind(f"/robot/node_{at}", f"/robot/topic_{at}_{topic}", "std_msgs/Float32", uri)
    threading.Event().wait()


def _robot_of_ros2() -> None:
    import rclpy
    from rclpy.node import Node
    from rclpy.parameter import Parameter
    from std_msgs.msg import Float32

    rclpy.init()
    quiet = [Parameter("start_type_description_service", value=False)]
    nodes = []
    for at in range(NODES):
        node = Node(
            f"node_{at}",
            namespace="robot",
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=quiet,
        )
        for topic in range(TOPICS_PER_NODE):
            if topic == 1:
                node.create_subscription(Float32, f"topic_{at}_{topic}", lambda message: None, 10)
            else:
                node.create_publisher(Float32, f"topic_{at}_{topic}", 10)
        nodes.append(node)
    threading.Event().wait()


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        {"ros1": _robot_of_ros1, "ros2": _robot_of_ros2}[os.environ["BENCHMARK_ROS"]]()
    sys.exit(0)
