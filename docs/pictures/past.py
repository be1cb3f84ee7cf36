"""The past that the pictures show: the bags of docs/recordings.md, and what a monitor has stored of the day before."""

from __future__ import annotations

import math
import random
import time
from pathlib import Path
from typing import Iterable, Iterator

from harness.recorded import Recorded, write_bag

from robot_health_monitor.core import Level
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.samples import MERGED_S, StoredSamples, store

_DRIVES_S = 90_000_000  # after START_NS of harness.recorded
_CYCLE_S = 4.0 * 3600.0
_PARKED_H = (13.0, 14.5)
"""The robots are switched off then, in hours since the begin."""


def record(file: Path, seed: int, hours: float, broken: bool = False) -> None:
    """Writes a drive at 2 Hz: battery_level in % and motor_temperature in degrees Celsius; if `broken`, both fail."""
    chance = random.Random(seed)
    messages = []
    for step in range(int(hours * 7200)):
        time_s = step / 2
        driven = time_s / 3600.0 / hours
        sag = 6.0 if step % 1800 in (0, 1, 2, 3) else 0.0
        battery = 97.0 - 50.0 * driven * (1.7 if broken else 1.0) - sag + chance.gauss(0.0, 0.15)
        hot = 62.5 * max(0.0, driven - 0.6) if broken else 0.0
        temperature = 52.0 + 6.0 * math.sin(time_s / 700.0) + hot + chance.gauss(0.0, 0.3)
        for topic, value in (("/battery_level", battery), ("/motor_temperature", temperature)):
            messages.append(Recorded(_DRIVES_S + seed * 86_400 + time_s, topic, value))
    write_bag(file, messages)


def write_yesterday(file: Path, robots: Iterable[str]) -> None:
    """Stores battery_level and temperature of each robot for the last 24 hours, in periods of 5 minutes."""
    history = History(HistorySettings(str(file)))
    begin_s = (time.time() - 86_400.0) // MERGED_S * MERGED_S
    samples = [each for number, robot in enumerate(robots) for each in _day(robot, number, begin_s)]
    history.run(lambda connection: store(connection, samples), 60.0)
    history.close()


def _day(robot: str, number: int, begin_s: float) -> Iterator[StoredSamples]:
    for period in range(int(86_400.0 / MERGED_S)):
        after_s = period * MERGED_S
        if _PARKED_H[0] <= after_s / 3600.0 - number / 3.0 < _PARKED_H[1]:
            continue
        turn, place = divmod((after_s + 2_400.0 * number) / _CYCLE_S, 1.0)
        emptied = 66.0 + 9.0 * ((turn + number) % 3)  # in %; how far depends on the work
        battery = 96.0 - emptied * (place / 0.85 if place < 0.85 else (1.0 - place) / 0.15)
        charge = Level.ERROR if battery < 10.5 else Level.WARN if battery < 20.5 else Level.OK
        temperature = 34.0 + 5.0 * math.sin(after_s / 14_000.0 + number) + 0.8 * math.sin(after_s / 900.0)
        for signal, value, noise, level in (
            ("battery_level", battery, 0.5, charge),
            ("temperature", temperature, 0.4, Level.OK),
        ):
            start_s, least, most = begin_s + after_s, value - noise, value + noise
            yield StoredSamples(robot, signal, start_s, MERGED_S, least, most, value, value, 300, 0, level)
