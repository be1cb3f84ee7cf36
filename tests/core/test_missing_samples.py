"""Why a topic brings no samples."""

from __future__ import annotations

from typing import Dict, List, Optional, Tuple

import pytest

from robot_health_monitor.core.missing_samples import Answer, Hints, explain, similar_topics

FLOAT32 = "std_msgs/Float32"
BATTERY = "sensor_msgs/BatteryState"


class Lookup:
    """Answers later, with what `answer` sets."""

    def __init__(self) -> None:
        self.asked: List[Tuple[str, str]] = []
        self.waiting: List[Answer] = []
        self.now_s = 1000.0

    def __call__(self, topic: str, type_name: str, answer: Answer) -> None:
        self.asked.append((topic, type_name))
        self.waiting.append(answer)

    def answer(self, text: Optional[str]) -> None:
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
def test_the_publishers_give_the_reason(types: List[str], text: Optional[str]) -> None:
    assert explain("/battery", "std_msgs/Float32", types, []) == text
    assert explain("/battery", "std_msgs/msg/Float32", types, []) == text


def test_without_a_configured_type_any_type_is_right() -> None:
    assert explain("/battery", "", ["sensor_msgs/Temperature"], []) is None
    assert explain("/battery", "", [], ["/battery_state"]) == "no publisher on /battery; /battery_state exists"


def test_names_from_outside_are_bounded_and_have_no_control_characters() -> None:
    text = explain("/battery", FLOAT32, ["a\x1b[2J/" + "b" * 10_000], [])
    assert text is not None and len(text) < 250 and text.isprintable()
    text = explain("/battery", FLOAT32, [], ["/battery\n\x1b[2J" + "b" * 10_000])
    assert text is not None and len(text) < 250 and text.isprintable()


@pytest.mark.parametrize(
    ("wanted", "other"),
    [
        ("/battery", "/battery_state"),
        ("/battery_state", "/battery"),
        ("/battery", "/robot1/battery"),
        ("/robot1/battery", "/battery"),
        ("/battery_state", "/BatteryState"),
        ("/odom", "/wheel_odometry"),
        ("/batery", "/battery"),  # left out
        ("/battterry", "/batterry"),  # added
        ("/bettery", "/battery"),  # replaced
        ("/abttery", "/battery"),  # exchanged, at the begin
        ("/battrey", "/battery"),  # exchanged, within
        ("/batteyr", "/battery"),  # exchanged, at the end
        ("/scam", "/scan"),
    ],
)
def test_a_name_is_similar(wanted: str, other: str) -> None:
    assert similar_topics(wanted, FLOAT32, {other: "sensor_msgs/Range"}) == [other]


@pytest.mark.parametrize(
    ("wanted", "other"),
    [
        ("/battery", "/battery"),  # itself
        ("/battery", "/temperature"),
        ("/imu", "/maximum"),
        ("/imu", "/imo"),
        ("/a", "/b"),
        ("/battery_left", "/battery_rights"),
        ("/cpu_usage", "/cpu_load"),
        ("/", "/battery"),
        ("/battery", "/"),
        ("/battery", ""),
    ],
)
def test_a_name_is_not_similar(wanted: str, other: str) -> None:
    assert similar_topics(wanted, FLOAT32, {other: FLOAT32}) == []


def test_the_configured_type_counts_unless_it_says_nothing_about_the_meaning() -> None:
    topics = {"/power": "sensor_msgs/msg/BatteryState", "/pressure": "std_msgs/msg/Float32"}
    assert similar_topics("/bat", BATTERY, topics) == ["/power"]
    assert similar_topics("/bat", FLOAT32, topics) == []
    assert similar_topics("/bat", "", topics) == []


def test_the_best_comes_first() -> None:
    topics: Dict[str, str] = {
        "/power": BATTERY,  # the type only
        "/battery_current": FLOAT32,  # part of the name
        "/battery_state": BATTERY,  # part of the name, and the type
        "/batterx": FLOAT32,  # a typing mistake
        "/robot2/battery": FLOAT32,  # the same last part
    }
    expected = ["/robot2/battery", "/batterx", "/battery_state", "/battery_current", "/power"]
    assert similar_topics("/battery", BATTERY, topics) == expected
    assert similar_topics("/battery", BATTERY, topics, own={"/battery_state", "/power"}) == [
        "/robot2/battery",
        "/batterx",
        "/battery_current",
    ]


def test_a_graph_of_any_size_costs_a_bounded_time() -> None:
    topics = {f"/t{number}": FLOAT32 for number in range(20_000)}
    assert similar_topics("/battery", FLOAT32, {**topics, "/battery_state": BATTERY}) == []
    assert similar_topics("/" + "b" * 100_000, FLOAT32, {"/" + "b" * 99_999: BATTERY}) == ["/" + "b" * 99_999]
