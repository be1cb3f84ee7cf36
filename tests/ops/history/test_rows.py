"""Transitions and evidence as rows."""

from __future__ import annotations

import math
from typing import Any, List, Sequence, Tuple

import pytest

from robot_health_monitor.ops.history.rows import pack_samples, unpack_samples


def packed_and_unpacked(samples: Sequence[Tuple[float, Any]]) -> List[Tuple[float, float]]:
    """Returns the samples as they are read again."""
    unpacked = unpack_samples(pack_samples(samples))
    assert unpacked is not None
    assert unpacked.is_complete
    return unpacked.samples


def test_samples_survive_packing() -> None:
    samples = [(1_700_000_000.25, 19.299999237060547), (1_700_000_001.25, -5.0), (1_700_000_061.75, 1e300)]
    assert packed_and_unpacked(samples) == samples


def test_no_samples_take_no_space() -> None:
    assert pack_samples([]) == b""
    assert unpack_samples(b"") is None


def test_a_value_that_is_no_number_becomes_nan() -> None:
    [(_, text), (_, huge)] = packed_and_unpacked([(1.0, "fault"), (2.0, 10**400)])
    assert math.isnan(text) and math.isnan(huge)


def test_only_the_newest_300_samples_are_kept() -> None:
    assert [value for _, value in packed_and_unpacked([(float(n), n) for n in range(301)])] == list(range(1, 301))


def test_samples_that_an_earlier_transition_has_are_left_out() -> None:
    samples = [(10.0, 1.0), (11.0, 2.0), (12.0, 3.0)]
    assert unpack_samples(pack_samples(samples, 11.0)) == (10.0, [(12.0, 3.0)])
    assert unpack_samples(pack_samples(samples, 12.0)) == (10.0, [])
    assert len(pack_samples(samples, 12.0)) == 8


def test_all_samples_are_stored_after_the_wall_clock_was_set_back() -> None:
    assert packed_and_unpacked([(10.0, 1.0), (11.0, 2.0)]) == [(10.0, 1.0), (11.0, 2.0)]
    unpacked = unpack_samples(pack_samples([(10.0, 1.0), (11.0, 2.0)], 500.0))
    assert unpacked is not None
    assert unpacked.is_complete


@pytest.mark.parametrize("packed", [None, "text", 5, 2.5, b"odd", b"1" * 9])
def test_what_is_not_packed_samples_is_none(packed: Any) -> None:
    assert unpack_samples(packed) is None
