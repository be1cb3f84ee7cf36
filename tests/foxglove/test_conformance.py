"""The client over a real socket keeps the port's promises, with messages in CDR and in JSON."""

from __future__ import annotations

from typing import Any

import pytest
from harness.black_box_conformance import BlackBoxConformance
from harness.port_conformance import PortConformance
from harness.raw_conformance import RawConformance


class TestFoxglove(BlackBoxConformance, RawConformance, PortConformance):
    knows_graph = False

    @pytest.fixture
    def harness(self) -> Any:
        from harness.foxglove import FoxgloveHarness

        return FoxgloveHarness()
