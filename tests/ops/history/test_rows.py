"""Transitions and evidence as rows."""

from __future__ import annotations

import math

from robot_health_monitor.ops.history.rows import pack_samples, unpack_samples


def test_samples_survive_packing() -> None:
    samples = [(1_700_000_000.25, 19.299999237060547), (1_700_000_001.25, -5.0), (1_700_000_061.75, 1e300)]
    assert unpack_samples(pack_samples(samples)) == samples


def test_no_samples_take_no_space() -> None:
    assert pack_samples([]) == b""
    assert unpack_samples(b"") == []


def test_a_value_that_is_no_number_becomes_nan() -> None:
    [(_, text), (_, huge)] = unpack_samples(pack_samples([(1.0, "fault"), (2.0, 10**400)]))
    assert math.isnan(text) and math.isnan(huge)


def test_only_the_newest_300_samples_are_kept() -> None:
    assert [value for _, value in unpack_samples(pack_samples([(float(n), n) for n in range(301)]))] == list(
        range(1, 301)
    )
