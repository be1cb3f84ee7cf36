"""The text of a proposed file."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from robot_health_monitor.core.config.monitor_config import load_config
from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.proposal.measured import Measured
from robot_health_monitor.core.proposal.proposal import Proposed
from robot_health_monitor.core.proposal.suggestion import Setting, Signal
from robot_health_monitor.core.proposal.thresholds_file import thresholds_text, yaml_text


def signal(name: str, topic: str, **proposed: Any) -> Signal:
    measured = Measured(read_signal(name, {}))
    for number in range(3):
        measured.add(float(number), 1.0 + number)
    return Signal(name, topic, "number", {"topic": topic, "unit": "V"}, measured=measured, **proposed)


WATCHED: dict[str, Any] = {"proposed": {"warn_above": Setting(5.0, "why")}}
SHOWN: dict[str, Any] = {"seen": {"warn_above": Setting(5.0, "why")}, "left_out": ["too short"]}


def text(*signals: Signal, **more: Any) -> list[str]:
    return thresholds_text(["Made by hand."], {}, Proposed(list(signals), **more)).splitlines()


def test_settings_have_their_evidence() -> None:
    assert text(signal("a", "/a", **WATCHED), not_watched={"/b": "no message"}) == [
        "# Made by hand.",
        "alert_system:",
        "  ros__parameters:",
        "    signals:",
        "      a:",
        "        # 3 samples in 2 s",
        "        topic: /a",
        "        unit: V",
        "        warn_above: 5.0             # V; why",
        "    # Not watched:",
        "    #   /b: no message",
    ]


def test_a_range_that_was_not_seen_for_long_is_a_comment_that_can_become_a_line(tmp_path: Any) -> None:
    lines = text(signal("a", "/a", **WATCHED), signal("b", "/a", **SHOWN))
    assert lines[-1] == "      # b: {topic: /a, unit: V, warn_above: 5.0}  # seen 1 to 3 V in 2 s"
    file = tmp_path / "thresholds.yaml"
    file.write_text("\n".join(lines).replace("# b:", "b:"))
    assert list(load_config(file).signals) == ["a", "b"]


def test_numbers_without_bounds_for_the_same_reason_are_one_line() -> None:
    reasons = {"x": "constant", "n": "a counter", "y": "constant", **{f"c{number}": "a code" for number in range(20)}}
    fields = {("/a", field): reason for field, reason in reasons.items()}
    assert text(signal("a", "/a", **WATCHED), fields=fields)[-3:] == [
        "      # /a, x, y: constant",
        "      # /a, n: a counter",
        "      # /a, c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11, ...: a code",
    ]


def test_lists_are_bounded() -> None:
    lines = text(
        signal("a", "/a", **WATCHED),
        *(signal(f"b{number}", "/a", **SHOWN) for number in range(50)),
        fields={("/a", f"x{number}"): f"always {number}" for number in range(50)},
        not_watched={f"/t{number:04}": "no message" for number in range(2000)},
    )
    assert len(lines) < 110
    assert "      # /a: 38 more of them" in lines
    assert "      # /a: 38 more without bounds" in lines
    assert lines[-1] == "    #   and 1,940 other topics"


def test_names_from_a_robot_cannot_break_out_of_a_comment() -> None:
    lines = text(signal("a", "/a", **WATCHED), fields={("/a", 'effort["x\n  evil: 1"]'): "constant"})
    assert not any(line.strip().startswith("evil") for line in lines)


HOSTILE_TOPICS = [
    "/a: b", "/a #b", "/a\n  evil: 1", "/a\r\nevil: 1", "/a\tb", "/'", '/"', "/\\", "/{a: 1}", "/[a]", "/&a", "/*a",
    "/!!python/object:os.system", "/%a", "/@a", "/`a`", "/|", "/>", "/~", "/null", "/\x1b[2J", "/\x00", "/\u2028x",
    "/\u202etxt", "/\ud800", "/\ufeff", "/" + "a" * 500, "/ ", "/---",
]  # fmt: skip


@pytest.mark.parametrize("topic", HOSTILE_TOPICS)
def test_a_topic_of_any_name_stays_what_it_is_and_where_it_is(topic: str) -> None:
    lines = text(signal("a", topic, **WATCHED), signal("b", topic, **SHOWN), not_watched={topic: "no message"})
    tree = yaml.safe_load("\n".join(lines))
    signals = tree["alert_system"]["ros__parameters"]["signals"]
    assert list(tree) == ["alert_system"] and list(signals) == ["a"]
    assert signals["a"]["topic"] == topic and signals["a"]["warn_above"] == 5.0
    assert all(line.isprintable() for line in lines)


@pytest.mark.parametrize(
    "value", [1e-05, 1e300, "on", "a b", "y", "N", "~", "", "%", 'effort["a"]', [1.0], {"is": 1.0}, True, 5]
)
def test_values_are_read_back_as_they_are(value: Any) -> None:
    assert yaml.safe_load(yaml_text(value)) == value
