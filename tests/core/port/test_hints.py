"""Why a signal has no samples: looked up before it is needed, valid until the next sample, in every text."""

from __future__ import annotations

import json
from typing import Any

import pytest
from harness.stage import FLOAT32, Stage, status, values_of

from robot_health_monitor.core import Changes, Level, Monitor, Sample, load_config
from robot_health_monitor.core.nodes.outlets import json_line
from robot_health_monitor.core.port.hints import Answer, Hints, explain, similar_topic
from robot_health_monitor.core.port.local import LocalMiddleware
from robot_health_monitor.core.port.middleware import Severity

HINT = "no publisher on /battery"


def monitor(**settings: Any) -> Monitor:
    watched = Monitor(load_config({"signals": {"battery": settings}}), "atlas")
    watched.expect_sources()
    watched.tick(0.0)
    return watched


def silent(watched: Monitor, now_s: float) -> list[str]:
    return [config.name for config in watched.without_samples(now_s)]


def test_a_signal_lacks_samples_when_half_of_the_grace_or_of_the_limit_has_passed() -> None:
    watched = monitor(startup_grace_s=10.0, stale_after_s=4.0)
    assert silent(watched, 4.9) == []
    assert silent(watched, 5.0) == ["battery"]
    watched.observe(Sample("battery", 50.0, 5.0))
    assert silent(watched, 6.9) == []
    assert silent(watched, 7.0) == ["battery"]


def test_where_staleness_is_disabled_only_the_first_sample_is_missed() -> None:
    watched = monitor(stale_after_s=0.0, startup_grace_s=10.0)
    assert silent(watched, 5.0) == ["battery"]
    watched.observe(Sample("battery", 50.0, 6.0))
    assert silent(watched, 1e6) == []


def test_a_signal_lacks_no_samples_while_its_topic_brings_those_of_others() -> None:
    """The topic has a publisher: only the element is gone."""
    field = {"topic": "/battery", "field": "cell_voltage[*]", "stale_after_s": 4.0}
    watched = Monitor(load_config({"signals": {"cells": field, "load": {}}}))
    watched.expect_sources()
    watched.tick(0.0)
    watched.observe(Sample("cells[0]", 3.7, 0.0))
    watched.observe(Sample("cells[1]", 3.7, 0.0))
    watched.observe(Sample("cells[1]", 3.7, 8.0))
    watched.tick(9.0)
    assert silent(watched, 9.0) == ["load"]  # of another topic
    assert {"cells[0]", "cells[1]"} <= set(silent(watched, 10.0))


def test_while_the_link_is_down_no_signal_lacks_samples() -> None:
    watched = monitor()
    watched.note_hint("battery", HINT)
    watched.set_link(False, "connection refused", 1.0)
    assert silent(watched, 8.0) == []
    assert watched.status("battery", 8.0).hint == ""  # type: ignore[union-attr]
    watched.set_link(True, "", 9.0)
    assert silent(watched, 100.0) == ["battery"]


def test_status_and_transition_carry_the_hint_beside_their_texts() -> None:
    watched = monitor()
    watched.note_hint("battery", HINT)
    waiting = watched.status("battery", 6.0)
    assert waiting is not None
    assert (waiting.message, waiting.hint) == ("waiting for the first sample", HINT)
    (stale,) = watched.tick(11.0)
    assert stale.to_level is Level.STALE
    assert stale.hint == stale.status.hint == HINT
    assert HINT not in stale.text and HINT not in stale.status.message and HINT not in stale.status.values.values()
    assert json.loads(json_line(stale))["hint"] == HINT


def test_the_hint_does_not_make_two_transitions_different() -> None:
    with_hint, without = monitor(), monitor()
    with_hint.note_hint("battery", HINT)
    assert with_hint.tick(11.0) == without.tick(11.0)


@pytest.mark.parametrize("quick", [False, True])
def test_the_next_sample_ends_the_hint(quick: bool) -> None:
    watched = monitor(warn_below=20.0)
    if not quick:
        watched.tick(11.0)
    else:  # a sample that changes nothing
        watched.observe(Sample("battery", 50.0, 0.0))
        watched.observe(Sample("battery", 50.0, 1.0))
    watched.note_hint("battery", HINT)
    changes = watched.observe(Sample("battery", 50.0, 12.0 if not quick else 5.0))
    assert [change.hint for change in changes] == ([] if quick else [""])
    changes = watched.tick(100.0)
    assert [(change.to_level, change.hint) for change in changes] == [(Level.STALE, "")]


def test_a_signal_that_stays_error_while_it_is_silent_has_the_hint_in_its_status() -> None:
    watched = monitor(error_below=10.0)
    watched.observe(Sample("battery", 5.0, 0.0))
    watched.tick(8.0)
    watched.note_hint("battery", HINT)
    found = watched.status("battery", 8.0)
    assert found is not None
    assert (found.level, found.hint) == (Level.ERROR, HINT)


def test_a_repetition_carries_the_hint_that_holds_then() -> None:
    watched = monitor(repeat_s=5.0)
    watched.note_hint("battery", HINT)
    watched.tick(11.0)
    watched.note_hint("battery", "")
    (repeated,) = watched.tick(16.0)
    assert (repeated.repeat, repeated.hint) == (True, "")


def test_a_signal_that_is_no_longer_watched_ends_without_a_hint() -> None:
    watched = monitor()
    watched.note_hint("battery", HINT)
    watched.tick(11.0)
    (ended,) = watched.end()
    assert (ended.to_level, ended.hint, ended.status.hint) == (Level.OK, "", "")


def test_an_unknown_signal_takes_no_hint() -> None:
    watched = monitor()
    watched.note_hint("nothing", HINT)
    assert isinstance(watched.tick(1.0), Changes)


# --- the node ---

CONFIG: dict[str, Any] = {
    "robot_name": "robot1",
    "signals": {"battery": {"type": FLOAT32}, "gps": {"topic": "fix", "type": "sensor_msgs/NavSatFix", "field": ""}},
}


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_the_log_the_alert_and_diagnostics_show_the_hint_in_brackets(stage: Stage) -> None:
    alerts, arrays = stage.listen("alerts"), stage.listen("/diagnostics")
    stage.bus.node("driver").advertise("/battery_state", "sensor_msgs/BatteryState")
    stage.alert_system(CONFIG)
    stage.bus.run_until(6.0)
    waiting = status(arrays[-1], "alert_system: battery")
    assert waiting["message"] == "waiting for the first sample [no publisher on /battery; /battery_state exists]"
    stage.bus.run_until(12.0)
    (line,) = (text for text in stage.log(Severity.WARN) if " STALE: " in text)
    assert line.startswith(
        "/battery STALE: no message since the start 11 s ago (limit 10 s), nor on 1 other topic: /fix "
    )
    assert line.endswith(" [no publisher on /battery; /battery_state exists]")
    assert status(arrays[-1], "alert_system: gps")["message"].endswith(" [no publisher on /fix]")
    assert line in [alert["message"] for alert in alerts]
    assert status(arrays[-1], "alert_system: battery")["message"].endswith(
        " [no publisher on /battery; /battery_state exists]"
    )
    stage.publish("battery", 50.0)
    stage.bus.run_until(13.0)
    assert "[" not in status(arrays[-1], "alert_system: battery")["message"]
    assert values_of(status(arrays[-1], "alert_system: battery"))["state"] == "inactive"


def test_the_middleware_is_asked_from_half_of_the_grace_on_by_ticks_only(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[float, str, str]] = []

    def why_silent(self: LocalMiddleware, topic: str, type_name: str) -> str | None:
        asked.append((self.now_s(), topic, type_name))
        return None

    monkeypatch.setattr(LocalMiddleware, "why_silent", why_silent)
    stage.alert_system(CONFIG)
    for tenths in range(200):
        stage.bus.run_until(tenths / 10.0)
        stage.publish("battery", 50.0)
    times_s = {topic: [now_s for now_s, of_topic, _ in asked if of_topic == topic] for topic in ("battery", "fix")}
    assert times_s["battery"] == []
    assert 5.0 <= times_s["fix"][0] <= 7.0
    assert len(times_s["fix"]) <= 16
    assert {type_name for _, _, type_name in asked} == {"sensor_msgs/NavSatFix"}


def test_a_middleware_that_fails_delays_no_tick_and_hides_no_alert(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    def why_silent(self: LocalMiddleware, topic: str, type_name: str) -> str | None:
        raise RuntimeError("the graph is broken")

    monkeypatch.setattr(LocalMiddleware, "why_silent", why_silent)
    stage.alert_system(CONFIG)
    stage.bus.run_until(12.0)
    stale = [text for text in stage.log(Severity.WARN) if " STALE: " in text]
    assert len(stale) == 1 and not any("[" in text for text in stale)


FLOAT32 = "std_msgs/Float32"
BATTERY = "sensor_msgs/BatteryState"


class Lookup:
    """Answers later, with what `answer` sets."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []
        self.waiting: list[Answer] = []
        self.now_s = 1000.0

    def __call__(self, topic: str, type_name: str, answer: Answer) -> None:
        self.asked.append((topic, type_name))
        self.waiting.append(answer)

    def answer(self, text: str | None) -> None:
        self.waiting.pop(0)(text)

    def clock(self) -> float:
        return self.now_s


def test_the_answer_of_a_lookup_that_takes_long_is_returned_later() -> None:
    lookup = Lookup()
    hints = Hints(lookup, lookup.clock)
    assert hints.get("/a", FLOAT32) is None
    lookup.answer("no publisher on /a")
    assert hints.get("/a", FLOAT32) == "no publisher on /a"
    assert lookup.asked == [("/a", FLOAT32)]


def test_a_topic_is_looked_up_at_most_every_10_s_and_keeps_its_answer_meanwhile() -> None:
    lookup = Lookup()
    hints = Hints(lookup, lookup.clock)
    for tenths in range(300):
        lookup.now_s = 1000.0 + tenths / 10.0
        hints.get("/a", FLOAT32)
        if lookup.waiting and tenths % 100 == 50:
            lookup.answer(f"answer {len(lookup.asked)}")
        if tenths in (99, 149):
            assert hints.get("/a", FLOAT32) == "answer 1"
        if tenths == 151:
            assert hints.get("/a", FLOAT32) == "answer 2"
    assert len(lookup.asked) == 3
    hints.get("/b", FLOAT32)
    hints.get("/a", BATTERY)
    assert lookup.asked[3:] == [("/b", FLOAT32), ("/a", BATTERY)]


def test_the_answer_of_an_earlier_silence_is_forgotten() -> None:
    lookup = Lookup()
    hints = Hints(lookup, lookup.clock)
    hints.get("/a", FLOAT32)
    lookup.answer("no publisher on /a")
    lookup.now_s += 20.0
    assert hints.get("/a", FLOAT32) is None
    assert len(lookup.asked) == 2


def test_an_answer_may_come_after_the_next_question() -> None:
    lookup = Lookup()
    hints = Hints(lookup, lookup.clock)
    hints.get("/a", FLOAT32)
    lookup.now_s += 11.0
    hints.get("/a", FLOAT32)
    lookup.answer("no publisher on /a")
    assert hints.get("/a", FLOAT32) == "no publisher on /a"


def test_many_topics_are_looked_up_a_few_at_a_time() -> None:
    lookup = Lookup()
    hints = Hints(lookup, lookup.clock)
    for tick in range(1, 11):
        lookup.now_s += 1.0
        for number in range(100):
            hints.get(f"/topic_{number}", FLOAT32)
        assert len(lookup.asked) == min(20 * tick, 100)
    assert len(set(lookup.asked)) == 100


def test_the_number_of_topics_that_are_remembered_is_bounded() -> None:
    lookup = Lookup()
    hints = Hints(lookup, lookup.clock)
    for number in range(3000):
        hints.get(f"/topic_{number}", FLOAT32)
    assert len(hints._known) <= 1000


@pytest.mark.parametrize(
    ("types", "text"),
    [
        ([], "no publisher on /battery"),
        (["std_msgs/Float32"], None),
        (["std_msgs/msg/Float32"], None),
        (["sensor_msgs/msg/Temperature", "std_msgs/msg/Float32"], None),
        (
            ["sensor_msgs/Temperature"],
            "/battery is published as sensor_msgs/Temperature, configured as std_msgs/Float32",
        ),
        (["nonsense"], "/battery is published as nonsense, configured as std_msgs/Float32"),
    ],
)
def test_the_publishers_give_the_reason(types: list[str], text: str | None) -> None:
    assert explain("/battery", "std_msgs/Float32", types) == text
    assert explain("/battery", "std_msgs/msg/Float32", types) == text


def test_without_a_configured_type_any_type_is_right() -> None:
    assert explain("/battery", "", ["sensor_msgs/Temperature"]) is None


def test_names_from_outside_are_bounded_and_have_no_control_characters() -> None:
    text = explain("/battery", FLOAT32, ["a\x1b[2J/" + "b" * 10_000])
    assert text is not None and len(text) < 250 and text.isprintable()
    text = explain("/battery", FLOAT32, [], gone=["/battery\n\x1b[2J" + "b" * 10_000])
    assert text is not None and len(text) < 250 and text.isprintable()


@pytest.mark.parametrize(
    ("wanted", "other"),
    [
        ("/battery", "/battery_state"),
        ("/battery", "/robot1/battery"),
        ("/battery_state", "/BatteryState"),
        ("/batery", "/battery"),  # left out
        ("/battrey", "/battery"),  # exchanged
        ("/scam", "/scan"),  # replaced
    ],
)
def test_a_name_is_similar(wanted: str, other: str) -> None:
    assert similar_topic(wanted, FLOAT32, {other: "sensor_msgs/Range"}) == other


@pytest.mark.parametrize(
    ("wanted", "other"),
    [
        ("/battery", "/battery"),  # itself
        ("/battery", "/temperature"),
        ("/imu", "/maximum"),
        ("/imu", "/imo"),
        ("/battery_left", "/battery_rights"),
        ("/cpu_usage", "/cpu_load"),
        ("/battery", "/"),
        ("/battery", ""),
    ],
)
def test_a_name_is_not_similar(wanted: str, other: str) -> None:
    assert similar_topic(wanted, FLOAT32, {other: FLOAT32}) is None


def test_the_configured_type_counts_unless_it_says_nothing_about_the_meaning() -> None:
    topics = {"/power": "sensor_msgs/msg/BatteryState", "/pressure": "std_msgs/msg/Float32"}
    assert similar_topic("/bat", BATTERY, topics) == "/power"
    assert similar_topic("/bat", FLOAT32, topics) is None
    assert similar_topic("/bat", "", topics) is None
    named = {**topics, "/bat_1": FLOAT32}
    assert similar_topic("/bat", BATTERY, named) == "/bat_1"  # a similar name comes first


def test_a_graph_of_any_size_is_read_in_part() -> None:
    topics = {f"/t{number}": FLOAT32 for number in range(20_000)}
    assert similar_topic("/battery", FLOAT32, {**topics, "/battery_state": BATTERY}) is None
    assert similar_topic("/" + "b" * 100_000, FLOAT32, {"/" + "b" * 99_999: BATTERY}) == "/" + "b" * 99_999
