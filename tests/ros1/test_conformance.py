"""rospy against a real master keeps the port's promises."""

from __future__ import annotations

from typing import Any

import pytest
from harness.black_box_conformance import BlackBoxConformance
from harness.port_conformance import PortConformance
from harness.raw_conformance import RawConformance


class TestRos1(BlackBoxConformance, RawConformance, PortConformance):
    is_one_node_per_process = True

    @pytest.fixture
    def harness(self, ros_process: Any) -> Any:
        from harness.ros1 import Ros1Harness

        return Ros1Harness()
