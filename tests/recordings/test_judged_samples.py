"""A replay's numbers are those that were judged: the samples that `history --samples --json` has of the live run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Mapping, NamedTuple

import pytest

pytest.importorskip("mcap")
pytest.importorskip("numpy")

from harness.black_boxes import BOOT_S, START_S, RecordedRobot
from harness.field_timeline import BATTERY, DIAGNOSTICS, FIELDS, JOINTS
from harness.port_conformance import FLOAT32
from harness.port_conformance import START_S as SCENE_START_S
from harness.recorded import ROS2, START_NS, Recorded, message_of, write_mcap

from robot_health_monitor.__main__ import main
from robot_health_monitor.cli.embedded import sections_of_nodes
from robot_health_monitor.cli.operations import Operations
from robot_health_monitor.cli.testing.past_alert import attached
from robot_health_monitor.core.config.signal_config import STATISTICS
from robot_health_monitor.ops.configuration import BlackBoxSettings, HistorySettings, OpsConfig
from robot_health_monitor.recordings.judging import Judge
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings

VALUES: Mapping[str, Mapping[str, Any]] = {
    "charge": {"topic": "battery", "type": BATTERY, "field": "charge", "scale": 0.5, "placeholders": [57.9375]},
    "age": {"topic": "battery", "type": BATTERY, "field": "header.stamp", "valid_min": 0.0},
    "spread": {"topic": "battery", "type": BATTERY, "field": "cell_voltage[*]", "reduce": "spread", "scale": 10.0},
    "effort": {"topic": "joints", "type": JOINTS, "field": 'effort["wheel_*"]'},
    "arrivals": {"topic": "scan", "type": FLOAT32, "field": ""},
    "level": {"topic": "drivers", "type": DIAGNOSTICS, "field": 'status["*"].level', "valid_max": 3.0},
}
"""A plain number, a time, the reduction of an array, its elements, arrivals, and a number of drivers."""
FORECAST = {"forecast_s": 5.0}
SIGNALS = {
    **FIELDS.signals,
    **{
        f"{name}_{statistic}": {
            **signal,
            **({"statistic": statistic, "window_s": 4.0} if statistic != "last" else {}),
            **(FORECAST if statistic == "forecast" else {}),
        }
        for name, signal in VALUES.items()
        for statistic in STATISTICS
    },
}


class Totals(NamedTuple):
    """The samples of one signal."""

    good: int
    bad: int
    least: float | None
    most: float | None


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> RecordedRobot:
    """Returns a robot that has published the timeline, with a history and a black box that has all of it."""
    folder = tmp_path_factory.mktemp("live")
    config = OpsConfig(
        history=HistorySettings(str(folder / "history.db")),
        black_box=BlackBoxSettings(str(folder / "box"), before_s=60.0, after_s=60.0),
    )
    now_s = [START_S]
    operations = Operations(config, lambda: BOOT_S + now_s[0], lambda: now_s[0])
    robot = RecordedRobot(folder / "box", SIGNALS, operations=operations)
    for each in FIELDS.messages:
        now_s[0] = each.time_s - SCENE_START_S + START_S
        robot.bus.run_until(now_s[0])
        robot.publish(each.topic, stamped(each.message, BOOT_S + START_S), each.type_name)
    robot.close()
    return robot


def stamped(message: Mapping[str, Any], start_s: float) -> dict[str, Any]:
    """Returns a message whose stamp, if it has one, counts from another start of the timeline."""
    stamp = message.get("header", {}).get("stamp")
    if not stamp or not any(stamp.values()):
        return dict(message)
    return {**message, "header": {"stamp": {**stamp, "sec": stamp["sec"] + round(start_s - SCENE_START_S)}}}


def stored(robot: RecordedRobot, capsys: pytest.CaptureFixture[str]) -> dict[str, Totals]:
    """Returns the samples of the live run."""
    assert main(["history", "--samples", "--json", str(robot.folder.parent / "history.db")]) == 0
    found: dict[str, Totals] = {}
    for row in map(json.loads, capsys.readouterr().out.splitlines()):
        good, bad, least, most = found.get(row["signal"], Totals(0, 0, None, None))
        if row["min"] is not None:
            least = row["min"] if least is None else min(least, row["min"])
            most = row["max"] if most is None else max(most, row["max"])
        found[row["signal"]] = Totals(good + row["good"], bad + row["bad"], least, most)
    return found


def replayed(file: str, tree: Mapping[str, Any] | None = None) -> dict[str, Totals]:
    """Returns the samples of a replay, as its table has them; of a black box with its own thresholds and states."""
    found = {}
    with Recordings([file]) as recordings:
        file, saved = attached(recordings)
        begin_ns = None if saved is None else round(saved.time_s * 1e9)
        judge = Judge(Player(recordings, begin_ns=begin_ns), lambda event: None)
        judge.add("", tree or sections_of_nodes(file)["alert_system"].tree, saved)
        judge.run()
        for summary in judge.summaries:
            each = summary.samples
            found[summary.config.name] = Totals(each.good, each.bad, each.least, each.most)
    return found


def check(found: Mapping[str, Totals], expected: Mapping[str, Totals]) -> None:
    """Requires the same samples. Stamps of the timeline lose digits when they are moved to another year."""
    assert found.keys() == expected.keys()
    for name, (good, bad, *ends) in expected.items():
        assert (found[name].good, found[name].bad) == (good, bad), name
        assert list(found[name][2:]) == pytest.approx(ends, abs=1e-5), name


@pytest.mark.newest_python
def test_a_replay_has_the_samples_of_the_run(
    live: RecordedRobot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start_s = START_NS / 1e9
    messages = [
        Recorded(
            each.time_s - SCENE_START_S,
            each.topic,
            message_of(ROS2, each.type_name.replace("/", "/msg/"), stamped(each.message, start_s)),
        )
        for each in FIELDS.messages
    ]
    expected = stored(live, capsys)
    check(replayed(write_mcap(tmp_path / "run.mcap", messages), {"signals": SIGNALS}), expected)
    assert expected["age_last"] == Totals(56, 8, 0.0625, 0.75)
    assert expected["spread_max"].most == 6.25


@pytest.mark.newest_python
def test_the_replay_of_a_black_box_has_the_samples_of_the_run(
    live: RecordedRobot, capsys: pytest.CaptureFixture[str]
) -> None:
    (file,) = live.folder.glob("*.mcap")
    check(replayed(str(file)), stored(live, capsys))
