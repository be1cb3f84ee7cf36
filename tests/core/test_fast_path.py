"""The fast path of ordinary samples in `SignalMonitor.observe` gives what the full path gives."""

from __future__ import annotations

import random
from typing import Any, Callable, Mapping, Sequence

import pytest
from harness.seeds import examples

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.values.elements import DriverStatus, Elements


class Slow(float):
    """A number that is not a plain float, so that `observe` takes the full path."""


VALUES = (50.0, 50.5, 20.0, 19.5, 21.0, 22.0, 9.0, 80.0, 80.5, 75.0, 0.0, 1.0, 0.5, 100.0, 100.5, -1.0, float("nan"))
SETTINGS: Mapping[str, Sequence[Any]] = {
    "unit": ("", "%"),
    "valid_min": (0.0,),
    "valid_max": (100.0,),
    "warn_below": (20.0,),
    "warn_above": (80.0,),
    "error_below": (10.0,),
    "hysteresis": (0.0, 2.0),
    "for_s": (0.0, 2.0),
    "keep_firing_for_s": (0.0, 2.0),
    "invalid_for_s": (0.0, 2.0),
    "latch": (False, False, True),
    "flap_detection": (False, True),
    "flap_high": (0.0, 5.0, 30.0),
    "stale_after_s": (0.0, 3.0),
    "repeat_s": (0.0, 3.0),
    "window_samples": (7, 6000),
    "statistic": ("last", "last", "last", "mean"),
    "scale": (1.0, 1.0, 1.0, 0.5),
    "only_if": ({"signal": "charging", "is": 0.0},),
}
CALLS: Sequence[tuple[str, Sequence[float]]] = (
    *[("level", VALUES)] * 3,
    *[("level", (50.0,))] * 3,
    ("many", (50.0, 60.0)),
    ("tick", (0.0, 1.0, 4.0)),
    ("charging", (0.0, 1.0)),
    ("link", (0.0, 1.0)),
    ("back", (5.0,)),
    ("report", (0.0,)),
    ("reset", (0.0,)),
    ("configure", (15.0, 55.0)),
)


def replay(signal: dict[str, Any], calls: list[tuple[str, float]], number: type) -> list[Any]:
    def config(**changed: float) -> Any:
        level = {"warn_below": 20.0, "flap_low": 0.0, **signal, **changed}
        return load_config({"signals": {"level": level, "charging": {}}})

    monitor = Monitor(config(), "robot1")
    now_s = 100.0
    results: list[Any] = []
    for what, argument in calls:
        now_s += 0.5
        if what == "tick":
            now_s += argument
            results.append(monitor.tick(now_s))
        elif what == "back":
            now_s -= argument
            results.append(monitor.tick(now_s))
        elif what == "report":
            results.append(monitor.report(now_s))
        elif what == "reset":
            results.append(monitor.reset())
        elif what == "configure":
            results.append(monitor.configure(config(warn_below=argument)))
        elif what == "many":
            for step in range(120):
                now_s += 0.01
                results.append(monitor.observe(Sample("level", number(argument + step % 3), now_s)))
        else:
            results.append(monitor.observe(Sample(what, number(argument), now_s)))
    return [*results, monitor.report(now_s)]


@pytest.mark.newest_python
@pytest.mark.parametrize("seed", range(20))
def test_the_fast_path_gives_what_the_full_path_gives(seed: int) -> None:
    dice = random.Random(seed)
    for _ in range(examples(10)):
        signal = {name: dice.choice(values) for name, values in SETTINGS.items() if dice.random() < 0.6}
        calls = [(what, dice.choice(arguments)) for what, arguments in dice.choices(CALLS, k=30)]
        assert repr(replay(signal, calls, float)) == repr(replay(signal, calls, Slow)), (signal, calls)


def test_a_value_with_name_and_time_is_judged_as_the_sample_of_them() -> None:
    by_sample, by_value = (Monitor(load_config({"signals": {"level": {"warn_below": 20.0}}})) for _ in range(2))
    given = [Sample("level", value, 5.0 - at) for at, value in enumerate((50.0, 19.0, float("nan"), "x", 50.0))]
    given += [Sample("link", 0.0, 6.0), Sample("unknown", 1.0, float("nan"))]
    changes = [by_sample.observe(sample) for sample in given]
    assert repr([by_value.observe_value(*sample) for sample in given]) == repr(changes)
    assert [change.notices for change in changes].count(()) == 3
    assert by_value.report(7.0) == by_sample.report(7.0)


@pytest.mark.parametrize("number", [float, Slow])
def test_a_value_that_clears_a_bound_on_the_charger_clears_it_for_later(number: type) -> None:
    signal = {"hysteresis": 2.0, "only_if": {"signal": "charging", "is": 0.0}}
    calls = [("charging", 1.0), ("level", 19.0), ("level", 21.0), ("level", 50.0), ("level", 21.0), ("charging", 0.0)]
    assert replay(signal, calls, number)[-1].statuses["level"].level is Level.OK


def test_a_thousand_ordinary_samples_are_all_in_the_window() -> None:
    monitor = Monitor(load_config({"signals": {"level": {"warn_below": 20.0}}}))
    for number in range(1000):
        monitor.observe(Sample("level", 30.0 + number % 10, number / 100.0))
    values = monitor.report(10.0).statuses["level"].values
    assert (values["window_samples"], values["mean"], values["min"], values["max"]) == ("1000", "34.5", "30", "39")


STATUS_SETTINGS: Mapping[str, Sequence[Any]] = {
    name: SETTINGS[name]
    for name in ("for_s", "keep_firing_for_s", "invalid_for_s", "latch", "flap_detection", "stale_after_s", "repeat_s")
}


def replay_statuses(signal: dict[str, Any], calls: list[tuple[str, int]], level: Callable[[int], Any]) -> list[Any]:
    """Returns what the monitor says and shows; a level that is a byte takes the full path."""
    drivers = {"field": 'status["*"]', "flap_low": 0.0, "only_if": {"signal": "charging", "is": 0.0}, **signal}
    monitor = Monitor(load_config({"signals": {"drivers": drivers, "charging": {}}}), "robot1")
    now_s = 100.0
    results: list[Any] = []
    for what, argument in calls:
        now_s += 0.5 + (argument if what == "tick" else 0.0)
        if what == "tick":
            results.append(monitor.tick(now_s))
        elif what == "report":
            results.append(monitor.report(now_s))
        elif what == "many":
            for step in range(60):
                now_s += 0.01
                statuses = Elements([("a", DriverStatus(level(argument if step == 30 else 0), f"message {step % 3}"))])
                results.append(monitor.observe(Sample("drivers", statuses, now_s)))
        elif what == "drivers":
            statuses = Elements([("a", DriverStatus(level(argument), "message")), ("b", DriverStatus(level(0), "ok"))])
            results.append(monitor.observe(Sample("drivers", statuses, now_s)))
        else:
            results.append(monitor.observe(Sample(what, float(argument), now_s)))
    return [*results, monitor.report(now_s)]


@pytest.mark.newest_python
@pytest.mark.parametrize("seed", range(examples(40)))
def test_statuses_of_drivers_give_the_same_on_both_paths(seed: int) -> None:
    random_ = random.Random(seed)
    signal = {name: random_.choice(values) for name, values in STATUS_SETTINGS.items() if random_.random() < 0.4}
    levels = {
        "drivers": (0, 0, 0, 1, 2, 3), "many": (0, 0, 2), "tick": (0, 1, 4), "report": (0,), "charging": (0, 1),
        "link": (0, 1),
    }  # fmt: skip
    calls = [(what, random_.choice(levels[what])) for what in random_.choices(list(levels), (6, 2, 2, 1, 1, 1), k=60)]
    assert replay_statuses(signal, calls, int) == replay_statuses(signal, calls, lambda level: bytes([level]))


def test_a_status_whose_level_is_false_or_no_whole_number_is_invalid() -> None:
    for level in (False, 0.0, "0", [], None):
        monitor = Monitor(load_config({"signals": {"level": {}}}))
        for at, each in enumerate((0, 0, 0, level)):
            monitor.observe(Sample("level", DriverStatus(each, "ok"), float(at)))
        assert monitor.levels()["level"] == (Level.ERROR, "invalid"), level
