"""The client over a real socket gives the same verdicts as the reference."""

from __future__ import annotations

from typing import Any

import pytest
from harness.equivalence import Equivalence


@pytest.mark.newest_python
class TestRosbridge(Equivalence):
    @pytest.fixture
    def harness(self) -> Any:
        from harness.rosbridge import RosbridgeHarness

        return RosbridgeHarness()
