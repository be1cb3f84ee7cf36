"""Thirty days of ten signals in virtual time: what the history has of them equals what was observed.

The referee keeps the raw values of each hour in plain lists. Required: smallest and largest value, numbers of samples
and worst level of every hour are exactly those of the raw values, as stored and as read in periods of an hour, although
old periods were merged and the monitor was restarted; the file has the size that docs/reference/history_file.md
predicts.
"""

from __future__ import annotations

import math
import os
import random
import sqlite3
import tempfile
import time
from pathlib import Path
from typing import Any, Callable, Mapping, NamedTuple, Sequence

from soak.figures import Figure, count

from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.judge.continuity import Continuity
from robot_health_monitor.core.values.elements import Elements
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.retention import Retention
from robot_health_monitor.ops.store.samples import FINE_S, MERGED_S, StoredSamples, read, read_coarse
from robot_health_monitor.ops.web.history_requests import SamplesQuery, past_samples

START_S = 1_800_000_000.0
"""Begin of an hour."""
HOUR_S = 3600.0
DAY_S = 86_400.0
KEEP_S = 90.0 * DAY_S
BYTES_PER_PERIOD = 90.0
"""As docs/reference/history_file.md predicts."""
ALLOWED_SIZE = 1.25
READ_LIMIT_S = 0.2
SINGLE = tuple(f"signal_{number}" for number in range(7))
CELLS = tuple(f"cells[{number}]" for number in range(3))
NAMES = (*SINGLE, *CELLS)
SIGNALS: Mapping[str, Mapping[str, Any]] = {
    **{name: {"warn_below": 5.0, "error_below": 1.0, "valid_max": 1000.0, "stale_after_s": 0.0} for name in SINGLE},
    "cells": {"topic": "bms", "type": "sensor_msgs/BatteryState", "field": "cell_voltage[*]", "warn_below": 5.0,
              "error_below": 1.0, "valid_max": 1000.0, "stale_after_s": 0.0},
}  # fmt: skip
LEVELS = ("OK", "WARN", "ERROR")


class Hour(NamedTuple):
    """What is known of a signal in one hour."""

    least: float | None
    most: float | None
    good: int
    bad: int
    level: str


def run(days: float, sample_period_s: float, seed: int) -> tuple[list[str], list[Figure]]:
    """Plays the days; returns the differences, and the figures."""
    with tempfile.TemporaryDirectory() as folder:
        return _Run(Path(folder) / "history.db", days, sample_period_s, random.Random(seed)).play()


class _Run:
    """One monitor with its history, and the referee."""

    def __init__(self, file: Path, days: float, sample_period_s: float, chance: random.Random) -> None:
        self._file = file
        self._hours = round(days * DAY_S / HOUR_S)
        self._period_s = sample_period_s
        self._chance = chance
        self._now_s = 0.0
        self._expected: dict[tuple[str, int], Hour] = {}

    def play(self) -> tuple[list[str], list[Figure]]:
        """Observes and ticks; restarts the monitor now and then."""
        hour = 0
        while hour < self._hours:
            until = min(self._hours, hour + self._chance.randrange(1, 200))
            self._watch(hour, until)
            hour = until
        history = self._opened()
        try:
            differences = history.run(self._differences, 600.0)
            figures = [
                count("hours of signals in the history", len(self._expected), self._hours * len(NAMES)),
                self._size(),
                self._time("read as stored", lambda: history.read(_all_of_one_signal)),
                self._time("read in 30 minutes", lambda: self._read_for_page(history)),
            ]
        finally:
            history.close()
        return differences, figures

    def _opened(self) -> History:
        settings = HistorySettings(str(self._file), keep_days=KEEP_S / DAY_S, keep_mb=1e4)
        return History(settings, lambda: START_S + self._now_s)

    def _watch(self, begin: int, end: int) -> None:
        """Runs a monitor from one hour to another, and stops it cleanly."""
        history = self._opened()
        monitor = Monitor(load_config({"signals": SIGNALS}), robot="r1")
        continuity = Continuity(monitor, history.of_robot("r1"))
        continuity.restore(self._now_s, at_first_call=False)
        retention: list[Retention] = []

        def keep_up(connection: sqlite3.Connection) -> None:
            retention.extend([] if retention else [Retention(connection, 1e12)])
            while retention[0].delete_old(0, START_S + self._now_s, KEEP_S):
                pass

        for hour in range(begin, end):
            raw = self._observe_hour(hour, monitor, continuity)
            self._expected.update({(name, hour): _hour_of(values) for name, values in raw.items()})
            history.run(keep_up, 600.0)
        continuity.save(self._now_s)
        continuity.record_samples(self._now_s)
        history.close(600.0)  # a busy machine: the next run must find the file free

    def _observe_hour(self, hour: int, monitor: Monitor, continuity: Continuity) -> dict[str, list[float]]:
        chance, raw = self._chance, {name: [] for name in NAMES}  # type: Tuple[random.Random, Dict[str, List[float]]]
        tick_s = hour * HOUR_S
        for number in range(int(HOUR_S / self._period_s)):
            sample_s = hour * HOUR_S + number * self._period_s
            while tick_s < sample_s:  # at the same instant, a sample comes before a tick
                self._tick(tick_s, monitor, continuity)
                tick_s += 1.0 if self._period_s < 10.0 else self._period_s
            self._now_s = sample_s
            for name in NAMES:
                # Rarely an extreme: one sample of the hour, which nothing may average away.
                value = chance.uniform(-500.0, 999.0) if chance.random() < 1e-3 else chance.uniform(20.0, 80.0)
                raw[name].append(2000.0 if chance.random() < 1e-3 else value)
            for name in SINGLE:
                monitor.observe(Sample(name, raw[name][-1], sample_s))
            monitor.observe(
                Sample("cells", Elements((str(number), raw[name][-1]) for number, name in enumerate(CELLS)), sample_s)
            )
        self._tick((hour + 1) * HOUR_S - 1e-3, monitor, continuity)
        return raw

    def _tick(self, now_s: float, monitor: Monitor, continuity: Continuity) -> None:
        self._now_s = now_s
        monitor.tick(now_s)
        continuity.save(now_s)

    def _differences(self, connection: sqlite3.Connection) -> list[str]:
        found: list[str] = []
        for name in NAMES:
            stored: dict[int, list[StoredSamples]] = {}
            for each in read(connection, robot="r1", signal=name):
                stored.setdefault(int((each.start_s - START_S) // HOUR_S), []).append(each)
            coarse = read_coarse(connection, "r1", name, START_S, START_S + self._now_s, HOUR_S)
            found += self._compare(name, "stored", {hour: _joined(parts) for hour, parts in stored.items()})
            in_hours = {int((each.start_s - START_S) // HOUR_S): _joined([each]) for each in coarse}
            found += self._compare(name, "read per hour", in_hours)
        return found

    def _compare(self, name: str, what: str, hours: Mapping[int, Hour]) -> list[str]:
        expected = {hour: each for (signal, hour), each in self._expected.items() if signal == name}
        if hours.keys() != expected.keys():
            return [f"{name}, {what}: {len(hours)} hours, expected {len(expected)}"]
        return [
            f"{name}, hour {hour}, {what}: {hours[hour]}, expected {each}"
            for hour, each in expected.items()
            if hours[hour] != each
        ]

    def _size(self) -> Figure:
        fine_s = min(FINE_S, self._hours * HOUR_S)
        periods = fine_s / max(10.0, self._period_s) + (self._hours * HOUR_S - fine_s) / MERGED_S
        predicted_mb = len(NAMES) * periods * BYTES_PER_PERIOD / 1e6
        size_mb = os.path.getsize(self._file) / 1e6
        return Figure("file of samples", predicted_mb, size_mb, size_mb, predicted_mb * ALLOWED_SIZE, "MB")

    def _read_for_page(self, history: History) -> object:
        query = SamplesQuery("r1", NAMES[0], seconds=1800)
        return history.read(lambda connection: past_samples(connection, history.wall_s(), query))

    def _time(self, what: str, step: Callable[[], object]) -> Figure:
        limit_s = READ_LIMIT_S if self._hours * HOUR_S >= 30.0 * DAY_S else math.inf
        took_s: list[float] = []
        for _ in range(5):
            begin_s = time.perf_counter()
            step()
            took_s.append(time.perf_counter() - begin_s)
        return Figure(f"  one signal, {what}", took_s[0], min(took_s), min(took_s), limit_s, "s")


def _all_of_one_signal(connection: sqlite3.Connection) -> int:
    return len([*read(connection, robot="r1", signal=NAMES[0])])


def _hour_of(values: Sequence[float]) -> Hour:
    good = [value for value in values if value <= 1000.0]
    worst = max(2 if value < 1.0 or value > 1000.0 else 1 if value < 5.0 else 0 for value in values)
    return Hour(min(good), max(good), len(good), len(values) - len(good), LEVELS[worst])


def _joined(parts: Sequence[StoredSamples]) -> Hour:
    return Hour(
        min((each.least for each in parts if each.least is not None), default=None),
        max((each.most for each in parts if each.most is not None), default=None),
        sum(each.good for each in parts),
        sum(each.bad for each in parts),
        max((each.level for each in parts), key=lambda level: LEVELS.index(level.name)).name,
    )
