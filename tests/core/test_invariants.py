"""What always holds, for any configuration that loads and any sequence of calls (docs/rules.md, last section)."""

from __future__ import annotations

import dataclasses
import fractions
import math
import random
import sys
from typing import Any, Mapping, Sequence, Tuple

import numpy
import pytest
from harness.seeds import examples, fixed_seed
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.core import ConfigError, Level, Monitor, MonitorConfig, Sample, Transition, load_config
from robot_health_monitor.core.config.parameters import Parameter
from robot_health_monitor.core.config.signal_config import CONDITIONS, SIGNAL_PARAMETERS, STATISTICS
from robot_health_monitor.core.values.elements import Age, BadDatum, DriverStatus, Elements

Call = Tuple[Any, ...]


class Mute:
    """A datum whose methods raise."""

    def __repr__(self) -> str:
        raise RuntimeError("no repr")

    def __float__(self) -> float:
        raise RuntimeError("no number")

    def __eq__(self, other: object) -> bool:
        raise RuntimeError("no comparison")

    __hash__ = object.__hash__


class Dice(float):
    """A number whose conversion raises."""

    def __float__(self) -> float:
        raise RuntimeError("rolled off the table")


ODD_FLOATS = (
    math.nan,
    math.inf,
    -math.inf,
    5e-324,
    -5e-324,
    sys.float_info.max,
    -sys.float_info.max,
    1e308,
    -1e308,
    1e300,
    1e155,
    -0.0,
)
FOREIGN: Sequence[Any] = (
    None,
    True,
    "19.5",
    "line\nbreak",
    b"\x01",
    [1.0],
    {"data": 1.0},
    10**400,
    -(10**5000),
    1 + 2j,
    fractions.Fraction(39, 2),
    fractions.Fraction(10**400, 3),
    numpy.float32(19.5),
    numpy.int8(20),
    numpy.array([1.0, 2.0]),
    numpy.array(19.5),
    numpy.zeros((20, 20)),
    object(),
    float,
    Mute(),
    Dice(3.0),
    Elements([("0", 19.5), ("wheel_left", -3.0), ("2", None), ("3", Dice(3.0))]),
    Elements(),
    Age(-0.5),
    BadDatum("no time stamp"),
    DriverStatus(2, "stalled"),
)

# --- configurations -------------------------------------------------------------------------------------------------

numbers = st.one_of(
    st.sampled_from((0.0, 1.0, 10.0, 20.0, 50.0, 80.0, 100.0)),
    st.floats(-200.0, 200.0),
    st.floats(allow_nan=False, allow_infinity=False),
)
seconds = st.one_of(st.sampled_from((0.0, 0.5, 1.0, 2.0, 5.0, 60.0)), st.floats(0.0, allow_infinity=False))


any_text = st.text(st.characters(), max_size=20)  # with halves of surrogate pairs, which YAML can spell


def of_parameter(parameter: Parameter) -> st.SearchStrategy[Any]:
    """Values that the parameter allows, the usual ones often."""
    if parameter.choices:
        return st.sampled_from(parameter.choices)
    if parameter.kind is bool:
        return st.booleans()
    if parameter.kind is list:
        return st.lists(numbers, max_size=2)
    if parameter.kind is int:
        return st.sampled_from((1, 2, 3, 50))  # window_samples
    if parameter.name == "field":
        return st.sampled_from(("data", "cells[0]", "cells[*]", 'effort["*"]', "header.stamp"))
    if parameter.kind is str:
        return st.one_of(st.sampled_from(("%", "degC", "K", "V", "Hz", "°C", "", "rad/s")), any_text)
    if parameter.name in ("flap_high", "flap_low"):
        return st.floats(0.0, 100.0)
    if parameter.name == "scale":
        return st.sampled_from((1.0, 100.0, -1.0, 1e-300, 1e300))
    if parameter.name == "window_min_s":
        return st.one_of(st.sampled_from((0.0, 1.0, 30.0)), st.floats(0.0, allow_infinity=False))
    if parameter.name == "window_s":
        return st.one_of(st.sampled_from((0.5, 3.0, 60.0)), st.floats(0.001, allow_infinity=False))
    return seconds if parameter.minimum == 0.0 and parameter.name != "hysteresis" else numbers


NAMES = ("a", "b")
CALLED = (*NAMES, "link")

conditions = st.builds(
    lambda signal, comparison, number: {"signal": signal, comparison: number},
    st.sampled_from(CALLED),
    st.sampled_from(("is", "is_not", "below", "above")),
    numbers,
) | st.builds(
    lambda signal, ends: {"signal": signal, "between": sorted(ends)},
    st.sampled_from(CALLED),
    st.tuples(numbers, numbers),
)
signal_trees = st.fixed_dictionaries(
    {},
    optional={
        **{parameter.name: of_parameter(parameter) for parameter in SIGNAL_PARAMETERS},
        **dict.fromkeys(CONDITIONS, conditions),
    },
)


def loaded(tree: Mapping[str, Any]) -> MonitorConfig | None:
    try:
        return load_config(tree)
    except ConfigError:
        return None


def loadable(names: Sequence[str], trees: Sequence[Mapping[str, Any]], robot: str) -> MonitorConfig | None:
    """Removes contradictory keys from each signal, so that most drawn configurations load."""
    signals: dict[str, dict[str, Any]] = {name: {} for name in names}
    for name, tree in zip(names, trees):
        for key, value in tree.items():
            before = signals[name]
            signals[name] = {**before, key: value, **({"forecast_s": 1.0} if value == "forecast" else {})}
            if loaded({"signals": signals}) is None:
                signals[name] = before
    return loaded({"signals": signals, "robot_name": robot})


configs = st.builds(
    loadable,
    st.lists(st.sampled_from(NAMES), min_size=1, max_size=2, unique=True),
    st.lists(signal_trees, min_size=2, max_size=2),
    st.one_of(st.sampled_from(("", "atlas")), any_text),
).filter(lambda config: config is not None)

# --- calls ----------------------------------------------------------------------------------------------------------

times = st.one_of(
    st.floats(-1.0, 10.0),  # steps ahead, and now and then back
    st.floats(0.0, 3.0),
    st.sampled_from((0.0, 0.1, 1.0, 1000.0, -1000.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324)),
)
values = st.one_of(
    numbers,
    st.sampled_from((0.0, 1.0)),  # what a link says
    st.floats(0.0, 100.0),
    st.floats(),
    st.sampled_from(ODD_FLOATS),
    st.sampled_from(FOREIGN),
    st.text(max_size=5),
    st.integers(),
)
calls: st.SearchStrategy[Call] = st.one_of(
    st.tuples(st.just("observe"), times, st.sampled_from((*CALLED, "unknown")), values),
    st.tuples(st.just("observe"), times, st.sampled_from(CALLED), st.floats(0.0, 100.0)),
    st.tuples(st.just("tick"), times),
    st.tuples(st.just("report"), times),
    st.tuples(st.just("reset")),
    st.tuples(st.just("configure"), configs),
)


class Player:
    """Performs the calls on a monitor and checks the invariants after each."""

    def __init__(self, config: MonitorConfig) -> None:
        self.monitor = Monitor(config)
        self.now_s = 0.0
        self.sent_s = 0.0
        self.announced: dict[str, Level] = {}

    def play(self, call: Call) -> list[Transition]:
        what, *arguments = call
        transitions: list[Transition] = []
        now_s = self.now_s
        if what in ("observe", "tick", "report"):
            step_s = arguments[0]
            # Steps are small numbers; anything else is an odd time itself.
            now_s = self.now_s + step_s if abs(step_s) <= 10.0 else step_s
            if math.isfinite(now_s):
                self.now_s = now_s if what != "report" else self.now_s
        self.sent_s = now_s
        if what == "observe":
            transitions = self.monitor.observe(Sample(arguments[1], arguments[2], now_s))
        elif what == "tick":
            transitions = self.monitor.tick(now_s)
        elif what == "report":
            assert self.monitor.report(now_s).statuses.keys() >= self.monitor.config.signals.keys()
        elif what == "reset":
            transitions = self.monitor.reset()
        elif what == "configure":
            transitions = self.monitor.configure(arguments[0])
        self.check(transitions)
        return transitions

    def check(self, transitions: Sequence[Transition]) -> None:
        for transition in transitions:
            assert transition.from_level is self.announced.get(transition.signal, Level.OK)
            assert (transition.from_level is transition.to_level) is transition.repeat
            assert transition.since_s <= transition.now_s
            assert transition.text.isprintable(), repr(transition.text)
            assert transition.status.level is transition.to_level
            self.announced[transition.signal] = transition.to_level
        report = self.monitor.report(self.now_s)
        for name in self.announced.keys() - report.statuses.keys():
            assert self.announced.pop(name) is Level.OK, f"{name} was removed, and its alert did not end"
        assert report.overall is Level.worst(status.level for status in report.statuses.values())
        for name, status in report.statuses.items():
            if status.values["state"] in ("waiting", "unreachable"):
                assert status.level in (Level.STALE, Level.ERROR)
            elif status.values["flapping"] == "false":
                assert status.level is self.announced.get(name, Level.OK), (name, status)
            assert all(isinstance(value, str) for value in status.values.values())
            assert status.message.isprintable()
            config = self.monitor.config.signals.get(name)
            if config is not None:
                assert int(status.values["window_samples"]) <= config.window_samples


def played(config: MonitorConfig, sequence: Sequence[Call]) -> list[Transition]:
    player = Player(config)
    return [transition for call in sequence for transition in player.play(call)]


def comparable(transitions: Sequence[Transition]) -> list[tuple[Any, ...]]:
    """NaN is equal to nothing; its text is."""
    return [
        (each.signal, each.from_level, each.to_level, repr_or_type(each.value), each.bound, each.text, each.fingerprint)
        for each in transitions
    ]


def repr_or_type(value: object) -> str:
    if isinstance(value, Mute):
        return type(value).__name__
    return hex(value) if isinstance(value, int) else repr(value)  # Python limits the decimal digits of an int


def whole_text(transitions: Sequence[Transition]) -> str:
    """Every field, to the last bit."""
    return repr([dataclasses.replace(each, value=repr_or_type(each.value)) for each in transitions])


@pytest.mark.newest_python
@settings(max_examples=examples(100))
@given(configs, st.lists(calls, max_size=40))
def test_no_call_raises_and_transitions_chain_up_to_the_report(config: MonitorConfig, sequence: list[Call]) -> None:
    played(config, sequence)


@settings(max_examples=examples(100))
@given(configs, st.lists(calls, max_size=40))
def test_two_monitors_fed_the_same_calls_give_equal_transitions(config: MonitorConfig, sequence: list[Call]) -> None:
    assert comparable(played(config, sequence)) == comparable(played(config, sequence))


# --- one long plain run ---------------------------------------------------------------------------------------------

FEATURES: Sequence[Mapping[str, Any]] = (
    {"warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0, "valid_min": 0.0, "valid_max": 100.0, "unit": "%"},
    {"warn_above": 80.0, "for_s": 1.0, "keep_firing_for_s": 2.0, "latch": True, "window_samples": 10, "repeat_s": 5.0},
    {"warn_below": 40.0, "warn_above": 60.0, "flap_detection": True, "stale_after_s": 1.0, "invalid_for_s": 0.5},
    *(
        {"statistic": statistic, "warn_above": 1.0, "window_s": 2.0, "window_samples": 20, "flap_detection": True}
        for statistic in STATISTICS
        if statistic != "forecast"
    ),
    {"statistic": "forecast", "forecast_s": 6.0, "warn_above": 1.0, "window_s": 2.0, "window_min_s": 0.0},
    {
        "warn_below": 30.0,
        "latch": True,
        "only_if": {"signal": "s0", "below": 50.0},
        "latch_release_if": {"signal": "s1", "is": 0.0},
    },
)


@pytest.mark.newest_python
@settings(max_examples=examples(100))
@given(configs, st.lists(calls, max_size=40))
def test_reports_between_the_calls_change_nothing(config: MonitorConfig, sequence: list[Call]) -> None:
    unread = Monitor(config)
    read = Player(config)
    for call in sequence:
        transitions = read.play(call)  # with a report after each call
        found: list[Transition] = transitions
        if call[0] == "observe":
            found = unread.observe(Sample(call[2], call[3], read.sent_s))
        elif call[0] == "tick":
            found = unread.tick(read.sent_s)
        elif call[0] == "reset":
            found = unread.reset()
        elif call[0] == "configure":
            found = unread.configure(call[1])
        assert whole_text(found) == whole_text(transitions)


@pytest.mark.newest_python
def test_many_random_calls_raise_nothing() -> None:
    calls = examples(30_000)
    chance = random.Random(fixed_seed())
    config = load_config({"signals": {f"s{number}": tree for number, tree in enumerate(FEATURES)}})
    names = [*config.signals, "unknown"]
    monitor = Monitor(config)
    observe, tick = monitor.observe, monitor.tick
    random_number, random_normal, choose = chance.random, chance.gauss, chance.choice
    now_s, seen = 0.0, 0
    for _ in range(calls):
        kind = random_number()
        now_s += random_number() * 0.2
        if kind < 0.9:
            seen += len(observe(Sample(choose(names), random_normal(50.0, 30.0), now_s)))
        elif kind < 0.95:
            seen += len(observe(Sample(choose(names), choose(ODD_FLOATS if kind < 0.93 else FOREIGN), now_s)))
        elif kind < 0.998:
            seen += len(tick(now_s))
        elif kind < 0.999:
            seen += len(observe(Sample("link", choose((0.0, 1.0, 1.0, 1.0)), now_s)))
        elif kind < 0.9995:
            monitor.report(now_s)
            seen += len(monitor.reset())
        elif kind < 0.9998:
            now_s = choose((now_s - 5.0, 0.0, 1e9, now_s + 100.0))
        else:
            tick(choose((math.nan, math.inf, -math.inf)))
    assert seen > calls / 100


# --- whole numbers, which may come as int or as float ---------------------------------------------------------------

plain_values = st.one_of(st.integers(0, 100), st.sampled_from((0, 1, 19, 20, 21, 22, 80, 81, 10**6)))
plain_calls: st.SearchStrategy[Call] = st.one_of(
    st.tuples(st.just("observe"), st.sampled_from((0.0, 0.5, 1.0)), st.sampled_from(("a", "b")), plain_values),
    st.tuples(st.just("observe"), st.sampled_from((0.0, 0.5, 1.0)), st.just("a"), st.sampled_from((15, 50))),
    st.tuples(st.just("observe"), st.just(0.5), st.just("link"), st.sampled_from((0, 1))),
    st.tuples(st.just("tick"), st.sampled_from((0.5, 1.0, 6.0, -3.0))),
    st.tuples(st.just("reset")),
    st.tuples(st.just("configure"), configs),
)
plain_trees = st.fixed_dictionaries(
    {"warn_below": st.just(20.0)},
    optional={
        "error_below": st.just(10.0),
        "warn_above": st.just(80.0),
        "hysteresis": st.just(2.0),
        "for_s": st.sampled_from((0.0, 1.0)),
        "keep_firing_for_s": st.sampled_from((0.0, 2.0)),
        "latch": st.booleans(),
        "flap_detection": st.booleans(),
        "flap_high": st.sampled_from((10.0, 50.0)),
        "flap_low": st.sampled_from((0.0, 5.0)),
        "repeat_s": st.sampled_from((0.0, 3.0)),
        "valid_max": st.just(1000.0),
        "window_samples": st.sampled_from((2, 5, 6000)),
        "window_s": st.sampled_from((2.0, 60.0)),
        "unit": st.sampled_from(("", "V")),
        "only_if": st.just({"signal": "b", "is": 1.0}),
        "statistic": st.sampled_from(STATISTICS[:-1]),
    },
).map(lambda tree: {**tree, "window_samples": 6000} if tree.get("statistic") == "count" else tree)
"""A count has no bound that its window cannot hold."""


@pytest.mark.newest_python
@settings(max_examples=examples(100))
@given(st.lists(plain_trees, min_size=2, max_size=2), st.lists(plain_calls, max_size=60))
def test_a_whole_number_is_judged_alike_as_int_and_as_float(
    trees: list[Mapping[str, Any]], sequence: list[Call]
) -> None:
    """Only ordinary floats take the fast path."""
    config = loadable(("a", "b"), trees, "atlas")
    assert config is not None
    players = {kind: Player(config) for kind in (int, float)}
    for call in sequence:
        seen = {}
        for kind, player in players.items():
            converted = (*call[:3], kind(call[3])) if call[0] == "observe" else call
            transitions = player.play(converted)
            report = player.monitor.report(player.now_s)
            seen[kind] = (
                [
                    dataclasses.replace(each, value=float(each.value) if isinstance(each.value, (int, float)) else None)
                    for each in transitions
                ],
                report,
                getattr(transitions, "notices", ()),
            )
        assert seen[int] == seen[float]
