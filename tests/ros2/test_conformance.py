"""rclpy over real DDS keeps the port's promises, with either executor."""

from __future__ import annotations

from typing import Any

import pytest
from harness.black_box_conformance import BlackBoxConformance
from harness.port_conformance import PortConformance
from harness.raw_conformance import RawConformance


class TestRos2(BlackBoxConformance, RawConformance, PortConformance):
    @pytest.fixture
    def harness(self, inside: Any, outside: Any) -> Any:
        from harness.ros2 import Ros2Harness

        participant, spinner = inside
        return Ros2Harness(participant, outside, spinner)


class TestRos2Events(BlackBoxConformance, RawConformance, PortConformance):
    @pytest.fixture
    def harness(self, inside_events: Any, outside: Any) -> Any:
        from harness.ros2 import Ros2Harness

        participant, spinner = inside_events
        return Ros2Harness(participant, outside, spinner)
