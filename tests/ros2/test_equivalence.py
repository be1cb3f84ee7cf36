"""rclpy over real DDS gives the same verdicts as the reference."""

from __future__ import annotations

from typing import Any

import pytest
from harness.equivalence import Equivalence


class TestRos2(Equivalence):
    @pytest.fixture
    def harness(self, inside: Any, outside: Any) -> Any:
        from harness.ros2 import Ros2Harness

        participant, spinner = inside
        return Ros2Harness(participant, outside, spinner)
