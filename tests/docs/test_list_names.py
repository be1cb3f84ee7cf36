"""docs/reference/names.txt is what the code has; a name goes only with a new major version."""

from __future__ import annotations

import pydoc
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
SCRIPT: dict[str, Any] = runpy.run_path(str(DOCS / "list_names.py"))


def test_every_promised_name_exists_and_every_name_is_promised() -> None:
    wrong = SCRIPT["difference"](SCRIPT["promised"](), SCRIPT["names"]())
    assert wrong == "", f"\n{wrong}"


def test_every_call_of_the_library_can_be_imported_under_its_name() -> None:
    calls = {name for text in SCRIPT["names"]() for name in re.findall(r"^library ([\w.]+)\(", text)}
    assert {"core.load_config", "core.Monitor.observe", "core.nodes.AlertSystem", "core.port.LocalBus.node"} <= calls
    assert [name for name in sorted(calls) if pydoc.locate(f"robot_health_monitor.{name}") is None] == []


def test_the_difference_says_what_to_do() -> None:
    assert SCRIPT["difference"](["key a", "key b"], ["key a", "key b"]) == ""
    assert SCRIPT["difference"](["key a"], ["key a", "key b"]).splitlines() == [
        "+ key b",
        "These names are new: python docs/list_names.py writes them down.",
    ]
    lines = SCRIPT["difference"](["key a", "key b"], ["key a", "key c"]).splitlines()
    assert lines[0] == "- key b" and lines[3] == "+ key c"
    assert "Keep each beside its new one" in lines[1] and "only a new major version may remove it" in lines[2]


@pytest.mark.parametrize(
    ("written", "version", "may"),
    [("0.1.0", "0.2.0", True), ("0.1.0", "1.0.0", True), ("1.0.0", "1.1.0", False), ("1.9.0", "2.0.0", True)],
)
def test_names_go_before_1_0_and_with_a_new_major_version(written: str, version: str, may: bool) -> None:
    assert SCRIPT["may_remove"](written, version) is may


@pytest.fixture
def script(tmp_path: Path) -> tuple[dict[str, Any], Path]:
    """The program with a file of its own, at version 1.4.0."""
    found = runpy.run_path(str(DOCS / "list_names.py"))
    file = tmp_path / "names.txt"
    found["write"].__globals__.update(FILE=file, package_version=lambda: "1.4.0", names=lambda: ["key a", "key b"])
    return found, file


def written(file: Path) -> list[str]:
    return file.read_text(encoding="utf-8").splitlines()


def test_new_names_are_written_down(script: tuple[dict[str, Any], Path]) -> None:
    found, file = script
    file.write_text(found["HEAD"].format(version="1.3.0") + "key a\n")
    found["write"]()
    assert written(file)[1:] == ["key a", "key b"]
    assert "as of version 1.4.0." in written(file)[0]


def test_a_name_is_not_removed_in_a_minor_version(script: tuple[dict[str, Any], Path]) -> None:
    found, file = script
    before = found["HEAD"].format(version="1.3.0") + "key a\nkey old\n"
    file.write_text(before)
    with pytest.raises(SystemExit, match=r"^- key old\n"):
        found["write"]()
    assert file.read_text() == before


def test_a_major_version_may_remove_names(script: tuple[dict[str, Any], Path]) -> None:
    found, file = script
    file.write_text(found["HEAD"].format(version="0.9.0") + "key old\n")
    found["write"]()
    assert written(file)[1:] == ["key a", "key b"]


def test_names_of_each_kind_are_listed() -> None:
    """Written by hand, so that a kind that is lost is noticed."""
    assert {
        "API signal judged_unit",
        "alert in JSON from_level",
        "command silence add",
        "executable health_monitor",
        "exit code 2 USAGE",
        "key aggregator method",
        "key alert_system publish_rate",
        "key alert_system signals.*.only_if.signal",
        "key alert_system signals.*.warn_below",
        "key battery_sensor battery_level.source",
        "key alert_system signals.*.statistic: largest_gap_s",
        "key battery_sensor host.*.source: process_memory",
        "key battery_sensor host.*.command of process_memory",
        "key fleet.yaml defaults.namespace",
        "key fleet.yaml robots.*.url",
        "column of history --csv from_level",
        "column of history --samples --csv good",
        "key ops.yaml history.keep_days",
        "key ops.yaml notify.*.min_level",
        "launch argument composed",
        "library core.ConfigError.others",
        "library core.Level.STALE",
        "library core.Monitor.observe(sample)",
        "library core.Monitor(robot=)",
        "library core.Transition.fingerprint",
        "library core.load_config(node=)",
        "metric robot_health_samples_total{robot,signal,quality}",
        "option connect --fleet",
        "option export prometheus --interval",
        "option silence add --reason",
        "request POST /api/reset",
        "service /alert_system/reset std_srvs/Trigger",
        "status alert_system: SIGNAL good_samples",
        "status alert_system: monitor uptime_s",
        "topic aggregator publishes /system_health std_msgs/Float32",
        "topic alert_system publishes /alerts diagnostic_msgs/DiagnosticStatus",
    } <= set(SCRIPT["names"]())
