"""Simulated sources vary plausibly, are reproducible by seed, and tolerate any clock."""

from __future__ import annotations

import random
from typing import Any

import pytest

from robot_health_monitor.core.sensors.simulated import SimulatedBattery, SimulatedCpuUsage, SimulatedTemperature

START_S = 1000.0


def read(source: Any, seconds: int) -> list[float]:
    """Reads a source once a second, from START_S on."""
    return [source.read(START_S + second) for second in range(seconds)]


def test_battery_loses_one_percent_per_second_from_100():
    assert read(SimulatedBattery(), 4) == [100.0, 99.0, 98.0, 97.0]


def test_battery_shows_exactly_20_percent_after_80_seconds():
    battery = SimulatedBattery()
    battery.read(START_S)
    assert battery.read(START_S + 80.0) == 20.0
    assert battery.read(START_S + 81.0) == 19.0


def test_battery_is_charged_at_5_percent_back_to_100_and_discharges_again():
    battery = SimulatedBattery(discharge_rate=1.0, charge_rate=5.0)
    levels = read(battery, 120)
    assert levels[95] == 5.0
    assert levels[96:98] == [10.0, 15.0]
    assert levels[114] == 100.0  # 95 s down, 19 s up
    assert levels[115] == 99.0
    assert min(levels) == 5.0


def test_battery_discharges_at_the_configured_rate():
    assert read(SimulatedBattery(discharge_rate=2.5), 3) == [100.0, 97.5, 95.0]


def test_battery_that_does_not_discharge_stays_full():
    battery = SimulatedBattery(discharge_rate=0.0)
    assert read(battery, 2) == [100.0, 100.0]
    assert battery.read(START_S + 1e9) == 100.0


def test_battery_that_is_never_charged_stays_at_its_lowest():
    battery = SimulatedBattery(charge_rate=0.0)
    battery.read(START_S)
    assert battery.read(START_S + 1e6) == 5.0


def test_battery_stays_within_0_to_100_percent_at_any_rate():
    for rate in (1e-12, 0.3, 7.7, 1e12):
        battery = SimulatedBattery(discharge_rate=rate, charge_rate=rate, charge_at=0.0)
        assert all(0.0 <= level <= 100.0 for level in read(battery, 500))


def test_temperature_without_hot_spells_keeps_within_its_spread():
    temperatures = read(SimulatedTemperature(mean=20.0, spread=5.0, spike=0.0, seed=1), 2000)
    assert all(15.0 <= celsius <= 25.0 for celsius in temperatures)
    assert min(temperatures) < 17.0 and max(temperatures) > 23.0


@pytest.mark.parametrize("seed", range(20))
def test_temperature_exceeds_80_degrees_once_in_every_two_minutes_and_comes_back(seed):
    temperatures = read(SimulatedTemperature(seed=seed), 600)
    hot = [celsius > 80.0 for celsius in temperatures]
    begins = [second for second in range(1, 600) if hot[second] and not hot[second - 1]]
    assert [second // 120 for second in begins] == [0, 1, 2, 3, 4]
    # 56 to 64 degrees C, and 30 more at the height of a hot spell of 30 s
    assert max(temperatures) <= 94.0
    assert min(temperatures) >= 56.0
    assert sum(hot) <= 5 * 20


def test_temperature_wanders_instead_of_jumping():
    temperatures = read(SimulatedTemperature(spike=0.0, seed=3), 500)
    assert max(abs(later - earlier) for earlier, later in zip(temperatures, temperatures[1:])) < 1.5


def test_cpu_usage_stays_within_0_to_100_percent_even_when_told_to_leave():
    usage = read(SimulatedCpuUsage(mean=50.0, spread=500.0, seed=1), 1000)
    assert min(usage) == 0.0
    assert max(usage) == 100.0


def test_cpu_usage_of_one_second_resembles_that_of_the_second_before():
    usage = read(SimulatedCpuUsage(seed=5), 5000)
    mean = sum(usage) / len(usage)
    variance = sum((value - mean) ** 2 for value in usage)
    lagged = sum((earlier - mean) * (later - mean) for earlier, later in zip(usage, usage[1:]))
    assert lagged / variance > 0.7  # white noise has about 0.0
    assert max(usage) - min(usage) > 30.0


@pytest.mark.parametrize("source_of", [SimulatedTemperature, SimulatedCpuUsage])
def test_the_same_seed_gives_the_same_values_and_another_seed_others(source_of):
    assert read(source_of(seed=4), 100) == read(source_of(seed=4), 100)
    assert read(source_of(seed=4), 100) != read(source_of(seed=5), 100)


def test_the_values_of_a_seed_are_the_same_on_every_python():
    # read once with Python 3.8.18, and held fast
    assert SimulatedTemperature(seed=4).read(0.0) == pytest.approx(58.947857301616565, abs=1e-12)
    assert SimulatedCpuUsage(seed=4).read(0.0) == pytest.approx(58.06303400385549, abs=1e-12)


SOURCES = [
    lambda: SimulatedBattery(),
    lambda: SimulatedTemperature(seed=9),
    lambda: SimulatedCpuUsage(seed=9),
]


@pytest.mark.parametrize("source_of", SOURCES)
def test_how_often_it_is_read_changes_nothing(source_of):
    often, seldom = source_of(), source_of()
    for tenth in range(3001):
        value = often.read(START_S + tenth / 10)
    seldom.read(START_S)
    assert seldom.read(START_S + 300.0) == value


@pytest.mark.parametrize("source_of", SOURCES)
def test_the_start_of_the_clock_changes_nothing(source_of):
    late, early = source_of(), source_of()
    assert [late.read(1e6 + s) for s in range(50)] == [early.read(-1e6 + s) for s in range(50)]


@pytest.mark.parametrize("source_of", SOURCES)
def test_time_that_stands_still_gives_the_same_value(source_of):
    source = source_of()
    read(source, 30)
    assert len({source.read(START_S + 30.0) for _ in range(10)}) == 1


@pytest.mark.parametrize("source_of", SOURCES)
def test_after_time_went_back_it_goes_on_from_where_it_was(source_of):
    looped, straight = source_of(), source_of()
    values = read(straight, 80)
    assert read(looped, 41) == values[:41]
    assert looped.read(5.0) == values[40]
    assert [looped.read(5.0 + s) for s in range(40)] == values[40:]


@pytest.mark.parametrize("source_of", SOURCES)
def test_it_leaves_the_shared_random_numbers_alone(source_of):
    before = random.getstate()
    read(source_of(), 10)
    assert random.getstate() == before
