"""The client over a real socket gives the same verdicts as the reference, with messages in CDR and in JSON."""

from __future__ import annotations

from typing import Any

import pytest
from harness.equivalence import FIELDS, Equivalence
from harness.local import LocalHarness


@pytest.mark.newest_python
class TestFoxglove(Equivalence):
    @pytest.fixture
    def harness(self) -> Any:
        from harness.foxglove import FoxgloveHarness

        return FoxgloveHarness()


@pytest.mark.newest_python
def test_messages_in_json_give_the_same_transitions() -> None:
    """But for infinities, for which JSON has null: they are not among these fields."""
    from harness.foxglove import FoxgloveHarness

    suite, harness = Equivalence(), FoxgloveHarness("json")
    reference = suite.publish(LocalHarness(), FIELDS)
    try:
        found = suite.publish(harness, FIELDS, reference.samples)
    finally:
        harness.close()
    assert [repr(each) for each in found.transitions] == [repr(each) for each in reference.transitions]
