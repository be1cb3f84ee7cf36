"""A node of rospy can be served to rosbridge clients."""

from __future__ import annotations

from typing import Any

import pytest
from served_conformance import ServedConformance


class TestRos1Served(ServedConformance):
    @pytest.fixture
    def harness(self, ros_process: Any) -> Any:
        from ros1_harness import Ros1Harness

        return Ros1Harness()

    @pytest.fixture
    def served(self, ros_process: Any) -> Any:
        from robot_health_monitor.ros1.served_middleware import Ros1ServedMiddleware

        return Ros1ServedMiddleware("/bridge")
