"""The client over a real socket, through this project's server, keeps the port's promises."""

from __future__ import annotations

from typing import Any

import pytest
from harness.black_box_conformance import BlackBoxConformance
from harness.port_conformance import PortConformance
from harness.raw_conformance import RawConformance


class TestRosbridge(BlackBoxConformance, RawConformance, PortConformance):
    knows_graph = False

    @pytest.fixture
    def harness(self) -> Any:
        from harness.rosbridge import RosbridgeHarness

        return RosbridgeHarness()
