"""An rclpy node can be served to rosbridge clients."""

from __future__ import annotations

from typing import Any

import pytest
from served_conformance import ServedConformance


class TestRos2Served(ServedConformance):
    @pytest.fixture
    def harness(self, inside: Any, outside: Any) -> Any:
        from ros2_harness import Ros2Harness

        participant, spinner = inside
        return Ros2Harness(participant, outside, spinner)

    @pytest.fixture
    def served(self, inside: Any) -> Any:
        from robot_health_monitor.ros2.served_middleware import Ros2ServedMiddleware

        participant, _ = inside
        served = Ros2ServedMiddleware("bridge", participant.context, use_global_arguments=False)
        participant.executor.add_node(served.node)
        return served
