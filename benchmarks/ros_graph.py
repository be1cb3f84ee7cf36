"""CPU time of reading the graph on a robot with 100 nodes and 300 topics.

Two alert_systems run side by side: one watches ten nodes, ten topics' publishers and a pattern of subscribers, the
other a topic. What the first takes more is the graph's. `BENCHMARK_ROS=ros1 python -m benchmarks.ros_graph` is the
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
from typing import Iterator, Sequence

from benchmarks.processes import Process, Target
from benchmarks.table import Row, within

NODES, TOPICS_PER_NODE, WATCHED = 100, 3, 10
MOST_MS = 5.0
SETTLE_S, SLICE_S = 15.0, 10.0
ROUNDS = 5


def rows(target: Target, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the row of the table."""
    signals = [f"node_{at}: {{node: /robot/node_{at}}}" for at in range(WATCHED)]
    signals += [f"topic_{at}: {{publishers: /robot/topic_{at}_0}}" for at in range(WATCHED)]
    signals.append('heard: {subscribers: "/robot/topic_1*_1", error_below: 0}')
    with contextlib.ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory()))
        variables = {**target.variables, "BENCHMARK_ROS": target.package}
        robot = running.enter_context(Process([target.python, "-m", "benchmarks.ros_graph"], variables))

        def watching(name: str, lines: Sequence[str]) -> Process:
            file = folder / f"{name}.yaml"
            file.write_text(f"alert_system:\n  ros__parameters:\n    signals: {{{', '.join(lines)}}}\n")
            return running.enter_context(target.node("alert_system", name, parameters=file))

        without = watching("without", ["level: {topic: /level, stale_after_s: 0.0}"])
        graph = watching("graph", signals)
        time.sleep(SETTLE_S)
        slices_ms = []
        for _ in range(rounds):
            before_s = graph.cpu_s() - without.cpu_s()
            time.sleep(SLICE_S)
            slices_ms.append((graph.cpu_s() - without.cpu_s() - before_s) / SLICE_S * 1e3)
        robot.require_running()
    what = f"{target.name}, a second of reading a graph of {NODES} nodes and {NODES * TOPICS_PER_NODE} topics"
    yield within(what, "alert_system", statistics.median(slices_ms), MOST_MS, "ms", "CPU time", digits=1)


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
