"""The table at the end of a replay."""

from __future__ import annotations

from dataclasses import replace
from typing import Mapping, Optional

import numpy as np

from robot_health_monitor.core.model import Level
from robot_health_monitor.core.signal_config import read_signal
from robot_health_monitor.recordings.judging import SignalStatistics, SignalSummary
from robot_health_monitor.replay_table import header, plain_table, row, sentence, worst_first


def summary(
    shares: Optional[Mapping[Level, float]] = None, recorded: bool = True, samples: int = 3, unknown: float = 0.0
) -> SignalSummary:
    """Returns the summary of a battery with the values 10, 20 and 60."""
    config = read_signal("battery", {"unit": "%"})
    statistics = SignalStatistics(config)
    if samples:
        statistics.add(np.array([0.0, 1.0, 701.0]), np.array([10.0, 20.0, 60.0]))
    return SignalSummary("a.yaml", config, "/battery", recorded, "", statistics, shares or {}, unknown, 2)


def cells(found: SignalSummary) -> Mapping[str, str]:
    """Returns the cells by their heads."""
    return dict(zip(header(False), row(found, False)))


def test_a_row_has_the_figures_of_a_signal() -> None:
    shares = {Level.OK: 0.75, Level.WARN: 0.125, Level.ERROR: 0.0, Level.STALE: 0.0}
    assert cells(summary(shares, unknown=0.125)) == {
        "signal": "battery", "samples": "3", "bad": "0", "OK": "75.0 %", "WARN": "12.5 %", "ERROR": "0 %",
        "STALE": "0 %", "unknown": "12.5 %", "alerts": "2",
        "min": "10 %", "mean": "30 %", "max": "60 %", "longest gap": "11 min 40 s",
    }  # fmt: skip


def test_a_share_is_0_or_100_only_if_it_is() -> None:
    found = cells(summary({Level.OK: 0.999999, Level.WARN: 0.000001, Level.ERROR: 0.0, Level.STALE: 0.0}))
    assert [found[level] for level in ("OK", "WARN", "ERROR")] == ["99.9 %", "0.1 %", "0 %"]
    found = cells(summary({Level.OK: 1.0, Level.WARN: 0.0, Level.ERROR: 0.0, Level.STALE: 0.0}))
    assert [found[level] for level in ("OK", "WARN")] == ["100 %", "0 %"]


def test_a_signal_without_samples_has_no_figures() -> None:
    found = cells(summary(samples=0, unknown=1.0))
    assert [found[name] for name in ("samples", "OK", "unknown")] == ["0", "0 %", "100 %"]
    assert [found[name] for name in ("min", "mean", "max", "longest gap")] == [*"----"]


def test_a_signal_that_is_not_recorded_says_so() -> None:
    found = row(summary(recorded=False), False)
    assert found[:2] == ["battery", "not recorded"]
    assert set(found[2:]) == {""}
    assert len(found) == len(header(False))


def test_with_two_configurations_a_row_names_its_own() -> None:
    assert header(True)[:3] == ["signal", "file", "samples"]
    assert row(summary(), True)[:3] == ["battery", "a.yaml", "3"]


def test_columns_of_a_plain_table_are_aligned() -> None:
    head = header(False)
    lines = plain_table(head, [["a", *["1"] * 12], ["long\x1b_name", "not recorded", *[""] * 11]])
    assert lines == [
        "signal           samples  bad  OK  WARN  ERROR  STALE  unknown  alerts  min  mean  max  longest gap",
        "a                      1    1   1     1      1      1        1       1    1     1    1            1",
        "long?_name  not recorded",
    ]


def named(name: str, **shares: float) -> SignalSummary:
    """Returns the summary of a signal with shares of its time."""
    found = summary({Level[level]: share for level, share in shares.items()})
    return replace(found, config=read_signal(name, {}), alerts=max(0, len(shares) - 1))


def test_the_worst_signal_is_first() -> None:
    found = [
        named("fine", OK=1.0),
        named("warm", OK=0.1, WARN=0.9),
        named("hot", OK=0.99, ERROR=0.01),
        named("gone", OK=0.5, STALE=0.5),
        replace(named("missing"), missing="/missing is not recorded"),
        named("hotter", OK=0.9, ERROR=0.1),
        replace(named("fine", OK=1.0), file="b.yaml"),
        replace(named("warm", OK=1.0), file="b.yaml"),
    ]
    order = [(each.config.name, each.file) for each in worst_first(found)]
    assert order == [
        ("hotter", "a.yaml"), ("hot", "a.yaml"), ("gone", "a.yaml"), ("warm", "a.yaml"), ("warm", "b.yaml"),
        ("missing", "a.yaml"), ("fine", "a.yaml"), ("fine", "b.yaml"),
    ]  # fmt: skip


def test_a_sentence_names_the_signals_the_time_and_the_worst() -> None:
    two = [named("hot", OK=0.75, ERROR=0.05, WARN=0.2), named("fine", OK=1.0)]
    assert sentence(two, 4000.0) == (
        "hot, fine were judged over 1 h 6 min. The worst is hot: ERROR for 5.0 %, WARN for 20.0 % of the time."
    )
    missing = replace(named("gps"), missing="/gps is not recorded")
    assert sentence([missing, two[1]], 60.0) == "fine was judged over 60 s. It was OK."
    many = [named(f"s{number}", OK=1.0) for number in range(9)]
    assert sentence(many, 60.0) == "s0, s1, s2, s3, s4, s5, ... (9 signals) were judged over 60 s. All were OK."
