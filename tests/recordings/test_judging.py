"""Judging recordings: transitions, shares of time, samples, statistics and differences; expected values by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Iterable, Mapping, NamedTuple, Sequence

import pytest
from harness.recorded import ROS1, ROS2, START_NS, Recorded, message_of, values, write_bag, write_mcap

from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.judge.attachments import SavedMonitor
from robot_health_monitor.core.judge.sample_summary import SampleSummary
from robot_health_monitor.core.nodes.outlets import Notice
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.model import Level, Status, Transition
from robot_health_monitor.recordings.judging import (
    Differences,
    Judge,
    JudgedEvent,
    JudgedSample,
    SignalSummary,
)
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings

START_S = START_NS / 1e9
BATTERY: Mapping[str, Any] = {"signals": {"battery": {"type": "std_msgs/Float32", "warn_below": 20.0}}}


class Result(NamedTuple):
    """What a judge found."""

    transitions: list[tuple[float, str, str, str]]
    """Seconds since the start, configuration, signal, level."""
    summaries: dict[tuple[str, str], SignalSummary]
    samples: dict[tuple[str, str], list[tuple[float, float]]]
    """Per configuration and signal: seconds since the start, and the value that the bounds apply to."""
    bad_times: list[float]


def judge(folder: Path, messages: Iterable[Recorded], *configurations: Mapping[str, Any], **options: Any) -> Result:
    """Judges messages by configurations, which are named a, b and so on."""
    return judge_bags([write_bag(folder / "test.bag", messages)], *configurations, **options)


def judge_bags(bags: Sequence[Any], *configurations: Mapping[str, Any], **options: Any) -> Result:
    """Judges recordings by configurations, which are named a, b and so on."""
    result = Result([], {}, {}, [])

    def on_event(judged: JudgedEvent) -> None:
        event = judged.event
        if isinstance(event, Transition):
            at_s = round(judged.wall_s - START_S, 3)
            result.transitions.append((at_s, judged.file, event.signal, event.to_level.name))

    def on_sample(file: str, config: Any, sample: JudgedSample) -> None:
        shown = sample.value if config.statistic == "forecast" else sample.judged
        time_s = round(sample.wall_s - START_S, 3)
        result.samples.setdefault((file, config.name), []).append((time_s, math.nan if shown is None else shown))
        if sample.value is None:
            result.bad_times.append(time_s)

    with Recordings(bags) as recordings:
        found = Judge(Player(recordings, **options), on_event, on_sample)
        for name, configuration in zip("abc", configurations):
            found.add(name, configuration)
        found.run()
        for summary in found.summaries:
            result.summaries[summary.file, summary.config.name] = summary
    return result


def test_a_battery_that_falls_and_recovers(tmp_path: Path) -> None:
    messages = values("/battery", [50.0] * 10 + [10.0] * 10 + [50.0] * 21)
    result = judge(tmp_path, messages, BATTERY)
    assert result.transitions == [(10.0, "a", "battery", "WARN"), (20.0, "a", "battery", "OK")]
    summary = result.summaries["a", "battery"]
    assert (summary.recorded, summary.topic, summary.alerts) == (True, "/battery", 1)
    assert summary.shares == pytest.approx({Level.OK: 0.75, Level.WARN: 0.25, Level.ERROR: 0.0, Level.STALE: 0.0})
    samples = summary.samples
    assert (samples.good, samples.least, samples.most, summary.longest_gap_s) == (41, 10.0, 50.0, 1.0)
    assert samples.mean == pytest.approx((31 * 50.0 + 10 * 10.0) / 41)


def test_silence_is_stale_but_the_end_of_the_recording_is_not(tmp_path: Path) -> None:
    messages = [*values("/battery", [50.0] * 3), *values("/battery", [50.0], start_s=20.0)]
    result = judge(tmp_path, messages, BATTERY)
    # No sample for more than 5 s after 2.0: noticed by a tick, which runs every second.
    assert [level for _, _, _, level in result.transitions] == ["STALE", "OK"]
    stale_s, ok_s = (transition[0] for transition in result.transitions)
    assert 7.0 < stale_s <= 8.0
    assert ok_s == 20.0


def test_time_before_the_first_sample_is_unknown(tmp_path: Path) -> None:
    messages = [Recorded(0.0, "/other", 0.0), *values("/battery", [10.0, 10.0, 50.0, 50.0, 50.0], start_s=6.0)]
    summary = judge(tmp_path, messages, BATTERY).summaries["a", "battery"]
    assert summary.shares == pytest.approx({Level.OK: 0.2, Level.WARN: 0.2, Level.ERROR: 0.0, Level.STALE: 0.0})
    assert summary.unknown == pytest.approx(0.6)


def test_a_topic_that_is_not_recorded_raises_no_alert(tmp_path: Path) -> None:
    both = {"signals": {**BATTERY["signals"], "gps": {"type": "std_msgs/Float32", "warn_below": 1.0}}}
    result = judge(tmp_path, values("/battery", [50.0] * 60), both)
    assert result.transitions == []
    summary = result.summaries["a", "gps"]
    assert (summary.recorded, summary.alerts, summary.shares, summary.samples.good) == (False, 0, {}, 0)
    assert summary.unknown == 1.0


def test_a_topic_that_is_recorded_without_messages_in_the_range_is_stale(tmp_path: Path) -> None:
    messages = [*values("/battery", [50.0]), *values("/other", [0.0] * 60, start_s=1.0)]
    result = judge(tmp_path, messages, BATTERY, from_s=5.0)
    # 10 s of startup grace from the beginning of the range, give or take a tick.
    assert [(name, level) for _, _, name, level in result.transitions] == [("battery", "STALE")]
    assert 15.0 <= result.transitions[0][0] <= 17.0


def test_two_configurations_are_judged_in_one_pass(tmp_path: Path) -> None:
    strict = {"signals": {"battery": {"type": "std_msgs/Float32", "warn_below": 40.0}}}
    result = judge(tmp_path, values("/battery", [50.0, 30.0, 10.0]), BATTERY, strict)
    assert result.transitions == [(1.0, "b", "battery", "WARN"), (2.0, "a", "battery", "WARN")]
    assert [result.summaries[file, "battery"].samples.good for file in "ab"] == [3, 3]


def test_samples_are_those_of_the_signal_in_its_unit(tmp_path: Path) -> None:
    config = {"signals": {"battery": {"scale": 100.0, "valid_max": 100.0, "type": "std_msgs/Float32"}}}
    result = judge(tmp_path, values("/battery", [0.5, 2.0, 0.25]), config)
    assert result.samples["a", "battery"][0] == (0.0, 50.0)
    assert result.samples["a", "battery"][2] == (2.0, 25.0)
    assert result.bad_times == [1.0]


def test_samples_are_those_of_the_statistic_that_is_judged(tmp_path: Path) -> None:
    config = {"signals": {"battery": {"statistic": "mean", "window_s": 2.0, "window_min_s": 1.0}}}
    result = judge(tmp_path, values("/battery", [2.0, 4.0, 6.0, 8.0]), config)
    shown = [pair for pair in result.samples["a", "battery"] if pair[1] == pair[1]]
    # The mean of the last 2 s, bounds included; undefined until samples have come for 1 s.
    assert shown == [(1.0, 3.0), (2.0, 4.0), (3.0, 6.0)]
    assert result.summaries["a", "battery"].samples.most == 6.0  # the mean of 4 to 8


def test_a_forecast_is_shown_by_the_values_that_it_follows_from(tmp_path: Path) -> None:
    """60, and half less per second: at 50 s it is 35, and 15 in 40 s."""
    signals = {"soon": {"topic": "battery", "type": "std_msgs/Float32", "warn_below": 5.0}}
    signals["soon"].update(statistic="forecast", window_s=20.0, forecast_s=40.0, stale_after_s=5.0)
    messages = values("/battery", [60.0 - 0.5 * second for second in range(51)])
    found = judge(tmp_path, messages, {"signals": signals})
    summary = found.summaries["a", "soon"]
    assert [value for _, value in found.samples["a", "soon"]] == [60.0 - 0.5 * second for second in range(51)]
    assert summary.samples.least == pytest.approx(15.0)


def test_arrivals_are_counted_where_no_field_is_read(tmp_path: Path) -> None:
    config = {"signals": {"battery": {"field": "", "type": "std_msgs/Float32"}}}
    samples = judge(tmp_path, values("/battery", [7.0, 8.0, 9.0]), config).summaries["a", "battery"].samples
    assert (samples.good, samples.least, samples.most) == (3, 1.0, 1.0)


def test_every_sample_is_passed_on(tmp_path: Path) -> None:
    result = judge(tmp_path, values("/battery", [50.0] * 10_000, period_s=0.01), BATTERY)
    assert result.summaries["a", "battery"].samples.good == 10_000
    assert len(result.samples["a", "battery"]) == 10_000


def test_topics_are_those_of_the_namespace(tmp_path: Path) -> None:
    result = judge(tmp_path, values("/robot1/battery", [10.0]), BATTERY, namespace="robot1")
    assert result.summaries["a", "battery"].topic == "/robot1/battery"
    assert result.transitions == [(0.0, "a", "battery", "WARN")]


def test_a_signal_with_another_type_than_the_recorded_one_is_not_judged(tmp_path: Path) -> None:
    config = {"signals": {"battery": {"type": "std_msgs/Float64", "warn_below": 20.0}}}
    result = judge(tmp_path, values("/battery", [10.0] * 20), config)
    summary = result.summaries["a", "battery"]
    assert (result.transitions, summary.recorded) == ([], False)
    assert summary.missing == "/battery is recorded as std_msgs/Float32, configured as std_msgs/Float64"


def test_a_signal_whose_topic_has_no_messages_has_a_reason(tmp_path: Path) -> None:
    config = {"signals": {"battery": {"stale_after_s": 0.0, "field": "data"}}}
    messages = [*values("/battery", [10.0]), *values("/other", [1.0] * 9, start_s=1.0)]
    result = judge(tmp_path, messages, config, from_s=5.0)
    summary = result.summaries["a", "battery"]
    assert (summary.recorded, summary.missing) == (True, "/battery has no samples")


def test_the_time_between_two_recordings_is_no_silence(tmp_path: Path) -> None:
    # a night lies between them, and the WARN of the first is still there in the second
    first = write_bag(tmp_path / "first.bag", values("/battery", [50.0] * 5 + [10.0] * 5))
    second = write_bag(tmp_path / "second.bag", values("/battery", [10.0] * 5 + [50.0] * 3, start_s=40_000.0))
    result = judge_bags([first, second], BATTERY)
    assert result.transitions == [(5.0, "a", "battery", "WARN"), (40_005.0, "a", "battery", "OK")]
    # 9 s and 7 s are recorded; WARN lasts 4 s of the first and 5 s of the second.
    summary = result.summaries["a", "battery"]
    assert (summary.shares[Level.OK], summary.shares[Level.WARN]) == pytest.approx((7 / 16, 9 / 16))
    assert summary.longest_gap_s == 1.0


def test_time_before_the_first_sample_is_unknown_in_a_second_recording_either(tmp_path: Path) -> None:
    first = write_bag(tmp_path / "first.bag", values("/other", [0.0] * 5))
    second = write_bag(tmp_path / "second.bag", values("/battery", [50.0] * 4 + [10.0] * 5, start_s=40_000.0))
    third = write_bag(tmp_path / "third.bag", values("/battery", [10.0] * 5, start_s=90_000.0))
    summary = judge_bags([first, second, third], BATTERY).summaries["a", "battery"]
    # 4 s, 8 s and 4 s are recorded, the first 4 s of which without a sample
    assert (summary.shares[Level.OK], summary.shares[Level.WARN]) == pytest.approx((4 / 16, 8 / 16))
    assert summary.unknown == pytest.approx(4 / 16)


def test_silence_within_the_second_recording_counts_from_its_start(tmp_path: Path) -> None:
    # other topics begin at 1,000 s, the battery never comes back: 2 s of silence before the gap, 5 s are the limit
    first = [*values("/battery", [50.0] * 5), *values("/other", [0.0] * 7)]
    second = values("/other", [0.0] * 20, start_s=1_000.0)
    bags = [write_bag(tmp_path / "first.bag", first), write_bag(tmp_path / "second.bag", second)]
    (stale,) = judge_bags(bags, BATTERY).transitions
    assert stale[2:] == ("battery", "STALE")
    assert stale[0] == 1_004.0  # the first tick after 1,003 s, when the silence has lasted 5 s


def test_recordings_that_overlap_have_no_gap(tmp_path: Path) -> None:
    long = write_bag(tmp_path / "long.bag", values("/other", [0.0] * 60))
    early = write_bag(tmp_path / "early.bag", values("/battery", [50.0] * 5))
    late = write_bag(tmp_path / "late.bag", values("/battery", [50.0] * 5, start_s=30.0))
    levels = [level for _, _, _, level in judge_bags([long, early, late], BATTERY).transitions]
    assert levels == ["STALE", "OK", "STALE"]


def noted(*samples: tuple[float, float | None, bool]) -> SignalSummary:
    """Returns the summary of samples: time in s, value and whether it is good."""
    found = SignalSummary("a", read_signal("battery", {}), "/battery", True, "")
    for sample in samples:
        found.note_sample(*sample)
    found.finish(0.0, 100.0)
    return found


def statistics(*values: float | None) -> SampleSummary:
    """Returns the statistics of values that came every second; None is bad."""
    return noted(*((float(second), value, value is not None) for second, value in enumerate(values))).samples


def test_range_and_mean_are_those_of_all_good_samples() -> None:
    found = statistics(1.0, 2.0, 9.0, 4.0, None, 4.0)
    assert (found.good, found.bad, found.least, found.most, found.mean) == (5, 1, 1.0, 9.0, 4.0)


def test_a_statistic_that_is_not_defined_yet_is_a_good_sample_without_a_value() -> None:
    found = noted((0.0, None, True)).samples
    assert (found.good, found.bad, found.least, found.mean) == (1, 0, None, None)


def test_without_samples_nothing_is_known() -> None:
    found = noted()
    assert found.samples == (0.0, None, None, None, None, 0, 0, Level.OK)
    assert (found.longest_gap_s, found.missing) == (None, "/battery has no samples")


def test_the_longest_gap_is_that_between_two_samples_in_a_row() -> None:
    assert noted(*((time_s, 0.0, True) for time_s in (0.0, 1.0, 31.0, 33.0, 34.0))).longest_gap_s == 30.0


def test_one_sample_has_no_gap() -> None:
    assert noted((5.0, 1.0, True)).longest_gap_s is None


def test_the_mean_of_the_largest_doubles_is_a_double() -> None:
    assert statistics(*[1.7e308] * 13).mean == pytest.approx(1.7e308)


def announced(wall_s: float, file: str, level: Level, signal: str = "battery", text: str = "") -> JudgedEvent:
    """Returns a transition from OK, or to OK from WARN."""
    before = Level.WARN if level is Level.OK else Level.OK
    status = Status(signal, level, text, "robot", {})
    transition = Transition(
        signal, before, level, 1.0, "last", None, wall_s, 0.0, "robot", "0123456789abcdef", text, status
    )
    return JudgedEvent(wall_s, file, transition)


def differences(*events: JudgedEvent) -> list[tuple[float, str]]:
    """Returns time and configuration of the transitions in which a.yaml and b.yaml differ."""
    found: list[tuple[float, str]] = []
    compared = Differences(lambda event: found.append((event.wall_s, event.file)))
    for event in events:
        compared.add(event)
    compared.flush()
    return found


def test_the_same_transition_of_both_is_no_difference() -> None:
    assert differences(announced(1.0, "a.yaml", Level.WARN), announced(1.0, "b.yaml", Level.WARN)) == []


def test_a_transition_of_one_is_a_difference() -> None:
    assert differences(announced(1.0, "a.yaml", Level.WARN)) == [(1.0, "a.yaml")]


def test_the_same_transition_at_another_time_is_two_differences() -> None:
    found = differences(announced(1.0, "b.yaml", Level.WARN), announced(2.0, "a.yaml", Level.WARN))
    assert found == [(1.0, "b.yaml"), (2.0, "a.yaml")]


def test_another_level_and_another_signal_are_differences() -> None:
    assert len(differences(announced(1.0, "a.yaml", Level.WARN), announced(1.0, "b.yaml", Level.ERROR))) == 2
    assert len(differences(announced(1.0, "a.yaml", Level.WARN), announced(1.0, "b.yaml", Level.WARN, "other"))) == 2


def test_another_text_is_no_difference() -> None:
    first = announced(1.0, "a.yaml", Level.WARN, text="5 % is below 20 %")
    second = announced(1.0, "b.yaml", Level.WARN, text="5 % is below 25 %")
    assert differences(first, second) == []


def test_the_order_of_several_signals_at_one_instant_does_not_matter() -> None:
    events = [
        announced(1.0, "a.yaml", Level.WARN, "one"),
        announced(1.0, "a.yaml", Level.WARN, "two"),
        announced(1.0, "b.yaml", Level.WARN, "two"),
        announced(1.0, "b.yaml", Level.WARN, "one"),
    ]
    assert differences(*events) == []


def test_what_one_announced_twice_and_the_other_once_is_one_difference() -> None:
    once, twice = announced(1.0, "a.yaml", Level.WARN), announced(1.0, "b.yaml", Level.WARN)
    assert differences(once, twice, twice) == [(1.0, "b.yaml")]


def test_notices_are_not_compared() -> None:
    assert differences(JudgedEvent(1.0, "a.yaml", Notice(1.0, Severity.INFO, "time went back"))) == []


def diagnostics(time_s: float, **levels: int) -> Recorded:
    types = ROS1.types
    statuses = [
        types["diagnostic_msgs/msg/DiagnosticStatus"](level=level, name=name, message="m", hardware_id="", values=[])
        for name, level in levels.items()
    ]
    header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](0, 0), "")
    return Recorded(time_s, "/diagnostics", types["diagnostic_msgs/msg/DiagnosticArray"](header, statuses))


def test_each_element_is_a_signal_of_its_own(tmp_path: Path) -> None:
    drivers = {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]'}
    messages = [diagnostics(float(n), lidar=2 if 5 <= n < 10 else 0, motor=0) for n in range(21)]
    result = judge(tmp_path, messages, {"signals": {"drivers": drivers, "z": {"topic": "/z"}}})
    assert result.transitions == [(5.0, "a", "drivers[lidar]", "ERROR"), (10.0, "a", "drivers[lidar]", "OK")]
    assert [name for _, name in result.summaries] == ["drivers", "drivers[lidar]", "drivers[motor]", "z"]
    lidar, motor = (result.summaries["a", f"drivers[{name}]"] for name in ("lidar", "motor"))
    assert (lidar.alerts, motor.alerts) == (1, 0)
    assert lidar.shares[Level.ERROR] == pytest.approx(0.25)
    assert (lidar.samples.good, lidar.samples.bad, lidar.samples.most) == (21, 0, 2.0)
    assert result.samples["a", "drivers[lidar]"][4:6] == [(4.0, 0.0), (5.0, 2.0)]
    assert (result.summaries["a", "drivers"].samples.most, result.summaries["a", "drivers"].missing) == (2.0, "")


def test_elements_beyond_the_limit_are_not_measured(tmp_path: Path) -> None:
    drivers = {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"].level'}
    signals = {"drivers": {**drivers, "max_elements": 1, "statistic": "mean", "window_s": 4.0}}
    result = judge(tmp_path, [diagnostics(float(n), lidar=n % 2, motor=0) for n in range(9)], {"signals": signals})
    assert [name for _, name in result.summaries] == ["drivers", "drivers[lidar]"]
    assert result.summaries["a", "drivers[lidar]"].samples.most == pytest.approx(0.6)


def state_of_a_low_battery() -> dict[str, Any]:
    live = Monitor(load_config(dict(BATTERY)), "r")
    live.set_link(False, "cable", 100.0)
    live.set_link(True, "", 101.0)
    live.observe(Sample("battery", 10.0, 101.0))
    return {name: live.snapshot(name, 101.0, START_S) for name in live.signals()}


@pytest.mark.parametrize(
    ("states", "levels"),
    [(state_of_a_low_battery(), ["OK"]), ({}, ["WARN", "OK"]), ({"battery": {"announced": 1}}, ["WARN", "OK"])],
    ids=["known", "unknown", "odd"],
)
def test_a_recording_continues_from_the_states_at_its_beginning(
    tmp_path: Path, states: dict[str, Any], levels: list[str]
) -> None:
    """The battery was WARN: that is not announced again, and counts. The link is not part of a recording."""
    found: list[str] = []

    def note(judged: JudgedEvent) -> None:
        if isinstance(judged.event, Transition):
            found.append(judged.event.to_level.name)

    bag = write_bag(tmp_path / "test.bag", values("/battery", [10.0] * 5 + [50.0] * 4))
    with Recordings([bag]) as recordings:
        judge = Judge(Player(recordings), note)
        judge.add("", BATTERY, SavedMonitor("r", START_S, states))
        judge.run()
    assert found == levels
    assert [each.config.name for each in judge.summaries] == ["battery"]
    assert judge.summaries[0].shares[Level.WARN] == pytest.approx(5 / 8)


def test_an_alert_that_changes_its_level_is_counted_once(tmp_path: Path) -> None:
    levels = {"signals": {"battery": {"type": "std_msgs/Float32", "warn_below": 20.0, "error_below": 10.0}}}
    falls = [50.0, 15.0, 5.0, 15.0, 50.0]
    result = judge(tmp_path, values("/battery", [*falls, *falls]), levels)
    assert [level for _, _, _, level in result.transitions] == ["WARN", "ERROR", "WARN", "OK"] * 2
    assert result.summaries["a", "battery"].alerts == 2


@pytest.mark.parametrize("is_ros1", [True, False])
def test_goals_of_a_recorded_action_are_judged(tmp_path: Path, is_ros1: bool) -> None:
    """The first goal had been aborted before the recording began; of the others, one of two is."""

    def states(time_s: float, *codes: int) -> Recorded:
        if is_ros1:
            ended = [{"goal_id": {"id": str(at)}, "status": code} for at, code in enumerate(codes)]
            name, store, topic = "actionlib_msgs/msg/GoalStatusArray", ROS1, "/drive/status"
        else:
            ended = [{"goal_info": {"goal_id": {"uuid": [at] * 16}}, "status": code} for at, code in enumerate(codes)]
            name, store, topic = "action_msgs/msg/GoalStatusArray", ROS2, "/drive/_action/status"
        return Recorded(time_s, topic, message_of(store, name, {"status_list": ended}))

    aborted, succeeded, active = (4, 3, 1) if is_ros1 else (6, 4, 2)
    messages = [
        states(0.0, aborted, active),
        states(10.0, aborted, succeeded),
        states(20.0, aborted, succeeded, active),
        states(30.0, aborted, succeeded, aborted),
    ]
    write, file = (write_bag, "goals.bag") if is_ros1 else (write_mcap, "goals.mcap")
    signal = {"action": "drive", "statistic": "mean", "window_min_s": 0.0, "warn_above": 0.4}
    result = judge_bags([write(tmp_path / file, messages)], {"signals": {"drives": signal}})
    assert result.transitions == [(30.0, "a", "drives", "WARN")]
    assert result.samples["a", "drives"] == [(10.0, 0.0), (30.0, 0.5)]


def test_a_topic_that_falls_silent_has_its_time_and_its_effects(tmp_path: Path) -> None:
    signals = {name: {"topic": "/scan", "type": "std_msgs/Float32"} for name in ("low", "high")}
    signals["wheel"] = {"type": "std_msgs/Float32", "warn_below": 1.0, "depends_on": ["/scan"]}
    scan = [*values("/scan", [50.0] * 21), *values("/scan", [50.0] * 10, start_s=40.0)]
    wheel = values("/wheel", [5.0] * 28 + [0.0] * 7 + [5.0] * 15)
    events: list[JudgedEvent] = []
    with Recordings([write_bag(tmp_path / "test.bag", sorted([*scan, *wheel]))]) as recordings:
        judge = Judge(Player(recordings), events.append)
        judge.add("a", {"signals": signals})
        judge.run()
    begin, end = events
    assert (begin.wall_s - START_S, begin.effects) == (26.0, ["low", "high", "wheel"])
    assert isinstance(begin.event, Transition)
    assert (begin.event.signal, end.effects) == ("/scan", ())
    *others, source = judge.summaries
    assert [(each.config.name, each.cause, each.alerts) for each in others] == [
        ("low", "/scan", 0), ("high", "/scan", 0), ("wheel", "/scan", 0),
    ]  # fmt: skip
    assert (source.config.name, source.alerts, source.missing) == ("/scan", 1, "")
    # 49 s, of which it was silent from 26 to 40 s.
    assert source.shares[Level.STALE] == pytest.approx(14.0 / 49.0)
    assert source.shares[Level.OK] == pytest.approx(35.0 / 49.0)


def test_a_signal_with_an_alert_of_its_own_is_no_effect(tmp_path: Path) -> None:
    signals = {name: {"topic": "/scan", "type": "std_msgs/Float32"} for name in ("low", "high")}
    signals["low"] = {**signals["low"], "warn_below": 10.0}  # type: ignore[dict-item]
    scan = [*values("/scan", [5.0] * 3 + [50.0] * 18), *values("/scan", [50.0] * 10, start_s=40.0)]
    summaries = judge(tmp_path, scan, {"signals": signals}).summaries
    assert {name: each.cause for (_, name), each in summaries.items()} == {"low": "", "high": "/scan", "/scan": ""}
